"""Tesseract's TrajOpt: sequential convex optimisation with continuous collision checking."""

import importlib
import os
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers.common import Answer, Planner, goal_configurations, timed
from benchmarks.peers.description import BASE, GROUP, TIP, obstacles, srdf, urdf
from benchmarks.registry import NotAvailableError
from optipromp.core.arrays import FloatArray
from optipromp.core.planning.task import Task, resolve
from optipromp.core.scenes.scene import Scene

STEPS = 30  # of the interpolated program
MARGIN = 0.01  # [m] wanted clearance
BUFFER = 0.02  # [m] beyond it that is looked at
PROFILE, NAMESPACE = "benchmark", "TrajOptMotionPlannerTask"
PLUGIN = "libtesseract_collision_bullet_factories"
CONTACTS = """\
contact_manager_plugins:
  search_paths: [{folder}]
  search_libraries: [{library}]
  discrete_plugins:
    default: BulletDiscreteBVHManager
    plugins:
      BulletDiscreteBVHManager: {{class: BulletDiscreteBVHManagerFactory}}
  continuous_plugins:
    default: BulletCastBVHManager
    plugins:
      BulletCastBVHManager: {{class: BulletCastBVHManagerFactory}}
"""


def trajopt() -> Planner:
    """TrajOpt from the straight line in joint space to our best goal configuration.

    Raises:
        NotAvailableError: tesseract-robotics is not installed, or has no collision checker.
    """
    os.environ.setdefault("TRAJOPT_LOG_THRESH", "FATAL")
    try:
        package = importlib.import_module("tesseract_robotics")
        for part in ("command_language", "motion_planners", "motion_planners_simple",
                     "motion_planners_trajopt", "environment", "common"):  # fmt: skip
            importlib.import_module(f"tesseract_robotics.tesseract_{part}")
    except ImportError as error:
        raise NotAvailableError(f"tesseract-robotics is not installed ({error})") from error
    libraries = Path(str(package.__file__)).parents[1] / "tesseract_robotics.libs"
    found = sorted(libraries.glob(f"{PLUGIN}*"))
    if not found:
        raise NotAvailableError("tesseract-robotics comes without Bullet's contact managers")
    contacts = CONTACTS.format(folder=libraries, library=found[0].name.removeprefix("lib")[:-3])

    def solve(scene: Scene, seed: int) -> Answer:
        setup = resolve(scene)
        goals = goal_configurations(setup, seed)
        if not len(goals):
            return Answer(None, "no goal configuration")
        environment = _environment(package, scene, setup, contacts)
        return _optimise(package, setup, environment, goals[0])

    return solve


def _environment(package: Any, scene: Scene, setup: Task, contacts: str) -> Any:
    objects = obstacles(scene)
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "contacts.yaml"
        path.write_text(contacts, encoding="utf-8")
        extra = f'<contact_managers_plugin_config filename="file://{path}"/>'
        environment = package.tesseract_environment.Environment()
        texts = urdf(setup.robot, objects), srdf(setup.robot, objects, extra)
        locator = package.tesseract_common.GeneralResourceLocator()
        if not environment.init(*texts, locator):
            raise RuntimeError("the environment did not start")
    return environment


def _optimise(package: Any, setup: Task, environment: Any, goal: FloatArray) -> Answer:
    language, common = package.tesseract_command_language, package.tesseract_common
    trajopt, simple = (
        package.tesseract_motion_planners_trajopt, package.tesseract_motion_planners_simple,
    )  # fmt: skip
    manipulator = common.ManipulatorInfo()
    manipulator.manipulator, manipulator.working_frame, manipulator.tcp_frame = GROUP, BASE, TIP
    program = language.CompositeInstruction(PROFILE)
    program.setManipulatorInfo(manipulator)
    for q in (setup.start, goal):
        point = language.JointWaypoint(list(setup.robot.joint_names), np.array(q))
        move = language.MoveInstruction(
            language.JointWaypointPoly_wrap_JointWaypoint(point),
            language.MoveInstructionType_FREESPACE, PROFILE,
        )  # fmt: skip
        program.appendMoveInstruction(language.MoveInstructionPoly_wrap_MoveInstruction(move))
    profiles = language.ProfileDictionary()
    profiles.addProfile(NAMESPACE, PROFILE, trajopt.TrajOptDefaultPlanProfile())
    profiles.addProfile(NAMESPACE, PROFILE, _profile(trajopt))
    request = package.tesseract_motion_planners.PlannerRequest()
    request.instructions = simple.generateInterpolatedProgram(
        program, environment, 3.14, 1.0, 3.14, STEPS
    )
    request.env, request.profiles = environment, profiles
    response = trajopt.TrajOptMotionPlanner(NAMESPACE).solve(request)
    path = np.array([_positions(language, step) for step in response.results.flatten()])
    if len(path) < 3:
        return Answer(None, str(response.message))
    return Answer(timed(setup, path), "" if response.successful else str(response.message))


def _profile(trajopt: Any) -> Any:
    """Collision as a constraint and a cost, checked along each segment; smooth velocities."""
    profile = trajopt.TrajOptDefaultCompositeProfile()
    profile.smooth_velocities = True
    for config, margin in (
        (profile.collision_constraint_config, MARGIN / 2),
        (profile.collision_cost_config, MARGIN),
    ):
        config.enabled = True
        config.safety_margin, config.safety_margin_buffer = margin, BUFFER
        config.type = trajopt.CollisionEvaluatorType_CAST_CONTINUOUS
        config.coeff = 10.0
    return profile


def _positions(language: Any, step: Any) -> FloatArray:
    move = language.InstructionPoly_as_MoveInstructionPoly(step)
    state = language.WaypointPoly_as_StateWaypointPoly(move.getWaypoint())
    return np.asarray(state.getPosition(), dtype=np.float64).ravel()
