"""Inputs and outputs of URDFormer (Chen et al., 2024): its classes, grid and logits."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import NamedTuple

import numpy as np
from jaxtyping import Float, Float32

from momapos.model.records import PartKind

Rectangle = tuple[float, float, float, float]
"""Left, top, right, bottom as fractions of the face."""

IMAGE = 224
"""Edge length of the image [px]."""
SLOTS = 32
"""Part boxes per image; unused ones are zero."""
STEPS = 13
"""Marks of the grid over the front, from 0/12 to 12/12 of its side."""
PARTS = (
    "none", "drawer", "doorL", "doorR", "handle", "knob", "washer_door", "doorD", "oven_door",
)  # fmt: skip
"""Part classes, in the order of the output."""
BASES = ("none", "cabinet", "oven", "dishwasher", "washer", "fridge", "oven_fan", "shelf")
"""Object classes; a microwave is not among them."""
KINDS: Mapping[str, PartKind] = {
    "drawer": "drawer",
    "doorL": "door_left",
    "doorR": "door_right",
    "washer_door": "door_left",
    "doorD": "door_down",
    "oven_door": "door_down",
    "doorU": "door_up",
}
"""How parts of a class open. `doorU` is in the authors' files, but not in the network's output."""
HANDLES = ("handle", "knob")
"""Classes of handles; all other classes have no counterpart here."""


class Logits(NamedTuple):
    """The network's output for one image."""

    start: Float[np.ndarray, "slots 3 steps"]
    """Corner of each part along depth, width and height."""
    end: Float[np.ndarray, "slots 3 steps"]
    """The opposite corner."""
    part: Float[np.ndarray, "slots classes"]
    parent: Float[np.ndarray, "slots parents relations"]
    """The base first, then every slot."""
    base: Float[np.ndarray, " bases"]


Network = Callable[[Float32[np.ndarray, "3 h w"], Float32[np.ndarray, "slots 4"]], Logits]
"""Maps a prepared image and boxes (top, left, height, width), zero in unused slots, to logits."""


def around(center: tuple[float, float], size: tuple[float, float], within: Rectangle) -> Rectangle:
    """Return a rectangle with a center and size (width, height), clipped to another one."""
    (x, y), (width, height) = center, size
    return (
        max(x - width / 2, within[0]),
        max(y - height / 2, within[1]),
        min(x + width / 2, within[2]),
        min(y + height / 2, within[3]),
    )
