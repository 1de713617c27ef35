"""Doors and drawers of a room against those of a scene made of its scan, one row each."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from momapos.core.geometry.transforms import apply
from momapos.model.scene.scene import Scene, SceneObject
from momapos.model.urdf.joint_opening import opening_of
from objects import parts, set_of
from scan import handle_at

LOCATED = 0.5
"""IoU of two fronts from which on they are one [-]."""
APART = 0.2
"""Their planes are no farther apart [m]."""
AXIS, TILT = 0.02, np.radians(3.0)
"""An axis is right within these [m], [rad]."""
SOON = 0.4
"""Looking at an object may take so long [s]."""


@dataclass(frozen=True)
class Way:
    """How a part moves, in the world."""

    kind: str
    """door, flap or drawer."""
    direction: np.ndarray
    """Of its axis."""
    point: np.ndarray
    """On the axis [m]."""
    low: np.ndarray
    high: np.ndarray
    """Corners of the part while it is shut [m]."""


@dataclass(frozen=True)
class Row:
    """One door or drawer, and what became of it."""

    object: str
    joint: str
    subset: str
    kind: str
    match: str = ""
    """The joint of the scan; "" where no front is there."""
    label: str = ""
    found: str = ""
    """As what it is found."""
    side: bool = False
    """Whether kind and side of the hinge are right."""
    axis: float | None = None
    """Distance between the axes [m]."""
    tilt: float | None = None
    """Angle between them [rad]."""
    handle: tuple[float, ...] = ()
    """Errors of the handle shut, half and wide open [m]."""
    solvable: bool = False
    planned: str = ""
    """Status of the plan in the scene made."""
    strict: str = "not found"
    """Why the plan does not hold in the room, checked exactly."""
    done: bool = False
    reason: str = ""
    """Why the run did not open it."""
    thing: str = "object"
    """Name of the object in its room."""
    seconds: float = 0.0
    """How long looking at the object found took [s]."""

    @property
    def right(self) -> bool:
        """Whether the axis is right."""
        return (
            self.side and self.axis is not None and self.axis < AXIS
            and self.tilt is not None and self.tilt < TILT
        )  # fmt: skip


def way_of(item: SceneObject, joint: str, T: np.ndarray) -> Way:
    """How a part moves, in a frame that T maps the world to."""
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
    """IoU of two fronts seen along x; 0 where one lies far behind the other."""
    if abs(one.low[0] - other.low[0]) > APART:
        return 0.0
    low, high = np.maximum(one.low, other.low)[1:], np.minimum(one.high, other.high)[1:]
    common = float(np.prod(np.maximum(high - low, 0.0)))
    area = sum(float(np.prod((w.high - w.low)[1:])) for w in (one, other))
    return common / max(area - common, 1e-9)


def off(true: Way, found: Way) -> tuple[bool, float | None, float]:
    """Whether a part opens the right way, how far its axis is off [m] and at what angle [rad]."""
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
    name: str, thing_name: str, truth: Scene, scanned: Scene, back: np.ndarray, T: np.ndarray
) -> list[Row]:
    """Every part of an object against the scene made.

    Args:
        name: Of the object, as the list of objects has it.
        thing_name: Its name in the room.
        truth, scanned: The room, and the scene made of its scan.
        back: From the frame of that scene to the room's.
        T: From the room's frame to one in which the object's front is toward -x.
    """
    item = truth.object(thing_name)
    ours = [(j.name, way_of(item, j.name, T)) for j in parts(item.model)]
    theirs = [
        (thing, joint, way_of(thing, joint, T @ back))
        for thing in scanned.objects
        for joint in thing.model.joints
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
        row = Row(name, joint, set_of(name), way.kind, thing=thing_name)
        if i in found:
            thing, other, seen = theirs[found[i]]
            side, axis, tilt = off(way, seen)
            errors: tuple[float, ...] = ()
            if (way.kind == "drawer") == (seen.kind == "drawer"):
                errors = tuple(
                    float(np.linalg.norm(
                        handle_at(truth, thing_name, joint, share)
                        - apply(back, handle_at(scanned, thing.name, other, share)[None])[0]
                    ))
                    for share in (0.0, 0.5, 1.0)
                )  # fmt: skip
            row = replace(
                row, match=f"{thing.name}/{other}", label=thing.category, found=seen.kind,
                side=side, axis=axis, tilt=tilt, handle=errors,
            )  # fmt: skip
        rows.append(row)
    return rows


def table(rows: Sequence[Row]) -> str:
    """One set in figures, and each part that is not opened with its reason."""
    located = [r for r in rows if r.match]
    kinds = [r for r in located if r.found == r.kind]
    hinged = [r for r in kinds if r.kind != "drawer"]
    solvable = [r for r in rows if r.solvable]
    errors = np.array([r.handle for r in located if r.side and r.handle]).reshape(-1, 3)

    counts = [
        ("parts located", len(located), len(rows)),
        ("kind right, of those located", len(kinds), len(located)),
        ("hinge side right, of doors and flaps", sum(r.side for r in hinged), len(hinged)),
        ("axis within 2 cm, 3 degrees", sum(r.right for r in located), len(located)),
        ("the same, of all parts", sum(r.right for r in rows), len(rows)),
        ("plan in the scene made", sum(r.planned == "solved" for r in solvable), len(solvable)),
        ("holds in the room, exactly", sum(not r.strict for r in solvable), len(solvable)),
        ("opened in physics", sum(r.done for r in solvable), len(solvable)),
    ]
    lines = [
        f"| {name} | {part} of {whole} ({part / whole:.0%}) |"
        for name, part, whole in counts
        if whole
    ]
    if len(errors):
        medians = ", ".join(f"{100 * v:.1f}" for v in np.median(errors, axis=0))
        lines.append(f"| handle shut, half, wide open, where the side is right | {medians} cm |")
    times = [*{(r.object, r.match.partition("/")[0]): r.seconds for r in located}.values()]
    if times:
        soon = f"{sum(time <= SOON for time in times)} of {len(times)} within {SOON} s"
        spread = f"{np.median(times):.2f} s, most {max(times):.2f} s"
        lines.append(f"| looking at an object | {spread}, {soon} |")
    reasons = Counter(cause(r) for r in solvable if not r.done)
    taken = Counter((r.kind, r.found) for r in located if r.found != r.kind)
    lines += [
        f"  {count} {one} taken for a {other}" for (one, other), count in sorted(taken.items())
    ]
    lines += [f"  {count} not opened: {reason}" for reason, count in reasons.most_common()]
    return "\n".join(lines)


def cause(row: Row) -> str:
    """Why a part is not opened, in general words."""
    if not row.match:
        return "part not located"
    if row.found != row.kind:
        return f"{row.kind} taken for a {row.found}"
    if not row.side:
        return "hinge on the wrong side"
    if row.planned != "solved":
        return "no plan in the scene made"
    return "run fails, axis right" if row.right else "run fails, axis off"


def shown(row: Row) -> str:
    """One line."""
    where = f"{row.object.removeprefix('Kitchen_models/')}/{row.joint} {row.kind}"
    if not row.match:
        return f"{where}: not located" + (" (solvable)" if row.solvable else "")
    axis = (
        "-" if row.axis is None else f"{100 * row.axis:.1f} cm {np.degrees(row.tilt or 0):.1f} deg"
    )
    handle = ", ".join(f"{100 * v:.1f}" for v in row.handle)
    text = f"{where}: {row.match} ({row.found}) side {row.side}, axis {axis}, handle {handle} cm"
    if row.planned:
        text += f"; {row.planned}; strict: {row.strict or 'holds'}; done {row.done} {row.reason}"
    return text
