"""Parse base poses and offsets on the command line."""

from __future__ import annotations

import math
from typing import get_args

from momapos.core import TaskError, parse_quantity
from momapos.planning import BaseUse


def parse_pose(text: str, name: str) -> list[float]:
    """Parse a base pose X,Y,YAW [m, m, rad], the yaw with a unit if it is not in radians.

    Args:
        text: The pose.
        name: Its name in messages, such as --start.
    """
    parts = text.split(",")
    if len(parts) != 3:
        raise TaskError(f"{name} {text!r} is not X,Y,YAW; write it as 1.5,2.0,90deg")
    x, y, yaw = map(parse_quantity, parts)
    if not yaw.unit and abs(yaw.value) > 2 * math.pi:
        raise TaskError(f"{name} {text!r}: a yaw of {yaw.value:g} rad; did you mean {yaw.text}deg?")
    return [x.length(f"{name}: X"), y.length(f"{name}: Y"), yaw.angle(f"{name}: YAW")]


def parse_base(text: str) -> BaseUse:
    """Parse how --base lets the base serve a task."""
    for use in get_args(BaseUse):
        if text == use:
            return use
    raise TaskError(f"--base {text!r} is none of {', '.join(get_args(BaseUse))}")


def parse_robust(text: str) -> tuple[float, float]:
    """Parse the radius [m] and the turn [rad] of --robust."""
    parts = text.split(",")
    if len(parts) != 2:
        raise TaskError(f"--robust {text!r} is not LENGTH,ANGLE; write it as 0.05m,3deg")
    length, angle = (parse_quantity(part) for part in parts)
    radius, turn = length.length("--robust: length"), angle.angle("--robust: angle")
    if not (0 <= radius < math.inf and 0 <= turn < math.inf):
        raise TaskError(f"--robust must be a length and an angle of at least 0, not {text}")
    return radius, turn
