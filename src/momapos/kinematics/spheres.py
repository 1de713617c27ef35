"""The robot as spheres: what the batched collision kernels move around.

Spheres may stick out of a shape a little, or leave a corner uncovered by at most `MARGIN`; the
exact check at the end of planning is what decides, see `momapos.verification`.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float, Int

from momapos.geometry.transforms import apply
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.chain import Segments
from momapos.kinematics.hulls import Boxes, cover, hull_of
from momapos.kinematics.urdf import Geometry

MARGIN = 0.006
"""Corners may stay uncovered by this much [m]."""
STICK_OUT = 0.008
"""How far spheres should stick out of thin shapes at most [m]."""
MAX_CELLS = 400


@dataclass(frozen=True)
class Spheres:
    """Spheres of the links that the arm moves, in groups of one link each."""

    center: Float[np.ndarray, "s 3"]
    """Relative to the joint origin of the group's segment, base-aligned at zero [m]."""
    radius: Float[np.ndarray, " s"]
    start: Int[np.ndarray, " groups_plus_1"]
    """Spheres of group g are start[g]:start[g + 1]."""
    segment: Int[np.ndarray, " groups"]
    bound_center: Float[np.ndarray, "groups 3"]
    bound_radius: Float[np.ndarray, " groups"]
    """A sphere around each group, for culling."""
    links: tuple[str, ...]
    """Link of each group."""
    gripper: Bool[np.ndarray, " groups"]
    pairs: Int[np.ndarray, "pairs 2"]
    """Groups to be checked against each other."""
    base: Boxes
    """The links that do not move with the arm, as boxes in the base frame."""
    base_pairs: Bool[np.ndarray, "groups b"]
    """Which group is checked against which box of the base."""

    def arrays(self) -> tuple[np.ndarray, ...]:
        """The spheres as the kernels take them."""
        return (
            self.center, self.radius, self.start, self.segment, self.bound_center,
            self.bound_radius, self.gripper, self.pairs, self.base.center, self.base.rotation,
            self.base.half, self.base_pairs,
        )


def build_spheres(
    model: Articulated,
    segments: Segments,
    disabled: Collection[frozenset[str]],
    gripper_links: Sequence[str],
) -> Spheres:
    """Cover a robot's arm with spheres and its base with boxes.

    Args:
        model: The robot.
        segments: Which link moves with which joint.
        disabled: Pairs of links whose contact is never checked (SRDF).
        gripper_links: Links that may touch what is grasped.
    """
    moving = [link for link in model.links if segments.of_link[link] > 0 and model.hulls[link]]
    groups = [_link_spheres(model, link, segments.T_segment_link[link]) for link in moving]
    if not groups:
        groups, moving = [(np.zeros((1, 3)), np.zeros(1))], [model.links[-1]]
    bounds = [_bound(center, radius) for center, radius in groups]
    base, base_links = _base_boxes(model, segments)
    joined = _neighbours(model)

    def checked(a: str, b: str) -> bool:
        return frozenset((a, b)) not in disabled and not joined(a, b, segments)

    pairs = [
        (i, j)
        for i in range(len(moving))
        for j in range(i + 1, len(moving))
        if segments.of_link[moving[i]] != segments.of_link[moving[j]]
        and checked(moving[i], moving[j])
    ]
    against = np.array([[checked(a, b) for b in base_links] for a in moving], bool)
    return Spheres(
        center=np.concatenate([center for center, _ in groups]),
        radius=np.concatenate([radius for _, radius in groups]),
        start=np.cumsum([0, *(len(radius) for _, radius in groups)]),
        segment=np.array([segments.of_link[link] for link in moving]),
        bound_center=np.array([center for center, _ in bounds]),
        bound_radius=np.array([radius for _, radius in bounds]),
        links=tuple(moving),
        gripper=np.array([link in set(gripper_links) for link in moving]),
        pairs=np.array(pairs, np.int64).reshape(-1, 2),
        base=base,
        base_pairs=against.reshape(len(moving), len(base)),
    )


def carry(
    spheres: Spheres, segment: int, center: Float[np.ndarray, "k 3"], radius: Float[np.ndarray, " k"]
) -> Spheres:
    """The same robot with something in its hand, which is not checked against the robot itself.

    Args:
        spheres: The robot.
        segment: Segment that holds it: the last.
        center: Spheres of the thing, relative to the segment's joint origin [m].
        radius: Their radii [m].
    """
    middle, bound = _bound(center, radius)
    return replace(
        spheres,
        center=np.concatenate([spheres.center, center]),
        radius=np.concatenate([spheres.radius, radius]),
        start=np.append(spheres.start, len(spheres.center) + len(center)),
        segment=np.append(spheres.segment, segment),
        bound_center=np.vstack([spheres.bound_center, middle]),
        bound_radius=np.append(spheres.bound_radius, bound),
        links=(*spheres.links, "carried object"),
        gripper=np.append(spheres.gripper, True),
        base_pairs=np.vstack([spheres.base_pairs, np.zeros((1, len(spheres.base)), bool)]),
    )


def box_spheres(boxes: Boxes) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Spheres that cover boxes up to `MARGIN`, in the boxes' frame."""
    parts = [_box(boxes.center[i], boxes.rotation[i], boxes.half[i]) for i in range(len(boxes))]
    return np.concatenate([c for c, _ in parts]), np.concatenate([r for _, r in parts])


def _neighbours(model: Articulated):  # type: ignore[no-untyped-def]
    """Tell whether two links are joined by one moving joint, fixed joints being no joints."""
    body: dict[str, str] = {model.urdf.root: model.urdf.root}
    parent: dict[str, str] = {}
    for joint in model.urdf.joints:
        if joint.movable:
            body[joint.child] = joint.child
            parent[joint.child] = body[joint.parent]
        else:
            body[joint.child] = body[joint.parent]

    def joined(a: str, b: str, segments: Segments) -> bool:
        x, y = body[a], body[b]
        return x == y or parent.get(x) == y or parent.get(y) == x

    return joined


def _base_boxes(model: Articulated, segments: Segments) -> tuple[Boxes, list[str]]:
    center, rotation, half, names = [], [], [], []
    for link in model.links:
        if segments.of_link[link] > 0:
            continue
        T = segments.T_segment_link[link]
        for boxes in model.boxes[link]:
            center.append(apply(T, boxes.center))
            rotation.append(T[:3, :3] @ boxes.rotation)
            half.append(boxes.half)
            names += [link] * len(boxes)
    if not names:
        return Boxes(np.zeros((0, 3)), np.zeros((0, 3, 3)), np.zeros((0, 3))), []
    return Boxes(np.concatenate(center), np.concatenate(rotation), np.concatenate(half)), names


def _bound(center: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, float]:
    middle = (
        (center - radius[:, None]).min(0) + (center + radius[:, None]).max(0)
    ) / 2
    return middle, float((np.linalg.norm(center - middle, axis=1) + radius).max())


def _link_spheres(
    model: Articulated, link: str, T_segment_link: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    parts = [shape_spheres(shape) for shape in model.urdf.links[link].collisions]
    center = np.concatenate([c for c, _ in parts])
    radius = np.concatenate([r for _, r in parts])
    keep = _not_inside_another(center, radius)
    return apply(T_segment_link, center[keep]), radius[keep]


def _not_inside_another(center: np.ndarray, radius: np.ndarray) -> np.ndarray:
    distance = np.linalg.norm(center[:, None] - center[None], axis=-1)
    inside = distance + radius[:, None] <= radius[None] + 1e-9
    np.fill_diagonal(inside, False)
    # Of two equal spheres the first stays.
    twins = inside & inside.T & (np.arange(len(radius))[:, None] < np.arange(len(radius)))
    return ~(inside & ~twins).any(1)


def shape_spheres(shape: Geometry) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Spheres that cover a shape up to `MARGIN`, in the link frame."""
    if shape.kind == "sphere":
        return apply(shape.T_link_geometry, np.zeros((1, 3))), np.array([shape.size[0]])
    if shape.kind == "cylinder" and shape.size[1] > 1.2 * shape.size[0]:
        center, radius = _cylinder(*shape.size)
        return apply(shape.T_link_geometry, center), radius
    return box_spheres(cover(hull_of(shape), depth=4))


def _cylinder(radius: float, length: float) -> tuple[np.ndarray, np.ndarray]:
    """Spheres along the axis; the rims stay uncovered by at most `MARGIN`."""
    wide = radius + min(STICK_OUT / 2, 0.06 * radius)
    inset = min(np.sqrt((wide + MARGIN) ** 2 - radius**2), length / 2)
    step = 2 * np.sqrt(wide**2 - radius**2)
    span = length - 2 * inset
    count = max(1, int(np.ceil(span / step)) + 1)
    z = np.linspace(-span / 2, span / 2, count) if count > 1 else np.zeros(1)
    center = np.zeros((count, 3))
    center[:, 2] = z
    return center, np.full(count, wide)


def _box(center: np.ndarray, rotation: np.ndarray, half: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """A lattice of spheres; cells inside the box that no surface needs are left out."""
    tolerance = max(STICK_OUT, 0.12 * float(half.min())) + MARGIN
    size = tolerance / (np.sqrt(3) / 2 - 0.5)
    count = np.maximum(1, np.ceil(2 * half / size)).astype(int)
    while np.prod(count) > MAX_CELLS:
        size *= 1.15
        count = np.maximum(1, np.ceil(2 * half / size)).astype(int)
    cell = half / count
    radius = max(float(np.linalg.norm(cell)) - MARGIN, float(cell.min()))
    grid = np.stack(np.meshgrid(*(np.arange(n) for n in count), indexing="ij"), -1).reshape(-1, 3)
    depth = np.minimum(grid, count - 1 - grid).min(1)
    grid = grid[depth <= max(1, int(radius / cell.min()) - 1)]
    local = (2 * grid + 1) * cell - half
    return center + local @ rotation.T, np.full(len(grid), radius)
