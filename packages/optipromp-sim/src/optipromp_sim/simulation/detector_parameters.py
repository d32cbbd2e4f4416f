"""The numbers of a camera with a detector behind it."""

import math
from dataclasses import dataclass, replace
from typing import Annotated, Literal

from annotated_types import Gt, Le

from optipromp.core.errors import InvalidRequestError
from optipromp.core.parameters import parameter
from optipromp.core.values import Part, Positive
from optipromp_sim.detection import Noise

View = Annotated[float, Gt(0.0), Le(math.pi)]


@dataclass(frozen=True)
class DetectorParameters(Noise):
    """Where the camera is, how late it is and what the detector does wrong.

    Standard deviations, ``bias`` and ``angle`` hold at the distance ``reference`` and grow with the
    square of the distance.

    Raises:
        InvalidRequestError: a number that is not finite, out of its range, or an unknown mount.
    """

    signed = "bias", "lower", "stamp"
    # palm: on the tool's axis; hand: on the flange; beside: standing
    mount: Literal["palm", "hand", "beside"] = parameter("palm", "", "choice", "its place")
    view: View = parameter(1.4, "rad", "choice", "full angle of the view; RGB-D: 42-87 degrees")
    rate: Positive = parameter(20.0, "Hz", "reported", "pictures; detectors run at 10-30 Hz")
    latency: float = parameter(0.06, "s", "reported", "exposure to detections; 0.03-0.1 s reported")
    reference: Positive = parameter(0.45, "m", "choice", "distance at which the errors hold")
    along: float = parameter(1.0, "1", "choice", "deviation along the sight over that across")
    least_position: float = parameter(0.001, "m", "guess", "least deviation, of a position above 0")
    steady: Part = parameter(0.3, "1", "guess", "of the variance, for a run: an unseen part")
    bias: float = parameter(0.0, "m", "choice", "along the line of sight; positive: too far")
    hidden_from: Part = parameter(0.0, "1", "choice", "hidden share: missed more often above it")
    hidden_to: Part = parameter(1.0, "1", "choice", "share from which it is as if wholly hidden")
    missed_steadily: Part = parameter(0.5, "1", "guess", "of misses: until the slot ends")
    slot: Positive = parameter(0.5, "s", "guess", "how long a steady miss or a hidden stem lasts")
    false: float = parameter(0.0, "1", "choice", "mean count of false detections in a picture")
    swapped: Part = parameter(0.0, "1", "choice", "probability that two detections swap ids")
    stem_seen: Part = parameter(1.0, "1", "choice", "probability, held for a slot")
    leaf: Part = parameter(0.0, "1", "choice", "share of fruits with a leaf to the first picture")
    leaf_size: Positive = parameter(
        1.3, "1", "guess", "radius over its fruit's; hangs two before it"
    )
    camera_offset: float = parameter(0.0, "m", "choice", "deviation of its place an axis, in a run")
    camera_turn: float = parameter(0.0, "deg", "choice", "the same of its turn about each axis")
    told: bool = parameter(True, "", "choice", "whether covariances include camera errors")
    near: float = parameter(0.0, "m", "choice", "of a centre: nearer is not measured; D405: 0.07")
    far: float = parameter(math.inf, "m or inf", "choice", "of a centre: farther is not measured")
    # at which the arm's pose is taken; negative: early
    stamp: float = parameter(0.0, "s", "choice", "from the exposure to its stamp")
    # pictures are that before, with stamps that go on, once
    frozen: float = parameter(0.0, "s", "choice", "for how long, from ``frozen_at`` on")
    frozen_at: float = parameter(0.15, "m", "choice", "distance of the target from the camera")
    palm_below: float = parameter(0.03, "m", "choice", "camera in the palm, behind the rim")
    hand_aside: float = parameter(0.03, "m", "choice", "hand camera, beyond the mouth's radius")
    hand_below: float = parameter(0.06, "m", "choice", "of the hand camera, behind the rim")
    aim: Positive = parameter(0.15, "m", "choice", "mid-view, on the tool axis before the rim")
    stand_away: float = parameter(0.40, "m", "choice", "standing camera to the target")
    stand_below: float = parameter(0.15, "m", "choice", "the same, behind or above the target")

    def __post_init__(self) -> None:
        super().__post_init__()
        if not self.hidden_from < self.hidden_to:
            raise InvalidRequestError(
                f"hidden_from is {self.hidden_from:g}: must be below hidden_to, {self.hidden_to:g}"
            )

    def sigma(self, distance: float) -> float:
        """Standard deviation [m] of each coordinate at a ``distance`` [m], white and steady."""
        if self.position == 0.0:
            return 0.0
        return max(self.position * (distance / self.reference) ** 2, self.least_position)


_WHITE = DetectorParameters(position=0.005, angle=5.0)

DETECTORS: dict[str, DetectorParameters] = {
    "perfect": DetectorParameters(),
    "zero-mean": _WHITE,
    "detector": replace(
        _WHITE, bias=0.010, missed=0.05, hidden=0.5, stem_seen=0.65, false=0.02, swapped=0.02
    ),
}
"""Detectors by name.

``perfect`` is late and takes 20 pictures a second, but has no errors; it sees hidden fruits too.

Centres of strawberries from what one RGB-D view shows of them are 8.9 mm off, with the shape
completed 5.7 mm (Ge, Xiong, From 2020, doi 10.1016/j.biosystemseng.2020.07.003): hence 10 mm, and
5 mm a coordinate. Inclinations are 6.4-7.5° off (strawberries, sweet peppers, flowers), 6.4° about
each axis at most: hence 5°. Recall is 95.4 % of strawberries (Yu et al. 2019, Mask R-CNN) and
90.5 % of greenhouse tomatoes (Gao et al. 2022, doi 10.18280/ts.390130): hence 5 %. The half of
those that are wholly hidden is a guess. Labellers found the end of the stem hidden for 35 % of
1,704 strawberries (StrawDI with key points, Tafuro et al., ICRA 2022): hence 0.65. Rates of false
detections and of exchanged ids are guesses.
"""

EYES: dict[str, DetectorParameters] = {
    "beside": DetectorParameters(
        mount="beside", view=0.93, rate=9.7, latency=0.13, position=0.0008, least_position=0.0004,
        along=2.82, bias=-0.0009, angle=1.6, reference=0.41, steady=0.59, missed=0.025,
        hidden=0.833, hidden_from=0.5, hidden_to=0.55, missed_steadily=0.54, slot=2.0,
        false=0.042, stem_seen=0.89,
    ),
    "palm": DetectorParameters(
        view=0.93, rate=10.6, latency=0.12, position=0.0006, least_position=0.0003, along=2.13,
        bias=0.0004, reference=0.16, steady=0.54, missed=0.045, hidden=0.974, hidden_from=0.65,
        hidden_to=0.7, missed_steadily=0.72, slot=2.0, stem_seen=0.0,
    ),
}  # fmt: skip
"""The eyes of :mod:`optipromp_eyes` on rendered pictures, by mount.

Fitted by ``scripts/fit_eyes.py --seeds 70400:70408`` to 48 pictures of ``cluster``, ``mixed`` and
``field`` from each mount, found by geometry; from the palm at the point where the approach of a
plan begins. No stems are taken from there.
"""
