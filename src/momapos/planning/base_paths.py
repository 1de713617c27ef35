"""The ways to base poses, and on from there when the task is done."""

from __future__ import annotations

from dataclasses import dataclass, field
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError
from momapos.model.records import ArmPathResult, Attempt, PoseOutcome, PoseStatus
from momapos.model.scene import Scene
from momapos.planning.navigation import (
    BasePath,
    NavigationMap,
    gaps,
    leads_straight,
    plan_path,
    with_object_moved,
)
from momapos.planning.placement import AttemptPose

from .query import PlacementQuery
from .task_setup import roomy_place

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_AWAY = 0.3
"""A part that stays so far from where the robot came from leaves it there as free as it was [m]."""


@dataclass(frozen=True)
class Drives:
    """The ways to base poses with the arm at home."""

    query: PlacementQuery
    start: Float[np.ndarray, "3"]
    _paths: dict[bytes, BasePath | None] = field(default_factory=dict)
    _cut_off: list[Float[np.ndarray, "3"]] = field(default_factory=list)
    """Base poses to which no way was found, which is told slowly."""

    def path(self, base: Float[np.ndarray, "3"] | None) -> BasePath | None:
        """The way to a base pose that was checked, if there is one."""
        return None if base is None else self._paths.get(base.tobytes())

    def drivable(self, check: AttemptPose) -> AttemptPose:
        """A check that asks for a way to the base pose as well, and what the query does."""

        def attempt(
            base: Float[np.ndarray, "3"], screened: ArmPathResult, ways: Int[np.ndarray, " k"]
        ) -> Attempt:
            nav_map, no_way = self.query.nav_map, PoseOutcome(PoseStatus.NO_ROUTE_AT_HOME)
            with self.query.watch.stage("way"):
                if any(leads_straight(nav_map, base, other) for other in self._cut_off):
                    return Attempt(None, no_way)
            found = check(base, screened, ways)
            if found.motion is None:
                return found
            with self.query.watch.stage("way"):
                path = self._paths[base.tobytes()] = plan_path(nav_map, self.start, base)
            if path is None:
                self._cut_off.append(base)
                return Attempt(None, no_way)
            also = self.query.also
            refused = None if also is None else also(base)
            return found if refused is None else Attempt(None, refused)

        return attempt


@dataclass(frozen=True)
class WaysOn:
    """Whether the robot can drive on from base poses when the task is done.

    Mostly the way that it came is free still. Else there has to be a way for the whole footprint to
    where it came from, or, where the part has come near to that, to a roomy place close by.
    """

    drives: Drives
    _known: dict[bool, list[Float[np.ndarray, "3"]]] = field(
        default_factory=lambda: {True: [], False: []}
    )
    """Base poses from which a way leads there, and from which none does."""
    _compared: dict[bytes, tuple[int, bool]] = field(default_factory=dict)
    """By base pose: with how many that shut the robot in it was compared, and whether one of them
    is beside it."""

    def __call__(self, base: Float[np.ndarray, "3"]) -> bool:
        """Look at a base pose to which a way was found."""
        came, query = self.drives.path(base), self.drives.query
        assert came is not None
        room = gaps(came.poses, query.nav_map.prisms, query.outlines_after, cap=_AWAY)
        if room[0] >= _AWAY and (room > 0.0).all():
            return True
        if room[-1] <= 0.0:
            return False
        with query.watch.stage("way"):
            if any(leads_straight(self._map_after, base, free) for free in self._known[True]):
                return True
            goal = came.poses[0] if room[0] >= _AWAY else self._roomy
            leads = goal is not None and plan_path(self._map_after, base, goal) is not None
        self._known[leads].append(base)
        return leads

    def hopeless(self, base: Float[np.ndarray, "3"]) -> bool:
        """Whether it touches what was moved, or is beside a pose from which no way leads on.

        A search comes to many poses in the same corner, and that no way leads out is told slowly.
        """
        query, shut_in, key = self.drives.query, self._known[False], base.tobytes()
        before, out = self._compared.get(key, (0, False))
        if key not in self._compared:
            out = bool((gaps(base[None], query.nav_map.prisms, query.outlines_after) <= 0.0).any())
        with query.watch.stage("way"):
            nav_map = self._map_after
            out = out or any(leads_straight(nav_map, base, other) for other in shut_in[before:])
        self._compared[key] = len(shut_in), out
        return out

    @cached_property
    def _after(self) -> Scene:
        task = self.drives.query.task
        assert task.joint is not None
        assert task.to is not None
        return self.drives.query.scene.with_joint(task.object, task.joint, task.to)

    @cached_property
    def _map_after(self) -> NavigationMap:
        query = self.drives.query
        return with_object_moved(query.nav_map, query.task.object, query.outlines_after)

    @cached_property
    def _roomy(self) -> Float[np.ndarray, "3"] | None:
        """A place with room near the start; None where there is none in all of the room."""
        try:
            return roomy_place(self._after, self._map_after, self.drives.start[:2])
        except SceneError:
            return None
