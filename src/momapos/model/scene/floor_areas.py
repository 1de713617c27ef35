"""The floor of a room, its named areas, and the start on it."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import SceneError, is_name, read_text_bounded, unknown_name
from momapos.core.geometry import signed_area
from momapos.model.records import Outline

from .scene import Scene

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_AREAS = 1_000
MAX_CORNERS = 1_000
"""Maximum number of corners of an area or a floor [-]."""
MAX_DISTANCE = 1e4
"""Maximum distance from the world's origin [m]."""
_MAX_BYTES = 1_000_000


def read_areas(value: Any, where: str) -> dict[str, Outline]:
    """Read the areas of a scene file by name.

    Raises:
        SceneError: They are not {name: [[x, y], ...]}; the message starts with `where`.
    """
    if not isinstance(value, dict) or len(value) > MAX_AREAS:
        raise SceneError(f"{where} must be {{name: [[x, y], ...]}} with at most {MAX_AREAS} areas")
    for name in value:
        if not is_name(name):
            raise SceneError(f"{where}: {name!r:.80} must be printable, 1 to 1000 characters long")
    return {name: read_outline(corners, f"{where}: {name!r}") for name, corners in value.items()}


def read_outline(value: Any, where: str) -> Outline:
    """Read the corners of an area or a floor.

    Raises:
        SceneError: The outline has too few or too many corners, or encloses no area.
    """
    if not isinstance(value, list) or not 3 <= len(value) <= MAX_CORNERS:
        raise SceneError(f"{where} must be an outline of 3 to {MAX_CORNERS} points [x, y]")
    points = np.array([read_numbers(p, 2, f"{where} point {i}") for i, p in enumerate(value)])
    if np.abs(points).max() > MAX_DISTANCE:
        raise SceneError(f"{where} must be within 10 km of the origin")
    if abs(signed_area(points)) < 1e-6:
        raise SceneError(f"{where} encloses no area")
    return tuple((float(x), float(y)) for x, y in points)


def read_floor(value: Any, where: str) -> Float[np.ndarray, "k 2"] | None:
    """Read the outline of the floor; None if there is none.

    Raises:
        SceneError: It is no outline; the message starts with `where`.
    """
    return None if value is None else np.array(read_outline(value, where))


def read_start(value: Any, where: str) -> Float[np.ndarray, "3"] | None:
    """Read the initial pose of the robot: x [m], y [m], yaw [rad]; None if there is none.

    Raises:
        SceneError: It is no pose; the message starts with `where`.
    """
    if value is None:
        return None
    if not isinstance(value, dict) or not {"x", "y", "yaw"} <= set(value):
        raise SceneError(f"{where} must be {{'x': ..., 'y': ..., 'yaw': ...}}")
    start = read_numbers([value[k] for k in ("x", "y", "yaw")], 3, where)
    if np.abs(start).max() > MAX_DISTANCE:
        raise SceneError(f"{where} is more than 10 km away")
    return start


def read_numbers(value: object, count: int, where: str) -> Float[np.ndarray, " count"]:
    """Read a list of finite numbers.

    Raises:
        SceneError: The value is not a list of `count` finite numbers.
    """
    values = value if isinstance(value, list) else []
    if len(values) != count or not all(
        isinstance(v, int | float) and not isinstance(v, bool) for v in values
    ):
        raise SceneError(f"{where} must be {f'{count} numbers' if count > 1 else 'a number'}")
    try:
        array = np.array(values, float)
    except OverflowError:
        array = np.array([math.inf])
    if not np.isfinite(array).all():
        raise SceneError(f"{where} must be finite")
    return array


def area_name(area: Outline, scene: Scene) -> str:
    """Return an area in words: by its name in the scene, or else by where it is."""
    names = [name for name, one in scene.areas.items() if np.array_equal(one, area)]
    x, y = np.mean(area, axis=0).tolist()
    return f"area {names[0]!r}" if names else f"area around ({x:.2f}, {y:.2f})"


def find_area(words: str, scene: Scene, where: str) -> Outline:
    """Find an area by its name in the scene, a JSON file, or its corners.

    Args:
        words: For example "kitchen", "area.json" or "0,0 2,0 2,1".
        scene: The room.
        where: Name of the argument, for messages.

    Raises:
        SceneError: The words are none of these.
    """
    if words in scene.areas:
        return scene.areas[words]
    if words.endswith(".json"):
        text = read_text_bounded(Path(words), _MAX_BYTES, error=SceneError)
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SceneError(f"{where} {words}: damaged JSON ({error})") from error
        return read_outline(value, f"{where} {words}")
    pairs = [pair.split(",") for pair in words.split()]
    try:
        corners = [[float(v) for v in pair] for pair in pairs]
    except ValueError:
        if scene.areas:
            raise unknown_name("area", words, scene.areas, f"scene {scene.name}") from None
        raise SceneError(
            f"{where} {words!r}: the scene names no areas; give the corners, such as "
            '"0,0 2,0 2,1", or a JSON file with corners'
        ) from None
    return read_outline(corners, f"{where} {words!r}")
