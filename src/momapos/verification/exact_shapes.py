"""Collision elements as convex shapes for the exact check: primitives, and meshes as hulls.

Hollow meshes of robots, and of furniture that stands still, are convex pieces.
"""

from __future__ import annotations

import re
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import islice
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import UrdfError, owner_cache
from momapos.core.compiled import F1, F2, F3, F4, I1, entry
from momapos.core.geometry import apply, invert
from momapos.model.urdf import (
    Articulated,
    Geometry,
    Hull,
    StaticElement,
    is_concave,
    pieces_of,
    triangles_of,
)

from .convex import Body
from .link_bodies import LinkBodies, bodies_of

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_SURFACE_TRIANGLES = 100_000
"""Meshes with more triangles count as their hulls [-]."""
_SOLID = re.compile(r" \((hull|piece) of .*\)$")
_NUMBERED = re.compile(r" \(piece \d+ of .*\)$")
_TESTED_TRIANGLES = 20_000
"""Meshes with more triangles count as concave; the test would take seconds [-]."""
_RIM = 64
"""Corners of the polygon that approximates a cylinder's rim in `Shapes.outline`."""


class ShapeArrays(NamedTuple):
    """`Shapes` as arguments of the kernels."""

    points: F2
    first: I1
    disc: F1
    ball: F1
    half: F2


@dataclass(frozen=True, eq=False)
class Shapes:
    """Convex shapes: hulls of points, extended by a disc in xy and by a ball.

    Each shape has a bounding box; the box's center and axes are the shape's frame.
    """

    names: tuple[str, ...]
    """Link of each shape."""
    body: Int[np.ndarray, " k"]
    Ts_body_shape: Float[np.ndarray, "k 4 4"]
    half: Float[np.ndarray, "k 3"]
    """Half edges of the box [m]."""
    points: Float[np.ndarray, "n 3"]
    """Points of all shapes, concatenated [m]."""
    first: Int[np.ndarray, " k_1"]
    """Index of each shape's first point, and the total number of points."""
    disc: Float[np.ndarray, " k"]
    ball: Float[np.ndarray, " k"]
    """Radii [m]."""

    def __len__(self) -> int:
        return len(self.names)

    @property
    def arrays(self) -> ShapeArrays:
        """Return the arguments of the kernels."""
        return ShapeArrays(self.points, self.first, self.disc, self.ball, self.half)

    def core(self, index: int) -> Body:
        """Return one shape as an argument of `convex.overlap`."""
        points = self.points[self.first[index] : self.first[index + 1]]
        return Body(points, float(self.disc[index]), float(self.ball[index]))

    def outline(self, index: int) -> Float[np.ndarray, "n 3"]:
        """Return points whose hull, extended by the ball, is the shape; a rim is a polygon."""
        points, disc, _ = self.core(index)
        if disc == 0.0:
            return points
        angle = np.linspace(0.0, 2.0 * np.pi, _RIM, endpoint=False)
        rim = disc * np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_RIM)])
        return np.asarray(points[:, None] + rim).reshape(-1, 3)

    @cached_property
    def outlines(self) -> tuple[Float[np.ndarray, "_ 3"], ...]:
        """The outline of every shape."""
        return tuple(map(self.outline, range(len(self))))

    def placed(self, Ts_world_body: Float[np.ndarray, "s b 4 4"]) -> Float[np.ndarray, "s k 4 4"]:
        """Return world poses of the shapes, given those of the bodies."""
        return np.asarray(_place(Ts_world_body, self.body, self.Ts_body_shape))

    def moved_to(self, Ts: Float[np.ndarray, "k 4 4"]) -> Shapes:
        """Return the same shapes at other poses in their bodies."""
        return replace(self, Ts_body_shape=np.asarray(Ts))

    def take(self, index: Int[np.ndarray, " m"]) -> Shapes:
        """Return some of the shapes."""
        points = [self.core(i)[0] for i in index.tolist()]
        return replace(
            self,
            names=tuple(self.names[i] for i in index),
            body=self.body[index],
            Ts_body_shape=self.Ts_body_shape[index],
            half=self.half[index],
            points=np.concatenate([np.empty((0, 3)), *points]),
            first=np.cumsum([0, *map(len, points)]),
            disc=self.disc[index],
            ball=self.ball[index],
        )


@owner_cache()
def prepared(model: Articulated) -> tuple[LinkBodies, Shapes]:
    """Return the bodies and shapes of a model, cached for all tasks."""
    bodies = bodies_of(model)
    return bodies, shapes_of(model, bodies)


@owner_cache()
def prepared_static(model: Articulated) -> tuple[LinkBodies, Shapes, Int[np.ndarray, " k"]]:
    """Return the shapes of furniture that stands still, cached for all tasks.

    Hollow meshes are in pieces.

    Returns:
        Its bodies, the shapes, and the index of each one's element in `shapes_of`.
    """
    bodies = bodies_of(model)
    names, numbers, made, element = [], [], [], []
    for index, (name, geometry, solid) in enumerate(_static_elements(model)):
        for hull in solid.hulls:
            names.append(solid.label(name, static=True))
            numbers.append(bodies.of_link[name])
            made.append(_shape(geometry, hull, bodies.T_body_link[name]))
            element.append(index)
    return bodies, _pack(names, numbers, made), np.array(element, np.int64)


def elements_of(model: Articulated) -> Iterator[tuple[str, Geometry]]:
    """Yield each collision element of a model with its link, in the order of `shapes_of`."""
    for name, link in model.urdf.links.items():
        for geometry in link.collisions:
            yield name, geometry


@owner_cache()
def concave_surface(model: Articulated, element: int) -> tuple[str, Float[np.ndarray, "t 3 3"]]:
    """Return an element's link and, in its frame, its triangles; none if its hull is good enough.

    That is so for primitives, nearly convex meshes, meshes with unreadable faces, and very large
    ones.

    Args:
        model: The model.
        element: Index in `shapes_of`.
    """
    link, geometry = next(islice(elements_of(model), element, None))
    none = np.empty((0, 3, 3))
    if geometry.kind != "mesh":
        return link, none

    def compute() -> np.ndarray:
        try:
            triangles = triangles_of(geometry)
        except UrdfError:  # its faces are damaged, which its hull does not need
            return none
        if len(triangles) > MAX_SURFACE_TRIANGLES:
            return none
        concave = len(triangles) > _TESTED_TRIANGLES or (len(triangles) and is_concave(triangles))
        return triangles if concave else none

    return link, model.cached("surface", compute, element)


def hulls_of(
    points: Float[np.ndarray, "n 3"], first: Int[np.ndarray, " k_1"], body: int, name: str
) -> Shapes:
    """Return hulls of points as shapes of a body, in whose frame the points are.

    Args:
        points: Points of all hulls, one after the other; three points are a triangle [m].
        first: Index of the first point of each hull, and the number of points.
        body: Index of the body.
        name: Name of the link.
    """
    low, high = (f.reduceat(points, first[:-1]) for f in (np.minimum, np.maximum))
    middle = (low + high) / 2
    Ts = np.tile(np.eye(4), (len(low), 1, 1))
    Ts[:, :3, 3] = middle
    return Shapes(
        names=(name,) * len(low),
        body=np.full(len(low), body, np.int64),
        Ts_body_shape=Ts,
        half=(high - low) / 2,
        points=points - np.repeat(middle, np.diff(first), axis=0),
        first=first,
        disc=np.zeros(len(low)),
        ball=np.zeros(len(low)),
    )


def triangle_shapes(triangles: Float[np.ndarray, "t 3 3"], body: int, name: str) -> Shapes:
    """Return triangles as flat shapes of a body, in whose frame they are."""
    return hulls_of(triangles.reshape(-1, 3), 3 * np.arange(len(triangles) + 1), body, name)


def _static_elements(model: Articulated) -> Iterator[tuple[str, Geometry, StaticElement]]:
    """Yield each collision element of a model with its link, in the order of `shapes_of`."""
    for name, link in model.urdf.links.items():
        for geometry, element in zip(link.collisions, model.static_elements[name], strict=True):
            yield name, geometry, element


@owner_cache()
def element_pieces(model: Articulated, link: str, index: int, drawn: bool) -> Shapes:
    """Return the convex pieces of a collision or drawn element, in its link's frame."""
    shapes = model.urdf.links[link]
    if drawn:
        geometry = shapes.visuals[index]
        pieces = pieces_of(geometry, model.hull(link, geometry))
    else:
        geometry, pieces = shapes.collisions[index], model.pieces(link, index)
    made = [_shape(geometry, piece, np.eye(4)) for piece in pieces]
    return _pack([link] * len(made), [0] * len(made), made)


def shapes_of(model: Articulated, bodies: LinkBodies) -> Shapes:
    """Return all collision elements of a model."""
    names, numbers, made = [], [], []
    for name, link in model.urdf.links.items():
        for geometry, hull in zip(link.collisions, model.hulls[name], strict=True):
            names.append(name)
            numbers.append(bodies.of_link[name])
            made.append(_shape(geometry, hull, bodies.T_body_link[name]))
    return _pack(names, numbers, made)


def moving_names(model: Articulated) -> tuple[str, ...]:
    """Return a name of each of `shapes_of` for messages: its link, and whether it is a hull."""
    return tuple(solid.label(name, static=False) for name, _, solid in _static_elements(model))


def piece_names(model: Articulated) -> tuple[str, ...]:
    """Return a name of each of `shapes_of` of a robot for messages: its link, and which piece."""
    return tuple(f"{n} ({shape.piece})" if shape.piece else n for n, shape in elements_of(model))


def without_piece(name: str) -> str:
    """Return a name without the number of a piece, see `piece_names`."""
    return _NUMBERED.sub("", name)


def link_of_label(label: str) -> str:
    """Return the link that a name of a shape means, see `StaticElement.label`."""
    return _SOLID.sub("", label)


def join(parts: Sequence[Shapes], prefixes: Sequence[str]) -> Shapes:
    """Concatenate sets of shapes, prefixing their names; body indices are reset to 0."""
    names = [
        f"{prefix}{name}"
        for part, prefix in zip(parts, prefixes, strict=True)
        for name in part.names
    ]
    counts = np.concatenate([[0], *(np.diff(part.first) for part in parts)]).astype(np.int64)
    return Shapes(
        names=tuple(names),
        body=np.zeros(len(names), np.int64),
        Ts_body_shape=np.concatenate([np.empty((0, 4, 4)), *(p.Ts_body_shape for p in parts)]),
        half=np.concatenate([np.empty((0, 3)), *(p.half for p in parts)]),
        points=np.concatenate([np.empty((0, 3)), *(p.points for p in parts)]),
        first=np.cumsum(counts),
        disc=np.concatenate([np.empty(0), *(p.disc for p in parts)]),
        ball=np.concatenate([np.empty(0), *(p.ball for p in parts)]),
    )


def of_bodies(shapes: Shapes, bodies: Collection[int]) -> Int[np.ndarray, " m"]:
    """Return the indices of the shapes on any of the bodies."""
    return np.flatnonzero(np.isin(shapes.body, list(bodies)))


@entry
def _place(Ts: F4, body: I1, local: F3) -> np.ndarray:
    """Compute Ts[:, body] @ local, 5 times as fast as numpy."""
    out = np.zeros((len(Ts), len(body), 4, 4))
    for s in range(len(Ts)):
        for k in range(len(body)):
            T, L, to = Ts[s, body[k]], local[k], out[s, k]
            for r in range(3):
                for c in range(4):
                    to[r, c] = T[r, 0] * L[0, c] + T[r, 1] * L[1, c] + T[r, 2] * L[2, c]
                to[r, 3] += T[r, 3]
            to[3, 3] = 1.0
    return out


_CORNERS = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
_Made = tuple[np.ndarray, np.ndarray, np.ndarray, float, float]


def _shape(geometry: Geometry, hull: Hull, T_body_link: np.ndarray) -> _Made:
    """Return a shape's pose in the body, half edges, points, disc and ball."""
    T = T_body_link @ geometry.T_link_geometry
    size = geometry.size
    if geometry.kind == "sphere":
        return T, np.full(3, size[0]), np.zeros((1, 3)), 0.0, size[0]
    if geometry.kind == "cylinder":
        radius, length = size
        ends = np.array([[0.0, 0.0, -length / 2], [0.0, 0.0, length / 2]])
        return T, np.array([radius, radius, length / 2]), ends, radius, 0.0
    if geometry.kind == "box":
        half = np.array(size) / 2
        return T, half, _CORNERS * half, 0.0, 0.0
    T_link_box, half = _box_around(hull.vertices)
    points = np.asarray(apply(invert(T_link_box), hull.vertices))
    return T_body_link @ T_link_box, half, points, 0.0, 0.0


def _box_around(vertices: Float[np.ndarray, "n 3"]) -> tuple[np.ndarray, np.ndarray]:
    """Return pose and half edges of the smaller of two boxes: axis-aligned or principal axes."""
    spread = np.linalg.svd(vertices - vertices.mean(0), full_matrices=False)[2].T
    frames = [np.eye(3), spread * np.linalg.det(spread)]
    local = [vertices @ R for R in frames]
    R, x = min(zip(frames, local, strict=True), key=lambda item: float(np.prod(np.ptp(item[1], 0))))
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = R, R @ (x.min(0) + x.max(0)) / 2
    return T, np.ptp(x, 0) / 2


def _pack(names: list[str], bodies: list[int], made: list[_Made]) -> Shapes:
    return Shapes(
        names=tuple(names),
        body=np.array(bodies, np.int64),
        Ts_body_shape=np.array([m[0] for m in made]).reshape(-1, 4, 4),
        half=np.array([m[1] for m in made]).reshape(-1, 3),
        points=np.concatenate([np.empty((0, 3)), *(m[2] for m in made)]),
        first=np.cumsum([0, *(len(m[2]) for m in made)]),
        disc=np.array([m[3] for m in made], float),
        ball=np.array([m[4] for m in made], float),
    )
