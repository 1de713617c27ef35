"""The node over DDS, called by a client, with stand-ins for Nav2 and the robot's controllers."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator
from copy import deepcopy
from dataclasses import dataclass, field
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from tests import optional

import momapos

pytestmark = optional.needs("rclpy", optional.has("rclpy"))

QUESTION = {
    "scene": "kitchen_small", "robot": "segway_ur5e", "verb": "open",
    "target": "cabinet_right/drawer_middle_slide",
}  # fmt: skip
AWAY = 0.01
"""The base ends so far beside its goal [m]."""
PATIENCE = 120.0
"""Nothing here takes longer [s]."""


@dataclass
class Robot:
    """What stands for Nav2 and the controllers: it notes every goal, and does it at once."""

    goals: list[Any] = field(default_factory=list)
    blocked: bool = False
    """Whether the base finds no way."""
    stuck: bool = False
    """Whether the base drives until it is stopped."""
    drives: threading.Event = field(default_factory=threading.Event)
    """Set where it begins to drive."""
    stopped: threading.Event = field(default_factory=threading.Event)
    """Set where it is stopped."""

    def drive(self, handle: Any) -> Any:
        from nav2_msgs.action import NavigateToPose

        self.goals.append(handle.request)
        result = NavigateToPose.Result()
        if self.blocked:
            result.error_msg = "no way"
            handle.abort()
            return result
        self.drives.set()
        if self.stuck:
            self.stopped.wait(PATIENCE)
            handle.canceled()
            return result
        feedback = NavigateToPose.Feedback(current_pose=deepcopy(handle.request.pose))
        feedback.current_pose.pose.position.x += AWAY
        handle.publish_feedback(feedback)
        handle.succeed()
        return result

    def stop(self, _: Any) -> Any:
        from rclpy.action import CancelResponse

        self.stopped.set()
        return CancelResponse.ACCEPT

    def move(self, handle: Any) -> Any:
        from control_msgs.action import FollowJointTrajectory

        self.goals.append(handle.request)
        handle.succeed()
        return FollowJointTrajectory.Result()

    def grip(self, handle: Any) -> Any:
        from control_msgs.action import GripperCommand

        self.goals.append(handle.request)
        if handle.request.command.position > 0:
            handle.succeed()
            return GripperCommand.Result(reached_goal=True)
        handle.abort()  # as controllers do whose fingers meet the handle before they are closed
        return GripperCommand.Result(stalled=True)


@pytest.fixture(scope="module")
def ros() -> Iterator[SimpleNamespace]:
    """The node, the robot's stand-in and a client, each a node of this process."""
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    os.environ["ROS_DOMAIN_ID"] = str(1 + os.getpid() % 100)
    import rclpy
    from action_msgs.msg import GoalStatus
    from control_msgs.action import FollowJointTrajectory, GripperCommand
    from momapos_interfaces.action import DoTask
    from momapos_interfaces.srv import PlanBasePlacement
    from nav2_msgs.action import NavigateToPose
    from rclpy.action import ActionClient, ActionServer
    from rclpy.executors import MultiThreadedExecutor

    from momapos_ros.node import PARAMETERS, MomaposNode

    rclpy.init()
    node, other, robot = MomaposNode(), rclpy.create_node("other"), Robot()
    servers = [
        ActionServer(other, kind, PARAMETERS[name], does, cancel_callback=robot.stop)
        for name, kind, does in (
            ("navigate", NavigateToPose, lambda handle: robot.drive(handle)),
            ("arm", FollowJointTrajectory, lambda handle: robot.move(handle)),
            ("gripper", GripperCommand, lambda handle: robot.grip(handle)),
        )
    ]
    service = other.create_client(PlanBasePlacement, "plan_base_placement")
    action = ActionClient(other, DoTask, "do_task")
    executor = MultiThreadedExecutor(num_threads=4)
    executor.add_node(node)
    executor.add_node(other)
    thread = threading.Thread(target=executor.spin)
    thread.start()
    assert service.wait_for_service(timeout_sec=PATIENCE)
    assert action.wait_for_server(timeout_sec=PATIENCE)
    yield SimpleNamespace(
        robot=robot, service=service, action=action, request=PlanBasePlacement.Request,
        goal=DoTask.Goal, canceled=GoalStatus.STATUS_CANCELED,
    )  # fmt: skip
    executor.shutdown()
    thread.join(PATIENCE)
    for server in servers:
        server.destroy()
    rclpy.shutdown()


def wait(future: Any) -> Any:
    done = threading.Event()
    future.add_done_callback(lambda _: done.set())
    assert done.wait(PATIENCE)
    return future.result()


def do(ros: SimpleNamespace, **question: str) -> tuple[Any, list[str]]:
    """The result of the action, and the stages that it reported."""
    stages: list[str] = []
    goal = ros.goal(**question)
    sent = ros.action.send_goal_async(goal, lambda sent: stages.append(sent.feedback.stage))
    return wait(wait(sent).get_result_async()).result, stages


def test_the_service_gives_the_answer_of_the_library(ros: SimpleNamespace) -> None:
    scene = momapos.load_scene(QUESTION["scene"])
    robot = momapos.load_robot(QUESTION["robot"])
    task = momapos.make_task(scene, "open", *QUESTION["target"].split("/"))
    result = momapos.plan_base_placement(scene, robot, task)
    plan = result.plan
    response = wait(ros.service.call_async(ros.request(**QUESTION)))
    assert response.status == plan.status == "solved"
    assert response.message.endswith(f"; tolerance {result.tolerance}")
    position, turn = response.base_pose.pose.position, response.base_pose.pose.orientation
    yaw = 2 * np.arctan2(turn.z, turn.w)
    np.testing.assert_allclose((position.x, position.y, yaw), plan.base_pose, atol=1e-9)
    assert response.base_pose.header.frame_id == response.path.header.frame_id == "map"
    end = response.path.poses[-1].pose.position
    assert (end.x, end.y) == pytest.approx((position.x, position.y), abs=1e-6)
    assert response.phases.count("arm") == len(response.trajectories) >= 2
    assert response.phases.index("close_gripper") < response.phases.index("open_gripper")
    for trajectory in response.trajectories:
        assert trajectory.joint_names == list(plan.joints)
        times = [
            p.time_from_start.sec + 1e-9 * p.time_from_start.nanosec for p in trajectory.points
        ]
        assert np.all(np.diff(times) > 0)
    np.testing.assert_allclose(response.trajectories[0].points[0].positions, robot.home, atol=1e-9)
    for before, after in zip(response.trajectories, response.trajectories[1:], strict=False):
        np.testing.assert_allclose(
            before.points[-1].positions, after.points[0].positions, atol=1e-6
        )


def test_a_request_says_where_the_base_is_and_how_far_the_part_goes(ros: SimpleNamespace) -> None:
    from geometry_msgs.msg import PoseStamped

    start = PoseStamped()
    start.pose.position.x, start.pose.position.y = 2.0, -1.7
    start.pose.orientation.z, start.pose.orientation.w = np.sin(0.4), np.cos(0.4)
    response = wait(ros.service.call_async(ros.request(**QUESTION, to="20cm", start=[start])))
    assert response.status == "solved", response.message
    first = response.path.poses[0].pose
    assert (first.position.x, first.position.y) == pytest.approx((2.0, -1.7))
    assert first.orientation.z == pytest.approx(np.sin(0.4))
    scene, robot = momapos.load_scene(QUESTION["scene"]), momapos.load_robot(QUESTION["robot"])
    task = momapos.make_task(scene, "open", *QUESTION["target"].split("/"), "20cm")
    plan = momapos.plan_base_placement(scene, robot, task, start=np.array([2.0, -1.7, 0.8])).plan
    last = response.trajectories[-1].points[-1].positions
    np.testing.assert_allclose(last, plan.motion.q[-1], atol=1e-6)


def test_the_service_says_why_not(ros: SimpleNamespace) -> None:
    low = {**QUESTION, "target": "cabinet_right/drawer_bottom_slide"}
    response = wait(ros.service.call_async(ros.request(**low)))
    assert response.status == "infeasible"
    assert "out of reach" in response.message
    assert len(response.reasons) == len(response.counts) > 1
    assert min(response.counts) > 0
    assert list(response.trajectories) == []


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"target": "fridg"}, "did you mean"),
        ({"verb": "push"}, "it must be one of open"),
        ({"robot": "nobody"}, "nobody"),
        ({"to": "400deg"}, "400deg"),
    ],
)
def test_a_request_that_makes_no_sense_is_refused_in_words(
    ros: SimpleNamespace, change: dict[str, str], words: str
) -> None:
    response = wait(ros.service.call_async(ros.request(**{**QUESTION, **change})))
    assert response.status == "refused"
    assert words in response.message


def test_the_action_drives_then_moves_from_where_the_base_is(ros: SimpleNamespace) -> None:
    ros.robot.goals.clear()
    result, stages = do(ros, **QUESTION)
    assert result.done, result.message
    drive, *moves = ros.robot.goals
    reached, meant = result.base_pose.pose.position, drive.pose.pose.position
    assert reached.x - meant.x == pytest.approx(AWAY)
    names = [type(goal).__name__.split("_")[0] for goal in ros.robot.goals]
    assert names[:3] == ["NavigateToPose", "FollowJointTrajectory", "GripperCommand"]
    assert stages[:3] == ["planning", "driving", "planning the arm"]
    assert len(stages) == 3 + len(moves)
    # The arm gets a motion from where the base is: the exact check accepts it.
    scene, robot = momapos.load_scene(QUESTION["scene"]), momapos.load_robot(QUESTION["robot"])
    turn = drive.pose.pose.orientation
    base = (reached.x, reached.y, 2 * np.arctan2(turn.z, turn.w))
    task = momapos.make_task(scene, "open", *QUESTION["target"].split("/"))
    last = [goal for goal in moves if hasattr(goal, "trajectory")][-1].trajectory.points[-1]
    motion = momapos.check_base_pose(scene, robot, task, base).motion
    np.testing.assert_allclose(last.positions, motion.q[-1], atol=1e-6)


def test_the_action_ends_where_the_base_finds_no_way(ros: SimpleNamespace) -> None:
    ros.robot.goals.clear()
    ros.robot.blocked = True
    result, stages = do(ros, **QUESTION)
    ros.robot.blocked = False
    assert not result.done
    assert "no way" in result.message
    assert stages == ["planning", "driving"]
    assert len(ros.robot.goals) == 1


def test_the_action_says_why_there_is_no_base_pose(ros: SimpleNamespace) -> None:
    ros.robot.goals.clear()
    result, _ = do(ros, **{**QUESTION, "target": "cabinet_right/drawer_bottom_slide"})
    assert not result.done
    assert result.message.startswith("infeasible")
    assert ros.robot.goals == []


def test_a_task_that_is_canceled_stops_the_base(ros: SimpleNamespace) -> None:
    ros.robot.goals.clear()
    ros.robot.stuck = True
    ros.robot.drives.clear()
    sent = wait(ros.action.send_goal_async(ros.goal(**QUESTION)))
    assert ros.robot.drives.wait(PATIENCE)
    assert not wait(ros.action.send_goal_async(ros.goal(**QUESTION))).accepted  # one at a time
    wait(sent.cancel_goal_async())
    ended = wait(sent.get_result_async())
    ros.robot.stuck = False
    assert ended.status == ros.canceled
    assert ended.result.message == "canceled"
    assert len(ros.robot.goals) == 1
