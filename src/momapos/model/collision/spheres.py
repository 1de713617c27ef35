"""The robot as spheres, for the batched collision kernels.

Links outside the chain that follow its joints, such as a head that follows the torso, move with no
segment of it. For planning, their shapes are those of all their positions; the exact check and the
simulation move them.

Spheres protrude slightly from a shape, or leave points uncovered by at most `MARGIN`. The exact
check at the end of planning makes the final decision, see `momapos.verification`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise, product
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import RobotError
from momapos.core.geometry import apply, invert
from momapos.model.kinematics import Segments, SphereArrays
from momapos.model.urdf import Articulated, Boxes, Geometry, Hull, Joint, Mesh, hull_around

from .arm_collision import FINGER, OTHER, PALM
from .link_hulls import LinkHulls, link_hulls
from .sphere_cover import ARM, BODY, GRIPPER, MARGIN, box_spheres, cover_shapes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


MAX_TURN = np.radians(5.0)
"""Turn between two positions whose common hull is taken; an arc leaves it by 0.1 % of its radius
[rad]."""
MAX_POSITIONS = 1_000
"""Largest number of positions of one link [-]."""


def with_swept_followers(model: Articulated, followers: Sequence[str]) -> Articulated:
    """Return a robot whose side followers have the shapes of all their positions.

    Args:
        model: The robot.
        followers: Mimic joints outside the chain, as in `Segments.side_followers`.

    Raises:
        RobotError: A leader has no limits, or a link has too many positions.
    """
    if not followers:
        return model
    joints = [model.joint(name) for name in followers]
    below = {joint.name: set(model.links_below(joint.child)) for joint in joints}
    links = dict(model.urdf.links)
    for joint in joints:
        if any(joint.parent in inside for inside in below.values()):
            continue  # the follower that carries it includes it
        runs = _runs(model, [one for one in joints if one.child in below[joint.name]])
        for link in below[joint.name]:
            shapes = [
                shape
                for hull in model.hulls[link]
                for shape in _swept(model, joint.parent, link, hull, runs)
            ]
            links[link] = replace(links[link], collisions=tuple(shapes))
    return Articulated(replace(model.urdf, links=links), model.held, model.cache, model.closed)


def never_touching(model: Articulated, segments: Segments) -> set[frozenset[str]]:
    """Return pairs of a side follower and a link that its leader moves, which never touch.

    Only the leader moves the two relative to each other, so that the shapes of all positions of
    the follower are too large for this pair: a head that rises half as far as a shoulder below it
    gives way to it.

    Args:
        model: The robot, not swept.
        segments: The segment with which each link moves, and the side followers.
    """
    found = set()
    for name in segments.side_followers:
        joint = model.joint(name)
        assert joint.mimic is not None
        leader = model.joint(joint.mimic.joint)
        if segments.of_link[joint.parent] != segments.of_link[leader.parent]:
            continue  # another joint of the arm lies between the two
        runs = _runs(model, [joint])
        first = segments.of_link[leader.child]
        partners = [link for link in model.links if segments.of_link[link] == first]
        # Links below a further follower move differently.
        others = [model.joint(other).child for other in segments.side_followers if other != name]
        below = set(model.links_below(joint.child)).difference(*map(model.links_below, others))
        found |= {
            frozenset((link, partner))
            for link, partner in product(sorted(below), partners)
            if _apart(model, link, partner, runs)
        }
    return found


def _apart(model: Articulated, link: str, partner: str, runs: list[list[dict[str, float]]]) -> bool:
    """Return whether a plane separates all hulls of two links over each group of values."""
    for states in runs:
        poses = [model.link_poses(values) for values in states]
        Ts = [invert(at[partner]) @ at[link] for at in poses]
        for hull, other in product(model.hulls[link], model.hulls[partner]):
            swept = np.concatenate([apply(T, hull.vertices) for T in Ts])
            if not _separable(swept, other.vertices):
                return False
    return True


def _separable(a: Float[np.ndarray, "n 3"], b: Float[np.ndarray, "m 3"]) -> bool:
    """Return whether a plane lies between two sets of points (a linear program)."""
    from scipy.optimize import linprog

    rows = np.vstack([np.column_stack([a, -np.ones(len(a))]),
                      np.column_stack([-b, np.ones(len(b))])])  # fmt: skip
    found = linprog(np.zeros(4), rows, -np.ones(len(rows)), bounds=(None, None))
    return bool(found.status == 0)


def _runs(model: Articulated, followers: Sequence[Joint]) -> list[list[dict[str, float]]]:
    """Return groups of leaders' values; the hull of a body over a group holds it in between."""
    counts: dict[str, int] = {}
    for joint in followers:
        assert joint.mimic is not None
        leader = model.joint(joint.mimic.joint)
        travel = abs(joint.mimic.ratio) * (leader.upper - leader.lower)
        if not np.isfinite(travel):
            raise RobotError(
                f"{model.urdf.name}: joint {joint.name!r} follows {leader.name!r}, which has no "
                "limits, and does not carry the tool; give the leader limits"
            )
        count = 2 if joint.kind == "prismatic" else 2 + int(travel / MAX_TURN)
        counts[leader.name] = max(count, counts.get(leader.name, 0))
    if np.prod([float(count) for count in counts.values()]) > MAX_POSITIONS:
        raise RobotError(
            f"{model.urdf.name}: joint {followers[0].name!r} follows the arm over more than "
            f"{MAX_POSITIONS} positions, and does not carry the tool; give its leader limits"
        )
    ends = {name: (model.joint(name).lower, model.joint(name).upper) for name in counts}
    grid = product(*(np.linspace(*ends[name], count).tolist() for name, count in counts.items()))
    states = [dict(zip(counts, row, strict=True)) for row in grid]
    return [list(pair) for pair in pairwise(states)] if len(counts) == 1 else [states]


def _swept(
    model: Articulated, carrier: str, link: str, hull: Hull, runs: list[list[dict[str, float]]]
) -> list[Geometry]:
    """Return the hulls of a link's hull over each group of values, in the link's frame at rest."""
    T_link_carrier = invert(model.rest_poses[link]) @ model.rest_poses[carrier]
    shapes = []
    for states in runs:
        points = []
        for values in states:
            poses = model.link_poses(values)
            T = T_link_carrier @ invert(poses[carrier]) @ poses[link]
            points.append(apply(T, hull.vertices))
        around = hull_around(np.concatenate(points), hull.name)
        mesh = Mesh(around.vertices, around.faces)
        shapes.append(Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), hull.name, mesh))
    return shapes


__all__ = ["MARGIN", "Spheres", "box_spheres", "build_spheres", "carry"]


@dataclass(frozen=True, eq=False)
class Spheres:
    """Spheres of the links that the arm moves, in groups of one link each."""

    center: Float[np.ndarray, "s 3"]
    """Centers relative to the joint origin of the group's segment, in base axes at zero [m]."""
    radius: Float[np.ndarray, " s"]
    start: Int[np.ndarray, " groups_plus_1"]
    """Spheres of group g are start[g]:start[g + 1]."""
    segment: Int[np.ndarray, " groups"]
    bound_center: Float[np.ndarray, "groups 3"]
    bound_radius: Float[np.ndarray, " groups"]
    """Bounding sphere of each group, for culling."""
    links: tuple[str, ...]
    """Link of each group."""
    gripper: Int[np.ndarray, " groups"]
    """Role of each group in a grasp: OTHER, PALM or FINGER."""
    pairs: Int[np.ndarray, "pairs 2"]
    """Pairs of groups to check."""
    base: Boxes
    """The links that do not move with the arm, as boxes in the base frame."""
    base_pairs: Bool[np.ndarray, "groups b"]
    """Whether to check each group against each box of the base."""
    base_links: tuple[str, ...]
    """Link of each box of the base."""
    hulls: LinkHulls
    """The collision shapes."""
    exact: Bool[np.ndarray, " pairs"]
    """For which pairs hulls decide, since spheres are too coarse."""
    base_exact: Bool[np.ndarray, "groups b"]
    """The same for groups and boxes of the base."""

    @cached_property
    def arrays(self) -> SphereArrays:
        """Return the spheres as an argument of kernels."""
        base = self.base
        return SphereArrays(
            self.center, self.radius, self.start, self.segment, self.bound_center,
            self.bound_radius, self.gripper, self.pairs, base.center, base.rotation, base.half,
            self.base_pairs, self.base_bounds, np.linalg.norm(base.half, axis=1),
            self.hulls.arrays, self.exact, self.base_exact,
            np.flatnonzero(self.base_pairs.any(1)),
        )  # fmt: skip

    @cached_property
    def by_hulls(self) -> Spheres:
        """Return the robot with hulls to decide wherever spheres of two links meet.

        For planning: the hand may pass its own arm closely. Maps need spheres, which are faster.
        """
        return replace(self, exact=np.ones_like(self.exact), base_exact=self.base_pairs)

    def grown(self, margin: float) -> Spheres:
        """Return the robot enlarged on all sides by a margin [m]."""
        return replace(
            self, radius=self.radius + margin, bound_radius=self.bound_radius + margin,
            hulls=replace(self.hulls, margin=margin),
        )  # fmt: skip

    @cached_property
    def base_bounds(self) -> Float[np.ndarray, "2 3"]:
        """Return the lower and upper corner of all boxes of the base, in its frame [m]."""
        extent = np.einsum("bij,bj->bi", np.abs(self.base.rotation), self.base.half)
        low, high = self.base.center - extent, self.base.center + extent
        return np.stack([low.min(0, initial=np.inf), high.max(0, initial=-np.inf)])


def build_spheres(
    model: Articulated,
    segments: Segments,
    disabled: Collection[frozenset[str]],
    gripper_links: Sequence[str],
) -> Spheres:
    """Cover a robot's arm with spheres and its base with boxes.

    Args:
        model: The robot.
        segments: The segment with which each link moves.
        disabled: Pairs of links that are never checked (SRDF).
        gripper_links: Links that may touch the grasped part.
    """
    disabled = never_touching(model, segments) | set(disabled)
    model = with_swept_followers(model, segments.side_followers)
    moving = [link for link in model.links if segments.of_link[link] > 0 and model.hulls[link]]
    bodies = _bodies(model, segments)
    groups = []
    for link in moving:
        stick_out = (
            GRIPPER if link in gripper_links else BODY if segments.of_link[link] in bodies else ARM
        )
        center, radius = cover_shapes(model.urdf.links[link].collisions, stick_out)
        groups.append((apply(segments.T_segment_link[link], center), radius))
    if not groups:
        groups, moving = [(np.zeros((1, 3)), np.zeros(1))], [model.links[-1]]
    bounds = [_bound(center, radius) for center, radius in groups]
    base, base_links = _base_boxes(model, segments)
    joined = neighbors(model)

    def checked(a: str, b: str) -> bool:
        return frozenset((a, b)) not in disabled and not joined(a, b)

    pairs = [
        (i, j)
        for i in range(len(moving))
        for j in range(i + 1, len(moving))
        if segments.of_link[moving[i]] != segments.of_link[moving[j]]
        and checked(moving[i], moving[j])
    ]
    against = np.array([[checked(a, b) for b in base_links] for a in moving], bool)
    against = against.reshape(len(moving), len(base))
    return Spheres(
        center=np.concatenate([center for center, _ in groups]),
        radius=np.concatenate([radius for _, radius in groups]),
        start=np.cumsum([0, *(len(radius) for _, radius in groups)]),
        segment=np.array([segments.of_link[link] for link in moving]),
        bound_center=np.array([center for center, _ in bounds]),
        bound_radius=np.array([radius for _, radius in bounds]),
        links=tuple(moving),
        gripper=np.array([_role(model, link, set(gripper_links)) for link in moving], np.int64),
        pairs=np.array(pairs, np.int64).reshape(-1, 2),
        base=base,
        base_pairs=against,
        base_links=tuple(base_links),
        hulls=link_hulls(model, segments, moving, _standing(model, segments)),
        exact=np.zeros(len(pairs), bool),
        base_exact=np.zeros_like(against),
    )


def reposed(spheres: Spheres, model: Articulated, before: Segments, after: Segments) -> Spheres:
    """Return the spheres of a robot whose links rest elsewhere, such as its fingers.

    Args:
        spheres: The robot.
        model: The robot with the other rest values.
        before, after: The poses of its links.
    """
    Ts = np.array(
        [after.T_segment_link[n] @ invert(before.T_segment_link[n]) for n in spheres.links]
    )
    each = np.repeat(Ts, np.diff(spheres.start), axis=0)
    center = np.einsum("sij,sj->si", each[:, :3, :3], spheres.center) + each[:, :3, 3]
    bound = np.einsum("gij,gj->gi", Ts[:, :3, :3], spheres.bound_center) + Ts[:, :3, 3]
    hulls = link_hulls(model, after, spheres.links, _standing(model, after))
    return replace(spheres, center=center, bound_center=bound, hulls=hulls)


def _role(model: Articulated, link: str, gripper_links: set[str]) -> int:
    """Return a link's role; links that a joint of the gripper moves are fingers."""
    if link not in gripper_links:
        return OTHER
    for joint in model.joints.values():
        if joint.child in gripper_links and link in model.links_below(joint.child):
            return FINGER
    return PALM


def carry(
    spheres: Spheres,
    segment: int,
    center: Float[np.ndarray, "k 3"],
    radius: Float[np.ndarray, " k"],
) -> Spheres:
    """Return the robot with an object in its hand.

    The object is checked against the robot, except for links that move with the hand.

    Args:
        spheres: The robot.
        segment: Segment that holds the object: the last.
        center: Spheres of the object, relative to the segment's joint origin [m].
        radius: Their radii [m].
    """
    middle, bound = _bound(center, radius)
    others = np.flatnonzero(spheres.segment < segment)
    pairs = np.stack([others, np.full(len(others), len(spheres.segment))], -1)
    of_group = spheres.hulls.of_group
    return replace(
        spheres,
        pairs=np.concatenate([spheres.pairs, pairs]),
        center=np.concatenate([spheres.center, center]),
        radius=np.concatenate([spheres.radius, radius]),
        start=np.append(spheres.start, len(spheres.center) + len(center)),
        segment=np.append(spheres.segment, segment),
        bound_center=np.vstack([spheres.bound_center, middle]),
        bound_radius=np.append(spheres.bound_radius, bound),
        links=(*spheres.links, "carried object"),
        gripper=np.append(spheres.gripper, FINGER),
        base_pairs=np.vstack([spheres.base_pairs, np.ones((1, len(spheres.base)), bool)]),
        hulls=replace(spheres.hulls, of_group=np.append(of_group, of_group[-1])),
        exact=np.append(spheres.exact, np.zeros(len(others), bool)),
        base_exact=np.vstack([spheres.base_exact, np.zeros((1, len(spheres.base)), bool)]),
    )


def _bodies(model: Articulated, segments: Segments) -> set[int]:
    """Return the segments behind prismatic joints only: the base and links on a lift."""
    found = {0}
    for joint in model.urdf.joints:
        before, after = segments.of_link[joint.parent], segments.of_link[joint.child]
        if after != before and before in found and joint.kind == "prismatic":
            found.add(after)
    return found


def neighbors(model: Articulated) -> Callable[[str, str], bool]:
    """Return a function that tells whether a single movable joint, or none, connects two links."""
    body: dict[str, str] = {model.urdf.root: model.urdf.root}
    parent: dict[str, str] = {}
    for joint in model.urdf.joints:
        if joint.movable:
            body[joint.child] = joint.child
            parent[joint.child] = body[joint.parent]
        else:
            body[joint.child] = body[joint.parent]

    def joined(a: str, b: str) -> bool:
        x, y = body[a], body[b]
        return x == y or parent.get(x) == y or parent.get(y) == x

    return joined


def _base_boxes(model: Articulated, segments: Segments) -> tuple[Boxes, list[str]]:
    center, rotation, half = [np.zeros((0, 3))], [np.zeros((0, 3, 3))], [np.zeros((0, 3))]
    names: list[str] = []
    for link in _standing(model, segments):
        T = segments.T_segment_link[link]
        for boxes in model.boxes[link]:
            center.append(apply(T, boxes.center))
            rotation.append(T[:3, :3] @ boxes.rotation)
            half.append(boxes.half)
            names += [link] * len(boxes)
    return Boxes(np.concatenate(center), np.concatenate(rotation), np.concatenate(half)), names


def _standing(model: Articulated, segments: Segments) -> list[str]:
    return [link for link in model.links if segments.of_link[link] == 0]


def _bound(center: np.ndarray, radius: np.ndarray) -> tuple[np.ndarray, float]:
    middle = ((center - radius[:, None]).min(0) + (center + radius[:, None]).max(0)) / 2
    return middle, float((np.linalg.norm(center - middle, axis=1) + radius).max())
