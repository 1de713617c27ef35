"""Geometry for the relations: each object's upright box, rigid groups and convex bodies.

It is stacked over the whole scene once, so that the kernels run over plain arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Articulated, Boxes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

CONTACT_LAYER = 0.01
"""Vertices up to this height above an object's lowest point form its support area [m]."""
GRIDS = ((9, 9), (27, 3), (3, 27))
"""Sample points along the two sides of a support area: squarish, long in x, long in y [-]."""
LONG_ASPECT_RATIO = 3.0
"""Ratio of the sides above which a rectangle is long [-]."""


@dataclass(frozen=True, eq=False)
class ObjectBodies:
    """All objects of a scene at their joint values, in the world frame."""

    upright: Boxes
    """The upright box around each object, turned with the object's frame."""
    low: Float[np.ndarray, "n 3"]
    """Lower corner of each object's axis-aligned box [m]."""
    high: Float[np.ndarray, "n 3"]
    base: Float[np.ndarray, "n s 2"]
    """Sample points of each object's support area [m]."""
    articulated: Bool[np.ndarray, " n"]
    """Whether an object has movable joints; such objects are taken to be hollow."""
    groups: Boxes
    """The box of each rigid group of links, in the frame of its first link."""
    group_start: Int[np.ndarray, " n_plus_1"]
    hull_start: Int[np.ndarray, " n_plus_1"]
    hull_low: Float[np.ndarray, "h 3"]
    hull_high: Float[np.ndarray, "h 3"]
    planes: Float[np.ndarray, "p 4"]
    """Faces of the hulls: points x inside have planes[:, :3] x <= planes[:, 3]."""
    plane_start: Int[np.ndarray, " h_plus_1"]

    def __len__(self) -> int:
        return len(self.low)


def stack_bodies(scene: Scene, upright: Boxes) -> ObjectBodies:
    """Stack the geometry of a scene; an object without geometry is a point at its origin."""
    rows = [_hull_rows(item) for item in scene.objects]
    flat = [row for group in rows for row in group]
    T = np.array([pose for pose, *_ in flat]).reshape(-1, 4, 4)
    counts = np.array([len(vertices) for _, vertices, _, _ in flat], int)
    vertices = np.concatenate([v for _, v, _, _ in flat]) if flat else np.zeros((0, 3))
    owner = np.repeat(np.arange(len(flat)), counts)
    points = np.einsum("vij,vj->vi", T[owner, :3, :3], vertices) + T[owner, :3, 3]
    vertex_start = np.r_[0, np.cumsum(counts)].astype(np.int64)
    faces = [faces for _, _, faces, _ in flat]
    objects = np.array([len(group) for group in rows])
    low, high, base = _each_object(
        scene, upright.rotation, points, vertex_start[np.r_[0, np.cumsum(objects)]]
    )
    group_boxes, group_counts = _groups(scene, rows, points, vertex_start)
    return ObjectBodies(
        upright=upright,
        low=low,
        high=high,
        base=base,
        articulated=np.array([bool(item.model.joints) for item in scene.objects]),
        groups=group_boxes,
        group_start=np.r_[0, np.cumsum(group_counts)].astype(np.int64),
        hull_start=np.r_[0, np.cumsum(objects)].astype(np.int64),
        hull_low=_reduce(np.minimum, points, vertex_start),
        hull_high=_reduce(np.maximum, points, vertex_start),
        planes=_planes(points, vertex_start, faces),
        plane_start=np.r_[0, np.cumsum([len(f) for f in faces])].astype(np.int64),
    )


def _hull_rows(item: SceneObject) -> list[tuple[np.ndarray, np.ndarray, np.ndarray, str]]:
    """Return world pose, vertices, faces and rigid group of each hull, group by group."""
    poses, parents = item.link_poses(), _rigid_groups(item.model)
    rows = [
        (poses[link], hull.vertices, hull.faces, parents[link])
        for link in item.model.links
        for hull in item.model.hulls[link]
    ]
    order = {name: k for k, name in enumerate(item.model.links)}
    return sorted(rows, key=lambda row: order[row[3]])


def _rigid_groups(model: Articulated) -> dict[str, str]:
    """Map each link to the first link of its rigid group."""
    first = {model.urdf.root: model.urdf.root}
    for joint in model.urdf.joints:
        first[joint.child] = joint.child if joint.movable else first[joint.parent]
    return first


def _each_object(
    scene: Scene,
    rotation: Float[np.ndarray, "n 3 3"],
    points: Float[np.ndarray, "v 3"],
    start: Int[np.ndarray, " n_plus_1"],
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Compute lower and upper corner and support points of each object from its vertices."""
    n = len(scene.objects)
    low, high, base = np.zeros((n, 3)), np.zeros((n, 3)), np.zeros((n, int(np.prod(GRIDS[0])), 2))
    for i, item in enumerate(scene.objects):
        mine = points[start[i] : start[i + 1]]
        if not len(mine):
            mine = item.T_world_object[None, :3, 3]
        local, R = mine @ rotation[i], rotation[i]
        low[i], high[i] = mine.min(0), mine.max(0)
        feet = local[mine[:, 2] <= low[i, 2] + CONTACT_LAYER, :2]
        a, b = feet.min(0), feet.max(0)
        base[i] = (a + _grid(b - a)) @ R[:2, :2].T
    return low, high, base


def _grid(size: Float[np.ndarray, "2"]) -> Float[np.ndarray, "s 2"]:
    """Spread points evenly over a rectangle, denser along a long side [m]."""
    x, y = size
    ratio = LONG_ASPECT_RATIO
    counts = GRIDS[1] if x > ratio * y else GRIDS[2] if y > ratio * x else GRIDS[0]
    steps = [(np.arange(count) + 0.5) / count for count in counts]
    return np.stack(np.meshgrid(*steps, indexing="ij"), -1).reshape(-1, 2) * size


def _groups(
    scene: Scene,
    rows: list[list[tuple[np.ndarray, np.ndarray, np.ndarray, str]]],
    points: Float[np.ndarray, "v 3"],
    vertex_start: Int[np.ndarray, " h_plus_1"],
) -> tuple[Boxes, Int[np.ndarray, " n"]]:
    """Compute the box of each rigid group in the frame of its first link, and groups per object."""
    center, rotation, half, counts = [], [], [], []
    hull = 0
    for item, mine in zip(scene.objects, rows, strict=True):
        names = [row[3] for row in mine]
        poses = item.link_poses()
        for name in dict.fromkeys(names):
            first, last = hull + names.index(name), hull + names.index(name) + names.count(name)
            local = apply(invert(poses[name]), points[vertex_start[first] : vertex_start[last]])
            lower, upper = local.min(0), local.max(0)
            center.append(apply(poses[name], (lower + upper)[None] / 2)[0])
            rotation.append(poses[name][:3, :3])
            half.append((upper - lower) / 2)
        hull += len(mine)
        counts.append(len(dict.fromkeys(names)))
    shape = (-1, 3)
    return (
        Boxes(
            np.array(center).reshape(shape), np.array(rotation).reshape(-1, 3, 3),
            np.array(half).reshape(shape),
        ),
        np.array(counts, int),
    )  # fmt: skip


def _reduce(
    pick: np.ufunc, points: Float[np.ndarray, "v 3"], start: Int[np.ndarray, " h_plus_1"]
) -> Float[np.ndarray, "h 3"]:
    return pick.reduceat(points, start[:-1]) if len(points) else np.zeros((0, 3))


def _planes(
    points: Float[np.ndarray, "v 3"],
    vertex_start: Int[np.ndarray, " h_plus_1"],
    faces: list[np.ndarray],
) -> Float[np.ndarray, "p 4"]:
    """Compute the outward planes of all faces; those of slivers constrain nothing."""
    if not faces:
        return np.zeros((0, 4))
    index = np.concatenate([f + s for f, s in zip(faces, vertex_start, strict=False)])
    a, b, c = (points[index[:, k]] for k in range(3))
    normal = np.cross(b - a, c - a)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    normal = np.where(length > 1e-10, normal / np.maximum(length, 1e-10), 0.0)
    return np.concatenate([normal, np.einsum("ij,ij->i", normal, a)[:, None] + 1e-9], axis=1)
