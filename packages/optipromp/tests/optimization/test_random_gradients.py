"""Every cost and constraint on random trajectories, surroundings and settings, kinks included.

The derivative along a direction lies between the one from before and the one to after. Where a
formula is smooth both agree, and the gradient is tested to the last digits that differences have;
where the nearest sphere, face or edge changes, any of the sides is right and nothing else.
The variable GRADIENTS sets how many cases there are (docs/judged.md).
"""

import os
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.optimization.terms import CONSTRAINTS, TERMS, constraints, terms

from optipromp.core.geometry import Box, Capsule, Cylinder, HalfSpace, Sphere, pack
from optipromp.core.optimization.problem import Surroundings

often = settings(max_examples=int(os.environ.get("GRADIENTS", "12")), deadline=None)
seeds = st.integers(0, 10**6)
STEP = 1e-6
ROBOTS = "panda", "scara", "mimic"


def turned(rng: np.random.Generator) -> np.ndarray:
    axes, _ = np.linalg.qr(rng.normal(size=(3, 3)))
    axes[:, 0] *= np.sign(np.linalg.det(axes))
    return np.asarray(axes)


def objects(rng: np.random.Generator, case: Any, count: int) -> list[Any]:
    """Near or around body spheres; a quarter of them centred exactly on one, unturned."""
    size = np.exp(rng.uniform(np.log(0.005), np.log(0.2), (count, 3)))
    shapes = [
        (Sphere(a), Box((a, b, c)), Cylinder(a, b), Capsule(a, b), HalfSpace())[rng.integers(5)]
        for a, b, c in size
    ]
    out = []
    for shape in shapes:
        waypoint, index = rng.integers(len(case.q)), rng.integers(len(case.robot.spheres.radius))
        exact = rng.random() < 0.25
        away = 0.0 if exact else rng.uniform(0.0, 0.15)
        at = case.robot.sphere_centers(case.q[waypoint])[index]
        off = rng.normal(size=3)
        at = at + away * off / np.linalg.norm(off)
        out.append((shape, at, np.eye(3) if exact else turned(rng)))
    return out


def drawn(case: Any, seed: int) -> tuple[Any, Surroundings, np.random.Generator]:
    """A random trajectory of the case's robot, and surroundings."""
    rng = np.random.default_rng(seed)
    size = rng.choice([0.0, 1e-9, 0.02, 0.3])  # an arm that stands, and ever larger motions
    knots = rng.normal(0.0, 1.0, (3, case.q.shape[1]))
    z = np.linspace(0.0, 1.0, len(case.q))[:, None]
    q = case.q[rng.integers(len(case.q))] + size * (
        knots[0] * z + knots[1] * np.sin(3 * z) + knots[2] * z**2
    )
    case = replace(case, q=q)
    avoid = objects(rng, case, int(rng.integers(0, 3)))
    push = [o for o in objects(rng, case, 2) if not isinstance(o[0], HalfSpace)]
    around = Surroundings(pack(objects(rng, case, 3)), pack([*avoid, *push]), len(avoid))
    return case, around, rng


@pytest.mark.parametrize("name", [*TERMS, *CONSTRAINTS])
@given(which=st.sampled_from(ROBOTS), seed=seeds)
@often
def test_the_slope_is_between_those_of_both_sides(name, which, seed, cases):
    case, around, rng = drawn(cases[which], seed)
    cost = {**terms(case), **constraints(case)}[name]
    problem = case.problem([cost], surroundings=around)
    direction = rng.normal(size=case.q.shape)
    if rng.random() < 0.3:  # one joint at one waypoint
        one = np.zeros_like(direction)
        at = rng.integers(problem.first, problem.last + 1), rng.integers(case.q.shape[1])
        one[at] = 1.0
        direction = one
    direction[: problem.first] = direction[problem.last + 1 :] = 0.0
    direction /= np.linalg.norm(direction)
    middle = problem.evaluate(case.q).merit
    gradient = problem.gradient()
    assert np.isfinite(middle)
    assert np.isfinite(gradient).all()
    low, high = (problem.evaluate(case.q + s * STEP * direction).merit for s in (-1.0, 1.0))
    before, after = (middle - low) / STEP, (high - middle) / STEP
    slope, size = float((gradient * direction).sum()), float(np.abs(gradient).max())
    rounding = 1e-15 * max(abs(middle), 1e-9) / STEP * 100.0
    room = 1e-4 * (size + abs(before) + abs(after)) + rounding
    assert min(before, after) - room <= slope <= max(before, after) + room
