"""Check a scene: shapes, sizes, overlaps, joints, and where a robot can drive."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import UrdfError, expect
from momapos.core.geometry import apply
from momapos.model.robots import Robot
from momapos.model.scene import (
    FLOOR_EDGE,
    Scene,
    SceneObject,
    latch_guess,
    latch_value,
    resting_on,
    size_hint,
    usual_edge,
)
from momapos.model.urdf import hull_space, opening_of, opens_both_ways
from momapos.planning import survey_floor
from momapos.planning.grasps import PartFacts, part_facts_of, parts_of
from momapos.verification import ObjectContact, object_contacts

from .report import Finding, FindingKind, FloorReport, JointReport, SceneReport, Severity

if TYPE_CHECKING:
    from jaxtyping import Float, Int


MIN_REACHABLE_SHARE = 0.9
"""If the robot reaches less of the free floor, a part of the room is cut off [-]."""


def drive_report(
    scene: Scene, robot: Robot, joints: Sequence[JointReport]
) -> tuple[FloorReport, tuple[JointReport, ...], tuple[Finding, ...]]:
    """Survey the floor, and add to each joint how near to its handle the robot can drive.

    A handle counts as out of reach if the arm cannot reach it from any place that the base's
    inscribed circle can drive to. So "within reach" is necessary for a task, not sufficient.
    """
    survey = survey_floor(scene, robot)
    start, drivable = survey.start, survey.floor
    free = 0.0 if drivable is None else drivable.free_area
    floor = FloorReport(
        robot=robot.title,
        start=None if start is None else (float(start[0]), float(start[1]), float(start[2])),
        given=scene.start is not None,
        is_free=not survey.problem,
        free_area=free,
        reachable_share=0.0 if drivable is None else drivable.reachable_area / free,
    )
    shown = [one for one in joints if one.handle_xyz is not None]
    points = np.array([one.handle_xyz for one in shown]).reshape(-1, 3)
    distance = survey.distances(points[:, :2]).tolist()
    reach = robot.outreach + float(np.linalg.norm(robot.footprint, axis=1).max())
    near = {
        (one.object, one.joint): replace(one, base_distance=d, base_reaches=d <= reach)
        for one, d in zip(shown, distance, strict=True)
    }
    joints = tuple(near.get((one.object, one.joint), one) for one in joints)
    findings = (*_start(survey.problem), *_drive(floor, joints))
    return floor, joints, findings


def _start(problem: str) -> Iterator[Finding]:
    if problem:
        yield Finding(
            FindingKind.START, Severity.ERROR, problem.partition("; ")[0],
            "give a free 'start' in the scene, or --start X,Y,YAW with a task",
        )  # fmt: skip


def _drive(floor: FloorReport, joints: Sequence[JointReport]) -> Iterator[Finding]:
    if not floor.is_free:
        return
    if floor.reachable_share < MIN_REACHABLE_SHARE:
        yield Finding(
            FindingKind.DRIVING, Severity.WARNING,
            f"{floor.robot} reaches only {100 * floor.reachable_share:.0f} % of the free floor "
            f"({floor.free_area:.1f} m^2) from its start",
            "widen the passages, move the start, or use a narrower robot",
        )  # fmt: skip
    for one in joints:
        if one.base_reaches is False and not one.is_handle:
            assert one.base_distance is not None
            near = (
                "nowhere near" if np.isinf(one.base_distance)
                else f"only within {one.base_distance:.2f} m of"
            )  # fmt: skip
            yield Finding(
                FindingKind.DRIVING, Severity.WARNING,
                f"{floor.robot} can drive {near} the handle of {one.object}/{one.joint}, "
                "which is beyond its arm",
                "clear the floor in front of it, or move the start", one.object, one.joint,
            )  # fmt: skip


MIN_RANGE = 1e-6
"""Smallest range of a joint that moves [rad] or [m]."""


def joint_reports(scene: Scene) -> tuple[JointReport, ...]:
    """Return what is known about each movable joint, in the scene's order."""
    return tuple(
        _report(item, joint, part_facts_of(item, joint))
        for item in scene.objects
        for joint in item.model.joints
    )


def _report(item: SceneObject, joint: str, facts: PartFacts) -> JointReport:
    handle, xyz, latch = facts.handle, facts.handle_world, item.latch
    return JointReport(
        object=item.name,
        joint=joint,
        kind=item.joint(joint).kind,
        closed=facts.opening.closed,
        wide=facts.opening.wide,
        value=item.values()[joint],
        both_ways=opens_both_ways(item.model, joint),
        follows=facts.follows,
        is_handle=facts.is_handle,
        handle="" if handle is None else str(handle),
        has_handle=handle is not None and not handle.edge,
        handle_xyz=None if xyz is None else (float(xyz[0]), float(xyz[1]), float(xyz[2])),
        pull=facts.pull,
        problem=facts.problem,
        latch="" if latch is None or latch.holds != joint else latch.joint,
        latch_to="" if latch is None or latch.holds != joint else latch_value(item, latch),
        holds="" if latch is None or latch.joint != joint else latch.holds,
        latch_guess=latch_guess(item, joint),
    )


def joint_findings(joints: Sequence[JointReport]) -> Iterator[Finding]:
    """Yield the joints that move nothing, undeclared latches, and the parts without a handle."""
    for one in joints:
        where = f"{one.object}/{one.joint}"
        if one.follows:
            continue
        if one.latch_guess:
            yield Finding(
                FindingKind.LATCH, Severity.NOTE,
                f"{one.object}/{one.latch_guess} may be a latch of {one.joint}; plans leave it "
                "alone", f'declare it: "latch": {{"joint": "{one.latch_guess}", "to": VALUE, '
                f'"holds": "{one.joint}"}}', one.object, one.joint,
            )  # fmt: skip
        if abs(one.wide - one.closed) < MIN_RANGE:
            yield Finding(
                FindingKind.JOINT, Severity.NOTE, f"{where} has a range of zero and cannot move",
                "set its limits, or make it a fixed joint", one.object, one.joint,
            )  # fmt: skip
        elif one.problem:
            yield Finding(
                FindingKind.JOINT, Severity.WARNING, f"{where}: {one.problem.partition('; ')[0]}",
                "give its child link a collision element", one.object, one.joint,
            )  # fmt: skip
        elif not one.has_handle and not one.is_handle:
            yield Finding(
                FindingKind.NO_HANDLE, Severity.NOTE,
                f"no handle was found on {where}; it is held by {one.handle}",
                "if it has one, name its collision element 'handle'", one.object, one.joint,
            )  # fmt: skip


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


_ORDER = list(Severity)


def rest_findings(scene: Scene) -> Iterator[Finding]:
    """Yield what rests on parts, and so moves with them."""
    for item in scene.objects:
        for joint in parts_of(item):
            for name, link in resting_on(scene.objects, item, item.model.moved_by(joint)).items():
                text = f"{name!r} rests on {item.name}/{link} and moves with {item.name}/{joint}"
                yield Finding(FindingKind.RESTS, Severity.NOTE, text, object=name, joint=joint)


def check_scene(scene: Scene, robot: Robot | None = None) -> SceneReport:
    """Check a scene before a task: what is wrong, and what is known about its parts.

    Each finding says what is wrong, where, and what would be right. A report without findings does
    not mean that a task is feasible.

    Args:
        scene: The scene, with the joint values of interest.
        robot: The robot whose start and paths are checked; None to leave these out.

    Returns:
        The findings, the worst first, and what is known about each joint.

    Raises:
        InputError: An argument is of the wrong type.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    if robot is not None:
        expect("robot", robot, Robot, "load_robot reads one")
    findings, joints, floor = list(_file_findings(scene)), joint_reports(scene), None
    findings += shape_findings(scene)
    bare = {one.object for one in findings if one.kind is FindingKind.NO_SHAPE}
    findings += joint_findings([one for one in joints if one.object not in bare])
    findings += rest_findings(scene)
    if robot is not None and scene.objects:
        floor, joints, more = drive_report(scene, robot, joints)
        findings += more
    return SceneReport(
        scene=scene.name,
        path="" if scene.path is None else str(scene.path),
        objects=len(scene.objects),
        findings=tuple(sorted(findings, key=lambda one: _ORDER.index(one.severity))),
        joints=joints,
        floor=floor,
    )


def _file_findings(scene: Scene) -> Iterator[Finding]:
    """Yield the unknown keys of the file, and the assumptions of its reader."""
    for key in scene.ignored_keys:
        where = key.where.removeprefix(f"{scene.path}").removeprefix(": ")
        text = f"{where}{': ' if where else ''}{key.key!r:.80} is not known and was ignored"
        yield Finding(FindingKind.UNKNOWN_KEY, Severity.WARNING, text, key.advice, key.object)
    ignored = {str(key) for key in scene.ignored_keys}
    for text in scene.warnings:
        if text not in ignored:
            shown = text.removeprefix(f"{scene.path}: ")
            yield Finding(FindingKind.READER, Severity.NOTE, shown)
