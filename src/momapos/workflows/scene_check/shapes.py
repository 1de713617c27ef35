"""Findings about the geometry of a scene: shapes, sizes, hulls, overlaps, floor and support."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError
from momapos.core.geometry import apply
from momapos.model.scene import FLOOR_EDGE, Scene, SceneObject, size_hint, usual_edge
from momapos.model.urdf import hull_space, opening_of
from momapos.verification import ObjectContact, object_contacts

from .report import Finding, FindingKind, Severity

if TYPE_CHECKING:
    from jaxtyping import Float, Int

CONTACT_GAP = 0.02
"""Objects that are closer touch: the shared kitchens have gaps up to 1.4 cm between flush furniture
and below plates [m]."""
MAX_FLUSH = 0.02
"""Objects that overlap by more were placed wrongly: flush furniture of the shared kitchens overlaps
by up to 1.8 cm, and the next deeper overlaps (2.7 cm) are a plate in its holder and food in a plate
[m]."""
MAX_SUNK = 0.01
"""An object that reaches farther below the floor was placed wrongly [m]."""
MAX_SLAB = 0.05
"""An object whose top is not higher may be the floor itself, or a carpet [m]."""
MAX_LOOSE_VOLUME = 0.02
"""Objects with a smaller bounding box do not hang on walls: cups, food, lamps of a table [m^3]."""
MIN_HULL, MIN_HULL_RATIO, MIN_FREE_SPACE = 0.005, 2.0, 0.005
"""Volume of hulls that are examined, their ratio to the solid part, and the free space in them from
which they are reported; a hand fills 2 to 4 l [m^3], [-], [m^3]."""
MIN_OPEN = 0.01
"""A part is open if its joint is farther from the closed value [rad] or [m]."""
_STRUCTURE = ("wall", "floor", "ceiling")
"""Categories of parts of the building, which meet and may have any size."""


def shape_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what is wrong with the geometry of a scene."""
    if not scene.objects:
        yield Finding(
            FindingKind.NO_OBJECTS, Severity.ERROR, "the scene has no objects",
            "add at least the object of a task",
        )  # fmt: skip
    yield from _room_size(scene)
    for item in scene.objects:
        yield from _shapes(item)
        yield from _size(item)
        yield from _hulls(item)
    contacts = object_contacts(scene, CONTACT_GAP)
    yield from _overlaps(scene, contacts)
    yield from _below_floor(scene)
    yield from _in_the_air(scene, contacts)


def _is_structure(item: SceneObject) -> bool:
    return item.category.lower() in _STRUCTURE


def _has_shape(item: SceneObject) -> bool:
    return any(item.model.hulls.values())


def _room_size(scene: Scene) -> Iterator[Finding]:
    if scene.floor_polygon is None:
        return
    size = np.ptp(scene.floor_polygon, axis=0)
    if size.min() < FLOOR_EDGE[0]:
        hint = size_hint(size.tolist(), FLOOR_EDGE)
        yield Finding(
            FindingKind.ROOM_SIZE, Severity.WARNING, f"the floor measures {_meters(size)}",
            hint or "its outline is in meters; a robot needs a strip at least 0.8 m wide",
        )  # fmt: skip


def _shapes(item: SceneObject) -> Iterator[Finding]:
    links = item.model.urdf.links
    drawn = [name for name, link in links.items() if link.visuals and not item.model.hulls[name]]
    advice = "add <collision> elements to its URDF"
    if not _has_shape(item):
        what = "is only drawn" if drawn else "has no shape"
        yield Finding(
            FindingKind.NO_SHAPE, Severity.WARNING,
            f"{item.name!r} {what}: robots drive and reach through it", advice, item.name,
        )  # fmt: skip
    elif drawn:
        yield Finding(
            FindingKind.NO_SHAPE, Severity.NOTE,
            f"{_some(item.name, drawn)} only drawn: arms reach through it", advice, item.name,
        )  # fmt: skip


def _size(item: SceneObject) -> Iterator[Finding]:
    if not _has_shape(item) or _is_structure(item):
        return
    size = np.ptp(item.bounds, axis=0)
    usual = usual_edge(item.category, item.name, jointed=bool(item.model.joints))
    if usual[0] <= size.max() <= usual[1]:
        return
    hint = size_hint(size.tolist(), usual)
    if hint:
        hint += "" if item.model.urdf.path is None else " 'scale' of the object corrects it"
    advice = hint or f"the largest edge of such an object is usually {usual[0]:g} to {usual[1]:g} m"
    yield Finding(
        FindingKind.SIZE, Severity.WARNING, f"{item.name!r} measures {_meters(size)}", advice,
        item.name,
    )  # fmt: skip


def _hulls(item: SceneObject) -> Iterator[Finding]:
    """Yield a finding on the hull with the most free space, which stands for the others.

    Hollow elements that are checked in pieces count only if a joint may move them.
    """
    moving = {link for joint in item.model.joints for link in item.model.moved_by(joint)}
    found = []
    for link, hulls in item.model.hulls.items():
        for index, hull in enumerate(hulls):
            if float(np.prod(np.ptp(hull.vertices, axis=0))) < MIN_HULL:
                continue
            pieces = item.model.static_elements[link][index].hulls
            if len(pieces) > 1 and link not in moving:
                continue
            try:
                volume, free = hull_space(item.model, link, index)
            except UrdfError as error:
                yield Finding(FindingKind.HULL, Severity.NOTE, str(error), object=item.name)
                continue
            ratio = volume / max(volume - free, 1e-9)
            if free > MIN_FREE_SPACE and ratio > MIN_HULL_RATIO:
                found.append((free, ratio, link, index))
    if not found:
        return
    free, ratio, link, index = max(found)
    mesh = item.model.urdf.links[link].collisions[index].mesh
    name = mesh.name if isinstance(mesh, Path) else "its mesh"
    text = (
        f"{item.name}/{link}: the convex hull of collision element {index} ({name}) is "
        f"{min(ratio, 100.0):.1f} times as large as the mesh and fills {1000 * free:.0f} l of "
        "free space"
    )
    if others := len(found) - 1:
        text += f"; {others} more {'element has' if others == 1 else 'elements have'} such a hull"
    yield Finding(
        FindingKind.HULL, Severity.WARNING, text,
        "robots cannot reach into it; split the mesh into convex collision elements", item.name,
    )  # fmt: skip


def _overlaps(scene: Scene, contacts: Sequence[ObjectContact]) -> Iterator[Finding]:
    for one in contacts:
        pair = scene.objects[one.first], scene.objects[one.second]
        if one.depth <= MAX_FLUSH or all(map(_is_structure, pair)):
            continue
        smaller = min(pair, key=lambda item: float(np.prod(np.ptp(item.bounds, axis=0))))
        yield Finding(
            FindingKind.OVERLAP, Severity.WARNING,
            f"{one.labels[0]} and {one.labels[1]} overlap by {_centimeters(one.depth)}",
            _apart(one, pair, smaller.name), smaller.name,
        )  # fmt: skip


def _apart(one: ObjectContact, pair: tuple[SceneObject, SceneObject], smaller: str) -> str:
    """Return how to part two objects: close what is open, else move the smaller one."""
    for item, label in zip(pair, one.labels, strict=True):
        link = label.removeprefix(f"{item.name}/")
        for joint in item.model.joints:
            opening, value = opening_of(item.model, joint), item.values()[joint]
            if link in item.model.moved_by(joint) and abs(value - opening.closed) > MIN_OPEN:
                return f"close {item.name}/{joint}, or move {smaller!r} by that distance"
    return f"move {smaller!r} by that distance"


def _below_floor(scene: Scene) -> Iterator[Finding]:
    for item in scene.objects:
        low, high = item.bounds[:, 2].tolist()
        is_slab = -MAX_SUNK <= high <= MAX_SLAB
        if low >= -MAX_SUNK or is_slab or _is_structure(item) or not _has_shape(item):
            continue
        how = f"reaches {_centimeters(-low)}" if high > 0 else f"is {_centimeters(-high)}"
        yield Finding(
            FindingKind.BELOW_FLOOR, Severity.WARNING,
            f"{item.name!r} {how} below the floor, which is at z = 0",
            f"raise it by {_centimeters(-low)} to pose z {_pose_z(item, -low)}", item.name,
        )  # fmt: skip


def _in_the_air(scene: Scene, contacts: Sequence[ObjectContact]) -> Iterator[Finding]:
    """Yield the groups of touching objects of which none is on the floor or at a wall."""
    group = _connected(len(scene.objects), contacts)
    bounds = np.array([item.bounds for item in scene.objects]).reshape(-1, 2, 3)
    held = bounds[:, 0, 2] <= CONTACT_GAP
    fixed = [_is_structure(item) or not _has_shape(item) for item in scene.objects]
    held |= np.array(fixed, bool)
    floating = np.setdiff1d(group, group[held]).tolist()
    boxes = _hull_boxes(scene) if floating else np.zeros((0, 2, 3))
    for k in floating:
        members = np.flatnonzero(group == k)
        yield _floating(scene, boxes, members[np.argsort(bounds[members, 0, 2], kind="stable")])


def _connected(n: int, contacts: Sequence[ObjectContact]) -> Int[np.ndarray, " n"]:
    """Return the smallest index of the objects that each object touches, also through others."""
    a, b = np.array([(one.first, one.second) for one in contacts], int).reshape(-1, 2).T
    group, before = np.arange(n), np.full(n, -1)
    while not np.array_equal(group, before):
        before, group = group, group.copy()
        np.minimum.at(group, a, before[b])
        np.minimum.at(group, b, before[a])
        group = group[group]
    return group


def _hull_boxes(scene: Scene) -> Float[np.ndarray, "h 2 3"]:
    """Return the bounding boxes of all hulls in the world [m]."""
    points = [
        apply(T, hull.vertices)
        for item in scene.objects
        for link, T in item.link_poses().items()
        for hull in item.model.hulls[link]
    ]
    return np.array([(x.min(0), x.max(0)) for x in points]).reshape(-1, 2, 3)


def _floating(
    scene: Scene, boxes: Float[np.ndarray, "h 2 3"], members: Int[np.ndarray, " m"]
) -> Finding:
    """Return the finding on a group in the air, its lowest object first."""
    item = scene.objects[int(members[0])]
    low, high = item.bounds
    below = (boxes[:, 0, :2] < high[:2]).all(1) & (boxes[:, 1, :2] > low[:2]).all(1)
    tops = boxes[below & (boxes[:, 1, 2] <= low[2]), 1, 2]
    gap = float(low[2] - tops.max(initial=0.0))
    on = "what is below it" if len(tops) else "the floor"
    loose = bool(np.prod(high - low) < MAX_LOOSE_VOLUME)
    names = _some("", [scene.objects[m].name for m in members.tolist()])
    down = f"lower it by {_centimeters(gap)} onto {on} (pose z {_pose_z(item, -gap)})"
    return Finding(
        FindingKind.IN_THE_AIR, Severity.WARNING if loose else Severity.NOTE,
        f"{names} in the air, {_centimeters(gap)} above {on}",
        down if loose else f"this is right for what hangs on a wall; otherwise {down}", item.name,
    )  # fmt: skip


def _pose_z(item: SceneObject, by: float) -> str:
    return f"{item.T_world_object[2, 3] + by:.3f}"


def _meters(size: Float[np.ndarray, " k"]) -> str:
    return f"{' x '.join(f'{v:.4g}' for v in size)} m"


def _centimeters(length: float) -> str:
    return f"{100 * length:.3g} cm"


def _some(owner: str, names: Sequence[str], most: int = 3) -> str:
    """Return "a, b and 2 more are" for names of an owner."""
    shown = [f"{owner}/{name}" if owner else repr(name) for name in names[:most]]
    more = [f"{len(names) - most} more"] if len(names) > most else []
    words = [*shown, *more]
    text = words[0] if len(words) == 1 else f"{', '.join(words[:-1])} and {words[-1]}"
    return f"{text} {'is' if len(names) == 1 else 'are'}"
