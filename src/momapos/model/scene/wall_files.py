"""Walls in scene files: along the floor's edges, or by segments."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, SceneError

from .floor_areas import read_numbers
from .walls import WALL_HEIGHT, WALL_THICKNESS, Wall, check_crossing, wall_name, walls_around

if TYPE_CHECKING:
    from jaxtyping import Float

ALONG_FLOOR = "floor"
MAX_WALLS = 1_000


def read_walls(value: Any, floor: Float[np.ndarray, "k 2"] | None, where: str) -> tuple[Wall, ...]:
    """Read the walls of a scene file.

    Args:
        value: "floor", or a list of {"from": [x, y], "to": [x, y]} that may also give "height" and
            "thickness" [m]; None for no walls.
        floor: Outline of the floor [m].
        where: Start of messages.

    Raises:
        SceneError: A wall is invalid, two walls cross, or there is no floor to follow.
    """
    if value is None:
        return ()
    if value == ALONG_FLOOR:
        if floor is None:
            raise SceneError(
                f'{where}: "{ALONG_FLOOR}" needs the outline of the floor; add "floor": '
                "[[x, y], ...], or list the walls"
            )
        return _named(where, walls_around, floor)
    if not isinstance(value, list) or len(value) > MAX_WALLS:
        raise SceneError(
            f'{where} must be "{ALONG_FLOOR}" or a list of at most {MAX_WALLS} walls '
            '{"from": [x, y], "to": [x, y]}'
        )
    walls = tuple(_wall(item, f"{where}: {wall_name(i)}") for i, item in enumerate(value))
    check_crossing(walls, where)
    return walls


def _wall(item: Any, where: str) -> Wall:
    if not isinstance(item, dict):
        raise SceneError(f'{where} must be {{"from": [x, y], "to": [x, y]}}')
    (x, y), (u, v) = (
        read_numbers(item.get(k), 2, f"{where}: {k}").tolist() for k in ("from", "to")
    )
    sizes = [
        read_numbers([item.get(key, default)], 1, f"{where}: {key}").tolist()[0]
        for key, default in (("height", WALL_HEIGHT), ("thickness", WALL_THICKNESS))
    ]
    return _named(where, Wall, (x, y), (u, v), *sizes)


def _named(where: str, make: Any, *arguments: Any) -> Any:
    """Make walls; the message of an error starts with `where`."""
    try:
        return make(*arguments)
    except InputError as error:
        raise SceneError(f"{where}: {error}".replace("Wall.", "")) from error


def walls_to_json(walls: Sequence[Wall], floor: Float[np.ndarray, "k 2"] | None) -> Any:
    """Return walls as a scene file has them."""
    if floor is not None and tuple(walls) == walls_around(floor):
        return ALONG_FLOOR
    return [
        {"from": list(w.start), "to": list(w.end), "height": w.height, "thickness": w.thickness}
        for w in walls
    ]
