"""The drives of a run, and what the robot believes on its way from one try to the next."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import KW_ONLY, dataclass, field, replace
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import SceneError, Stopwatch, TaskError
from momapos.core.geometry import wrap_angle
from momapos.model.records import Attempt, Motion, PlacementPlan, ReachScorer, Task
from momapos.model.scene import Scene
from momapos.planning import PipelineConfig, check_base_pose
from momapos.planning.baselines import plan_by_method
from momapos.planning.grasps import GraspFilter, slides
from momapos.planning.navigation import DriveRecord, NavigationMap, build_navigation_map, gaps
from momapos.simulation import Learned, Outcome, Pose, TrueWorld, Visit, WayHome

from .joint_belief import JointBelief, JointBeliefs
from .recovery import (
    arm_way_home,
    believed_scene,
    falls_shut,
    grasp_in_part,
    other_grasps,
    taken_as_felt,
    without_pushes,
)

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

APART = 0.15
"""A base pose is another one when it is this far from those that failed [m]."""
TURN = 0.3
"""A radian of turning counts as this distance [m]."""
DOCKED = 0.005
"""A drive that ends nearer to its goal than this is not repeated [m]."""
NONE_LEFT = "no other base pose is left"

Drive: TypeAlias = (
    "Callable[[NavigationMap, Float[np.ndarray, '3'], Float[np.ndarray, '3'],"
    " np.random.Generator], DriveRecord]"
)
"""Drives from a pose to a pose: x [m], y [m], yaw [rad]."""
Trace: TypeAlias = "Callable[[Float[np.ndarray, ' t'], Float[np.ndarray, 't 3']], None]"
"""Called after every drive with its times [s] and true poses."""


@dataclass
class Trip:
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
    """Grasps that did not hold, see `grasp_in_part`."""
    _: KW_ONLY
    whole: Scene
    """The room as the run began, the part as it is believed to move."""
    beliefs: JointBeliefs
    """How the part may move."""
    first: TrueWorld = field(init=False)
    """The room and the task as they were given."""
    otherwise: Scene | None = None
    """Where the part may be too, if it is not where it is believed to be."""
    before: tuple[Scene, Scene, Task] | None = None
    """`whole`, `scene` and the task as they would be if the hand had not felt where the joint is;
    None where it has not."""

    def __post_init__(self) -> None:
        """Keep what was given."""
        self.first = TrueWorld(self.whole, self.plan.task)

    def true_world(self, there: TrueWorld | None) -> TrueWorld | None:
        """What is really there, where that differs from what the robot believes.

        Args:
            there: As it was given; None for the scene that the run began with.
        """
        return there or (None if self.whole is self.first.scene else self.first)

    def learn(self, motion: Motion, outcome: Outcome) -> bool:
        """Take in how a motion failed: its grasp, where the hand left the part, how that moves.

        Args:
            motion: What was executed.
            outcome: What came of it.

        Returns:
            Whether the part is still taken for the same kind.
        """
        # A hand that does not find a part again that it has moved is led by a wrong belief, too.
        if outcome.learned is not None or self.beliefs.moved:
            other = self.beliefs.fail(() if outcome.learned is None else outcome.learned.way)
            if other is not None:
                self._switch(other)
                return False
        task = self.plan.task
        self.grasps.append(grasp_in_part(self.scene, task, motion))
        if outcome.learned is not None:
            falls = falls_shut(self.scene, task, outcome.learned)
            if falls or outcome.ran_away:
                self.config = without_pushes(self.config)
            self._feel(outcome.learned, falls=falls)
        elif outcome.nothing_there:  # it moved on alone, or did not
            self._believe(self.otherwise or self.whole)
        return True

    def _feel(self, learned: Learned, *, falls: bool) -> None:
        """Take the part's joint to be where the hand found it, and the part where it left it.

        Args:
            learned: What the hand found.
            falls: Whether the part falls shut where it is let go.
        """
        task, whole = self.plan.task, self.whole
        known, first = (
            scene.object(task.object).T_world_object[:3, 3] for scene in (self.scene, whole)
        )
        offset = learned.offset + known - first
        left = believed_scene(whole, task, learned.value, offset)
        self.before = whole, whole if falls else left, task
        try:
            self.whole, task, value = taken_as_felt(
                whole, task, learned.axis.shifted(first - known), learned.value
            )
        except SceneError:  # it moves together with others, as its file says
            self.before = None
        else:
            self.plan = replace(self.plan, task=task)
            left = believed_scene(self.whole, task, value, offset)
        self.otherwise = left if falls else self.whole
        self._believe(self.whole if falls else left)

    def _switch(self, belief: JointBelief) -> None:
        """Take the part for another kind; no grasp and no base pose has failed for that yet."""
        self.whole, self.grasps, self.failed = belief.scene, [], []
        self.before, self.otherwise = None, None
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
        """Another grasp at the same base pose, else another base pose, else another belief.

        Args:
            here: Where the base stands: x [m], y [m], yaw [rad].
            attempts: Base poses that are driven to at most [-].
            elsewhere: Whether something was in the arm's way, so that this pose is no good.

        Returns:
            The pose reached last, and the motion found there, if any.
        """
        while (found := self._next(here, elsewhere)) is None:
            if self.before is not None:  # no base pose serves the joint as felt
                (self.whole, scene, task), self.before = self.before, None
                self.otherwise = None
                self.plan = replace(self.plan, task=task)
                self._believe(scene)
                continue
            other = self.beliefs.give_up()
            if other is None:
                return here, None
            self._switch(other)
            elsewhere = False
        return self.go(here, found, attempts) if isinstance(found, PlacementPlan) else (here, found)

    def _next(self, here: Float[np.ndarray, "3"], elsewhere: bool) -> Motion | PlacementPlan | None:
        """A motion at a base pose, else the plan of another one, for the part as it is believed.

        A second hold comes past the edge of a part that was let go, by less than what is known of
        it after a failure: one hold from elsewhere is tried before two from here.
        """
        task = self.plan.task
        configs = [self.config]
        once = without_pushes(self.config)
        if task.verb == "open" and not slides(self.scene, task) and once != self.config:
            configs.insert(0, once)
        try:
            with self.stopwatch.stage("plan"):
                others = other_grasps(self.scene, task, self.grasps)
                for config in configs:
                    found = None if elsewhere else self._motion(here, config, others).motion
                    if found is not None:
                        return found
                    self.failed.append(here)
                    other = self._another(here, config)
                    if other is not None:
                        return other
        except TaskError:  # no hand holds a part of that kind
            return None
        return None

    def way_home(self, base: Float[np.ndarray, "3"]) -> WayHome:
        """Plans the arm's way home at a base pose, with the part where the hand left it.

        Asked again, it has the part where the next likely way to move has left it.
        """
        asked = 0

        def plan(q: Float[np.ndarray, " n"], learned: Learned) -> Float[np.ndarray, "k n"] | None:
            nonlocal asked
            ways, task = self.beliefs.ranked(learned.way)[asked:], self.plan.task
            asked += 1
            if not ways:
                return None
            scene = believed_scene(self.scene, task, learned.value, learned.offset)
            if ways[0] is not None:
                scene, task = ways[0].as_left()
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
                    attempt = self._motion(here, self.config)
                motion, reason = attempt.motion, attempt.reason
                self.failed.append(here)
            self.failed.append(goal)
            self.visits.append(_visit(goal, driven, reason))
            # A base that touched something is not driven on: that is an accident, no detour.
            if motion is None and not driven.hit and len(self.visits) < most:
                with self.stopwatch.stage("plan"):
                    plan = self._another(here, self.config)
                if plan is None:
                    reason = f"{reason}; {NONE_LEFT}"
                    self.visits[-1] = replace(self.visits[-1], reason=reason)
                    plan = now if driven.arrived and _beside(goal, here) else None
        return here, motion

    def _motion(
        self,
        pose: Float[np.ndarray, "3"],
        config: PipelineConfig,
        grasps: GraspFilter | None = None,
    ) -> Attempt:
        return check_base_pose(
            self.scene, self.ground.robot, self.plan.task, pose, self.reach,
            how_far=False, grasp_filter=grasps, config=config, seed=self.plan.seed,
        )  # fmt: skip

    def _another(
        self, pose: Float[np.ndarray, "3"], config: PipelineConfig
    ) -> PlacementPlan | None:
        """The cheapest base pose seen from where the robot is, those that failed ruled out."""
        try:
            result = plan_by_method(
                self.scene, self.ground.robot, self.plan.task, self.reach, start=pose,
                pose_filter=self._ruled_out, region=self.plan.region, config=config,
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
