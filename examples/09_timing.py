"""Waypoints of any arm become a jerk-limited curve, without a scene and without a robot file.

``timed`` keeps velocity, acceleration and jerk within their limits at every instant, and stops only
where it is asked to.
"""

import numpy as np

from optipromp.timing import timed

waypoints = np.array([
    [0.0, -0.8, 0.0, -2.3, 0.0, 1.6],
    [0.4, -0.5, 0.2, -2.0, 0.1, 1.5],
    [0.9, -0.4, 0.1, -1.8, 0.3, 1.2],
    [1.3, -0.7, -0.2, -2.1, 0.2, 1.4],
])  # fmt: skip
limits = {"velocity": [2.0, 2.0, 2.0, 2.5, 3.0, 3.0], "acceleration": 10.0, "jerk": 200.0}

through = timed(waypoints, **limits)
resting = timed(waypoints, **limits, stops=[2])
for name, curve in (("through", through), ("with a rest at waypoint 2", resting)):
    rows = curve.resample(1000)  # for a controller at 1 kHz
    fastest = np.abs(rows.velocities).max(axis=0).round(2)
    print(f"{name}: {curve.duration:.2f} s, {rows.n_waypoints} rows, at most {fastest} rad/s")
