"""Find where an item can be put: at a point, on an object or a part of it, or in an area.

A spot is on one upward face that carries the whole base, with room around and above it.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError, parse_quantity, unknown_name
from momapos.core.geometry import apply, contains, pose_planar, rotation
from momapos.model.scene import Scene, SceneObject, is_carried, link_named, pieces_of, top_of
from momapos.model.urdf import Boxes, Hull
from momapos.planning.grasps import LIFT_HEIGHT, scene_boxes

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

MAX_SPOTS = 6
"""Number of spots that are proposed for a place [-]."""
MIN_DISTANCE = 0.2
"""Distance between proposed spots, about twice a hand's width [m]."""
ROOM = 0.03
"""Free room around an item, for fingers and inexact placing [m]."""
EDGE = 0.02
"""Distance of the base from the edge of the face that carries it [m]."""
FLAT = 2e-3
"""Largest difference in height below an item's base [m]."""
_STEP = 0.03
"""Distance between the compared spots [m]."""
_MAX_POINTS = 4000
"""Number of spots that are compared on one face, about [-]."""
_LAST = 1e3
"""Added to the distance of spots that come last [m]."""
_CORNERS = np.array([[x, y] for x in (-1.0, 0.0, 1.0) for y in (-1.0, 0.0, 1.0)])


def spots_for(
    scene: Scene,
    item: SceneObject,
    place: str,
    *,
    start: Float[np.ndarray, "2"] | None = None,
    heights: tuple[float, float] = (-np.inf, np.inf),
) -> list[Float[np.ndarray, "4 4"]]:
    """Return poses of an item at a place, in the order of trying them.

    The item stays as upright as it is; at a point it may turn.

    Args:
        scene: The scene.
        item: The item, which is one of its objects.
        place: "x,y,z" or "x,y,z,yaw" for the middle of its base [m], [rad]; an object, or a part
            of it as "table" or "chest/drawer"; or an area of the scene, for its floor.
        start: Where the robot is [m]; nearer spots come first.
        heights: Between which a hand reaches [m]; other spots come last.

    Raises:
        TaskError: The place is none of these, the item itself, has no room, or is in the air.
        UnknownNameError: There is no such object, part or area.
    """
    others = scene.without(item.name)
    if "," in place:
        T = _at_point(item, place)
        _check_carried(others, item, T, place)
        return [T]
    name, _, part = place.partition("/")
    if name == item.name:
        raise TaskError(f"{name} cannot be put on itself; name another object, or a point")
    names = {item.name for item in others.objects}
    if name in names:
        support = others.object(name)
        links = [link_named(support, part)] if part else list(support.model.links)
        yaw = math.atan2(support.T_world_object[1, 0], support.T_world_object[0, 0])
        half = _half(item, yaw)
        found = np.concatenate([np.zeros((0, 3)), *(
            _on_face(face, half, yaw) for face in _faces(support, links, fine=bool(part))
        )])  # fmt: skip
    elif place in scene.areas:
        yaw, half = 0.0, _half(item, 0.0)
        found = _on_floor(np.array(scene.areas[place]), half)
    else:
        raise unknown_name("place", place, [*sorted(names), *scene.areas], f"scene {scene.name}")
    boxes = scene_boxes(others)
    roomy = found[_is_free(found, half, boxes, yaw, LIFT_HEIGHT)]
    # Where nothing can be let down, it may be pushed in.
    found = roomy if len(roomy) else found[_is_free(found, half, boxes, yaw, FLAT)]
    if not len(found):
        raise TaskError(
            f"{place} has no room for {item.name}, which needs a flat face of "
            f"{' x '.join(f'{100 * edge:.0f}' for edge in 2 * half[:2])} cm and "
            f"{100 * ROOM:.0f} cm around it"
        )
    away = np.zeros(len(found)) if start is None else np.hypot(*(found[:, :2] - start).T)
    away += _LAST * ((found[:, 2] < heights[0]) | (found[:, 2] > heights[1]))
    return [_moved_to(item, found[k]) for k in _spread(found, away)]


def _at_point(item: SceneObject, text: str) -> Float[np.ndarray, "4 4"]:
    parts = text.split(",")
    if len(parts) not in (3, 4):
        raise TaskError(f"{text!r} is not X,Y,Z or X,Y,Z,YAW; write it as 1.2,0.4,0.75")
    x, y, z = (
        parse_quantity(one).length(f"{text!r}: {axis}")
        for one, axis in zip(parts[:3], "XYZ", strict=True)
    )
    T = _moved_to(item, np.array([x, y, z]))
    if len(parts) == 3:
        return T
    yaw = parse_quantity(parts[3]).angle(f"{text!r}: YAW")
    turn = pose_planar(np.array([x, y, yaw - math.atan2(T[1, 0], T[0, 0])]))
    back = pose_planar(np.array([0.0, 0.0, 0.0]))
    back[:2, 3] = -np.array([x, y])
    return turn @ back @ T


def _check_carried(
    others: Scene, item: SceneObject, T: Float[np.ndarray, "4 4"], place: str
) -> None:
    """Refuse a point in the air.

    Raises:
        TaskError: Nothing carries the item there.
    """
    moved = replace(item, T_world_object=T)
    if is_carried(others.objects, moved):
        return
    low, high = moved.bounds
    at = (low + high)[None, :2] / 2
    tops = [
        (abs(z - low[2]), f"a face of {one.name} is at {z:.3f} m there")
        for one in others.objects
        for face in _faces(one, [*one.model.links], fine=False)
        for z in top_of(face, at).tolist()
        if not math.isnan(z)
    ]
    _, known = min([*tops, (abs(low[2]), "the floor is at 0 m")])
    raise TaskError(f"nothing carries {item.name} at {place}; {known}")


def _moved_to(item: SceneObject, at: Float[np.ndarray, "3"]) -> Float[np.ndarray, "4 4"]:
    """Return the pose of an item with the middle of its base at a point [m]."""
    low, high = item.bounds
    base = np.array([*(low[:2] + high[:2]) / 2, low[2]])
    T = item.T_world_object.copy()
    T[:3, 3] += at - base
    return T


def _faces(support: SceneObject, links: Sequence[str], *, fine: bool) -> Iterator[Hull]:
    """Yield the convex pieces of links in the world; finer ones take seconds at first."""
    for link in links:
        T = support.link_poses()[link]
        for index, element in enumerate(support.model.static_elements[link]):
            for one in pieces_of(support.model, link, index) if fine else element.hulls:
                yield replace(one, vertices=apply(T, one.vertices))


def _half(item: SceneObject, yaw: float) -> Float[np.ndarray, "3"]:
    """Return half the extents of an item in a frame that is turned about z [m]."""
    local = item.vertices.copy()
    local[:, :2] = local[:, :2] @ rotation(yaw)
    return np.asarray(np.ptp(local, axis=0) / 2)


def _on_face(face: Hull, half: Float[np.ndarray, "3"], yaw: float) -> Float[np.ndarray, "n 3"]:
    """Return where a base of half a size [m] lies on the upward side of a convex body [m].

    Args:
        face: The body, in the world.
        half: Half the extents of the item in a frame turned about z [m].
        yaw: Direction of that frame [rad].
    """
    R = rotation(yaw)
    local = face.vertices[:, :2] @ R
    at, base = _laid_out(local.min(0), local.max(0), half)
    tops = top_of(face, (base @ R.T).reshape(-1, 2)).reshape(-1, len(_CORNERS))
    z = tops[:, len(_CORNERS) // 2]
    flat = np.abs(tops - z[:, None]).max(1, initial=0.0) <= FLAT
    return np.column_stack([at @ R.T, z])[flat]


def _on_floor(
    area: Float[np.ndarray, "k 2"], half: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "n 3"]:
    """Return where a base of half a size [m] lies in an area of the floor [m]."""
    at, base = _laid_out(area.min(0), area.max(0), half)
    inside = contains(area, base.reshape(-1, 2)).reshape(-1, len(_CORNERS)).all(1)
    return np.column_stack([at, np.zeros(len(at))])[inside]


def _laid_out(
    low: Float[np.ndarray, "2"], high: Float[np.ndarray, "2"], half: Float[np.ndarray, "3"]
) -> tuple[Float[np.ndarray, "n 2"], Float[np.ndarray, "n 9 2"]]:
    """Return middles of a base in a rectangle, and points of the base and around its edge [m]."""
    first, last = low + half[:2] + EDGE, high - half[:2] - EDGE
    if (first > last).any():
        return np.zeros((0, 2)), np.zeros((0, len(_CORNERS), 2))
    step = max(_STEP, math.sqrt(float(np.prod(last - first)) / _MAX_POINTS))
    x, y = (
        np.linspace(a, b, math.ceil((b - a) / step) + 1) for a, b in zip(first, last, strict=True)
    )
    at = np.stack(np.meshgrid(x, y, indexing="ij"), -1).reshape(-1, 2)
    return at, at[:, None] + _CORNERS * (half[:2] + EDGE)


def _boxes_in(
    boxes: Boxes, yaw: float
) -> tuple[Float[np.ndarray, "b 3"], Float[np.ndarray, "b 3"]]:
    """Return the corners of boxes around boxes, aligned with a frame turned about z [m]."""
    R = np.eye(3)
    R[:2, :2] = rotation(yaw)
    center = boxes.center @ R
    extent = np.einsum("bij,bj->bi", np.abs(R.T @ boxes.rotation), boxes.half)
    return center - extent, center + extent


def _is_free(
    spots: Float[np.ndarray, "n 3"],
    half: Float[np.ndarray, "3"],
    obstacles: Boxes,
    yaw: float,
    above: float,
) -> Bool[np.ndarray, " n"]:
    """Return at which spots an item has room.

    Args:
        spots: Middles of its base [m].
        half: Half its extents in a frame turned about z [m].
        obstacles: Boxes of everything else.
        yaw: Direction of that frame [rad].
        above: Free height above it [m].
    """
    local = spots.copy()
    local[:, :2] = local[:, :2] @ rotation(yaw)
    around = np.array([half[0] + ROOM, half[1] + ROOM, 0.0])
    bottom, top = local - around, local + around
    bottom[:, 2] += FLAT
    top[:, 2] += 2.0 * half[2] + above
    hit = np.zeros(len(spots), bool)
    for low, high in zip(*_boxes_in(obstacles, yaw), strict=True):
        hit |= ((bottom < high) & (top > low)).all(1)
    return ~hit


def _spread(spots: Float[np.ndarray, "n 3"], away: Float[np.ndarray, " n"]) -> list[int]:
    """Return the indices of a few spots that are far from each other, the nearest first."""
    chosen: list[int] = []
    for k in np.argsort(away, kind="stable").tolist():
        gaps = [np.linalg.norm(spots[k] - spots[one]) for one in chosen]
        if not gaps or min(gaps) >= MIN_DISTANCE:
            chosen.append(k)
        if len(chosen) == MAX_SPOTS:
            break
    return chosen
