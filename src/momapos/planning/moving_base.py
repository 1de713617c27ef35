"""Open or close a part while the base moves.

A base at one pose is the usual case, and this module is asked only after it failed. The base slides
without turning, along its heading or, if its drive is omnidirectional, in any direction: such a
path suits every drive, and a controller follows it best. Arms of six and more degrees of freedom
try families of base paths that advance with the part. Shorter arms take the base as joints: an arm
of five degrees of freedom reaches a grasp only from base poses on a surface, which samples miss. On
a base that slides in both directions it reaches any position, so that each yaw and grasp has a few
base poses, or none.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import (
    all_inside,
    any_overlap,
    invert,
    place_points,
    pose_planar,
    rotation,
)
from momapos.model.collision import FLOOR, FREE, CollisionWorld, base_hits, base_hits_moving
from momapos.model.kinematics import solve_ik
from momapos.model.records import MOVING_PULL, Outline, PoseOutcome, PoseStatus, ReachScorer
from momapos.model.robots import Robot
from momapos.model.scene import area_name
from momapos.planning.arm_motion import ArmPath, DrivingArm, find_paths, waypoint_name
from momapos.planning.grasps import FULL_DOF, TaskMotion, no_turning
from momapos.planning.placement import (
    BasePoseRule,
    GraspModeScorer,
    GraspModeScores,
    PlaceConfig,
    Problem,
    Search,
    search,
)

from .search_setup import SearchSetup

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


REACH = 3.0
"""How far the base slides to the grasp, more than the length of such arms and a door [m]."""
YAWS = 36
"""Number of yaws at which grasps are examined [-]."""
MAX_GRASPS = 4
"""Largest number of grasps to which a base pose is fitted [-]."""
_GOLDEN_RATIO = 0.5 * (5.0**0.5 - 1.0)
"""Its multiples modulo 1 are spread evenly, for any count [-]."""


@dataclass(frozen=True, eq=False)
class ShortArmStarts:
    """Shifts base poses so that a short arm takes hold there, each with one of the grasps."""

    robot: Robot
    motion: TaskMotion

    def __call__(
        self, poses: Float[np.ndarray, "n 3"]
    ) -> tuple[Float[np.ndarray, "n 3"], Int[np.ndarray, " n"]]:
        """Shift base poses.

        Returns:
            The shifted poses, and the grasp of each; -1 for an unchanged pose without one.
        """
        order, count = self._grasps
        poses, own = poses.copy(), np.full(len(poses), -1)
        column = np.rint(poses[:, 2] / (2 * np.pi / YAWS)).astype(np.int64) % YAWS
        for turn in range(MAX_GRASPS):
            left = np.flatnonzero((own < 0) & (turn < count[column]))
            share = (_GOLDEN_RATIO * left + turn / MAX_GRASPS) % 1.0
            rank = (share * count[column[left]]).astype(np.int64)
            chosen = order[rank, column[left]]
            q, found = self._solve(poses[left], chosen, self.motion.grasp_step)
            rows = np.flatnonzero(found > 0)
            slides = q[rows, :, :2]
            # Solutions come first, and NaN is the largest.
            best = slides[np.arange(len(rows)), np.hypot(*slides.T).T.argsort(1)[:, 0]]
            R = rotation(poses[left[rows], 2])
            poses[left[rows], :2] += np.einsum("nij,nj->ni", R, best)
            own[left[rows]] = chosen[rows]
        return poses, own

    @cached_property
    def _arm(self) -> DrivingArm:
        return DrivingArm(self.robot, np.eye(3)[:2], REACH)

    @cached_property
    def _grasps(self) -> tuple[Int[np.ndarray, "g y"], Int[np.ndarray, " y"]]:
        """Return the grasps in the order of trying them at each yaw, and how many are possible."""
        return np.argsort(~self.possible, axis=0, kind="stable"), self.possible.sum(0)

    @property
    def possible(self) -> Bool[np.ndarray, "g y"]:
        """Return with which grasps and at which yaws the arm reaches every waypoint from somewhere.

        Yaws are multiples of a full turn over `YAWS`. The base keeps its yaw.
        """
        return self._examined[0]

    @property
    def no_way(self) -> str:
        """Return why no grasp is possible at any yaw; "" if one is."""
        possible, last = self._examined
        if possible.any():
            return ""
        return f"no grasp is within reach at {waypoint_name(last)}, wherever the base moves"

    @cached_property
    def _examined(self) -> tuple[Bool[np.ndarray, "g y"], int]:
        """Return the possible grasps, and the waypoint that left none."""
        steps = self.motion.waypoint_steps
        position = self.motion.Ts_world_tool[0, self.motion.grasp_step, :2, 3]
        possible = np.ones((len(self.motion.Ts_world_tool), YAWS), bool)
        # The grasp and the end exclude most.
        count = len(steps)
        for waypoint in dict.fromkeys([1, count - 1, *range(count)]):
            step = int(steps[waypoint])
            grasp, column = np.nonzero(possible)
            yaw = column * (2 * np.pi / YAWS)
            poses = np.column_stack([np.tile(position, (len(yaw), 1)), yaw])
            possible[grasp, column] = self._solve(poses, grasp, step)[1] > 0
            if not possible.any():
                return possible, waypoint
        return possible, -1

    def _solve(
        self, poses: Float[np.ndarray, "n 3"], grasps: Int[np.ndarray, " n"], step: int
    ) -> tuple[Float[np.ndarray, "n b m"], Int[np.ndarray, " n"]]:
        """Solve for slides and arm at a step of the motion, see `solve_ik`."""
        Ts = invert(pose_planar(poses)) @ self.motion.Ts_world_tool[grasps, step]
        return solve_ik(self._arm.chain, self._arm.ik, Ts)


TRAVELS = (0.2, 0.4, 0.6)
"""How far the base moves with the part in the families, short ones first [m]."""
DIRECTIONS = 8
"""Number of directions in which an omnidirectional base moves in the families [-]."""
SLIDE = 0.8
"""How far the base of a short arm slides to either side, less than the reach of such arms [m]."""
_BLOCK = 4096
"""Base poses whose paths are checked together [-]."""


@dataclass(frozen=True, eq=False)
class BaseShift:
    """Base paths that advance with the part."""

    along: Float[np.ndarray, "2"]
    """Where the base ends, in its own frame [m]."""
    share: Float[np.ndarray, " d"]
    """Share of that at each step of the motion, 0 up to the grasp."""

    def paths(
        self, poses: Float[np.ndarray, "n 3"], steps: Int[np.ndarray, " w"] | slice = slice(None)
    ) -> Float[np.ndarray, "n w 3"]:
        """Return the base pose at steps of the motion, for base poses at the grasp."""
        share = self.share[steps]
        out = np.repeat(poses[:, None], len(share), axis=1)
        out[..., :2] += (rotation(poses[:, 2]) @ self.along)[:, None] * share[:, None]
        return out


@dataclass(frozen=True, eq=False)
class MovingBase:
    """One way in which the base moves; base poses are those where it begins."""

    robot: Robot
    world: CollisionWorld
    """The areas to keep out of have its last labels."""
    motion: TaskMotion
    clearance: float
    """Distance that the base keeps from everything [m]."""
    floor_polygon: Float[np.ndarray, "k 2"] | None
    keep_out: tuple[Outline, ...]
    """Areas that the base does not touch."""
    shift: BaseShift | None = None
    """The base path; None for an arm that takes the base as joints."""
    arm: DrivingArm | None = None
    """That arm."""

    def find(self, bases: Float[np.ndarray, "j 3"], grasps: Int[np.ndarray, " j"]) -> list[ArmPath]:
        """Search an arm path for each pair of base pose and grasp, see `find_paths`."""
        paths = bases if self.shift is None else self.shift.paths(bases)
        arm = self.arm or self.robot
        return find_paths(arm, self.world, self.motion, paths, grasps, {}, self.hits)

    def hits(
        self, bases: Float[np.ndarray, "d 3"], value: Int[np.ndarray, " d"]
    ) -> Int[np.ndarray, " d"]:
        """Return what the base hits at poses, given the index of the part's value at each."""
        base, world = self.robot.base, self.world
        codes = base_hits(bases, base, world.static, clearance=self.clearance)
        left = np.flatnonzero(codes == FREE)
        hit = base_hits_moving(
            bases[left], value[left], base, world.moving, clearance=self.clearance
        )
        codes[left] = np.where(hit == FREE, FREE, hit + len(world.static))
        if self.floor_polygon is not None:
            outlines = place_points(bases, self.robot.footprint)
            codes[~all_inside(self.floor_polygon, outlines)] = FLOOR
        for label, area in enumerate(self.keep_out, len(world.labels) - len(self.keep_out)):
            outlines = place_points(bases, self.robot.base_outline)
            codes[any_overlap(np.array(area), outlines)] = label
        return codes

    def keeps(
        self, poses: Float[np.ndarray, "n 3"], _travel: Float[np.ndarray, " n"]
    ) -> Bool[np.ndarray, " n"]:
        """Return from which base poses the base path is free, at the waypoints."""
        assert self.shift is not None
        steps = self.motion.waypoint_steps
        free = np.zeros(len(poses), bool)
        for first in range(0, len(poses), _BLOCK):
            paths = self.shift.paths(poses[first : first + _BLOCK], steps)
            value = np.tile(self.motion.value[steps], len(paths))
            codes = self.hits(paths.reshape(-1, 3), value).reshape(paths.shape[:2])
            free[first : first + _BLOCK] = (codes == FREE).all(1)
        return free

    @cached_property
    def scorer(self) -> GraspModeScorer:
        """Return the scorer of each grasp by its smallest reachability over the waypoints."""
        motion, shift = self.motion, self.shift
        # The end excludes most poses.
        steps = motion.waypoint_steps[[-1, *range(len(motion.waypoint_steps) - 1)]]
        if shift is None:
            steps = motion.waypoint_steps[:2]

        def score(reach: ReachScorer, poses: Float[np.ndarray, "n 3"]) -> GraspModeScores:
            scores = np.ones((len(poses), len(motion.Ts_world_tool)), np.float32)
            rows = np.arange(len(poses))
            for step in steps:
                at = poses[rows] if shift is None else shift.paths(poses[rows], step[None])[:, 0]
                Ts = np.ascontiguousarray(motion.Ts_world_tool[:, step : step + 1])
                scores[rows] = np.minimum(scores[rows], reach.min_score(at, Ts))
                rows = rows[scores[rows].max(1) > 0]
            return GraspModeScores(scores, scores.shape[1])

        return score


def search_moving(setup: SearchSetup, place: PlaceConfig) -> Search:
    """Search base poses from which the base moves with the part.

    Args:
        setup: A query that no fixed base pose solves.
        place: How to search.
    """
    every, rng = Search(), np.random.default_rng(setup.query.seed)
    problems = [_problem(setup, way) for way in _ways(setup)] or [_unsolvable(setup)]
    plans = [replace(place, rounds=1, grid=False)]
    if place.grid:
        plans.append(replace(place, rounds=0))
    for how in plans:
        for problem in problems:
            if problem.infeasible_reason and how is not plans[0]:
                continue  # it has no base poses
            every.merge(search(problem, how, rng), reasons=True)
            if every.motion is not None or every.timed_out:
                return every
    return every


def _ways(setup: SearchSetup) -> Iterator[MovingBase]:
    """Yield the ways in which the base may move, simple ones first."""
    prepared, robot = setup.prepared, setup.query.robot
    motion, geometry = prepared.motion, prepared.geometry
    if prepared.infeasible_reason or motion.latch_q is not None:
        return
    motion = replace(motion, more_pull=MOVING_PULL)
    world, keep_out = prepared.world, setup.query.region.keep_out
    areas = [f"the keep-out {area_name(area, setup.query.scene)}" for area in keep_out]
    world = replace(world, labels=(*world.labels, *areas)) if areas else world
    way = MovingBase(robot, world, motion, geometry.clearance, geometry.floor_polygon, keep_out)
    if robot.chain.size < FULL_DOF:
        axes = np.eye(3)[: 2 if robot.drive == "omni" else 1]
        rigid = replace(motion, turning=no_turning(len(motion.Ts_world_tool)))
        yield replace(way, motion=rigid, arm=DrivingArm(robot, axes, SLIDE))
        return
    share = motion.progress
    angles = np.arange(DIRECTIONS) * 2 * np.pi / DIRECTIONS if robot.drive == "omni" else [0, np.pi]
    for travel in TRAVELS:
        for angle in angles:
            along = travel * np.array([np.cos(angle), np.sin(angle)])
            yield replace(way, shift=BaseShift(np.round(along, 9), share))


def _unsolvable(setup: SearchSetup) -> Problem:
    """Return the problem of a task that no moving base does, with the reason."""
    reason = setup.prepared.infeasible_reason or "a latch is turned and opened from one base pose"
    return replace(setup.problem, infeasible_reason=reason)


def _problem(setup: SearchSetup, way: MovingBase) -> Problem:
    """Return the search's problem for one way in which the base moves."""
    prepared, motion = setup.prepared, way.motion
    begin = motion.waypoint_steps[:2]
    geometry = replace(
        prepared.geometry,
        Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[:, begin]),
        sweep=motion.moving.at(int(motion.value[0])),
    )
    path = BasePoseRule(way.keeps, PoseOutcome(PoseStatus.BASE_PATH_BLOCKED))
    starts = None if way.arm is None else ShortArmStarts(setup.query.robot, motion)
    check = replace(setup.feasible, motion=motion, find=way.find)
    return replace(
        setup.problem,
        geometry=geometry,
        mode_scorers=(way.scorer,),
        screen=check.screen,
        near=None,
        attempt=setup.accepted(check),
        infeasible_reason=setup.passage.no_way(geometry) or (starts.no_way if starts else ""),
        home_is_free=None,
        departure=None,
        rules=(setup.passage,),
        path_rules=() if way.shift is None else (path,),
        fit=starts,
    )
