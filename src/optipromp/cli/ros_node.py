"""``optipromp ros-node``: the planner as a node of ROS 2; the only file that imports rclpy."""

from contextlib import suppress
from typing import TYPE_CHECKING, Annotated, Any

import typer

from optipromp.cli.command import command
from optipromp.cli.console import Recorded, say_if_compiling
from optipromp.core.errors import InvalidRequestError, OptiPrompError

if TYPE_CHECKING:
    from optipromp.ros import LiveScene


@command(reports=False)
def ros_node(
    scene: Annotated[
        str, typer.Argument(metavar="SCENE", help="Gives robot, tool and what no topic says.")
    ],
    prefix: Annotated[
        str, typer.Option(metavar="TEXT", help="Before joint and link names in ROS, as in fr3_.")
    ] = "",
    rate: Annotated[
        float | None, typer.Option(metavar="HZ", help="Of the points; the plan's own if left out.")
    ] = None,
    demonstrations: Recorded = None,
    execute: Annotated[
        str | None,
        typer.Option(metavar="ACTION", help="FollowJointTrajectory action that gets each success."),
    ] = None,
) -> None:
    """Plan on request: a node of ROS 2 with MoveIt's service GetMotionPlan.

    Listens to planning_scene, collision_object and joint_states. Offers the service
    optipromp/plan, and publishes optipromp/joint_trajectory and display_planned_path.
    Needs ROS 2 (rclpy, moveit_msgs, control_msgs) and the extra ros.

    [bold]Examples[/bold]

    \b
    optipromp ros-node my-scene.yaml --prefix fr3_
    optipromp ros-node my-scene.yaml --execute /arm_controller/follow_joint_trajectory
    """
    try:
        import rclpy  # noqa: F401
    except ImportError:
        raise InvalidRequestError(
            "ros-node needs ROS 2 and finds no rclpy: source the setup.bash of a ROS 2 "
            "installation, and start it with the Python of that installation"
        ) from None
    from optipromp.core.scenes.io import load_scene
    from optipromp.ros import LiveScene

    say_if_compiling()
    settings = {"prefix": prefix, "rate": rate, "demonstrations": demonstrations}
    _serve(LiveScene.of(load_scene(scene), prefix), settings, execute)


def _serve(world: "LiveScene", settings: dict[str, Any], execute: str | None) -> None:
    """Carry messages between ROS and :func:`optipromp.ros.answer` until the node is shut down."""
    import rclpy
    from control_msgs.action import FollowJointTrajectory
    from moveit_msgs.msg import CollisionObject, DisplayTrajectory, PlanningScene
    from moveit_msgs.srv import GetMotionPlan
    from rclpy.action import ActionClient
    from rclpy.executors import ExternalShutdownException
    from rclpy.serialization import deserialize_message, serialize_message
    from sensor_msgs.msg import JointState
    from trajectory_msgs.msg import JointTrajectory

    from optipromp.ros import answer, from_bytes, to_bytes

    def listen(kind: Any, name: str, topic: str) -> None:
        def heard(item: Any) -> None:
            nonlocal world
            try:
                world = world.heard(from_bytes(serialize_message(item), name))
            except OptiPrompError as error:
                node.get_logger().warning(f"{topic}: {error}", throttle_duration_sec=5.0)

        node.create_subscription(kind, topic, heard, 10)

    def plan(request: Any, response: Any) -> Any:
        data = serialize_message(request.motion_plan_request)
        asked = from_bytes(data, "moveit_msgs/msg/MotionPlanRequest")
        found = answer(world, asked, **settings)
        kind = type(response.motion_plan_response)
        response.motion_plan_response = deserialize_message(to_bytes(found.response), kind)
        if found.display is not None:
            displays.publish(deserialize_message(to_bytes(found.display), DisplayTrajectory))
        if found.trajectory is not None:
            motion = deserialize_message(to_bytes(found.trajectory), JointTrajectory)
            trajectories.publish(motion)
            if controller is not None:
                controller.send_goal_async(FollowJointTrajectory.Goal(trajectory=motion))
        return response

    rclpy.init()
    node = rclpy.create_node("optipromp")
    trajectories = node.create_publisher(JointTrajectory, "~/joint_trajectory", 10)
    displays = node.create_publisher(DisplayTrajectory, "display_planned_path", 10)
    controller = ActionClient(node, FollowJointTrajectory, execute) if execute else None
    listen(PlanningScene, "moveit_msgs/msg/PlanningScene", "planning_scene")
    listen(CollisionObject, "moveit_msgs/msg/CollisionObject", "collision_object")
    listen(JointState, "sensor_msgs/msg/JointState", "joint_states")
    node.create_service(GetMotionPlan, "~/plan", plan)
    with suppress(ExternalShutdownException):
        rclpy.spin(node)
