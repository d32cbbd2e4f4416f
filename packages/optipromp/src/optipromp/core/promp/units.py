"""Units and names of recordings that are not ours, as those of LeRobot's arms."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError
from optipromp.core.scenes.values import suggest

Unit = Literal["radians", "degrees", "range"]
STEPS = 4095.0  # of a turn: of the servos that LeRobot calibrates, by its MotorsBus
HALF = 100.0  # of LeRobot's range on either side of its middle


@dataclass(frozen=True)
class Units:
    """What a recording's columns are.

    Attributes:
        unit: of turning joints; ``range``: LeRobot's -100 to 100 of what was calibrated.
        ranges: by column, the angle of that range [rad], negative where the servo is mounted the
            other way round.
        names: other names of columns; the empty one leaves a column out.
        slides: joints that keep their unit [m], by their new names.
    """

    unit: Unit = "radians"
    ranges: Mapping[str, float] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    slides: Collection[str] = ()

    @classmethod
    def of(
        cls,
        unit: Unit | None,
        calibration: Path | None,
        rename: Sequence[str],
        slides: Collection[str],
    ) -> "Units":
        """Of a command's options; ``rename``: OLD=NEW.

        Raises:
            InvalidRequestError: options that do not fit, or no calibration file of LeRobot.
        """
        pairs = [each.partition("=") for each in rename]
        for each, (old, sign, _) in zip(rename, pairs, strict=True):
            if not (old and sign):
                raise InvalidRequestError(f"--rename {each}: must be OLD=NEW, or OLD= to leave out")
        if (unit == "range") != (calibration is not None):
            raise InvalidRequestError(
                "--unit range and --calibration FILE go together: LeRobot's file of the arm says "
                "which angles are -100 and 100"
            )
        ranges = {} if calibration is None else _ranges(calibration)
        return cls(unit or "radians", ranges, {old: new for old, _, new in pairs}, slides)

    def __call__(
        self, columns: Sequence[str], positions: FloatArray
    ) -> tuple[list[str], FloatArray]:
        """Names and positions (m, n) [rad or m] of a recording's ``columns``.

        Raises:
            InvalidDemonstrationError: a column that is renamed, or whose range is not known.
        """
        for asked, known in ((self.names, columns), (columns, self.ranges)):
            for name in asked if asked is self.names or self.unit == "range" else ():
                if name not in known:
                    what = "column" if known is columns else "calibrated joint"
                    raise InvalidDemonstrationError(f"no {what} {name!r}: {suggest(name, known)}")
        names = [self.names.get(column, column) for column in columns]
        factor = np.ones(len(names))
        for k, (column, name) in enumerate(zip(columns, names, strict=True)):
            if self.unit == "degrees" and name not in self.slides:
                factor[k] = math.radians(1.0)
            elif self.unit == "range":
                factor[k] = self.ranges[column] / (2.0 * HALF)
        kept = [k for k, name in enumerate(names) if name]
        return [names[k] for k in kept], np.asarray(positions * factor)[:, kept]


def _ranges(path: Path) -> dict[str, float]:
    """The angles [rad] of what was calibrated, by joint, of LeRobot's calibration file."""
    content = read_document(path, InvalidRequestError, "a calibration of LeRobot")
    try:
        return {
            name: 2.0 * math.pi / STEPS
            * (float(each["range_max"]) - float(each["range_min"]))
            * (-1.0 if each.get("drive_mode") else 1.0)
            for name, each in content.items()
        }  # fmt: skip
    except (AttributeError, KeyError, TypeError, ValueError) as error:
        raise InvalidRequestError(
            f"{path}: no calibration of LeRobot: each joint must have range_min and range_max "
            f"({error!r})"
        ) from None
