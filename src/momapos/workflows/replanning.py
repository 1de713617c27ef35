"""Replan during a run: drive, plan arm motions, and update the belief after failures."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import SceneError, Stopwatch, TaskError
from momapos.core.geometry import wrap_angle
from momapos.model.records import Attempt, Motion, PlacementPlan, ReachScorer, Task
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, PlacementQuery, check_pose, grasp_of
from momapos.planning.baselines import plan_with_method
from momapos.planning.grasps import GraspFilter, slides
from momapos.planning.navigation import (
    DriveRecord,
    HeldObject,
    NavigationMap,
    build_navigation_map,
    gaps,
)
from momapos.simulation import AttemptOutcome, LearnedPart, PlanHomePath, Pose, TrueWorld, Visit

from .joint_belief import JointBelief, JointBeliefs
from .moved_motion import motion_from
from .recovery import (
    arm_home_path,
    believed_scene,
    falls_closed,
    grasp_in_part,
    other_grasps,
    with_estimated_joint,
    without_pushes,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MIN_POSE_DISTANCE = 0.15
"""Minimum distance of a new base pose from the failed ones [m]."""
YAW_WEIGHT = 0.3
"""Distance that counts as much as a rotation by one radian [m]."""
DOCKING_TOLERANCE = 0.005
"""A drive that ends nearer to its goal is not repeated [m]."""
NO_POSE_LEFT = "no other base pose is left"

Drive: TypeAlias = (
    "Callable[[NavigationMap, Float[np.ndarray, '3'], Float[np.ndarray, '3'],"
    " np.random.Generator], DriveRecord]"
)
"""BasePaths from a pose to a pose: x [m], y [m], yaw [rad]."""
OnDrive: TypeAlias = "Callable[[Float[np.ndarray, ' t'], Float[np.ndarray, 't 3']], None]"
"""Called after every drive with its times [s] and true poses."""


@dataclass(eq=False)
class Replanner:
    """BasePaths to base poses until the arm finds a motion, and replans after failures."""

    ground: NavigationMap
    scene: Scene
    plan: PlacementPlan
    reach: ReachScorer
    drive: Drive
    config: PipelineConfig
    trace: OnDrive
    stopwatch: Stopwatch
    rng: np.random.Generator
    visits: list[Visit] = field(default_factory=list)
    failed: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Base poses that failed."""
    grasps: list[Float[np.ndarray, "4 4"]] = field(default_factory=list)
    """Grasps that failed, see `grasp_in_part`."""
    _: KW_ONLY
    initial: Scene
    """The scene at the start of the run, with the joint of the part as now believed."""
    held: HeldObject | None = None
    """What the robot holds on its drives, with its arm at home."""
    beliefs: JointBeliefs
    """Hypotheses of the part's joint."""
    given: TrueWorld = field(init=False)
    """The given scene and task."""
    alternative: Scene | None = None
    """The scene with the part at its next most probable value."""
    unmeasured: tuple[Scene, Scene, Task] | None = None
    """`initial`, `scene` and the task without the measured joint; None if it was not measured."""

    def __post_init__(self) -> None:
        self.given = TrueWorld(self.initial, self.plan.task)
        if self.plan.moves_base and self.config.base == "fixed":
            # Where no single base pose served the task, none does after a failure.
            self.config = replace(self.config, base="auto")

    def true_world(self, there: TrueWorld | None) -> TrueWorld | None:
        """Return the true world if it differs from the robot's belief.

        Args:
            there: The true world as given; None for the scene at the start of the run.
        """
        return there or (None if self.initial is self.given.scene else self.given)

    def learn(self, motion: Motion, outcome: AttemptOutcome) -> bool:
        """Update the belief after a failed motion: failed grasps, state and joint of the part.

        Args:
            motion: The executed motion.
            outcome: Its outcome.

        Returns:
            Whether the hypothesis of the part's joint stays the same.
        """
        # A hand that does not find a part that it moved before also indicates a wrong hypothesis.
        if outcome.learned is not None or self.beliefs.moved:
            other = self.beliefs.fail(() if outcome.learned is None else outcome.learned.way)
            if other is not None:
                self._switch(other)
                return False
        task = self.plan.task
        self.grasps.append(grasp_in_part(self.scene, task, motion))
        if outcome.learned is not None:
            falls = falls_closed(self.scene, task, outcome.learned)
            if falls or outcome.ran_away:
                self.config = without_pushes(self.config)
            self._use_measured(outcome.learned, falls=falls)
        elif outcome.nothing_there:  # the part is not at its believed value
            self._believe(self.alternative or self.initial)
        return True

    def _use_measured(self, learned: LearnedPart, *, falls: bool) -> None:
        """Use the measured joint, and the value at which the hand left the part.

        Args:
            learned: The measurements of the hand.
            falls: Whether the released part falls closed.
        """
        task, initial = self.plan.task, self.initial
        known, first = (
            scene.object(task.object).T_world_object[:3, 3] for scene in (self.scene, initial)
        )
        offset = learned.offset + known - first
        left = believed_scene(initial, task, learned.value, offset)
        self.unmeasured = initial, initial if falls else left, task
        try:
            self.initial, task, value = with_estimated_joint(
                initial, task, learned.axis.shifted(first - known), learned.value
            )
        except SceneError:  # its file couples the joint with others
            self.unmeasured = None
        else:
            self.plan = replace(self.plan, task=task)
            left = believed_scene(self.initial, task, value, offset)
        self.alternative = left if falls else self.initial
        self._believe(self.initial if falls else left)

    def _switch(self, belief: JointBelief) -> None:
        """Use another hypothesis, and forget the failed grasps and base poses."""
        self.initial, self.grasps, self.failed = belief.scene, [], []
        self.unmeasured, self.alternative = None, None
        self.plan = replace(self.plan, task=belief.task)
        self._believe(belief.as_left()[0])

    def _believe(self, scene: Scene) -> None:
        if scene is not self.scene:
            self.scene = scene
            with self.stopwatch.stage("drive"):
                self.ground = build_navigation_map(
                    scene, self.ground.robot, self.plan.region.keep_out, self.held
                )

    def retry(
        self, here: Float[np.ndarray, "3"], attempts: int, *, leave: bool
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Try another grasp at this base pose, then another base pose, then another hypothesis.

        Args:
            here: Current base pose x [m], y [m], yaw [rad].
            attempts: Maximum number of base poses [-].
            leave: Whether to leave this base pose because the arm was blocked.

        Returns:
            The last base pose, and the motion found there, if any.
        """
        while (found := self._next(here, leave)) is None:
            if self.unmeasured is not None:  # no base pose works for the measured joint
                (self.initial, scene, task), self.unmeasured = self.unmeasured, None
                self.alternative = None
                self.plan = replace(self.plan, task=task)
                self._believe(scene)
                continue
            other = self.beliefs.drop_current()
            if other is None:
                return here, None
            self._switch(other)
            leave = False
        if isinstance(found, PlacementPlan):
            return self.drive_and_plan(here, found, attempts)
        return here, found

    def _next(self, here: Float[np.ndarray, "3"], leave: bool) -> Motion | PlacementPlan | None:
        """Plan a motion at this base pose, or else a plan with another one.

        A regrasp passes the edge of the released part more closely than its value is known after a
        failure. So one grasp from another base pose is tried before two grasps from this one.
        """
        task = self.plan.task
        configs = [self.config]
        one_grasp = without_pushes(self.config)
        if task.verb == "open" and not slides(self.scene, task) and one_grasp != self.config:
            configs.insert(0, one_grasp)
        try:
            with self.stopwatch.stage("plan"):
                others = other_grasps(self.scene, task, self.grasps)
                for config in configs:
                    found = None if leave else self._motion(here, config, others).motion
                    if found is not None:
                        return found
                    self.failed.append(here)
                    other = self._other_pose(here, config)
                    if other is not None:
                        return other
        except TaskError:  # the hand has no grasp for a part of this kind
            return None
        return None

    def home_path_planner(self, base: Float[np.ndarray, "3"]) -> PlanHomePath:
        """Return a planner of the arm's path home, with the part where the hand left it.

        Each further call assumes the next most probable hypothesis of the joint.
        """
        calls = 0

        def plan(
            q: Float[np.ndarray, " n"], learned: LearnedPart
        ) -> Float[np.ndarray, "k n"] | None:
            nonlocal calls
            beliefs, task = self.beliefs.ranked(learned.way)[calls:], self.plan.task
            calls += 1
            if not beliefs:
                return None
            scene = believed_scene(self.scene, task, learned.value, learned.offset)
            if beliefs[0] is not None:
                scene, task = beliefs[0].as_left()
            return arm_home_path(
                scene, self.ground.robot, task, base, q, config=self.config, seed=self.plan.seed
            )

        return plan

    def drive_and_plan(
        self, here: Float[np.ndarray, "3"], plan: PlacementPlan | None, attempts: int
    ) -> tuple[Float[np.ndarray, "3"], Motion | None]:
        """Drive to the plan's base pose and replan the arm; on failure try other base poses.

        Returns:
            The last base pose, and the motion found there, if any.
        """
        motion, max_visits = None, len(self.visits) + attempts
        while plan is not None and len(self.visits) < max_visits:
            assert plan.base_pose is not None
            goal = np.array(plan.base_pose)
            with self.stopwatch.stage("drive"):
                driven = self.drive(self.ground, here, goal, self.rng)
            self.trace(driven.times, driven.poses)
            here, reason, now, plan = driven.pose, driven.reason, plan, None
            if driven.arrived:
                with self.stopwatch.stage("plan"):
                    attempt = self._at_plan(now, here)
                motion, reason = attempt.motion, attempt.reason
                self.failed.append(here)
            self.failed.append(goal)
            self.visits.append(_visit(goal, driven, reason))
            # After a collision the run ends: the base must not drive on.
            if motion is None and not driven.hit and len(self.visits) < max_visits:
                with self.stopwatch.stage("plan"):
                    plan = self._other_pose(here, self.config)
                if plan is None:
                    reason = f"{reason}; {NO_POSE_LEFT}"
                    self.visits[-1] = replace(self.visits[-1], reason=reason)
                    plan = now if driven.arrived and _missed(goal, here) else None
        return here, motion

    def _at_plan(self, plan: PlacementPlan, here: Float[np.ndarray, "3"]) -> Attempt:
        """Return the motion at the pose at which a drive to a plan's base pose has ended."""
        if plan.moves_base:
            return motion_from(plan, self.scene, self.ground.robot, here)
        return self._motion(here, self.config)

    def _motion(
        self,
        pose: Float[np.ndarray, "3"],
        config: PipelineConfig,
        grasps: GraspFilter | None = None,
    ) -> Attempt:
        query = self._query(config)
        if self.held is None:
            query = replace(query, keep_grasps=grasps)
        return check_pose(query, pose, how_far=False)

    def _other_pose(
        self, pose: Float[np.ndarray, "3"], config: PipelineConfig
    ) -> PlacementPlan | None:
        """Plan with the cheapest base pose from here that is not near a failed one."""
        try:
            query = replace(self._query(config), start=pose, keep_poses=self._untried)
            result = plan_with_method(query)
        except SceneError:  # the planner's boxes enclose more than the outlines for driving
            return None
        return result.plan if result.plan.feasible else None

    def _query(self, config: PipelineConfig) -> PlacementQuery:
        plan = self.plan
        return PlacementQuery(
            self.scene, self.ground.robot, plan.task, self.reach, config=config,
            region=plan.region, seed=plan.seed, from_home=True,
            keep_grasps=None if self.held is None else grasp_of(plan),
        )  # fmt: skip

    def _untried(self, poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which poses are away from the failed ones and let the base dock."""
        away = poses[:, None] - np.array(self.failed)
        apart = np.hypot(away[..., 0], away[..., 1]) + YAW_WEIGHT * np.abs(wrap_angle(away[..., 2]))
        fits = gaps(poses, self.ground.prisms, self.ground.planning_obstacles) > 0.0
        return np.asarray((apart >= MIN_POSE_DISTANCE).all(1) & fits)


def _missed(goal: Float[np.ndarray, "3"], pose: Float[np.ndarray, "3"]) -> bool:
    """Check that a drive ended so far from its goal that another drive may end nearer."""
    turn = abs(float(wrap_angle(pose[2] - goal[2])))
    return float(np.hypot(*(pose - goal)[:2])) + YAW_WEIGHT * turn > DOCKING_TOLERANCE


def _visit(goal: Float[np.ndarray, "3"], driven: DriveRecord, reason: str) -> Visit:
    return Visit(
        planned=base_triple(goal),
        reached=base_triple(driven.pose),
        length=driven.length,
        seconds=driven.time,
        reason=reason,
        arrived=driven.arrived,
        way=driven.planned if np.isfinite(driven.planned) else None,
        clearance=driven.clearance if np.isfinite(driven.clearance) else None,
        hit=driven.hit,
    )


def base_triple(pose: Float[np.ndarray, "3"]) -> Pose:
    return float(pose[0]), float(pose[1]), float(pose[2])
