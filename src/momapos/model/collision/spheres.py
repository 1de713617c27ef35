"""The robot as spheres, for the batched collision kernels.

Spheres protrude slightly from a shape, or leave points uncovered by at most `MARGIN`. The exact
check at the end of planning makes the final decision, see `momapos.verification`.
"""

from __future__ import annotations

from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.kinematics import Segments, SphereArrays
from momapos.model.urdf import Articulated, Boxes

from .arm_collision import FINGER, OTHER, PALM
from .link_hulls import LinkHulls, link_hulls
from .side_followers import never_touching, with_swept_followers
from .sphere_cover import ARM, BODY, GRIPPER, MARGIN, box_spheres, cover_shapes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

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
