"""Joints that follow others: URDF's `mimic`, and what a robot file couples."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence
from dataclasses import replace

from momapos.errors import RobotError, unknown_name
from momapos.kinematics.urdf_records import Joint, Mimic, Urdf


def coupled(urdf: Urdf, follows: Mapping[str, Mimic], where: str) -> Urdf:
    """The same model with more joints that follow others.

    Args:
        urdf: The model.
        follows: By the name of the joint that follows; the one that it follows may follow a third.
        where: Begins the messages: the file and table that this comes from.

    Raises:
        UnknownNameError: A joint does not exist or cannot move.
        RobotError: Joints follow each other in a circle, a
            number is no use, or the limits leave a joint no way to go.
    """
    moving = {joint.name: joint for joint in urdf.joints if joint.movable}
    for name, given in follows.items():
        for joint in (name, given.joint):
            if joint not in moving:
                raise unknown_name("movable joint", joint, moving, f"{urdf.name} ({where})")
        if not (math.isfinite(given.ratio) and given.ratio and math.isfinite(given.offset)):
            raise RobotError(f"{where}: {name!r} needs a ratio other than 0 and a finite offset")
    known = {joint.name: joint.mimic for joint in urdf.joints if joint.mimic is not None}
    joints = follow(urdf.joints, {**known, **follows}, where, RobotError)
    after = {joint.name: joint for joint in joints}
    for name in follows:
        mimic = after[name].mimic
        assert mimic is not None
        if not _shared(after[mimic.joint], moving[name], mimic):
            raise RobotError(
                f"{where}: the limits of {name!r} leave {mimic.joint!r} no way to go; is the ratio "
                f"{mimic.ratio:g} or the offset {mimic.offset:g} wrong?"
            )
    return replace(urdf, joints=joints)


def follow(
    joints: Sequence[Joint],
    follows: Mapping[str, Mimic],
    where: str,
    error: type[Exception],
) -> tuple[Joint, ...]:
    """Joints with what each follows: a joint that follows none, and keeps the limits of all.

    Limits that would leave it no way to go do not count: few programs read those of a joint that
    follows, so that files hold anything there.

    Args:
        joints: All joints of a model.
        follows: By the name of the joint that follows.
        where: Begins the messages.
        error: What to raise where joints follow each other in a circle.
    """
    leaders = {name: _leader(name, follows, where, error) for name in follows}
    narrowed = {joint.name: joint for joint in joints}
    for name, mimic in leaders.items():
        narrowed[mimic.joint] = _narrowed(narrowed[mimic.joint], narrowed[name], mimic)
    return tuple(replace(narrowed[joint.name], mimic=leaders.get(joint.name)) for joint in joints)


def _leader(name: str, follows: Mapping[str, Mimic], where: str, error: type[Exception]) -> Mimic:
    """What a joint follows in the end."""
    mimic, seen = follows[name], {name}
    while mimic.joint in follows:
        if mimic.joint in seen:
            raise error(f"{where}: joint {name!r} follows itself")
        seen.add(mimic.joint)
        above = follows[mimic.joint]
        offset = mimic.ratio * above.offset + mimic.offset
        mimic = Mimic(above.joint, mimic.ratio * above.ratio, offset)
    return mimic


def _shared(leader: Joint, follower: Joint, mimic: Mimic) -> tuple[float, float] | None:
    """Limits of a joint within which what follows it keeps its own; None: there are none."""
    if mimic.ratio == 0.0:
        return leader.lower, leader.upper
    ends = sorted((end - mimic.offset) / mimic.ratio for end in (follower.lower, follower.upper))
    lower, upper = max(leader.lower, ends[0]), min(leader.upper, ends[1])
    return (lower, upper) if lower < upper else None


def _narrowed(leader: Joint, follower: Joint, mimic: Mimic) -> Joint:
    """The leader with the limits of the other one too, in position and speed."""
    shared = _shared(leader, follower, mimic)
    if shared is None or mimic.ratio == 0.0:
        return leader
    velocity = min(leader.velocity, follower.velocity / abs(mimic.ratio))
    return replace(leader, lower=shared[0], upper=shared[1], velocity=velocity)
