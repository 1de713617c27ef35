"""Find which restriction of the base pose must give way, and by how little."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.core.geometry import contains, edge_distances, place_points, wrap_angle
from momapos.model.records import ANYWHERE, Outline
from momapos.model.scene import area_name

from .query import PlacementQuery
from .result import PlacementResult
from .trials import Trials

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

STEP = 0.05
"""Resolution of a wider area and of a longer drive [m]."""
TURN_STEP = np.radians(5.0)
"""Resolution of a wider angle [rad]."""
MAX_WIDENING = 2.0
"""An area that must grow by more is better dropped [m]."""
SAMPLES = 1024
"""Samples of a trial in an area, which contains few of them [-]."""

Relaxed: TypeAlias = "tuple[str, PlacementResult]"
"""A change in words, and the answer with it."""


def relaxed_restriction(query: PlacementQuery, trials: Trials) -> Relaxed | None:
    """Return a small change of the restrictions of the base pose with which a plan exists, or None.

    One restriction is relaxed if that is enough, as little as trials show. Else all are dropped.
    """
    anywhere = trials.solve(replace(query, region=ANYWHERE))
    if anywhere is None:
        return None
    found: Relaxed | None = None
    for relax, nothing in (
        (_keep_in, {"keep_in": ()}), (_keep_out, {"keep_out": ()}), (_facing, {"facing": None}),
        (_driving, {"most_driving": None}),
    ):  # fmt: skip
        free = _with(query, **nothing)
        if found is None and free.region != query.region:
            known = anywhere if free.region == ANYWHERE else trials.solve(free)
            found = None if known is None else relax(query, known, trials)
    return found or ("without the restrictions of the base pose", anywhere)


def _keep_in(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    areas = query.region.keep_in
    size = _steps(float(_beyond(query, areas, _base(known)[None])[0]), STEP)
    if size * STEP > MAX_WIDENING:
        return f"outside the keep-in {_names(query, areas)}", known
    free = _with(query, keep_in=())

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_within(free, areas, size * STEP), count=SAMPLES)

    size, best = trials.smallest(solve, size, known)
    return f"with the keep-in {_names(query, areas)} widened by {100 * size * STEP:.0f} cm", best


def _keep_out(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    areas = query.region.keep_out
    for k, area in enumerate(areas):
        others = areas[:k] + areas[k + 1 :]
        found = trials.solve(_with(query, keep_out=others)) if others else known
        if found is not None:
            return f"without the keep-out {_names(query, (area,))}", found
    return f"without the keep-out {_names(query, areas)}", known


def _facing(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    angle = query.region.facing
    assert angle is not None
    base, target = _base(known), known.prepared.geometry.Ts_world_tool[0, 1, :2, 3]
    x, y = target - base[:2]
    turn = abs(float(wrap_angle(np.arctan2(y, x) - base[2])))

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_with(query, facing=angle + size * TURN_STEP))

    size, best = trials.smallest(solve, _steps(turn - angle, TURN_STEP), known)
    return (
        f"with the base facing the grasp within {np.degrees(angle + size * TURN_STEP):.0f} deg",
        best,
    )


def _driving(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    most, needed = query.region.most_driving, known.plan.navigation_cost
    assert most is not None
    assert needed is not None

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_with(query, most_driving=most + size * STEP))

    size, best = trials.smallest(solve, _steps(needed - most, STEP), known)
    return f"with a drive of up to {most + size * STEP:.2f} m", best


def _with(query: PlacementQuery, **changes: Any) -> PlacementQuery:
    """Return the query with other restrictions."""
    return replace(query, region=replace(query.region, **changes))


def _base(answer: PlacementResult) -> Float[np.ndarray, "3"]:
    assert answer.plan.base_pose is not None
    return np.array(answer.plan.base_pose)


def _steps(excess: float, step: float) -> int:
    """Return the number of steps that are at least an excess."""
    return max(1, int(np.ceil(excess / step - 1e-9)))


def _names(query: PlacementQuery, areas: tuple[Outline, ...]) -> str:
    """Return areas in words, by their names in the scene or else by where they are."""
    found = " and ".join(area_name(one, query.scene).removeprefix("area ") for one in areas)
    return f"area{'s' if len(areas) > 1 else ''} {found}"


def _within(query: PlacementQuery, areas: tuple[Outline, ...], most: float) -> PlacementQuery:
    """Return the query for base poses whose footprint leaves one of the areas by a distance."""
    keeps = query.keep_poses

    def near(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        kept = _beyond(query, areas, poses) <= most + 1e-9
        return kept if keeps is None else kept & keeps(poses)

    return replace(query, keep_poses=near)


def _beyond(
    query: PlacementQuery, areas: tuple[Outline, ...], poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return how far the footprint leaves the best of the areas at each base pose [m]."""
    footprint = query.robot.footprint
    middles = (footprint + np.roll(footprint, -1, axis=0)) / 2
    points = place_points(poses, np.concatenate([footprint, middles])).reshape(-1, 2)
    each = []
    for area in areas:
        polygon = np.array(area)
        outside = np.where(contains(polygon, points), 0.0, edge_distances(points, polygon))
        each.append(outside.reshape(len(poses), -1).max(1))
    return np.asarray(np.min(each, axis=0))
