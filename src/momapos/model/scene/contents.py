"""Find what rests on a part of furniture, and move it along.

An item rests on the part whose upward face carries it, or on what the scene states. What moves with
a part becomes a link of its object, fixed to the link that carries it: collision checks, physics,
pictures and exports need no code for it.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, UrdfError, unknown_name
from momapos.core.geometry import apply, invert
from momapos.model.urdf import Articulated, Hull, Joint, Link, opening_of

from .scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_GAP = 5e-3
"""Largest distance between an item and the face on which it rests, above or below it [m]."""
MIN_SHARE = 0.5
"""Share of an item's base that a part carries at least [-]."""
MAX_CORNERS = 24
"""Number of points of an item's base that are compared, besides its middle [-]."""
_INWARD = 0.5
"""Place of these points between the middle and the corners of the base [-]."""
_UPRIGHT = 1e-6
"""Upward component of a face's normal below which the face counts as upright [-]."""
_WORLD_FRAME = np.eye(4)
WORLD = ""
"""What an item rests on that moves with nothing."""


def resting_on(
    objects: Sequence[SceneObject], target: SceneObject, links: Collection[str]
) -> dict[str, str]:
    """Return what rests on some links of an object, also on other items, with its link.

    Args:
        objects: The objects of the scene.
        target: One of them.
        links: Links of it that move together.
    """
    found: dict[str, str] = {}
    items = [item for item in objects if item is not target and _is_loose(item)]
    supports = [(target, link, link) for link in target.model.links if target.model.hulls[link]]
    while True:
        near = _bounds([one for one in supports if one[2] in links])
        more: dict[str, str] = {}
        for item in items:
            if item.name not in found and (item.on or _meet(item.bounds, near)):
                link = _support_of(item, supports)
                if link is not None and link in links:
                    more[item.name] = link
        if not more:
            return found
        found |= more
        supports = [
            (item, one, more[item.name])
            for item in items
            if item.name in more
            for one in item.model.links
        ]


def is_carried(objects: Sequence[SceneObject], item: SceneObject) -> bool:
    """Return whether an item stands on objects or on the floor.

    Args:
        objects: The other objects.
        item: The item at some pose.
    """
    if abs(item.bounds[0, 2]) <= MAX_GAP:
        return True
    base, near = _base_of(item), item.bounds + MAX_GAP * np.array([[-1.0], [1.0]])
    shares = [
        _carried(base, one, link)
        for one in objects
        if _meet(one.bounds, near)
        for link in one.model.links
    ]
    return sum(shares) >= MIN_SHARE


def _bounds(supports: Sequence[tuple[SceneObject, str, str]]) -> Float[np.ndarray, "2 3"]:
    """Return the box around links, with room for what rests on them [m]."""
    points = [
        apply(item.link_poses()[link], hull.vertices)
        for item, link, _ in supports
        for hull in item.model.hulls[link]
    ]
    if not points:
        return np.full((2, 3), np.nan)
    every = np.concatenate(points)
    return np.stack([every.min(0) - MAX_GAP, every.max(0) + MAX_GAP])


def _meet(a: Float[np.ndarray, "2 3"], b: Float[np.ndarray, "2 3"]) -> bool:
    """Return whether two boxes, given by their corners, overlap."""
    return bool((a[0] <= b[1]).all() and (b[0] <= a[1]).all())


def _is_loose(item: SceneObject) -> bool:
    """Return whether an object can rest on a part: it has no joints, and is no wall."""
    return item.wall is None and not item.model.joints and item.on != WORLD


def _support_of(item: SceneObject, supports: list[tuple[SceneObject, str, str]]) -> str | None:
    """Return the link on which an item rests, of some links of objects that stand for one."""
    if item.on is not None:
        named, _, part = item.on.partition("/")
        supports = [one for one in supports if one[0].name == named]
        if part and supports:
            owner = supports[0][0]
            return {link: stands for _, link, stands in supports}.get(link_named(owner, part))
    base = _base_of(item)
    shares = [(_carried(base, item, link), stands) for item, link, stands in supports]
    share, link = max(shares, default=(0.0, None))
    return link if share >= MIN_SHARE else None


def _base_of(item: SceneObject) -> Float[np.ndarray, "k 3"]:
    """Return the middle of an item's base, and points halfway to its corners [m]."""
    points = item.vertices
    corners = points[points[:, 2] < points[:, 2].min() + MAX_GAP]
    middle = (corners.min(0) + corners.max(0)) / 2
    chosen = corners[np.linspace(0, len(corners) - 1, MAX_CORNERS).astype(int)]
    return np.vstack([middle, middle + _INWARD * (chosen - middle)])


def _carried(base: Float[np.ndarray, "k 3"], item: SceneObject, link: str) -> float:
    """Return the share of points of a base that lie on an upward face of a link."""
    T = item.link_poses()[link]
    carried = np.zeros(len(base), bool)
    for index, hull in enumerate(item.model.hulls[link]):
        corners = apply(T, hull.vertices)
        low, high = corners.min(0) - MAX_GAP, corners.max(0) + MAX_GAP
        if not ((base >= low) & (base <= high)).all(1).any():
            continue
        for piece in pieces_of(item.model, link, index):
            carried |= np.abs(top_of(piece, base[:, :2], T) - base[:, 2]) <= MAX_GAP
    return float(carried.mean())


def pieces_of(model: Articulated, link: str, element: int) -> tuple[Hull, ...]:
    """Return the convex pieces of a collision element; its hull if its faces are unreadable."""
    try:
        return model.pieces(link, element)
    except UrdfError:
        return (model.hulls[link][element],)


def top_of(
    hull: Hull, at: Float[np.ndarray, "k 2"], T: Float[np.ndarray, "4 4"] = _WORLD_FRAME
) -> Float[np.ndarray, " k"]:
    """Return the height of a hull above points of the floor; NaN away from it [m].

    Args:
        hull: The hull.
        at: The points [m].
        T: Pose of the hull's frame in the world; that itself by default.
    """
    a, b, c = (apply(T, hull.vertices)[hull.faces[:, k]] for k in range(3))
    normals = np.cross(b - a, c - a)
    size = np.linalg.norm(normals, axis=1)
    kept = size > 0.0
    normals = normals[kept] / size[kept, None]
    offset = (normals * a[kept]).sum(1)
    left = offset[:, None] - normals[:, :2] @ at.T
    up, down = normals[:, 2] > _UPRIGHT, normals[:, 2] < -_UPRIGHT
    outside = (left[~up & ~down] < 0.0).any(0)
    top = (left[up] / normals[up, 2:]).min(0, initial=np.inf)
    bottom = (left[down] / normals[down, 2:]).max(0, initial=-np.inf)
    return np.where(outside | (bottom > top), np.nan, top)


def link_named(item: SceneObject, part: str) -> str:
    """Return the link of an object that a scene names, by its own name or that of its joint.

    Raises:
        UnknownNameError: There is neither.
    """
    if part in item.model.links:
        return part
    if part in item.model.joints:
        return item.model.joints[part].child
    raise unknown_name("part", part, [*item.model.links, *item.model.joints], item.name)


def check_supports(objects: Sequence[SceneObject], where: str) -> None:
    """Check what the items of a scene rest on.

    Raises:
        SceneError: An item rests on itself, directly or on others, or has joints.
        UnknownNameError: There is no such object or part.
    """
    by_name = {item.name: item for item in objects}
    for item in objects:
        if not item.on:
            continue
        at = f"{where}: object {item.name!r}: on"
        if item.model.joints:
            raise SceneError(f"{at}: it has joints; only rigid items move with a part")
        passed, name = [item.name], item.on.partition("/")[0]
        while name:
            if name in passed:
                raise SceneError(f"{at}: it rests on itself, by {' on '.join([*passed, name])}")
            if name not in by_name:
                raise unknown_name("object", name, by_name, at)
            passed.append(name)
            name = (by_name[name].on or "").partition("/")[0]
        _, _, part = item.on.partition("/")
        if part:
            link_named(by_name[passed[1]], part)


def poses_after(
    objects: Sequence[SceneObject], target: SceneObject, joint: str, value: float
) -> dict[str, Float[np.ndarray, "4 4"]]:
    """Return the poses of what moves with a joint, at another value of it [rad] or [m]."""
    resting = resting_on(objects, target, target.model.moved_by(joint))
    if not resting:
        return {}
    before, after = target.link_poses(), target.link_poses({joint: value})
    by_name = {item.name: item for item in objects}
    return {
        name: after[link] @ invert(before[link]) @ by_name[name].T_world_object
        for name, link in resting.items()
    }


def with_contents(
    objects: Sequence[SceneObject], target: SceneObject, joint: str
) -> tuple[SceneObject, ...]:
    """Return the objects of a scene with what moves with a joint as links of its object.

    Args:
        objects: The objects.
        target: The object.
        joint: The joint.
    """
    resting = resting_on(objects, target, target.model.moved_by(joint))
    if not resting:
        return tuple(objects)
    items = {item.name: item for item in objects if item.name in resting}
    loaded = replace(target, model=_loaded(target, items, resting))
    return tuple(loaded if item is target else item for item in objects if item.name not in resting)


def _loaded(
    target: SceneObject, items: Mapping[str, SceneObject], resting: Mapping[str, str]
) -> Articulated:
    """Return the model of an object with items as links; its own geometry is not computed again.

    What is in a part says nothing about how the part opens.
    """
    model, links = target.model, dict(target.model.urdf.links)
    joints, parts = list(target.model.urdf.joints), list[tuple[Articulated, dict[str, str]]]()
    for name, item in items.items():
        own = {link: _free_name(links, name, link, item.model) for link in item.model.links}
        T = invert(target.link_poses()[resting[name]]) @ item.T_world_object
        for link, renamed in own.items():
            links[renamed] = _renamed(item.model.urdf.links[link], renamed, item)
        root = own[item.model.urdf.root]
        joints.append(_fixed(resting[name], root, T))
        for joint in item.model.urdf.joints:
            joints.append(_fixed(own[joint.parent], own[joint.child], joint.T_parent_joint))
        parts.append((item.model, own))
    urdf = replace(model.urdf, links=links, joints=tuple(joints))
    closed = {name: opening_of(model, name).closed for name in model.joints}
    every = frozenset(new for _, own in parts for new in own.values())
    return Articulated(urdf, model.held, model.cache, closed, every).with_geometry_of(model, parts)


def _renamed(body: Link, name: str, item: SceneObject) -> Link:
    """Return an item's link with another name, and with the mass of an item of one link."""
    if item.mass is None or len(item.model.links) > 1:
        return replace(body, name=name)
    points = np.concatenate([hull.vertices for hull in item.model.hulls[body.name]])
    x, y, z = body.center if body.mass > 0.0 else ((points.min(0) + points.max(0)) / 2).tolist()
    return replace(body, name=name, mass=item.mass, center=(x, y, z))


def _free_name(taken: Collection[str], item: str, link: str, model: Articulated) -> str:
    """Return the name of an item's link in its object."""
    name = item if link == model.urdf.root else f"{item}/{link}"
    while name in taken:
        name += "'"
    return name


def _fixed(parent: str, child: str, T: Float[np.ndarray, "4 4"]) -> Joint:
    return Joint(f"{child} rests", "fixed", parent, child, T, np.array([1.0, 0, 0]), 0.0, 0.0, 0.0)
