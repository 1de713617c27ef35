"""Mimic joints: those of a URDF, and joints that a robot file couples."""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import replace

from momapos.core import RobotError, unknown_name

from .urdf_records import Joint, Mimic, Urdf


def check_coupled(urdf: Urdf, names: Iterable[str], where: str) -> None:
    """Check joints that a robot file couples to leaders.

    Args:
        urdf: The model with the couplings.
        names: The coupled joints.
        where: Source of the couplings, for messages.

    Raises:
        UnknownNameError: A coupled joint or its leader does not exist or is fixed.
        RobotError: The limits of a coupled joint leave its leader no range.
    """
    moving = {joint.name: joint for joint in urdf.joints if joint.movable}
    for name in names:
        joint = moving.get(name)
        if joint is None or joint.mimic is None:
            raise unknown_name("movable joint", name, moving, where)
        mimic = joint.mimic
        if not _shared(moving[mimic.joint], joint, mimic):
            raise RobotError(
                f"{where}: the limits of {name!r} leave {mimic.joint!r} no range; check the ratio "
                f"{mimic.ratio:g} and the offset {mimic.offset:g}"
            )


def follow(
    joints: Sequence[Joint], follows: Mapping[str, Mimic], where: str, error: type[Exception]
) -> tuple[Joint, ...]:
    """Return joints with mimic relations resolved: leaders are no mimic joints themselves.

    A leader's limits are narrowed to those of its mimic joints. Limits that would leave it no range
    are ignored: few programs read the limits of mimic joints, so files often have wrong ones.

    Args:
        joints: All joints of a model.
        follows: Mimic relations by the name of the mimic joint.
        where: Prefix of messages.
        error: Class of the error to raise if relations are cyclic.
    """
    leaders = {name: leader_of(name, follows, where, error) for name in follows}
    narrowed = {joint.name: joint for joint in joints}
    for name, mimic in leaders.items():
        narrowed[mimic.joint] = _narrowed(narrowed[mimic.joint], narrowed[name], mimic)
    return tuple(replace(narrowed[joint.name], mimic=leaders.get(joint.name)) for joint in joints)


def leader_of(name: str, follows: Mapping[str, Mimic], where: str, error: type[Exception]) -> Mimic:
    """Return a joint's relation to its final leader; see `follow` for the arguments."""
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
    """Return the leader's limits within which the follower keeps its own, or None."""
    if mimic.ratio == 0.0:
        return leader.lower, leader.upper
    ends = sorted((end - mimic.offset) / mimic.ratio for end in (follower.lower, follower.upper))
    lower, upper = max(leader.lower, ends[0]), min(leader.upper, ends[1])
    return (lower, upper) if lower < upper else None


def _narrowed(leader: Joint, follower: Joint, mimic: Mimic) -> Joint:
    """Return the leader with all limits narrowed for a follower."""
    shared = _shared(leader, follower, mimic)
    if shared is None or mimic.ratio == 0.0:
        return leader
    velocity = min(leader.velocity, follower.velocity / abs(mimic.ratio))
    acceleration = min(leader.acceleration, follower.acceleration / abs(mimic.ratio))
    jerk = min(leader.jerk, follower.jerk / abs(mimic.ratio))
    return replace(
        leader, lower=shared[0], upper=shared[1], velocity=velocity, acceleration=acceleration,
        jerk=jerk,
    )  # fmt: skip
