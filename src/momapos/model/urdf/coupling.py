"""Joints that follow others: URDF's `mimic`, and what a robot file couples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from momapos.core import RobotError, unknown_name

from .urdf_records import Joint, Mimic, Urdf


def check_coupled(urdf: Urdf, names: Iterable[str], where: str) -> None:
    """Refuse joints that were made to follow others and cannot.

    Args:
        urdf: The model in which they follow.
        names: The joints.
        where: Begins the messages: what the couplings come from.

    Raises:
        UnknownNameError: One of them, or what it follows, cannot move.
        RobotError: The limits leave what is followed no way to go.
    """
    moving = {joint.name: joint for joint in urdf.joints if joint.movable}
    for name in names:
        joint = moving.get(name)
        if joint is None or joint.mimic is None:
            raise unknown_name("movable joint", name, moving, where)
        mimic = joint.mimic
        if not _shared(moving[mimic.joint], joint, mimic):
            raise RobotError(
                f"{where}: the limits of {name!r} leave {mimic.joint!r} no way to go; is the ratio "
                f"{mimic.ratio:g} or the offset {mimic.offset:g} wrong?"
            )


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
    leaders = {name: leader_of(name, follows, where, error) for name in follows}
    narrowed = {joint.name: joint for joint in joints}
    for name, mimic in leaders.items():
        narrowed[mimic.joint] = _narrowed(narrowed[mimic.joint], narrowed[name], mimic)
    return tuple(replace(narrowed[joint.name], mimic=leaders.get(joint.name)) for joint in joints)


def leader_of(name: str, follows: Mapping[str, Mimic], where: str, error: type[Exception]) -> Mimic:
    """What a joint follows in the end; an error where that is itself, see `follow`."""
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
