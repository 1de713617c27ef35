"""The robot and the scene as upright prisms: convex outlines on the floor, with heights.

A robot with its arm at home is a stack of prisms; the lowest one is its footprint. So a low base
can pass under a table that the arm clears, and an arm over a countertop that the base clears.
Everything between the floor and the top of the robot is checked.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache, cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import owner_cache
from momapos.core.compiled import F1, F2, I1, entry, kernel
from momapos.core.geometry import (
    all_inside,
    apply,
    convex_hull,
    edge_normals,
    invert,
    normals_of,
    place_points,
    signed_area,
)
from momapos.model.robots import Robot
from momapos.model.scene import MAX_STEP_HEIGHT, Scene, SceneObject
from momapos.model.urdf import Hull

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_PRISMS = 5
"""Largest number of prisms of a robot [-]."""


class PrismArrays(NamedTuple):
    """The prisms of a robot for the kernels, base frame; see `RobotPrisms` and `ConvexPolygons`."""

    corner: F2
    normal: F2
    level: F1
    first: I1
    radius: float


class PolygonArrays(NamedTuple):
    """Convex polygons for the kernels, see `ConvexPolygons`."""

    corner: F2
    normal: F2
    level: F1
    first: I1
    layer: I1
    bounds: F2


@dataclass(frozen=True, eq=False)
class RobotPrisms:
    """The robot with its arm at home, as a stack of prisms."""

    outlines: tuple[Float[np.ndarray, "_ 2"], ...]
    """From the floor up, convex and counterclockwise, in the base frame [m]."""
    heights: Float[np.ndarray, " k_plus_1"]
    """Bottom of each prism, and the top of the robot [m]."""

    @cached_property
    def radius(self) -> float:
        """Distance from the base's origin to the farthest corner [m]."""
        return float(max(np.linalg.norm(outline, axis=1).max() for outline in self.outlines))

    @cached_property
    def inside(self) -> Bool[np.ndarray, "k k"]:
        """Whether the outline of the first index is within that of the second."""
        within = [
            [bool((a @ n.T <= np.einsum("ki,ki->k", b, n) + 1e-9).all()) for a in self.outlines]
            for b, n in ((b, edge_normals(b)) for b in self.outlines)
        ]
        return np.array(within).T

    @cached_property
    def arrays(self) -> PrismArrays:
        """The prisms for the kernels."""
        layers = range(len(self.outlines))
        packed = pack(self.outlines, layers, ["robot"] * len(self.outlines))
        return PrismArrays(packed.corner, packed.normal, packed.level, packed.first, self.radius)


@dataclass(frozen=True, eq=False)
class HeldObject:
    """An object in the hand of a robot that drives."""

    name: str
    T_tool_object: Float[np.ndarray, "4 4"]
    hulls: tuple[Float[np.ndarray, "_ 3"], ...]
    """Corners of its hulls, in the tool frame [m]."""

    @classmethod
    def of(cls, item: SceneObject, T_world_tool: Float[np.ndarray, "4 4"]) -> HeldObject:
        """Return an object where it is in the scene, in a hand there."""
        T_tool_world = invert(T_world_tool)
        hulls = [
            apply(T_tool_world @ T, hull.vertices)
            for link, T in item.link_poses().items()
            for hull in item.model.hulls[link]
        ]
        return cls(item.name, T_tool_world @ item.T_world_object, tuple(hulls))


@dataclass(frozen=True, eq=False)
class ConvexPolygons:
    """Convex polygons on the floor, counterclockwise, one after the other."""

    corner: Float[np.ndarray, "p 2"]
    normal: Float[np.ndarray, "p 2"]
    """Outward normal of the edge from each corner to the next."""
    level: Float[np.ndarray, " p"]
    """The edge is where normal . x equals this [m]."""
    first: Int[np.ndarray, " o_plus_1"]
    """Index of each polygon's first corner, and the number of corners."""
    layer: Int[np.ndarray, " o"]
    """Index of the robot's prism that each polygon obstructs, from the floor up."""
    bounds: Float[np.ndarray, "o 4"]
    """Low x, low y, high x, high y [m]."""
    names: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.layer)

    @property
    def arrays(self) -> PolygonArrays:
        """The polygons for the kernels, without names."""
        return PolygonArrays(
            self.corner, self.normal, self.level, self.first, self.layer, self.bounds
        )

    def polygon(self, index: int) -> Float[np.ndarray, "k 2"]:
        """Return the corners of one polygon [m]."""
        return self.corner[self.first[index] : self.first[index + 1]]

    def subset(self, which: Bool[np.ndarray, " o"]) -> ConvexPolygons:
        """Return some of the polygons."""
        lengths = np.diff(self.first)
        corners = np.repeat(which, lengths)
        first = np.concatenate([[0], np.cumsum(lengths[which])])
        names = tuple(name for name, kept in zip(self.names, which, strict=True) if kept)
        return ConvexPolygons(
            self.corner[corners], self.normal[corners], self.level[corners], first,
            self.layer[which], self.bounds[which], names,
        )  # fmt: skip

    def of_object(self, name: str) -> Bool[np.ndarray, " o"]:
        """Return which polygons belong to an object's links."""
        return np.array([one.startswith(f"{name}/") for one in self.names], bool)


def concatenate(parts: Sequence[ConvexPolygons]) -> ConvexPolygons:
    """Concatenate sets of polygons."""
    lengths = np.concatenate([np.diff(part.first) for part in parts])
    return ConvexPolygons(
        np.concatenate([part.corner for part in parts]),
        np.concatenate([part.normal for part in parts]),
        np.concatenate([part.level for part in parts]),
        np.concatenate([[0], np.cumsum(lengths)]),
        np.concatenate([part.layer for part in parts]),
        np.concatenate([part.bounds for part in parts]),
        tuple(name for part in parts for name in part.names),
    )


def pack(
    polygons: Sequence[Float[np.ndarray, "_ 2"]], layers: Sequence[int], names: Sequence[str]
) -> ConvexPolygons:
    """Stack polygons into arrays."""
    first = np.concatenate([[0], np.cumsum([len(p) for p in polygons])]).astype(np.int64)
    if not len(polygons):
        none = np.zeros((0, 2))
        return ConvexPolygons(
            none, none, np.zeros(0), first, np.zeros(0, np.int64), np.zeros((0, 4)), ()
        )
    corner, after = np.concatenate(polygons), np.arange(1, first[-1] + 1)
    after[first[1:] - 1] = first[:-1]
    normal = normals_of(corner[after] - corner)
    low, high = (ends.reduceat(corner, first[:-1]) for ends in (np.minimum, np.maximum))
    bounds = np.concatenate([low, high], axis=1)
    level = np.einsum("pi,pi->p", corner, normal)
    return ConvexPolygons(
        corner, normal, level, first, np.array(layers, np.int64), bounds, tuple(names)
    )


@owner_cache()
def prisms_of(robot: Robot, held: HeldObject | None = None) -> RobotPrisms:
    """Enclose a robot in prisms, cut at the heights that minimize their volume.

    The lowest prism contains the footprint of the robot file. Cuts are added greedily, one by one.

    Args:
        robot: The robot, with its arm at home.
        held: What it holds.
    """
    shapes = _shapes(robot, held)
    low = np.array([points[:, 2].min() for points in shapes])
    high = np.array([points[:, 2].max() for points in shapes])
    flat = [convex_hull(points[:, :2]) for points in shapes]

    @cache
    def outline(begin: float, end: float) -> np.ndarray:
        met = [flat[i] for i in np.flatnonzero((low < end) & (high > begin))]
        given = [robot.footprint, *met] if begin == 0.0 or not met else met
        return convex_hull(np.concatenate(given))

    @cache
    def area(begin: float, end: float) -> float:
        return float(signed_area(outline(begin, end)))

    def volume(heights: list[float]) -> float:
        return sum(area(begin, end) * (end - begin) for begin, end in pairwise(heights))

    top = float(high.max(initial=0.3))
    heights = [0.0, top]
    at = np.unique(np.round(np.concatenate([low, high]), 3))
    cuts = at[(at > MAX_STEP_HEIGHT) & (at < top - MAX_STEP_HEIGHT)].tolist()
    for _ in range(min(MAX_PRISMS - 1, len(cuts))):
        heights = min((sorted({*heights, cut}) for cut in cuts), key=volume)
    outlines = tuple(outline(begin, end) for begin, end in pairwise(heights))
    return RobotPrisms(outlines, np.array(heights))


def outline_from_above(robot: Robot, held: HeldObject | None = None) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline of all prisms of a robot and of what it holds, see `prisms_of`."""
    points = [shape[:, :2] for shape in _shapes(robot, held)]
    return convex_hull(np.concatenate([robot.footprint, *points]))


def _shapes(robot: Robot, held: HeldObject | None) -> list[Float[np.ndarray, "_ 3"]]:
    """Return the corners of the hulls of a robot and of what it holds, in the base frame [m]."""
    poses = robot.model.link_poses(dict(zip(robot.arm_joints, robot.home, strict=True)))
    T_base_root = invert(poses[robot.base_link])
    shapes = [
        apply(T_base_root @ poses[link], hull.vertices)
        for link, hulls in robot.model.hulls.items()
        for hull in hulls
    ]
    if held is not None:
        shapes += [apply(T_base_root @ poses[robot.tool_link], points) for points in held.hulls]
    return shapes


def obstacles_of(scene: Scene, prisms: RobotPrisms) -> ConvexPolygons:
    """Project everything between the floor and the robot's top, for each prism it obstructs."""
    hulls = [
        (f"{item.name}/{link}", _from_above(hull, tuple(T.ravel().tolist())))
        for item in scene.objects
        for link, T in item.link_poses().items()
        for hull in item.model.hulls[link]
    ]
    if not hulls:
        return pack([], [], [])
    low = np.array([above.low for _, above in hulls])[:, None]
    high = np.array([above.high for _, above in hulls])[:, None]
    met = (low < prisms.heights[1:]) & (high > np.maximum(prisms.heights[:-1], MAX_STEP_HEIGHT))
    # A prism within a wider one that is obstructed too needs no check of its own.
    index = np.arange(len(prisms.outlines))
    wider = prisms.inside & ~(prisms.inside.T & (index[:, None] <= index))
    which, layers = np.nonzero(met & ~(met[:, None] & wider).any(axis=2))
    return pack([hulls[i][1].outline for i in which], layers.tolist(), [hulls[i][0] for i in which])


@dataclass(frozen=True, eq=False)
class _Above:
    """A convex body in the world."""

    points: Float[np.ndarray, "n 3"]
    """[m]"""

    @cached_property
    def low(self) -> float:
        """Return its least height [m]."""
        return float(self.points[:, 2].min())

    @cached_property
    def high(self) -> float:
        """Return its largest height [m]."""
        return float(self.points[:, 2].max())

    @cached_property
    def outline(self) -> Float[np.ndarray, "k 2"]:
        """Return its outline from above [m]."""
        return convex_hull(self.points[:, :2])


@owner_cache(8)
def _from_above(hull: Hull, T_world_link: tuple[float, ...]) -> _Above:
    """Place a convex body; a task moves few of a scene's."""
    return _Above(apply(np.reshape(T_world_link, (4, 4)), hull.vertices))


def planning_outlines(
    outlines: ConvexPolygons, floor: Float[np.ndarray, "k 2"] | None
) -> ConvexPolygons:
    """Drop outlines inside other ones, and add the edges of the floor."""
    kept = np.flatnonzero(~_covered(outlines))
    polygons = [outlines.polygon(int(i)) for i in kept]
    layers = outlines.layer[kept].tolist()
    names = [outlines.names[i] for i in kept]
    if floor is not None:
        polygons += list(np.stack([floor, np.roll(floor, -1, axis=0)], axis=1))
        layers += [0] * len(floor)
        names += ["the edge of the floor"] * len(floor)
    return pack(polygons, layers, names)


def _covered(outlines: ConvexPolygons) -> Bool[np.ndarray, " o"]:
    """Find outlines inside another one of their layer; of equal ones, all but the first."""
    covered: np.ndarray = _covered_polygons(outlines.arrays)
    return covered


@entry
def _covered_polygons(polygons: PolygonArrays) -> np.ndarray:
    """Compare each outline with every other one of its layer whose bounds contain its own."""
    first, layer, bounds = polygons.first, polygons.layer, polygons.bounds
    covered = np.zeros(len(layer), np.bool_)
    for i in range(len(layer)):
        if covered[i]:
            continue
        for j in range(len(layer)):
            if j == i or covered[j] or layer[j] != layer[i]:
                continue
            if bounds[j, 0] < bounds[i, 0] - 1e-9 or bounds[j, 1] < bounds[i, 1] - 1e-9:
                continue
            if bounds[j, 2] > bounds[i, 2] + 1e-9 or bounds[j, 3] > bounds[i, 3] + 1e-9:
                continue
            covered[j] = _within(polygons, j, first[i], first[i + 1])
    return covered


@kernel
def _within(polygons: PolygonArrays, j: int, begin: int, end: int) -> bool:
    """Return whether all corners of polygon j are inside the edges from begin to end."""
    for c in range(polygons.first[j], polygons.first[j + 1]):
        x, y = polygons.corner[c]
        for e in range(begin, end):
            if x * polygons.normal[e, 0] + y * polygons.normal[e, 1] > polygons.level[e] + 1e-9:
                return False
    return True


def on_floor(
    prisms: RobotPrisms, floor: Float[np.ndarray, "k 2"] | None, poses: Float[np.ndarray, "n 3"]
) -> Bool[np.ndarray, " n"]:
    """Check at which base poses the footprint is on the floor."""
    if floor is None:
        return np.ones(len(poses), bool)
    return all_inside(floor, place_points(poses, prisms.outlines[0]))
