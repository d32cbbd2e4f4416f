"""Drake's KinematicTrajectoryOptimization with our limits, obstacles and body spheres."""

import itertools
from typing import Any

import numpy as np

from benchmarks.peers.common import Answer, Planner, at_limits, goal_configurations
from benchmarks.peers.description import TIP, distal_links, exempt_pairs, urdf
from benchmarks.registry import NotAvailableError
from optipromp.core.arrays import FloatArray
from optipromp.core.geometry.shapes import Box, Capsule, Cylinder, Shape, Sphere
from optipromp.core.planning.task import Task, resolve
from optipromp.core.scenes.scene import PoseGoal, Scene

CONTROL_POINTS, ORDER = 12, 4
SLOWEST, FASTEST = 20.0, 0.3  # [s] bounds of the duration
INFLUENCE = 0.02  # [m] beyond which a distance is not looked at
TILT = np.deg2rad(1.9)
ITERATIONS = 200


def kinematic_trajectory_optimization(checks: int, margin: float) -> Planner:
    """The optimiser as its manual uses it: a B-spline, the goal, distances at some of its points.

    Args:
        checks: at how many points of the trajectory distances are constrained.
        margin: that is kept there [m].

    Raises:
        NotAvailableError: Drake is not installed.
    """
    try:
        import pydrake.all as drake
    except ImportError as error:
        raise NotAvailableError(f"drake is not installed ({error})") from error

    def solve(scene: Scene, seed: int) -> Answer:
        setup = resolve(scene)
        world = _World(drake, setup)
        goals = goal_configurations(setup, seed)
        if not len(goals):
            return Answer(None, "no goal configuration")
        return _optimise(drake, setup, world, goals[0], checks, margin)

    return solve


class _World:
    """A plant with the robot and the scene's obstacles, filtered by their roles."""

    def __init__(self, drake: Any, setup: Task) -> None:
        builder = drake.DiagramBuilder()
        self.plant, scene_graph = drake.AddMultibodyPlantSceneGraph(builder, time_step=0.0)
        drake.Parser(self.plant).AddModelsFromString(urdf(setup.robot), "urdf")
        self.plant.WeldFrames(self.plant.world_frame(), self.plant.GetFrameByName("base"))
        objects: dict[str, list[Any]] = {"static": [], "avoid": [], "pushable": []}
        for obj in setup.scene.objects:
            if obj.role == "target":
                continue
            pose = drake.RigidTransform(drake.RotationMatrix(obj.rotation), obj.position)
            geometry = self.plant.RegisterCollisionGeometry(
                self.plant.world_body(), pose, _shape(drake, obj.shape), obj.id,
                drake.CoulombFriction(),
            )  # fmt: skip
            objects[obj.role].append(geometry)
        self._filter(drake, setup, scene_graph, objects)
        self.plant.Finalize()
        self.diagram = builder.Build()
        self.root = self.diagram.CreateDefaultContext()
        self.context = self.plant.GetMyMutableContextFromRoot(self.root)

    def _filter(
        self, drake: Any, setup: Task, scene_graph: Any, objects: dict[str, list[Any]]
    ) -> None:
        robot = setup.robot

        def geometries(bodies: list[Any]) -> Any:
            found = [self.plant.GetCollisionGeometriesForBody(body) for body in bodies]
            return drake.GeometrySet(list(itertools.chain(*found)))

        link = {name: self.plant.GetBodyByName(name) for name in robot.link_names
                if self.plant.HasBodyNamed(name)}  # fmt: skip
        manager, apart = scene_graph.collision_filter_manager(), drake.CollisionFilterDeclaration
        for a, b in exempt_pairs(robot):
            declared = apart().ExcludeBetween(geometries([link[a]]), geometries([link[b]]))
            manager.Apply(declared)
        soft = drake.GeometrySet(objects["avoid"] + objects["pushable"])
        tool = geometries([link[name] for name in distal_links(robot)])
        manager.Apply(apart().ExcludeBetween(tool, soft))


def _shape(drake: Any, shape: Shape) -> Any:
    match shape:
        case Sphere(radius):
            return drake.Sphere(radius)
        case Box(size):
            return drake.Box(*size)
        case Cylinder(radius, length):
            return drake.Cylinder(radius, length)
        case Capsule(radius, length):
            return drake.Capsule(radius, length)
    raise NotAvailableError(f"{type(shape).__name__} is not written for Drake")


def _optimise(
    drake: Any, setup: Task, world: _World, goal: FloatArray, checks: int, margin: float
) -> Answer:
    robot, plant = setup.robot, world.plant
    n = robot.n_joints
    spline = drake.KinematicTrajectoryOptimization(n, CONTROL_POINTS, ORDER, 4.0)
    program = spline.get_mutable_prog()
    spline.AddDurationCost(1.0)
    spline.AddPathLengthCost(1.0)
    spline.AddPositionBounds(robot.lower, robot.upper)
    spline.AddVelocityBounds(-robot.velocity, robot.velocity)
    spline.AddAccelerationBounds(-robot.acceleration, robot.acceleration)
    spline.AddDurationConstraint(FASTEST, SLOWEST)
    spline.AddPathPositionConstraint(setup.start, setup.start, 0.0)
    for share in (0.0, 1.0):
        spline.AddPathVelocityConstraint(np.zeros(n), np.zeros(n), share)
    tip = plant.GetFrameByName(TIP)
    assert isinstance(setup.goal, PoseGoal)
    position, axis = setup.goal.position, setup.goal.axis
    near = np.full(3, 5e-4)
    spline.AddPathPositionConstraint(
        drake.PositionConstraint(
            plant, plant.world_frame(), position - near, position + near, tip, np.zeros(3),
            world.context,
        ), 1.0,
    )  # fmt: skip
    spline.AddPathPositionConstraint(
        drake.AngleBetweenVectorsConstraint(
            plant, plant.world_frame(), axis, tip, np.array([0.0, 0.0, 1.0]), 0.0, TILT,
            world.context,
        ), 1.0,
    )  # fmt: skip
    distance = drake.MinimumDistanceLowerBoundConstraint(
        plant, margin, world.context, None, INFLUENCE
    )
    for share in np.linspace(0.0, 1.0, checks):
        spline.AddPathPositionConstraint(distance, float(share))
    guess = drake.BsplineTrajectory(
        spline.basis(),
        [(setup.start + s * (goal - setup.start))[:, None]
         for s in np.linspace(0.0, 1.0, CONTROL_POINTS)],
    )  # fmt: skip
    spline.SetInitialGuess(guess)
    options = drake.SolverOptions()
    options.SetOption(drake.SnoptSolver.id(), "Major iterations limit", ITERATIONS)
    result = drake.SnoptSolver().Solve(program, program.initial_guess(), options)
    found = spline.ReconstructTrajectory(result)
    count = max(60, checks)
    times = np.linspace(found.start_time(), found.end_time(), count + 1)
    q = np.array([found.value(t).ravel() for t in times])
    q[0] = setup.start
    reason = "" if result.is_success() else f"SNOPT: {result.get_solution_result()}"
    return Answer(at_limits(setup, q), reason)
