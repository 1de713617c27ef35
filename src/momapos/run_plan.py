"""Drive there and do it: a plan, carried out in physics.

On arrival the arm motion is planned anew from the pose really reached; where that fails, another
base pose is asked for, from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from importlib import metadata
from typing import cast

import numpy as np
from jaxtyping import Float

from momapos.config import PipelineConfig
from momapos.errors import InputError
from momapos.execution.config import ExecutionConfig
from momapos.execution.record import Execution, Pose, RunRecord, Visit
from momapos.execution.run import Watch, execute
from momapos.geometry.polygons import all_inside
from momapos.kinematics.base_collision import base_hits
from momapos.kinematics.collision import FREE
from momapos.manipulation.feasibility import Feasibility, hand_clears
from momapos.manipulation.motion import room_boxes, task_motion
from momapos.pipeline import arm_world, place, start_pose
from momapos.placement.area import CLEAR, Site, footprints, standing
from momapos.placement.place import REASONS
from momapos.protocols import Clock, ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.types import Attempt, Motion, PlacementPlan, Task
from momapos.verification.exact import ExactWorld

DEFAULT = PipelineConfig()
PHYSICS = ExecutionConfig()
POSITION, HEADING = 0.02, np.radians(1.0)
"""Standard deviation of the pose reached, in each direction [m], and of its yaw [rad]."""
WORST_POSITION, WORST_HEADING = 0.03, np.radians(2.0)
"""No arrival is farther off than this [m], [rad]."""
_DRAWS = 100


@dataclass(frozen=True)
class Arrival:
    """Where a drive ended."""

    pose: Pose
    """The true pose: x [m], y [m], yaw [rad]."""
    length: float
    """Driven [m]."""
    seconds: float = 0.0
    """How long it took [s]."""
    reason: str = ""
    """Why it did not arrive; "" where it did."""


Drive = Callable[[Pose, Pose, float, np.random.Generator], Arrival]
"""Drives from a pose to a pose; also given the length that was planned, where it is known [m]."""


def run_plan(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    *,
    reach: ReachScorer | None = None,
    drive: Drive | None = None,
    start: Float[np.ndarray, "3"] | None = None,
    attempts: int = 3,
    config: PipelineConfig = DEFAULT,
    physics: ExecutionConfig = PHYSICS,
    seed: int = 0,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> RunRecord:
    """Carry out a plan.

    Args:
        plan: A solved plan for this scene and robot.
        scene: The room.
        robot: The robot.
        reach: The robot's reachability map, for planning anew; needed with `drive`.
        drive: How the base drives; without it the base stands where the plan says, and the plan's
            own arm motion is executed.
        start: Where the base is at first; as for `place` by default.
        attempts: Base poses that are driven to at most [-].
        config: How to plan anew.
        physics: How to model and judge.
        seed: Same seed, same run.
        watch: Sees the physics, see `execute`.
        clock: Measures the stages.

    Raises:
        InputError: The plan is not solved, or `reach` is missing.
        SceneError: The robot stands in something at the beginning, of the drive or of the motion.
        TaskError, RobotError: They do not fit together.
    """
    if plan.status != "solved" or plan.motion is None or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: there is nothing to execute")
    rng, spent = np.random.default_rng(seed), {"drive": 0.0, "plan": 0.0, "execute": 0.0}
    watch_of = _Watch(clock, spent)
    visits: tuple[Visit, ...] = (_there(plan),)
    pose, motion = plan.base_pose, cast("Motion | None", plan.motion)
    if drive is not None:
        if reach is None:
            raise InputError("planning anew on arrival needs the robot's reachability map")
        trip = _Trip(scene, robot, plan, reach, drive, config, seed, watch_of)
        visits, pose, motion = trip.go(start, attempts, rng)
    outcome: Execution | None = None
    if motion is not None:
        with watch_of("execute"):
            outcome = execute(
                scene, robot, pose, motion, plan.task, physics, rng, watch=watch, clock=clock
            )
    return RunRecord(
        scene=plan.scene,
        robot=robot.name,
        task=plan.task,
        visits=visits,
        execution=outcome,
        seed=seed,
        noise=drive is not None,
        time=spent,
        versions={name: metadata.version(name) for name in ("momapos", "mujoco", "toppra")},
    )


class _Watch:
    """Adds up seconds by stage."""

    def __init__(self, clock: Clock, spent: dict[str, float]) -> None:
        self.clock, self.spent = clock, spent
        self.stage, self.began = "", 0.0

    def __call__(self, stage: str) -> _Watch:
        self.stage = stage
        return self

    def __enter__(self) -> None:
        self.began = self.clock()

    def __exit__(self, *_: object) -> None:
        self.spent[self.stage] += self.clock() - self.began


def _there(plan: PlacementPlan) -> Visit:
    """The base stands exactly where the plan says."""
    assert plan.base_pose is not None
    return Visit(plan.base_pose, plan.base_pose, plan.navigation_cost or 0.0, 0.0, "")


@dataclass(frozen=True)
class _Trip:
    """Drives to base poses until the arm finds a motion at one."""

    scene: Scene
    robot: Robot
    plan: PlacementPlan
    reach: ReachScorer
    drive: Drive
    config: PipelineConfig
    seed: int
    watch: _Watch

    def go(
        self, start: Float[np.ndarray, "3"] | None, attempts: int, rng: np.random.Generator
    ) -> tuple[tuple[Visit, ...], Pose, Motion | None]:
        """Drive, plan anew, and ask for another base pose where that fails.

        Returns:
            All visits, the pose reached last, and the motion found there, if any.
        """
        plan: PlacementPlan | None = self.plan
        moved = task_motion(self.scene, self.robot, self.plan.task, self.config.motion)
        here = _triple(start_pose(self.scene, self.robot, moved, start))
        visits: list[Visit] = []
        motion = None
        while len(visits) < attempts and motion is None and plan is not None:
            goal, cost = plan.base_pose, plan.navigation_cost or 0.0
            assert goal is not None
            with self.watch("drive"):
                arrival = self.drive(here, goal, cost, rng)
            here, reason = arrival.pose, arrival.reason
            if not reason:
                with self.watch("plan"):
                    attempt = self._motion(here, len(visits))
                motion, reason = attempt.motion, attempt.reason
            visits.append(Visit(goal, here, arrival.length, arrival.seconds, reason))
            if motion is None and len(visits) < attempts:
                with self.watch("plan"):
                    plan = self._another(here, len(visits))
        return tuple(visits), here, motion

    def _motion(self, pose: Pose, attempt: int) -> Attempt:
        return motion_at(
            self.scene, self.robot, self.plan.task, np.array(pose), self.reach,
            config=self.config, seed=self.seed + attempt,
        )  # fmt: skip

    def _another(self, pose: Pose, attempt: int) -> PlacementPlan | None:
        """The cheapest base pose seen from where the robot is; other samples, other poses."""
        answer = place(
            self.scene, self.robot, self.plan.task, self.reach, start=np.array(pose),
            config=self.config, seed=self.seed + attempt,
        )  # fmt: skip
        return answer.plan if answer.plan.status == "solved" else None


def motion_at(
    scene: Scene,
    robot: Robot,
    task: Task,
    base: Float[np.ndarray, "3"],
    reach: ReachScorer,
    *,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
) -> Attempt:
    """Plan the arm's motion at one base pose, all grasps tried, the room fully modelled.

    Args:
        scene: The room.
        robot: The robot.
        task: What is to be done.
        base: Where the base stands: x [m], y [m], yaw [rad].
        reach: The robot's reachability map; it orders the grasps.
        config: How to plan.
        seed: Same seed, same motion.

    Returns:
        A motion that the exact check accepts, or why there is none.
    """
    motion = task_motion(scene, robot, task, config.motion)
    world = arm_world(robot, motion, config)
    roomy, obstacle = hand_clears(robot, world, motion)
    if not roomy.any():
        return Attempt(None, f"the hand hits {obstacle} in every grasp")
    motion = replace(motion, Ts_world_tool=motion.Ts_world_tool[roomy])
    tools = np.ascontiguousarray(motion.Ts_world_tool[:, motion.coarse])
    site = Site(robot, tools, motion.static, motion.sweep(), scene.floor, clearance=0.0)
    outcome = int(standing(site, base[None])[0][0])
    if outcome != CLEAR:
        return Attempt(None, REASONS[outcome])
    exact = ExactWorld(scene, robot, task)

    def refuse(pose: Float[np.ndarray, "3"], found: Motion) -> str | None:
        return exact.refusal(_triple(pose), found)

    feasible = Feasibility(robot, world, motion, config.planner, refuse, seed, lambda: False)
    # The map is right for most poses, not for all: it orders the grasps and rules none out.
    scores = np.maximum(reach.weakest(base[None], tools), 1e-6)
    screened = feasible.screen(base[None], scores, None)
    assert screened is not None
    if screened[0].q is None:
        return Attempt(None, screened[0].reason)
    return feasible(base, screened[0], np.argsort(-scores[0], kind="stable"))


def noisy_arrival(scene: Scene, robot: Robot) -> Drive:
    """A drive that ends near its goal, as far off as a localisation by radio beacons would be.

    It stands in for driving: it never ends in furniture, which a base would notice.
    """
    boxes = room_boxes(scene)

    def stands(pose: Float[np.ndarray, "3"]) -> bool:
        on_floor = scene.floor is None or all_inside(scene.floor, footprints(robot, pose[None]))[0]
        free = base_hits(pose[None], robot.base, boxes, clearance=0.0)[0] == FREE
        return bool(on_floor and free)

    def drive(_: Pose, goal: Pose, length: float, rng: np.random.Generator) -> Arrival:
        for _draw in range(_DRAWS):
            off = rng.normal(0.0, [POSITION, POSITION, HEADING])
            near = np.hypot(off[0], off[1]) <= WORST_POSITION and abs(off[2]) <= WORST_HEADING
            pose = np.array(goal) + off
            if near and stands(pose):
                return Arrival(_triple(pose), length)
        return Arrival(goal, length, reason="there is no room around the planned base pose")

    return drive


def _triple(pose: Float[np.ndarray, "3"]) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])
