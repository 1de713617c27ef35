"""Read the known resistance of joints in scene files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import fields

from momapos.core import InputError, SceneError, unknown_name
from momapos.model.records import JointResistance

_KEYS = tuple(item.name for item in fields(JointResistance))


def read_resistance(
    value: object, followers: Mapping[str, str], where: str
) -> dict[str, JointResistance]:
    """Read the known resistance of an object's joints.

    Args:
        value: Content of the file.
        followers: Leader of each movable joint that follows another; "" for the others.
        where: File and object, for messages.

    Raises:
        SceneError: A value is unusable, or a key is unknown.
        UnknownNameError: The object has no such joint.
    """
    if not isinstance(value, dict):
        raise SceneError(f"{where}: resistance must be {{joint: {{...}}}}")
    found = {}
    for name, members in value.items():
        if name not in followers:
            raise unknown_name("movable joint", name, list(followers), f"{where}: resistance")
        at = f"{where}: resistance of {name!r}"
        if followers[name]:
            leader = followers[name]
            raise SceneError(f"{at}: it follows {leader!r}; give the resistance of {leader!r}")
        if not isinstance(members, dict):
            raise SceneError(f"{at} must be a JSON object")
        for key in members:
            if key not in _KEYS:
                raise unknown_name("key", key, _KEYS, at)
        try:
            found[name] = JointResistance(**members)
        except InputError as error:
            raise SceneError(f"{at}: {str(error).removeprefix('JointResistance.')}") from error
    return found
