"""Paths of the base: to base poses, and away from them after the task."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.core.geometry import any_overlap, place_points
from momapos.model.records import ArmPathResult, Attempt, Motion, PoseOutcome, PoseStatus
from momapos.model.scene import Scene, area_name, scene_after
from momapos.planning.navigation import (
    BasePath,
    CostMap,
    NavigationMap,
    Passage,
    ReachableFloor,
    build_navigation_map,
    gaps,
    lead_straight,
    leads_straight,
    plan_path,
    with_object_moved,
)
from momapos.planning.placement import AttemptPose, PlacementGeometry, reachable_rectangle

from .carrying import Carrying
from .query import PlacementQuery
from .task_setup import roomy_place

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

_MAX_INFLUENCE = 0.3
"""A moved part farther than this from the robot's path does not affect it [m]."""


MAX_CUT_OFF = 6
"""Base poses, between which no straight path leads, to which a robot does not get with an object in
some state of its arm, until that state is given up [-]."""


@dataclass(frozen=True, eq=False)
class AreaRule:
    """Rules out base poses to which only areas that the base keeps out of block all paths."""

    query: PlacementQuery
    start: Float[np.ndarray, "3"]
    costs: CostMap
    """Driving lengths through the areas."""

    def keeps(
        self, poses: Float[np.ndarray, "n 3"], travel: Float[np.ndarray, " n"]
    ) -> Bool[np.ndarray, " n"]:
        """Return which base poses are reached, or not even through the areas."""
        kept = np.isfinite(travel)
        kept[~kept] = np.isinf(self.costs.lengths(poses[~kept]))
        return kept

    @cached_property
    def open_map(self) -> NavigationMap:
        """Return where the robot fits if it may drive through the areas."""
        return build_navigation_map(self.query.scene, self.query.robot)

    @property
    def otherwise(self) -> PoseOutcome:
        """Return the outcome of the others, which names the areas."""
        areas = self.query.region.keep_out
        names = [area_name(area, self.query.scene) for area in areas]
        begun = place_points(self.start[None], self.query.robot.base_outline)
        inside = any(any_overlap(np.array(area), begun)[0] for area in areas)
        where = ", where the robot starts" if inside else ""
        return PoseOutcome(PoseStatus.AREA_IN_THE_WAY, f"the keep-out {' and '.join(names)}{where}")


@dataclass(eq=False)
class PassageRule:
    """Rules out base poses to which the robot's smallest cross-section cannot get.

    Most base poses are next to wide passages; the fill is computed for others only.
    """

    query: PlacementQuery
    start: Float[np.ndarray, "3"]
    costs: CostMap
    areas: AreaRule | None
    """None if the base need not keep out of areas."""
    _passage: str = ""

    def keeps(
        self, poses: Float[np.ndarray, "n 3"], _travel: Float[np.ndarray, " n"]
    ) -> Bool[np.ndarray, " n"]:
        """Return which base poses may be reached."""
        kept = self.costs.is_plainly_reached(poses[:, :2])
        if kept.all():
            return kept
        with self.query.watch.stage("path"):
            kept[~kept] = self._floor.contains(poses[~kept, :2])
            if not kept.all() and not self._passage:
                self._passage = _words(self._floor.passage(poses[~kept, :2]))
        return kept

    def no_way(self, *geometries: PlacementGeometry) -> str:
        """Return why no base pose that serves all of some motions can be reached; "" if one may."""
        each = [reachable_rectangle(one) for one in geometries]
        known = np.array([one for one in each if one is not None])
        if len(known) < len(each):
            return ""
        corners = np.stack([known[:, 0].max(0), known[:, 1].min(0)])
        if (corners[0] > corners[1]).any() or self.costs.is_rectangle_plainly_reached(corners):
            return ""
        with self.query.watch.stage("path"):
            if self._floor.meets(corners):
                return ""
            if self.areas is not None and self._floor_of(self.areas.open_map).meets(corners):
                return str(self.areas.otherwise)
            self._passage = _words(self._floor.passage(self._floor.centers(corners)))
        return str(self.otherwise)

    @cached_property
    def _floor(self) -> ReachableFloor:
        return self._floor_of(self.query.nav_map)

    def _floor_of(self, nav_map: NavigationMap) -> ReachableFloor:
        x, y = self.start[:2].tolist()
        return ReachableFloor(nav_map, (x, y))

    @property
    def otherwise(self) -> PoseOutcome:
        """Return the outcome of the others, which names the narrowest passage."""
        return PoseOutcome(PoseStatus.NO_PASSAGE, self._passage)


def _words(passage: Passage | None) -> str:
    return str(passage or "obstacles close it off from the start, with the arm at home")


@dataclass(frozen=True, eq=False)
class BasePaths:
    """Paths to base poses with the arm at home."""

    query: PlacementQuery
    start: Float[np.ndarray, "3"]
    areas: AreaRule | None = None
    """None if the base need not keep out of areas."""
    carrying: Carrying | None = None
    """How the robot carries an object; None if its hand is free, with the arm at home."""
    _paths: dict[tuple[bytes, NavigationMap], BasePath | None] = field(default_factory=dict)
    _cut_off: dict[NavigationMap, list[Float[np.ndarray, "3"]]] = field(default_factory=dict)
    """Base poses without a path; finding that out is slow."""
    _led: set[NavigationMap] = field(default_factory=set)
    """With these, a path led to some base pose."""

    def path(self, base: Float[np.ndarray, "3"] | None, motion: Motion | None) -> BasePath | None:
        """Return the path to a base pose that was checked, if there is one.

        Args:
            base: The base pose.
            motion: The motion from there, which begins as the arm is on the path.
        """
        return None if base is None else self._paths.get((base.tobytes(), self._map_of(motion)))

    def homes(self, base: Float[np.ndarray, "3"], grasp: int) -> Iterator[np.ndarray]:
        """Yield the arm states in which the robot can carry an object to a base pose.

        A state with which the first base poses have no path is not tried at others, nor one that
        takes up more of the floor than another one without a path.
        """
        assert self.carrying is not None
        for nav_map in self.carrying.maps(grasp):
            with self.query.watch.stage("path"):
                leads = (
                    not self._is_given_up(nav_map)
                    and not self._fails(base, nav_map)
                    and self._plan(base, nav_map) is not None
                )
            if leads:
                self._led.add(nav_map)
                yield nav_map.robot.home

    def _is_given_up(self, nav_map: NavigationMap) -> bool:
        given_up = [one for one, poses in self._cut_off.items() if len(poses) >= MAX_CUT_OFF]
        return nav_map not in self._led and self._is_within(given_up, nav_map)

    def _fails(self, base: Float[np.ndarray, "3"], nav_map: NavigationMap) -> bool:
        cut_off = [one for one in self._cut_off if self._is_cut_off(base, one)]
        return self._is_within(cut_off, nav_map)

    def _is_within(self, smaller: Sequence[NavigationMap], nav_map: NavigationMap) -> bool:
        """Return whether a way of carrying takes up as much of the floor as one of others."""
        assert self.carrying is not None
        sizes = np.array([self.carrying.size(one) for one in smaller]).reshape(-1, 2)
        return bool((sizes <= self.carrying.size(nav_map)).all(1).any())

    @property
    def _carries_nowhere(self) -> bool:
        """Return whether all ways to carry an object are given up."""
        if self.carrying is None or self._led or not self._cut_off:
            return False
        failed = any(len(poses) >= MAX_CUT_OFF for poses in self._cut_off.values())
        return failed and all(map(self._is_given_up, self.carrying.every_map()))

    def _map_of(self, motion: Motion | None) -> NavigationMap:
        if self.carrying is None or motion is None:
            return self.query.nav_map
        return self.carrying.map_of(motion)

    def _is_cut_off(self, base: Float[np.ndarray, "3"], nav_map: NavigationMap) -> bool:
        return any(leads_straight(nav_map, base, other) for other in self._cut_off.get(nav_map, ()))

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Return whether a path may lead to a base pose; planned only after one had none."""
        if self.query.nav_map not in self._cut_off:
            return True
        with self.query.watch.stage("path"):
            if self.known_blocked(base[None]).any():
                return False
            return self._plan(base, self.query.nav_map) is not None

    def known_blocked(self, bases: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        """Return which base poses are next to one without a path."""
        blocked = np.full(len(bases), self._carries_nowhere)
        for other in self._cut_off.get(self.query.nav_map, ()):
            blocked[~blocked] = lead_straight(self.query.nav_map, bases[~blocked], other)
        return blocked

    def _plan(self, base: Float[np.ndarray, "3"], nav_map: NavigationMap) -> BasePath | None:
        """Plan the path to a base pose, once."""
        key = base.tobytes(), nav_map
        if key not in self._paths:
            self._paths[key] = plan_path(nav_map, self.start, base)
            if self._paths[key] is None:
                self._cut_off.setdefault(nav_map, []).append(base)
        return self._paths[key]

    def no_way(self) -> PoseOutcome:
        """Return the outcome of base poses without a path."""
        if self.carrying is not None and self.query.nav_map not in self._cut_off:
            return PoseOutcome(PoseStatus.NO_ROUTE_CARRYING, self.query.task.object)
        if self.areas is not None and self._leads_through_areas:
            return self.areas.otherwise
        return PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)

    @cached_property
    def _leads_through_areas(self) -> bool:
        """Whether a path through areas leads to the first base pose that has no other."""
        assert self.areas is not None
        with self.query.watch.stage("path"):
            first = self._cut_off[self.query.nav_map][0]
            return plan_path(self.areas.open_map, self.start, first) is not None

    def drivable(self, check: AttemptPose) -> AttemptPose:
        """Extend a check by the path to the base pose and the query's final check."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            with self.query.watch.stage("path"):
                if self._is_cut_off(base, self.query.nav_map):
                    return Attempt(None, self.no_way())
            found = check(base, screened, ways)
            if found.motion is None:
                return found
            base = base if found.base is None else found.base
            with self.query.watch.stage("path"):
                path = self._plan(base, self._map_of(found.motion))
            if path is None:
                return Attempt(None, self.no_way())
            final = self.query.final_check
            moved = found.motion.base
            refused = None if final is None else final(base if moved is None else moved[-1])
            return found if refused is None else Attempt(None, refused)

        return attempt


@dataclass(frozen=True, eq=False)
class OnwardPaths:
    """Check whether the robot can drive on from base poses after the task.

    Usually the path that it came by is still free. If not, there must be a path for the whole
    footprint to its start or, if the moved part is close to that, to a free place near it.
    """

    drives: BasePaths
    _known: dict[bool, list[Float[np.ndarray, "3"]]] = field(
        default_factory=lambda: {True: [], False: []}
    )
    """Base poses with such a path, and without."""
    _compared: dict[bytes, tuple[int, bool]] = field(default_factory=dict)
    """By base pose: the number of blocked poses it was compared with, and whether one of them
    is next to it."""

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Return whether the robot can drive on from a base pose that has a path."""
        came, query = self.drives.path(base, None), self.drives.query
        assert came is not None
        room = gaps(came.poses, query.nav_map.prisms, query.outlines_after, cap=_MAX_INFLUENCE)
        if room[0] >= _MAX_INFLUENCE and (room > 0.0).all():
            return True
        if room[-1] <= 0.0:
            return False
        with query.watch.stage("path"):
            if any(leads_straight(self._map_after, base, free) for free in self._known[True]):
                return True
            goal = came.poses[0] if room[0] >= _MAX_INFLUENCE else self._roomy
            leads = goal is not None and plan_path(self._map_after, base, goal) is not None
        self._known[leads].append(base)
        return leads

    def is_known_blocked(self, base: Float[np.ndarray, "3"]) -> bool:
        """Return whether the base touches the moved part or is next to a pose that is blocked in.

        A search visits many poses in the same corner, and planning a path that does not exist is
        slow.
        """
        query, blocked, key = self.drives.query, self._known[False], base.tobytes()
        before, out = self._compared.get(key, (0, False))
        if key not in self._compared:
            out = bool((gaps(base[None], query.nav_map.prisms, query.outlines_after) <= 0.0).any())
        with query.watch.stage("path"):
            nav_map = self._map_after
            out = out or any(leads_straight(nav_map, base, other) for other in blocked[before:])
        self._compared[key] = len(blocked), out
        return out

    @cached_property
    def _after(self) -> Scene:
        return scene_after(self.drives.query.scene, self.drives.query.task)

    @cached_property
    def _map_after(self) -> NavigationMap:
        query = self.drives.query
        return with_object_moved(query.nav_map, query.task.object, query.outlines_after)

    @cached_property
    def _roomy(self) -> Float[np.ndarray, "3"] | None:
        """Return a free place near the start; None if the scene has none."""
        try:
            return roomy_place(self._after, self._map_after, self.drives.start[:2])
        except SceneError:
            return None
