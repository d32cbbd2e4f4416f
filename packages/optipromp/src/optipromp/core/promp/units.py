"""Units and names of recordings that are not ours, as those of LeRobot's arms."""

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import numpy as np

from optipromp.core.arrays import FloatArray
from optipromp.core.documents import read_document
from optipromp.core.errors import InvalidDemonstrationError, InvalidRequestError, suggest

STEPS = 4095.0  # of a turn, of the servos that LeRobot's MotorsBus calibrates


@dataclass(frozen=True)
class Units:
    """What a recording's columns are; called with their names and positions.

    Attributes:
        unit: of turning joints; ``range``: LeRobot's -100 to 100 of what was calibrated.
        ranges: by column, the angle of that range [rad], negative where the servo runs the other
            way.
        names: other names of columns; the empty one leaves a column out.
        slides: joints that keep their unit [m], by their new names.
    """

    unit: Literal["radians", "degrees", "range"] = "radians"
    ranges: Mapping[str, float] = field(default_factory=dict)
    names: Mapping[str, str] = field(default_factory=dict)
    slides: Collection[str] = ()

    def __call__(
        self, columns: Sequence[str], positions: FloatArray
    ) -> tuple[list[str], FloatArray]:
        """Names and positions (m, n) [rad or m]. Raises InvalidDemonstrationError."""
        calibrated = columns if self.unit == "range" else ()
        for what, asked, known in (
            ("column", self.names, columns), ("calibrated joint", calibrated, self.ranges),
        ):  # fmt: skip
            if lacking := [name for name in asked if name not in known]:
                told = f"no {what} {lacking[0]!r}: {suggest(lacking[0], known)}"
                raise InvalidDemonstrationError(told)
        names = [self.names.get(column, column) for column in columns]
        turns = np.array([name not in self.slides for name in names])
        factor = np.where(turns & (self.unit == "degrees"), math.radians(1.0), 1.0)
        if calibrated:
            factor = np.array([self.ranges[column] / 200.0 for column in columns])
        kept = [k for k, name in enumerate(names) if name]
        return [names[k] for k in kept], np.asarray(positions * factor)[:, kept]


def units_of(
    unit: Literal["radians", "degrees", "range"] | None, calibration: Path | None,
    rename: Sequence[str], slides: Collection[str],
) -> Units:  # fmt: skip
    """Of a command's options; ``rename``: OLD=NEW. Raises InvalidRequestError."""
    pairs = [each.partition("=") for each in rename]
    if wrong := [old for old, sign, _ in pairs if not (old and sign)]:
        raise InvalidRequestError(f"--rename {wrong[0]}: must be OLD=NEW, or OLD= to leave out")
    if (unit == "range") != (calibration is not None):
        told = "--unit range and --calibration FILE go together: LeRobot's file of the arm says"
        raise InvalidRequestError(f"{told} which angles are -100 and 100")
    ranges = {}
    if calibration is not None:
        content = read_document(calibration, InvalidRequestError, "a calibration of LeRobot")
        try:
            for name, each in content.items():
                steps = float(each["range_max"]) - float(each["range_min"])
                ranges[name] = steps / STEPS * (-2.0 if each.get("drive_mode") else 2.0) * math.pi
        except (AttributeError, KeyError, TypeError, ValueError, OverflowError) as error:
            told = "no calibration of LeRobot: each joint must have range_min and range_max"
            raise InvalidRequestError(f"{calibration}: {told} ({error!r})") from None
    return Units(unit or "radians", ranges, {old: new for old, _, new in pairs}, slides)
