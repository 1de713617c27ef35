"""Read the latches of scene files, and tell when a latch must be turned."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, Quantity, SceneError, parse_quantity, unknown_name
from momapos.core.geometry import apply, invert
from momapos.model.records import Latch
from momapos.model.urdf import Articulated, Joint, opening_of

from .scene import joint_value
from .scene_members import SceneLatch
from .scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_CLOSED_OFFSET = 0.01
"""A part within this of its closed value is held by its latch [rad] or [m]: the bolt of a door is
about 1 cm long, which is 0.012 rad at the edge of a door of 0.8 m."""
SAME_VALUE = 1e-3
"""A latch within this of its value is turned [rad] or [m]."""


MIN_LATCH_TRAVEL = 5e-3
"""Smallest range of a latch [rad] or [m]."""
MAX_LEVER_TURN = 2.0
"""Largest range of what may be a lever or a knob: door handles turn by 30 to 50 degrees, knobs and
window handles by 90 [rad]."""
MAX_BOLT_TRAVEL = 0.12
"""Largest range of what may be a bolt [m]."""
MAX_LATCH_SHARE = 0.2
"""Largest share of a part's front that a latch takes; the flap of a dispenser takes more [-]."""
EDGE_SHARE = 0.35
"""A latch is within this share of the part's width from the free edge: levers are 5 to 10 cm from
it, and narrow doors are 30 cm wide [-]."""


def latch_to_turn(item: SceneObject, joint: str) -> Latch | None:
    """Return the latch that must be turned before a joint of an object moves.

    None if no latch holds the joint, if the latch is turned already, or if the part is ajar, so
    that the latch is out of its keeper.
    """
    latch = item.latch
    if latch is None or latch.holds != joint:
        return None
    values = item.values()
    value, rest = values[latch.joint], item.model.rest[latch.joint]
    turned = abs(value - latch.to) < SAME_VALUE or (value - latch.to) * (latch.to - rest) > 0.0
    return None if turned or is_ajar(item, joint) else latch


def is_ajar(item: SceneObject, joint: str) -> bool:
    """Check whether a part is so far from its closed value that no latch holds it."""
    away = item.values()[joint] - opening_of(item.model, joint).closed
    return bool(abs(away) > MAX_CLOSED_OFFSET)


def latch_guess(item: SceneObject, joint: str) -> str:
    """Return the joint that may be a latch of a part although the scene declares none; "" for none.

    It turns or slides something small by a short range, on the part and near the edge that is
    farthest from its hinge; on a drawer near any edge of its front.

    Args:
        item: The object.
        joint: Joint of the part.
    """
    if item.latch is not None and item.latch.holds == joint:
        return ""
    for name, own, whole in _on_part(item, joint):
        other = item.joint(name)
        longest = MAX_BOLT_TRAVEL if other.kind == "prismatic" else MAX_LEVER_TURN
        if (
            other.upper - other.lower <= longest
            and _is_small(own, whole)
            and _is_near_edge(own.mean(0), whole, item.joint(joint))
        ):
            return name
    return ""


def loose_joints(item: SceneObject, joint: str) -> list[str]:
    """Return joints on a part that may swing or slide by themselves as the part moves.

    What they move is no latch and not small, such as a second leaf that follows no joint.

    Args:
        item: The object.
        joint: Joint of the part.
    """
    latch = None if item.latch is None else item.latch.joint
    return [
        n for n, own, whole in _on_part(item, joint) if n != latch and not _is_small(own, whole)
    ]


def _on_part(
    item: SceneObject, joint: str
) -> Iterator[tuple[str, Float[np.ndarray, "2 3"], Float[np.ndarray, "2 3"]]]:
    """Yield joints on the part that another joint moves, with boxes around what they move.

    Mimic joints and those with hardly any range are left out.

    Returns:
        The joint, lowest and highest corner of what it moves, and of the rest of the part [m], in
        the frame of the part's joint.
    """
    model, poses = item.model, item.link_poses()
    moved = {
        name: set(model.moved_by(name))
        for name, one in model.joints.items()
        if name != joint
        and one.mimic is None
        and one.child in model.moved_by(joint)
        and one.upper - one.lower > MIN_LATCH_TRAVEL
    }
    leaf = set(model.moved_by(joint)).difference(*moved.values())
    back = invert(poses[item.joint(joint).child])

    def corners(links: Collection[str]) -> Float[np.ndarray, "2 3"] | None:
        points = [apply(back @ poses[n], hull.vertices) for n in links for hull in model.hulls[n]]
        every = np.concatenate(points) if points else None
        return None if every is None else np.stack([every.min(0), every.max(0)])

    whole = corners(leaf)
    for name, links in moved.items():
        own = corners(links)
        if whole is not None and own is not None:
            yield name, own, whole


def _is_small(own: Float[np.ndarray, "2 3"], whole: Float[np.ndarray, "2 3"]) -> bool:
    """Check whether something is at most half as long as the part and takes little of its front."""
    size, part = np.sort(np.ptp(own, axis=0))[::-1], np.sort(np.ptp(whole, axis=0))[::-1]
    return bool(size[0] <= part[0] / 2 and size[0] * size[1] <= MAX_LATCH_SHARE * part[0] * part[1])


def _is_near_edge(
    middle: Float[np.ndarray, "3"], whole: Float[np.ndarray, "2 3"], record: Joint
) -> bool:
    """Check whether a point is near a free edge of a part, in the frame of the part's joint."""
    corners = np.stack(np.meshgrid(*whole.T), -1).reshape(-1, 3)
    if record.kind != "prismatic":
        points = np.concatenate([corners, middle[None]])
        arms = np.linalg.norm(points - np.outer(points @ record.axis, record.axis), axis=1)
        return bool(arms[-1] >= (1.0 - EDGE_SHARE) * arms[:-1].max())
    across = np.abs(record.axis) < np.abs(record.axis).max()
    gap = np.minimum(middle - whole[0], whole[1] - middle) / np.maximum(np.ptp(whole, axis=0), 1e-9)
    return bool((gap[across] <= EDGE_SHARE).any())


def latch_value(item: SceneObject, latch: Latch) -> str:
    """Return the value of a turned latch in words."""
    if item.joint(latch.joint).kind == "prismatic":
        return f"{100 * latch.to:.3g} cm"
    return f"{math.degrees(latch.to):.3g} deg"


def part_values(
    item: SceneObject, joint: str | None, value: float, latch: float | None = None
) -> dict[str, float]:
    """Return joint values of an object that a task moves, for `SceneObject.link_poses`.

    Args:
        item: The object.
        joint: The joint that the task moves; None if it moves none.
        value: Value of the joint [rad] or [m].
        latch: Value of the object's latch [rad] or [m]; None as in the scene.
    """
    if joint is None:
        return {}
    turned = {} if item.latch is None or latch is None else {item.latch.joint: float(latch)}
    return {joint: float(value), **turned}


def read_latch(latch: SceneLatch | None, model: Articulated, where: str) -> Latch | None:
    """Return the latch of an object of a file.

    Args:
        latch: The member of the file; None if there is no latch. The joint that it holds may be
            left out if only one moves the latch.
        model: The object.
        where: File and object, for messages.

    Raises:
        SceneError: The latch is unusable; the message says what would be right.
        UnknownNameError: The object has no such joint.
    """
    if latch is None:
        return None
    where = f"{where}: latch"
    joint = _leader(latch.joint, model, where)
    value = _value(latch.to, joint, f"{where}: to")
    return Latch(joint.name, value, _held(latch.holds, joint, model, where))


def _leader(name: str, model: Articulated, where: str) -> Joint:
    if name not in model.joints:
        raise unknown_name("movable joint", name, model.joints, where)
    joint = model.joint(name)
    if joint.mimic is not None:
        raise SceneError(f"{where}: {name!r} follows {joint.mimic.joint!r}; name that joint")
    return joint


def _value(value: float | str, joint: Joint, where: str) -> float:
    """Return the value of a latch, within the limits of its joint [rad] or [m]."""
    try:
        quantity = parse_quantity(value) if isinstance(value, str) else Quantity(value, "", "")
    except InputError as error:
        raise SceneError(f"{where}: {error}") from error
    try:
        number = joint_value(joint, quantity, where)
    except InputError as error:
        raise SceneError(str(error)) from error
    if not (math.isfinite(number) and joint.lower - 1e-6 <= number <= joint.upper + 1e-6):
        raise SceneError(
            f"{where} {value} is outside the limits of {joint.name!r}, {joint.lower:g} to "
            f"{joint.upper:g}"
        )
    return min(max(number, joint.lower), joint.upper)


def _held(name: str | None, joint: Joint, model: Articulated, where: str) -> str:
    """Return the joint that a latch holds: one that moves the latch."""
    movers = [
        other.name
        for other in model.joints.values()
        if other.mimic is None
        and other.name != joint.name
        and joint.child in model.moved_by(other.name)
    ]
    if name is None:
        if len(movers) == 1:
            return movers[0]
        if movers:
            raise SceneError(
                f"{where}: {joint.name!r} is on several parts; name the joint that it holds as "
                f"'holds', one of {', '.join(movers)}"
            )
        raise SceneError(
            f"{where}: no other joint moves {joint.child!r}; a latch is on the part that it holds"
        )
    held = _leader(name, model, f"{where}: holds").name
    if held == joint.name:
        raise SceneError(f"{where}: {held!r} cannot hold itself; 'holds' is the joint that opens")
    if held not in movers:
        raise SceneError(
            f"{where}: {joint.child!r} is not on the part that {held!r} moves, and no hand holds "
            "both; leave the latch out and turn it in a task of its own"
        )
    return held
