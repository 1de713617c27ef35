"""Drive there and do it: a plan, carried out in physics.

The base drives from its start to the base pose. On arrival the arm motion is planned anew from the
pose really reached; where the drive ends elsewhere, or the arm finds no motion, the next cheapest
base pose is driven to, from there.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.base_pose import check_base_pose
from momapos.baselines.answer import plan_by_method
from momapos.config import PipelineConfig
from momapos.errors import InputError, SceneError, TaskError
from momapos.execution.config import ExecutionConfig
from momapos.execution.joint_estimate import Learned
from momapos.execution.record import Execution, Pose, RunRecord, Visit
from momapos.execution.retreat import WayHome
from momapos.execution.run import Again, Outcome, attempt
from momapos.execution.stages import Watch
from momapos.execution.true_world import true_world
from momapos.geometry.transforms import wrap_angle
from momapos.joint_beliefs import JointBelief, JointBeliefs, joint_beliefs
from momapos.manipulation.motion import GraspFilter, task_motion
from momapos.navigation.clearance import gaps
from momapos.navigation.drive import DriveConfig, drive
from momapos.navigation.drive_record import DriveRecord
from momapos.navigation.footprint_map import NavigationMap, build_navigation_map
from momapos.navigation.localization import NoiseConfig
from momapos.next_try import arm_way_home, believed_scene, grasp_in_part, other_grasps
from momapos.prepare import start_pose
from momapos.protocols import Clock, ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene
from momapos.stopwatch import Stopwatch
from momapos.types import Attempt, Motion, PlacementPlan, Task
from momapos.versions import version_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

DEFAULT = PipelineConfig()
PHYSICS = ExecutionConfig()
DRIVING = DriveConfig()
QUIET = NoiseConfig(position=0.0, heading=0.0, odometry=0.0)
"""Sensors without errors."""
APART = 0.15
"""A base pose is another one when it is this far from those that failed [m]."""
TURN = 0.3
"""A radian of turning counts as this distance [m]."""
DOCKED = 0.005
"""A drive that ends nearer to its goal than this is not repeated [m]."""
STAGES = ("drive", "plan", "execute")
NONE_LEFT = "no other base pose is left"

Drive: TypeAlias = (
    "Callable[[NavigationMap, Float[np.ndarray, '3'], Float[np.ndarray, '3'],"
    " np.random.Generator], DriveRecord]"
)
"""Drives from a pose to a pose: x [m], y [m], yaw [rad]."""
Trace: TypeAlias = "Callable[[Float[np.ndarray, ' t'], Float[np.ndarray, 't 3']], None]"
"""Called after every drive with its times [s] and true poses."""


def run_plan(
    plan: PlacementPlan,
    scene: Scene,
    robot: Robot,
    reach: ReachScorer,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    world: Scene | None = None,
    attempts: int = 3,
    tries: int = 3,
    config: PipelineConfig = DEFAULT,
    driving: DriveConfig = DRIVING,
    physics: ExecutionConfig = PHYSICS,
    seed: int = 0,
    go: Drive | None = None,
    trace: Trace | None = None,
    watch: Watch | None = None,
    clock: Clock = time.perf_counter,
) -> RunRecord:
    """Carry out a plan.

    Args:
        plan: A solved plan for this scene and robot.
        scene: The room.
        robot: The robot.
        reach: The robot's reachability map, for planning anew.
        start: Where the base is at first; as the plan says by default, else as for `place`.
        world: What is really there, in the frame of `scene`, which is then what the robot
            believes: it plans and drives by the scene, its hand meets the world. The part nearest
            to where the plan takes hold is the one to open. As the scene says by default. Where
            the scene has several `hypotheses` of how that part moves, each motion is planned for
            the one that is the most probable after what the hand has felt.
        attempts: Base poses that are driven to for one motion at most [-].
        tries: Motions that are executed at most, one after the other, each after one that failed
            and after which the arm came home [-].
        config: How to plan anew.
        driving: How the base drives, and how wrong its sensors are.
        physics: How to model and judge.
        seed: Same seed, same run. The furniture is drawn from a stream of its own, so that it is
            the same for every plan, however far it has to be driven.
        go: Drives in the place of `navigation.drive`.
        trace: Sees the drives.
        watch: Sees the physics, see `execute`.
        clock: Measures the stages.

    Raises:
        InputError: The plan is not solved, or nothing in the world opens where it takes hold.
        SceneError: The robot stands in something at the start.
        TaskError, RobotError: They do not fit together.
    """
    if plan.status != "solved" or plan.base_pose is None:
        raise InputError(f"the plan is {plan.status!r}: there is nothing to execute")
    # Planned anew from another pose, it must go as far as planned, no farther and no less far.
    plan = replace(plan, task=replace(plan.task, farthest=False))
    there = None
    if world is not None:
        assert plan.motion is not None
        there = true_world(world, scene, plan.task, plan.motion.Ts_world_tool[0, :3, 3])
    of_drive, of_world = np.random.SeedSequence(seed).spawn(2)
    stopwatch = Stopwatch(clock, dict.fromkeys(STAGES, 0.0))

    def by_window(
        ground: NavigationMap,
        here: Float[np.ndarray, "3"],
        goal: Float[np.ndarray, "3"],
        rng: np.random.Generator,
    ) -> DriveRecord:
        return drive(ground, here, goal, rng=rng, config=driving, clock=clock)

    with stopwatch.stage("drive"):
        ground = build_navigation_map(scene, robot)
    if start is None and plan.start is not None:
        start = np.array(plan.start)
    begin = _begin(ground, scene, plan.task, start, config)
    trip = _Trip(
        ground, scene, plan, reach, go or by_window, config, trace or _unseen, stopwatch,
        np.random.default_rng(of_drive), whole=scene,
        beliefs=JointBeliefs(
            () if world is None else joint_beliefs(scene, plan.task), physics.compliance
        ),
    )  # fmt: skip
    here, motion = trip.go(begin, plan, attempts)
    executions: list[Execution] = []
    kinds: list[str] = []
    again: Again | None = None
    while motion is not None:
        last = len(executions) + 1 >= tries
        try:
            with stopwatch.stage("execute"):
                outcome = attempt(
                    trip.whole, robot, _triple(here), motion, trip.plan.task, physics,
                    np.random.default_rng(of_world), true_world=there, again=again,
                    way_home=None if last else trip.way_home(here),
                    doubt=None if last else trip.beliefs.speaks_against,
                    watch=watch, clock=clock,
                )  # fmt: skip
        except SceneError as error:  # by the exact shapes of the physics, which nothing before uses
            trip.visits[-1] = replace(trip.visits[-1], reason=str(error))
            break
        executions.append(outcome.execution)
        kinds.append(trip.beliefs.kind)
        if not outcome.at_home:
            break
        same = trip.learn(motion, outcome)
        here, motion = trip.try_anew(here, attempts, elsewhere=same and outcome.in_the_way)
        again = Again(trip.scene, outcome.value, outcome.collisions)
    return RunRecord(
        scene=plan.scene,
        robot=robot.name,
        task=plan.task,
        visits=tuple(trip.visits),
        execution=executions[-1] if executions else None,
        failed=tuple(executions[:-1]),
        kinds=tuple(filter(None, kinds)),
        seed=seed,
        noise=driving.noise != QUIET,
        time=stopwatch.seconds,
        versions={name: version_of(name) for name in ("momapos", "mujoco", "toppra")},
        true_task=None if there is None else there.task,
    )


def _unseen(_: Float[np.ndarray, " t"], __: Float[np.ndarray, "t 3"]) -> None:
    """Nobody looks."""


def _begin(
    ground: NavigationMap,
    scene: Scene,
    task: Task,
    start: Float[np.ndarray, "3"] | None,
    config: PipelineConfig,
) -> Float[np.ndarray, "3"]:
    """Where the base is at first.

    Raises:
        SceneError: The base cannot stand there, or not with its arm at home.
    """
    robot = ground.robot
    motion = task_motion(scene, robot, task, config.motion)
    return start_pose(scene, robot, motion, start, ground)


@dataclass
class _Trip:
    """Drives to base poses until the arm finds a motion at one; anew where that motion fails."""

    ground: NavigationMap
    scene: Scene
    plan: PlacementPlan
    reach: ReachScorer
    drive: Drive
    config: PipelineConfig
    trace: Trace
    stopwatch: Stopwatch
    rng: np.random.Generator
    visits: list[Visit] = field(default_factory=list)
    failed: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Base poses that were no good."""
    grasps: list[Float[np.ndarray, "4 4"]] = field(default_factory=list)
    """Grasps that did not hold: the tool in the part's frame."""
    _: KW_ONLY
    whole: Scene
    """The room as the run began, the part as it is believed to move."""
    beliefs: JointBeliefs
    """How the part may move."""

    def learn(self, motion: Motion, outcome: Outcome) -> bool:
        """Take in how a motion failed: its grasp, where the hand left the part, how that moves.

        Args:
            motion: What was executed.
            outcome: What came of it.

        Returns:
            Whether the part is still taken for the same kind.
        """
        if outcome.learned is not None:
            other = self.beliefs.fail(outcome.learned.way)
            if other is not None:
                self._switch(other)
                return False
        task = self.plan.task
        self.grasps.append(grasp_in_part(self.scene, task, motion))
        if outcome.learned is not None:
            value, offset = outcome.learned.value, outcome.learned.offset
            known = self.scene.object(task.object).T_world_object[:3, 3]
            offset = offset + known - self.whole.object(task.object).T_world_object[:3, 3]
            self._believe(believed_scene(self.whole, task, value, offset))
        elif outcome.nothing_there:  # it moved on alone: most parts fall shut
            self._believe(self.whole)
        return True

    def _switch(self, belief: JointBelief) -> None:
        """Take the part for another kind; no grasp and no base pose has failed for that yet."""
        self.whole, self.grasps, self.failed = belief.scene, [], []
        self.plan = replace(self.plan, task=belief.task)
        self._believe(belief.as_left()[0])

    def _believe(self, scene: Scene) -> None:
        if scene is not self.scene:
            self.scene = scene
            with self.stopwatch.stage("drive"):
                self.ground = build_navigation_map(scene, self.ground.robot)

    def try_anew(
        self, here: Float[np.ndarray, "3"], attempts: int, *, elsewhere: bool
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Another grasp at the same base pose, else another base pose, else another kind of part.

        `elsewhere` says that something was in the arm's way, so that the pose `here` is no good.
        Returns the pose reached last, and the motion found there, if any.
        """
        while (found := self._next(here, elsewhere)) is None:
            other = self.beliefs.give_up()
            if other is None:
                return here, None
            self._switch(other)
            elsewhere = False
        return self.go(here, found, attempts) if isinstance(found, PlacementPlan) else (here, found)

    def _next(self, here: Float[np.ndarray, "3"], elsewhere: bool) -> Motion | PlacementPlan | None:
        """A motion at a base pose, else the plan of another one, for the part as it is believed."""
        try:
            with self.stopwatch.stage("plan"):
                others = other_grasps(self.scene, self.plan.task, self.grasps)
                found = None if elsewhere else self._motion(here, others).motion
                self.failed += [] if found is not None else [here]
                return self._another(here) if found is None else found
        except TaskError:  # no hand holds a part of that kind
            return None

    def way_home(self, base: Float[np.ndarray, "3"]) -> WayHome:
        """Plans the arm's way home at a base pose, with the part where the hand left it."""

        def plan(q: Float[np.ndarray, " n"], learned: Learned) -> Float[np.ndarray, "k n"] | None:
            task = self.plan.task
            scene = believed_scene(self.scene, task, learned.value, learned.offset)
            other = self.beliefs.likelier(learned.way)
            if other is not None:
                scene, task = other.as_left()
            return arm_way_home(
                scene, self.ground.robot, task, base, q, config=self.config, seed=self.plan.seed
            )

        return plan

    def go(
        self, here: Float[np.ndarray, "3"], plan: PlacementPlan | None, attempts: int
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Drive, plan anew, and ask for the next base pose where that fails.

        Returns:
            The pose reached last, and the motion found there, if any.
        """
        motion, most = None, len(self.visits) + attempts
        while plan is not None and len(self.visits) < most:
            assert plan.base_pose is not None
            goal = np.array(plan.base_pose)
            with self.stopwatch.stage("drive"):
                driven = self.drive(self.ground, here, goal, self.rng)
            self.trace(driven.times, driven.poses)
            here, reason, now, plan = driven.pose, driven.reason, plan, None
            if driven.arrived:
                with self.stopwatch.stage("plan"):
                    attempt = self._motion(here)
                motion, reason = attempt.motion, attempt.reason
                self.failed.append(here)
            self.failed.append(goal)
            self.visits.append(_visit(goal, driven, reason))
            # A base that touched something is not driven on: that is an accident, no detour.
            if motion is None and not driven.hit and len(self.visits) < most:
                with self.stopwatch.stage("plan"):
                    plan = self._another(here)
                if plan is None:
                    reason = f"{reason}; {NONE_LEFT}"
                    self.visits[-1] = replace(self.visits[-1], reason=reason)
                    plan = now if driven.arrived and _beside(goal, here) else None
        return here, motion

    def _motion(self, pose: Float[np.ndarray, "3"], grasps: GraspFilter | None = None) -> Attempt:
        return check_base_pose(
            self.scene, self.ground.robot, self.plan.task, pose, self.reach,
            how_far=False, grasp_filter=grasps, config=self.config, seed=self.plan.seed,
        )  # fmt: skip

    def _another(self, pose: Float[np.ndarray, "3"]) -> PlacementPlan | None:
        """The cheapest base pose seen from where the robot is, those that failed ruled out."""
        try:
            result = plan_by_method(
                self.scene, self.ground.robot, self.plan.task, self.reach, start=pose,
                pose_filter=self._ruled_out, region=self.plan.region, config=self.config,
                seed=self.plan.seed,
            )  # fmt: skip
        except SceneError:  # boxes hold more than the outlines that were driven by
            return None
        return result.plan if result.plan.status == "solved" else None

    def _ruled_out(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Poses near one that failed, and those where the base cannot dock with its arm at home."""
        away = poses[:, None] - np.array(self.failed)
        apart = np.hypot(away[..., 0], away[..., 1]) + TURN * np.abs(wrap_angle(away[..., 2]))
        fits = gaps(poses, self.ground.prisms, self.ground.planning_obstacles) > 0.0
        return np.asarray((apart < APART).any(1) | ~fits)


def _beside(goal: Float[np.ndarray, "3"], pose: Float[np.ndarray, "3"]) -> bool:
    """Whether a drive has ended so far from its goal that another one may do better."""
    off = float(np.hypot(*(pose - goal)[:2])) + TURN * abs(float(wrap_angle(pose[2] - goal[2])))
    return off > DOCKED


def _visit(goal: Float[np.ndarray, "3"], driven: DriveRecord, reason: str) -> Visit:
    return Visit(
        planned=_triple(goal),
        reached=_triple(driven.pose),
        length=driven.length,
        seconds=driven.time,
        reason=reason,
        arrived=driven.arrived,
        way=driven.planned if np.isfinite(driven.planned) else None,
        clearance=driven.clearance if np.isfinite(driven.clearance) else None,
        hit=driven.hit,
    )


def _triple(pose: Float[np.ndarray, "3"]) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])
