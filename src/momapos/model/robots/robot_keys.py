"""Find keys of robot files that the reader does not know, at every depth."""

from __future__ import annotations

import difflib
from collections.abc import Iterator, Mapping
from typing import Any, TypeAlias

EACH = "*"
"""Stands for names that the user chooses, such as joints."""
MAX_IGNORED_KEYS = 20
"""Unknown keys of a file that are reported one by one [-]."""
Keys: TypeAlias = "Mapping[str, Keys] | None"
"""Known keys of a table; None for values without keys."""

_ARM: dict[str, Keys] = {
    **dict.fromkeys(("tool_link", "arm_joints", "gripper_links", "home", "reach", "payload")),
    "tool": dict.fromkeys(("approach_axis", "closing_axis", "opening", "grips", "force")),
}
ROBOT_KEYS: Mapping[str, Keys] = {
    **dict.fromkeys(("version", "name", "urdf", "srdf", "base_link", "visual_hulls")),
    "base": dict.fromkeys((
        "footprint", "drive", "min_turning_radius", "max_speed", "max_yaw_rate",
        "max_acceleration", "max_yaw_acceleration",
    )),
    **_ARM,
    "arms": {EACH: _ARM},
    "rest": {EACH: None},
    "frames": {EACH: dict.fromkeys(("parent", "xyz", "rpy"))},
    "mount": dict.fromkeys(("box", "urdf", "link", "xyz", "rpy")),
    "packages": {EACH: None},
    "coupled": {EACH: dict.fromkeys(("joint", "ratio", "offset"))},
    "limits": {EACH: dict.fromkeys(("lower", "upper", "velocity", "acceleration"))},
}  # fmt: skip
"""Keys of a robot file."""


def ignored_keys(data: Mapping[str, Any], name: str) -> tuple[str, ...]:
    """Return a line for each unknown key of a robot file, and one for those beyond a number.

    Args:
        data: Content of the file.
        name: The file, for the lines.
    """
    found = list(_unknown(data, ROBOT_KEYS, ""))
    lines = [f"{key} of {name} is not known and was ignored{hint}" for key, hint in found]
    if len(lines) > MAX_IGNORED_KEYS:
        rest = f"{len(lines) - MAX_IGNORED_KEYS} more keys of {name} are not known"
        return (*lines[:MAX_IGNORED_KEYS], rest)
    return tuple(lines)


def _unknown(data: object, keys: Keys, prefix: str) -> Iterator[tuple[str, str]]:
    if keys is None or not isinstance(data, Mapping):
        return
    for key, value in data.items():
        if key in keys or EACH in keys:
            yield from _unknown(value, keys.get(key, keys.get(EACH)), f"{prefix}{key}.")
        else:
            near = difflib.get_close_matches(key, keys, n=1)
            yield f"{f'{prefix}{key}'!r:.80}", f"; did you mean {near[0]!r}?" if near else ""
