"""Compare the doors and drawers of a room with those of its reconstructed scene, one row each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from momapos.apps.bench.articulated import parts, set_of
from momapos.core.geometry import apply
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import opening_of
from scan import handle_at

LOCATED = 0.5
"""Minimum IoU of two fronts that are the same part [-]."""
MAX_DEPTH_GAP = 0.2
"""Maximum distance of their planes [m]."""
AXIS, TILT = 0.02, np.radians(3.0)
"""Maximum errors of a right axis [m], [rad]."""
FEASIBLE = ("solved", "assumed")
"""Statuses of plans that are executed."""
TIME_GOAL = 0.4
"""Intended maximum time to reconstruct an object [s]."""


@dataclass(frozen=True)
class Way:
    """Motion of a part, in the world."""

    kind: str
    """door, flap or drawer."""
    direction: np.ndarray
    """Direction of its axis."""
    point: np.ndarray
    """A point on the axis [m]."""
    low: np.ndarray
    high: np.ndarray
    """Corners of the closed part [m]."""


@dataclass(frozen=True)
class Row:
    """One door or drawer, and its results."""

    object: str
    joint: str
    subset: str
    kind: str
    match: str = ""
    """The joint of the scan; "" if there is no front."""
    label: str = ""
    found: str = ""
    """Kind of the joint in the scan."""
    side: bool = False
    """Whether kind and side of the hinge are right."""
    axis: float | None = None
    """Distance between the axes [m]."""
    tilt: float | None = None
    """Angle between them [rad]."""
    handle: tuple[float, ...] = ()
    """Errors of the handle at 0, 50 and 100 % open [m]."""
    solvable: bool = False
    planned: str = ""
    """Status of the plan in the reconstructed scene."""
    strict: str = "not found"
    """Why the plan fails the exact check in the room."""
    done: bool = False
    reason: str = ""
    """Why the execution did not open it."""
    item: str = "object"
    """Name of the object in its room."""
    seconds: float = 0.0
    """Time to reconstruct the object [s]."""

    @property
    def right(self) -> bool:
        """Return whether the axis is right."""
        return (
            self.side and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
        )  # fmt: skip


def way_of(item: SceneObject, joint: str, T: np.ndarray) -> Way:
    """Return the motion of a part, in a frame that T maps the world to."""
    record = item.model.joint(joint)
    at = T @ item.link_poses()[record.parent] @ record.T_parent_joint
    sign = opening_of(item.model, joint).sign
    direction = sign * at[:3, :3] @ record.axis
    upright = abs(direction[2]) > np.sqrt(0.5)
    kind = "drawer" if record.kind == "prismatic" else "door" if upright else "flap"
    poses = item.link_poses({joint: opening_of(item.model, joint).closed})
    links = item.model.moved_by(joint)
    points = [apply(T @ poses[n], hull.vertices) for n in links for hull in item.model.hulls[n]]
    corners = np.concatenate(points)
    return Way(kind, direction, at[:3, 3], corners.min(0), corners.max(0))


def overlap(one: Way, other: Way) -> float:
    """Return the IoU of two fronts seen along x; 0 if one is far behind the other."""
    if abs(one.low[0] - other.low[0]) > MAX_DEPTH_GAP:
        return 0.0
    low, high = np.maximum(one.low, other.low)[1:], np.minimum(one.high, other.high)[1:]
    common = float(np.prod(np.maximum(high - low, 0.0)))
    area = sum(float(np.prod((w.high - w.low)[1:])) for w in (one, other))
    return common / max(area - common, 1e-9)


def off(true: Way, found: Way) -> tuple[bool, float | None, float]:
    """Return whether kind and side are right, and the axis errors [m], [rad]."""
    cosine = float(np.clip(true.direction @ found.direction, -1.0, 1.0))
    if true.kind != found.kind or cosine < 0.0:
        return False, None, float(np.arccos(cosine))
    if true.kind == "drawer":
        return True, 0.0, float(np.arccos(cosine))
    middle = (true.low + true.high) / 2
    points = [
        way.point + way.direction * float((middle - way.point) @ way.direction)
        for way in (true, found)
    ]
    apart = float(np.linalg.norm(points[0] - points[1]))
    return True, apart, float(np.arccos(cosine))


def compare(
    name: str, item_name: str, truth: Scene, scanned: Scene, back: np.ndarray, T: np.ndarray
) -> list[Row]:
    """Compare every part of an object with the reconstructed scene.

    Args:
        name: Name in the list of objects.
        item_name: Its name in the room.
        truth, scanned: The room, and its reconstructed scene.
        back: Transform from that scene's frame to the room's.
        T: Transform from the room's frame to one in which the object's front is toward -x.
    """
    item = truth.object(item_name)
    ours = [(j.name, way_of(item, j.name, T)) for j in parts(item.model)]
    theirs = [
        (seen_item, joint, way_of(seen_item, joint, T @ back))
        for seen_item in scanned.objects
        for joint in seen_item.model.joints
    ]
    pairs = sorted(
        ((overlap(a, b), i, k) for i, (_, a) in enumerate(ours)
         for k, (_, _, b) in enumerate(theirs)),
        reverse=True,
    )  # fmt: skip
    found: dict[int, int] = {}
    for common, i, k in pairs:
        if common >= LOCATED and i not in found and k not in found.values():
            found[i] = k
    rows = []
    for i, (joint, way) in enumerate(ours):
        row = Row(name, joint, set_of(name), way.kind, item=item_name)
        if i in found:
            seen_item, other, seen = theirs[found[i]]
            side, axis, tilt = off(way, seen)
            errors: tuple[float, ...] = ()
            if (way.kind == "drawer") == (seen.kind == "drawer"):
                errors = tuple(
                    float(np.linalg.norm(
                        handle_at(truth, item_name, joint, share)
                        - apply(back, handle_at(scanned, seen_item.name, other, share)[None])[0]
                    ))
                    for share in (0.0, 0.5, 1.0)
                )  # fmt: skip
            row = replace(
                row, match=f"{seen_item.name}/{other}", label=seen_item.category, found=seen.kind,
                side=side, axis=axis, tilt=tilt, handle=errors,
            )  # fmt: skip
        rows.append(row)
    return rows


def false_parts(rows: Sequence[Row], scanned: Scene) -> list[Row]:
    """Return a row without a joint for each part of a reconstructed room that is none.

    Args:
        rows: The true parts of all objects of the room; at least one.
        scanned: The reconstructed scene.
    """
    matched = {row.match for row in rows}
    every = [
        (f"{item.name}/{joint}", way_of(item, joint, np.eye(4)).kind)
        for item in scanned.objects
        for joint in item.model.joints
    ]
    return [
        Row(rows[0].object, "", rows[0].subset, "", match=name, found=kind)
        for name, kind in every
        if name not in matched
    ]


def table(rows: Sequence[Row]) -> str:
    """Summarize one set, and list each part that was not opened with its reason."""
    false = [r for r in rows if not r.joint]
    rows = [r for r in rows if r.joint]
    located = [r for r in rows if r.match]
    kinds = [r for r in located if r.found == r.kind]
    hinged = [r for r in kinds if r.kind != "drawer"]
    solvable = [r for r in rows if r.solvable]
    errors = np.array([r.handle for r in located if r.side and r.handle]).reshape(-1, 3)

    counts = [
        ("parts located", len(located), len(rows)),
        ("precision", len(located), len(located) + len(false)),
        ("kind right, of those located", len(kinds), len(located)),
        ("hinge side right, of doors and flaps", sum(r.side for r in hinged), len(hinged)),
        ("axis within 2 cm, 3 degrees", sum(r.right for r in located), len(located)),
        ("the same, of all parts", sum(r.right for r in rows), len(rows)),
        (
            "plan in the reconstructed scene",
            sum(r.planned in FEASIBLE for r in solvable),
            len(solvable),
        ),
        (
            "of these for an improbable joint",
            sum(r.planned == "assumed" for r in solvable),
            sum(r.planned in FEASIBLE for r in solvable),
        ),
        ("plan valid in the room", sum(not r.strict for r in solvable), len(solvable)),
        ("opened in physics", sum(r.done for r in solvable), len(solvable)),
    ]
    lines = [
        f"| {name} | {part} of {whole} ({part / whole:.0%}) |"
        for name, part, whole in counts
        if whole
    ]
    if len(errors):
        medians = ", ".join(f"{100 * v:.1f}" for v in np.median(errors, axis=0))
        lines.append(f"| handle at 0, 50, 100 % open, if the side is right | {medians} cm |")
    times = [*{(r.object, r.match.partition("/")[0]): r.seconds for r in located}.values()]
    if times:
        soon = f"{sum(time <= TIME_GOAL for time in times)} of {len(times)} within {TIME_GOAL} s"
        spread = f"{np.median(times):.2f} s, max {max(times):.2f} s"
        lines.append(f"| time per object | {spread}, {soon} |")
    reasons = Counter(cause(r) for r in solvable if not r.done)
    taken = Counter((r.kind, r.found) for r in located if r.found != r.kind)
    lines += [
        f"  {count} {one} classified as {other}" for (one, other), count in sorted(taken.items())
    ]
    lines += [f"  {count} not opened: {reason}" for reason, count in reasons.most_common()]
    return "\n".join(lines)


def cause(row: Row) -> str:
    """Return the category of the reason that a part is not opened."""
    if not row.match:
        return "part not located"
    if row.found != row.kind:
        return f"{row.kind} classified as {row.found}"
    if not row.side:
        return "hinge on the wrong side"
    if row.planned not in FEASIBLE:
        return "no plan in the reconstructed scene"
    return "run fails, axis right" if row.right else "run fails, axis wrong"


def shown(row: Row) -> str:
    """Format a row as one line."""
    where = f"{row.object.removeprefix('Kitchen_models/')}/{row.joint} {row.kind}"
    if not row.joint:
        return f"{where}: {row.match} ({row.found}) is no part"
    if not row.match:
        return f"{where}: not located" + (" (solvable)" if row.solvable else "")
    axis = (
        "-" if row.axis is None else f"{100 * row.axis:.1f} cm {np.degrees(row.tilt or 0):.1f} deg"
    )
    handle = ", ".join(f"{100 * v:.1f}" for v in row.handle)
    text = f"{where}: {row.match} ({row.found}) side {row.side}, axis {axis}, handle {handle} cm"
    if row.planned:
        text += f"; {row.planned}; strict: {row.strict or 'valid'}; done {row.done} {row.reason}"
    return text
