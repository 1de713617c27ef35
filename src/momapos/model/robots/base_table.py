"""The base's outline on the floor and its least turning radius, from a robot file."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Cache, RobotError
from momapos.model.urdf import once

from .file_values import TomlTable

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_FOOTPRINT_CORNERS = 1_000
"""Maximum number of footprint corners [-]."""
MAX_EXTENT = 5.0
"""Maximum distance of a corner from the base's origin along x and y [m]."""


def read_footprint(base: TomlTable, path: Path, cache: Cache | None) -> Float[np.ndarray, "k 2"]:
    """Return the convex outline, counterclockwise [m].

    Args:
        base: The file's table of the base.
        path: The file, for errors.
        cache: Keeps the outline; None to compute it.

    Raises:
        RobotError: The outline has no area, too many corners or corners too far away.
    """
    points = base.matrix("footprint", 2)
    return once(cache, "footprint", (points,), lambda: _outline(points, path))


def read_turning_radius(base: TomlTable) -> float:
    """Return the least turning radius, which only a car-like base has.

    Raises:
        RobotError: A car-like base lacks one, or another one has it.
    """
    key = "min_turning_radius"
    if base.data.get("drive") != "car":
        if key in base.data:
            raise RobotError(f'{base.path}: base.{key} is for base.drive = "car" only; remove it')
        return 0.0
    if key not in base.data:
        raise RobotError(
            f"{base.path}: base.{key} is missing; a car-like base needs the least radius on which "
            "base_link, at the middle of its fixed axle, can turn [m]"
        )
    return base.positive(key, 0.0)


def _outline(points: Float[np.ndarray, "n 2"], path: Path) -> Float[np.ndarray, "k 2"]:
    from scipy.spatial import ConvexHull, QhullError

    if len(points) > MAX_FOOTPRINT_CORNERS or np.abs(points).max(initial=0.0) > MAX_EXTENT:
        raise RobotError(
            f"{path}: base.footprint must have at most {MAX_FOOTPRINT_CORNERS} corners, within "
            f"{MAX_EXTENT:g} m of the origin"
        )
    try:
        return points[ConvexHull(points).vertices]
    except (QhullError, ValueError) as error:
        raise RobotError(
            f"{path}: base.footprint must enclose an area, as [[x, y], ...]"
        ) from error
