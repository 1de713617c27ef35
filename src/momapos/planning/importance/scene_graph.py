"""The scene graph: objects as nodes, and the relations on, in, inside and near as edges.

The geometry is stacked over the whole scene once, so that the kernels run over plain arrays.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core import SceneError, owner_cache, unknown_name
from momapos.core.compiled import B1, F2, F3, I1, entry, kernel
from momapos.core.geometry import apply, invert
from momapos.model.kinematics import BoxArrays
from momapos.model.scene import Scene, SceneObject, upright_boxes
from momapos.model.urdf import Articulated, Boxes

from .config import GraphConfig

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int
    from scipy import sparse


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


ON, IN, INSIDE, NEAR = range(4)
KINDS = ("on", "in", "inside", "near")
MIN_SUPPORT = 0.05
"""Smallest share of an object's support area that a supporter carries [-]."""
MIN_COVERED = 0.5
"""Smallest share of the support area above the container; for `inside`, also below it [-]."""
MIN_CONTAINED = 0.8
"""Smallest share of an object's box in the container's box; for `in`, of its outline [-]."""
MIN_WALLS_INSIDE, MIN_WALLS_IN = 3, 4
"""Smallest number of the four sides on which the container surrounds the object [-]."""
GAP_STEP = 1e-4
"""Gaps are rounded to this, so that touching cabinets tie regardless of the scene's yaw [m]."""
_CORNERS = np.array([[-1.0, -1.0], [-1.0, 1.0], [1.0, -1.0], [1.0, 1.0]])
_POINTS = 4
"""Sample points along each edge of a box that is tested for containment [-]."""


class BodyArrays(NamedTuple):
    """Stacked bodies for the kernels, see `ObjectBodies`."""

    low: F2
    high: F2
    base: F3
    articulated: B1
    hull_start: I1
    hull_low: F2
    hull_high: F2
    planes: F2
    plane_start: I1


@kernel
def _span(point, direction, planes, first, last):
    """Intersect a line with a convex body; return (enters, leaves), with leaves < enters for none.

    Args:
        point, direction: x, y, z of the line.
        planes, first, last: The body has the planes from first to last.
    """
    x, y, z = point
    dx, dy, dz = direction
    enters, leaves = -np.inf, np.inf
    for k in range(first, last):
        rate = planes[k, 0] * dx + planes[k, 1] * dy + planes[k, 2] * dz
        room = planes[k, 3] - (planes[k, 0] * x + planes[k, 1] * y + planes[k, 2] * z)
        if rate > 1e-12:
            leaves = min(leaves, room / rate)
        elif rate < -1e-12:
            enters = max(enters, room / rate)
        elif room < 0.0:
            return 1.0, 0.0
        if enters > leaves:
            return 1.0, 0.0
    return enters, leaves


@kernel
def _columns(i, j, bodies, contact):
    """Return the shares of i's support area where j carries it, is below it, and is above it."""
    low, high, base, articulated = bodies.low, bodies.high, bodies.base, bodies.articulated
    hull_start, hull_low, hull_high = bodies.hull_start, bodies.hull_low, bodies.hull_high
    planes, plane_start = bodies.planes, bodies.plane_start
    bottom, top = low[i, 2], high[i, 2]
    carried, below, roofed = 0, 0, 0
    for s in range(base.shape[1]):
        x, y = base[i, s, 0], base[i, s, 1]
        touches, under, over = False, False, False
        for h in range(hull_start[j], hull_start[j + 1]):
            if x < hull_low[h, 0] or x > hull_high[h, 0]:
                continue
            if y < hull_low[h, 1] or y > hull_high[h, 1]:
                continue
            point, up = (x, y, bottom), (0.0, 0.0, 1.0)
            enters, leaves = _span(point, up, planes, plane_start[h], plane_start[h + 1])
            if leaves < enters:
                continue
            touches |= abs(leaves) <= contact
            under |= enters < -1e-6
            # A body that contains the object stands for a hollow one, closed if it has doors.
            within = articulated[j] and enters < 0.0 and bottom + leaves > top
            over |= enters > contact or within
        carried += touches
        below += under
        roofed += over
    count = base.shape[1]
    return carried / count, below / count, roofed / count


@kernel
def _contained(i, g, upright, groups, low):
    """Return the share of i's box in the box of group g, the same seen from above, and the depth
    of i's underside below the top of that box [m].
    """
    center, rotation, half = upright
    group_center, group_rotation, group_half = groups
    inside, outline = 0, 0
    for a in range(_POINTS**3):
        point = np.empty(3)
        k = a
        for axis in range(3):
            point[axis] = ((k % _POINTS + 0.5) / _POINTS * 2 - 1) * half[i, axis]
            k //= _POINTS
        held = True
        across = True
        for axis in range(3):
            value = 0.0
            for b in range(3):
                world = center[i, b]
                for c in range(3):
                    world += rotation[i, b, c] * point[c]
                value += group_rotation[g, b, axis] * (world - group_center[g, b])
            beyond = abs(value) > group_half[g, axis] + 1e-6
            held &= not beyond
            if abs(group_rotation[g, 2, axis]) < 0.7:
                across &= not beyond
        inside += held
        outline += across
    rim = group_center[g, 2]
    for axis in range(3):
        rim += abs(group_rotation[g, 2, axis]) * group_half[g, axis]
    return inside / _POINTS**3, outline / _POINTS**3, rim - low[i, 2]


@kernel
def _walls(i, j, g, bodies, groups, height):
    """Count the sides, of four along the axes of the group's box, on which j surrounds i."""
    base, hull_start = bodies.base, bodies.hull_start
    planes, plane_start = bodies.planes, bodies.plane_start
    x, y = base[i, :, 0].mean(), base[i, :, 1].mean()
    count = 0
    for axis in range(3):
        dx, dy = groups.rotation[g, 0, axis], groups.rotation[g, 1, axis]
        size = np.hypot(dx, dy)
        if size < 0.7:
            continue
        for side in (-1.0, 1.0):
            hit = False
            for h in range(hull_start[j], hull_start[j + 1]):
                point, ahead = (x, y, height), (side * dx / size, side * dy / size, 0.0)
                enters, leaves = _span(point, ahead, planes, plane_start[h], plane_start[h + 1])
                if enters <= leaves and leaves > 0.0:
                    hit = True
                    break
            count += hit
    return count


@entry
def _hierarchy(
    bodies: BodyArrays, upright: BoxArrays, groups: BoxArrays, group_start: I1, contact: float
) -> np.ndarray:
    """Find the relations on, in and inside: rows of child, parent, kind."""
    low, high, base = bodies.low, bodies.high, bodies.base
    n = len(low)
    found = np.empty((64, 3), np.int64)
    size = 0
    for i in range(n):
        x0, x1 = base[i, :, 0].min(), base[i, :, 0].max()
        y0, y1 = base[i, :, 1].min(), base[i, :, 1].max()
        bottom = low[i, 2]
        for j in range(n):
            # The lower object carries the higher one, so no object is on itself, nor two on
            # each other.
            if low[j, 2] >= bottom - 1e-6 or high[j, 2] < bottom - contact:
                continue
            if low[j, 0] > x1 or high[j, 0] < x0 or low[j, 1] > y1 or high[j, 1] < y0:
                continue
            kind = _kind(i, j, bodies, upright, groups, group_start, contact)
            if kind < 0:
                continue
            if size == len(found):
                found = np.concatenate((found, np.empty_like(found)))
            found[size] = (i, j, kind)
            size += 1
    return found[:size]


@kernel
def _kind(i, j, bodies, upright, groups, group_start, contact):
    low, high = bodies.low, bodies.high
    carried, below, roofed = _columns(i, j, bodies, contact)
    if below >= MIN_COVERED:
        for g in range(group_start[j], group_start[j + 1]):
            inside, outline, sunk = _contained(i, g, upright, groups, low)
            if sunk <= contact or outline < MIN_CONTAINED:
                continue
            if inside >= MIN_CONTAINED and roofed >= MIN_COVERED:
                height = (low[i, 2] + high[i, 2]) / 2
                if _walls(i, j, g, bodies, groups, height) >= MIN_WALLS_INSIDE:
                    return INSIDE
            elif roofed < MIN_COVERED:
                height = low[i, 2] + min(contact, (high[i, 2] - low[i, 2]) / 2)
                if _walls(i, j, g, bodies, groups, height) >= MIN_WALLS_IN:
                    return IN
    return ON if carried >= MIN_SUPPORT else -1


@kernel
def _corner_gap(a, b, center, rotation, half):
    """Return the smallest distance from the corners of outline a to outline b."""
    best = np.inf
    for sx in (-1.0, 1.0):
        for sy in (-1.0, 1.0):
            ux, uy = sx * half[a, 0], sy * half[a, 1]
            x = center[a, 0] + rotation[a, 0, 0] * ux + rotation[a, 0, 1] * uy - center[b, 0]
            y = center[a, 1] + rotation[a, 1, 0] * ux + rotation[a, 1, 1] * uy - center[b, 1]
            u = abs(rotation[b, 0, 0] * x + rotation[b, 1, 0] * y) - half[b, 0]
            v = abs(rotation[b, 0, 1] * x + rotation[b, 1, 1] * y) - half[b, 1]
            best = min(best, np.hypot(max(u, 0.0), max(v, 0.0)))
    return best


@kernel
def _outlines_apart(a, b, center, rotation, half):
    """Check whether an edge direction of outline a separates it from outline b."""
    for axis in range(2):
        ux, uy = rotation[a, 0, axis], rotation[a, 1, axis]
        reach = half[a, axis]
        reach += abs(ux * rotation[b, 0, 0] + uy * rotation[b, 1, 0]) * half[b, 0]
        reach += abs(ux * rotation[b, 0, 1] + uy * rotation[b, 1, 1]) * half[b, 1]
        offset = ux * (center[b, 0] - center[a, 0]) + uy * (center[b, 1] - center[a, 1])
        if abs(offset) > reach:
            return True
    return False


@kernel
def _outline_gap(a, b, center, rotation, half):
    """Return the horizontal distance of two upright boxes [m], 0 if they overlap from above."""
    if not (
        _outlines_apart(a, b, center, rotation, half)
        or _outlines_apart(b, a, center, rotation, half)
    ):
        return 0.0
    return min(_corner_gap(a, b, center, rotation, half), _corner_gap(b, a, center, rotation, half))


@entry
def _nearest(center: F2, rotation: F3, half: F2, count: int, reach: float) -> np.ndarray:
    """Find the nearest boxes of each within reach, by gap: indices, -1 if there are fewer."""
    n = len(center)
    index = np.full((n, count), -1)
    gap = np.full((n, count), np.inf)
    radius = np.hypot(half[:, 0], half[:, 1])
    for i in range(n):
        for j in range(n):
            limit = min(gap[i, count - 1], reach + 1e-12)
            apart = np.hypot(center[i, 0] - center[j, 0], center[i, 1] - center[j, 1])
            rise = max(abs(center[i, 2] - center[j, 2]) - half[i, 2] - half[j, 2], 0.0)
            if i == j or rise >= limit or apart - radius[i] - radius[j] >= limit:
                continue
            d = np.hypot(_outline_gap(i, j, center, rotation, half), rise)
            d = np.floor(d / GAP_STEP + 0.5) * GAP_STEP
            if d >= limit:
                continue
            place = count - 1
            while place > 0 and gap[i, place - 1] > d:
                gap[i, place], index[i, place] = gap[i, place - 1], index[i, place - 1]
                place -= 1
            gap[i, place], index[i, place] = d, j
    return index


def hierarchy(bodies: ObjectBodies, *, contact: float) -> Int[np.ndarray, "e 3"]:
    """Find the relations on, in and inside: rows of child, parent, index into KINDS.

    Args:
        bodies: The objects.
        contact: Largest vertical gap or overlap of two surfaces in contact [m].
    """
    arrays = BodyArrays(
        bodies.low, bodies.high, bodies.base, bodies.articulated, bodies.hull_start,
        bodies.hull_low, bodies.hull_high, bodies.planes, bodies.plane_start,
    )  # fmt: skip
    upright, groups = bodies.upright, bodies.groups
    return _hierarchy(
        arrays,
        BoxArrays(upright.center, upright.rotation, upright.half),
        BoxArrays(groups.center, groups.rotation, groups.half),
        bodies.group_start,
        contact,
    )


def neighbors(box: Boxes, *, count: int, reach: float) -> Int[np.ndarray, "e 2"]:
    """Find pairs (smaller index first) of which one is among the other's nearest.

    Args:
        box: The upright boxes of the objects.
        count: Number of nearest boxes of each object [-].
        reach: Largest gap between two neighbors [m].
    """
    if count == 0 or len(box) < 2:
        return np.zeros((0, 2), np.int64)
    index = _nearest(box.center, box.rotation, box.half, min(count, len(box) - 1), reach)
    own = np.repeat(np.arange(len(index)), index.shape[1])
    pairs = np.sort(np.stack([own, index.ravel()], -1)[index.ravel() >= 0], axis=1)
    return np.unique(pairs, axis=0)


def outline_gaps(box: Boxes, target: int) -> Float[np.ndarray, " n"]:
    """Compute the horizontal distance of every object's upright box to the target's [m]."""
    center, rotation, half = box.center[:, :2], box.rotation[:, :2, :2], box.half[:, :2]
    corners = center[:, None] + np.einsum("nij,nkj->nki", rotation, _CORNERS * half[:, None])
    # Corners of each box in the target's frame, and of the target in the frame of each box.
    inside = (corners - center[target]) @ rotation[target]
    around = np.einsum("nki,nij->nkj", corners[target] - center[:, None], rotation)
    apart = np.zeros(len(center), bool)
    nearest = np.full(len(center), np.inf)
    for local, edge in ((inside, half[target]), (around, half)):
        apart |= ((local.min(1) > edge) | (local.max(1) < -edge)).any(-1)
        beyond = np.maximum(np.abs(local) - edge[..., None, :], 0.0)
        nearest = np.minimum(nearest, np.linalg.norm(beyond, axis=-1).min(1))
    return np.where(apart, nearest, 0.0)


MIN_SIZE = 1e-3
"""Lower bound of an object's size [m], for flat objects."""
_SEEN_FROM_PARENT = {"on": "carries", "in": "contains", "inside": "contains", "near": "near"}


@dataclass(frozen=True, eq=False)
class SceneGraph:
    """Objects and their relations, computed on first use."""

    scene: Scene
    config: GraphConfig

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in the order of the scene."""
        return tuple(item.name for item in self.scene.objects)

    @cached_property
    def categories(self) -> tuple[str, ...]:
        """Categories of the objects."""
        return tuple(item.category for item in self.scene.objects)

    @cached_property
    def upright(self) -> Boxes:
        """The upright box around each object, turned with the object's frame."""
        return upright_boxes(self.scene.objects)

    @cached_property
    def size(self) -> Float[np.ndarray, " n"]:
        """Cube root of the volume of each object's upright box [m]."""
        return np.maximum(np.cbrt(np.prod(2 * self.upright.half, axis=1)), MIN_SIZE)

    @cached_property
    def edges(self) -> Int[np.ndarray, "e 3"]:
        """Child, parent, index into KINDS; of two neighbors, the first in the scene is the child.

        An edge that follows from two others is omitted: a cup on a tray on a table is not on the
        table. Objects with another relation are not near as well. With `dense` edges, every two
        objects that nothing carries are.
        """
        config, n = self.config, len(self)
        bodies = stack_bodies(self.scene, self.upright)
        above = _shortest(hierarchy(bodies, contact=config.contact), n)
        if config.edges == "support":
            return above
        if config.edges == "dense":
            lowest = np.setdiff1d(np.arange(n), above[:, 0])
            near = np.stack([lowest[one] for one in np.triu_indices(len(lowest), 1)], -1)
        else:
            near = neighbors(self.upright, count=config.neighbors, reach=config.near)
        known = np.sort(above[:, :2], axis=1) @ [n, 1]
        near = near[~np.isin(near @ [n, 1], known)]
        return np.concatenate([above, np.column_stack([near, np.full(len(near), NEAR)])])

    @property
    def child(self) -> Int[np.ndarray, " e"]:
        """The object that is on, in, inside or near the parent, for each edge."""
        return self.edges[:, 0]

    @property
    def parent(self) -> Int[np.ndarray, " e"]:
        """The object that the child is on, in, inside or near, for each edge."""
        return self.edges[:, 1]

    @property
    def kind(self) -> Int[np.ndarray, " e"]:
        """Index into KINDS: on, in, inside, near."""
        return self.edges[:, 2]

    @cached_property
    def dist_xy(self) -> Float[np.ndarray, " e"]:
        """Horizontal distance between the two centers of each edge, at least `config.floor` [m]."""
        center = self.upright.center[:, :2]
        apart = np.linalg.norm(center[self.child] - center[self.parent], axis=1)
        return np.maximum(apart, self.config.floor)

    def __len__(self) -> int:
        return len(self.scene.objects)

    def index(self, name: str) -> int:
        """Return the index of an object in `names`.

        Raises:
            UnknownNameError: There is no such object; the message suggests the nearest name.
        """
        if name not in self.names:
            raise unknown_name("object", name, self.names, "the scene")
        return self.names.index(name)

    @cached_property
    def adjacency(self) -> sparse.csr_array:
        """The undirected graph: entry (i, j) is 1 + the index of the edge between i and j."""
        from scipy import sparse

        order = np.arange(1, len(self.child) + 1)
        rows, columns = np.r_[self.child, self.parent], np.r_[self.parent, self.child]
        shape = (len(self), len(self))
        matrix = sparse.coo_array((np.r_[order, order], (rows, columns)), shape=shape).tocsr()
        matrix.sort_indices()
        return matrix

    def steps(self, target: int) -> Int[np.ndarray, " n"]:
        """Count the edges on the shortest path from each object to the target, -1 without one."""
        ends = np.stack([np.r_[self.child, self.parent], np.r_[self.parent, self.child]])
        steps = np.full(len(self), -1)
        new = np.array([target])
        for count in range(len(self)):
            steps[new] = count
            near = np.unique(ends[1, np.isin(ends[0], new)])
            new = near[steps[near] < 0]
            if not len(new):
                break
        return steps

    def relations(self, target: int) -> tuple[str, ...]:
        """Return each object's relation to the target; "" for none."""
        words = [""] * len(self)
        for child, parent, kind in zip(self.child, self.parent, self.kind, strict=True):
            if parent == target:
                words[child] = KINDS[kind]
            elif child == target:
                words[parent] = _SEEN_FROM_PARENT[KINDS[kind]]
        return tuple(words)

    def gaps(self, target: int) -> Float[np.ndarray, " n"]:
        """Return the horizontal gap between each object's box and the target's [m]."""
        return outline_gaps(self.upright, target)


@owner_cache(4)
def build_graph(scene: Scene, config: GraphConfig | None = None) -> SceneGraph:
    """Build the scene graph from the geometry of the objects at their joint values.

    Raises:
        SceneError: The scene has no objects.
    """
    if not scene.objects:
        raise SceneError(f"scene {scene.name} has no objects to rank")
    return SceneGraph(scene, config or GraphConfig())


def _shortest(edges: Int[np.ndarray, "e 3"], n: int) -> Int[np.ndarray, "f 3"]:
    """Drop each edge whose ends are also connected by two other edges."""
    from scipy import sparse

    child, parent = edges[:, 0], edges[:, 1]
    matrix = sparse.csr_array((np.ones(len(edges), np.int32), (child, parent)), shape=(n, n))
    detour = (matrix @ matrix).multiply(matrix).tocoo()
    longer = np.isin(edges[:, :2] @ [n, 1], detour.row.astype(np.int64) * n + detour.col)
    return edges[~longer]
