"""The node: a service that plans, and an action that executes the plan.

ros2 run momapos_ros momapos_node --ros-args -p scene:=room.json -p robot:=fetch
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from threading import Lock
from typing import Any

import rclpy
from action_msgs.msg import GoalStatus
from control_msgs.action import FollowJointTrajectory, GripperCommand
from momapos_interfaces.action import DoTask
from momapos_interfaces.srv import PlanBasePlacement
from nav2_msgs.action import NavigateToPose
from rclpy.action import ActionClient, ActionServer, CancelResponse, GoalResponse
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.executors import ExternalShutdownException, MultiThreadedExecutor
from rclpy.node import Node

from momapos.core.errors import MomaposError
from momapos_ros.answers import Answer, Question, answer, answer_at, kinds
from momapos_ros.messages import fill, planar

PARAMETERS = {
    "scene": "kitchen_small", "robot": "fetch", "frame": "map", "timeout": 120.0,
    "server_timeout": 10.0, "navigate": "navigate_to_pose",
    "arm": "arm_controller/follow_joint_trajectory",
    "gripper": "gripper_controller/gripper_cmd",
}  # fmt: skip
"""Default scene and robot, the world's frame, names of the called actions, and the timeouts of the
search [s] and of waiting for an action server [s]."""
SERVERS = {
    "nav2_msgs/action/NavigateToPose": ("navigate", NavigateToPose),
    "control_msgs/action/FollowJointTrajectory": ("arm", FollowJointTrajectory),
    "control_msgs/action/GripperCommand": ("gripper", GripperCommand),
}
"""Parameter with the action's name, and action type, by the type names of momapos' export."""


class StepError(Exception):
    """A step of the task failed; the message states which and why."""


class MomaposNode(Node):
    """Serve `plan_base_placement`, and `do_task` with Nav2 and the arm's controllers."""

    def __init__(self, **options: Any) -> None:
        super().__init__("momapos", **options)
        for name, value in PARAMETERS.items():
            self.declare_parameter(name, value)
        group = ReentrantCallbackGroup()
        self._planning, self._moving = Lock(), Lock()
        self._running: Any = None  # goal handle of the current step
        self._actions = {
            action: ActionClient(self, kind, self._value(parameter), callback_group=group)
            for action, (parameter, kind) in SERVERS.items()
        }
        self.create_service(
            PlanBasePlacement, "plan_base_placement", self._plan, callback_group=group
        )
        self._server = ActionServer(
            self, DoTask, "do_task", self._do, goal_callback=self._accept,
            cancel_callback=self._cancel, callback_group=group,
        )  # fmt: skip

    def _value(self, parameter: str) -> Any:
        return self.get_parameter(parameter).value

    def _question(self, request: Any) -> Question:
        return Question(
            request.scene or self._value("scene"), request.robot or self._value("robot"),
            request.verb, request.target, request.to,
            planar(request.start[0].pose) if request.start else None,
        )  # fmt: skip

    def _answer(self, request: Any, *, tolerance: bool = False) -> Answer:
        question, timeout = self._question(request), self._value("timeout")
        with self._planning:
            return answer(question, timeout, tolerance=tolerance)

    def _plan(self, request: Any, response: Any) -> Any:
        """Answer a request; an invalid one is refused with the reason."""
        try:
            given = self._answer(request, tolerance=True)
        except MomaposError as error:
            response.status, response.message = "refused", str(error)
            return response
        response.status, response.message = given.plan.status, given.message
        response.reasons = list(given.plan.candidates.rejections)
        response.counts = list(given.plan.candidates.rejections.values())
        if given.plan.base_pose is None:
            return response
        members = given.messages(self._value("frame"))
        goals = [step["goal"] for step in members["steps"]]
        paths = [step["path"] for step in members["steps"] if "path" in step]
        arms = [goal["trajectory"] for goal in goals if "trajectory" in goal]
        response.phases = kinds(given)
        return fill(
            response,
            {"base_pose": members["base_pose"], "trajectories": arms}
            | ({"path": paths[0]} if paths else {}),
        )

    def _accept(self, _: Any) -> GoalResponse:
        """Accept a goal unless another one is being executed; `_do` releases the lock."""
        free = self._moving.acquire(blocking=False)
        return GoalResponse.ACCEPT if free else GoalResponse.REJECT

    def _cancel(self, _: Any) -> CancelResponse:
        if self._running is not None:
            self._running.cancel_goal_async()
        return CancelResponse.ACCEPT

    async def _do(self, handle: Any) -> Any:
        """Drive, replan the arm from the pose reached, and move; the goal ends as its steps do."""
        result = DoTask.Result()
        try:
            base_pose = await self._steps(handle)
        except (MomaposError, StepError) as error:
            result.message = str(error)
            if handle.is_cancel_requested:
                handle.canceled()
            else:
                handle.abort()
            return result
        finally:
            self._moving.release()
        result.done, result.message = True, "done"
        fill(result, {"base_pose": base_pose})
        handle.succeed()
        return result

    async def _steps(self, handle: Any) -> dict[str, Any]:
        """Execute a task; return the base pose from which the arm moved, as a PoseStamped."""
        frame = self._value("frame")
        self._publish(handle, "planning")
        given = self._answer(handle.request)
        if given.plan.base_pose is None or given.plan.status != "solved":
            raise StepError(given.message)
        reached = given.plan.base_pose
        drives = [step for step in given.messages(frame)["steps"] if "path" in step]
        for step in drives:
            self._publish(handle, "driving")
            seen: deque[Any] = deque(maxlen=1)
            await self._send(handle, step, seen.append)
            reached = planar(seen[0].feedback.current_pose.pose) if seen else reached
        self._publish(handle, "planning the arm")
        with self._planning:
            given = answer_at(given, reached)
        members = given.messages(frame)
        for stage, step in zip(kinds(given), members["steps"], strict=True):
            self._publish(handle, stage)
            await self._send(handle, step)
        base_pose: dict[str, Any] = members["base_pose"]
        return base_pose

    def _publish(self, handle: Any, stage: str) -> None:
        if handle.is_cancel_requested:
            raise StepError("canceled")
        handle.publish_feedback(DoTask.Feedback(stage=stage))

    async def _send(
        self, handle: Any, step: dict[str, Any], feedback: Callable[[Any], None] | None = None
    ) -> None:
        """Send one goal of the export and wait for its success.

        Raises:
            StepError: No server is available, or the goal was refused, canceled or failed.
        """
        name = step["action"]
        client = self._actions[name]
        if not client.wait_for_server(timeout_sec=self._value("server_timeout")):
            raise StepError(f"no server for {name} at {self._value(SERVERS[name][0])!r}")
        goal = fill(SERVERS[name][1].Goal(), step["goal"])
        sent = await client.send_goal_async(goal, feedback_callback=feedback)
        if not sent.accepted:
            raise StepError(f"{name} was refused")
        self._running = sent
        try:
            if handle.is_cancel_requested:
                sent.cancel_goal_async()
            ended = await sent.get_result_async()
        finally:
            self._running = None
        if handle.is_cancel_requested:
            raise StepError("canceled")
        closing = step["goal"].get("command", {}).get("position") == 0.0
        if closing and ended.result.stalled:
            return  # the fingers met the object before they were fully closed
        why = getattr(ended.result, "error_string", "") or getattr(ended.result, "error_msg", "")
        if ended.status != GoalStatus.STATUS_SUCCEEDED:
            raise StepError(f"{name} failed: {why or f'status {ended.status}'}")
        if getattr(ended.result, "error_code", 0):
            raise StepError(f"{name} failed: {why or f'code {ended.result.error_code}'}")


def main() -> None:
    """Run the node until shutdown."""
    rclpy.init()
    node = MomaposNode()
    executor = MultiThreadedExecutor()
    executor.add_node(node)
    try:
        executor.spin()
    except (KeyboardInterrupt, ExternalShutdownException):
        pass
    finally:
        node.destroy_node()
        rclpy.try_shutdown()
