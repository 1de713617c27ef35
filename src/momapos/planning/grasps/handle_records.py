"""Records of handles: where a hand holds or pushes a part."""

from __future__ import annotations

from dataclasses import dataclass
from enum import StrEnum
from typing import TYPE_CHECKING

import numpy as np

from .handle_core import HandleKind
from .handle_shapes import Element

if TYPE_CHECKING:
    from jaxtyping import Float


class HandleSource(StrEnum):
    """How a handle was found; plans contain the words."""

    NAME = "name"
    SHAPE = "shape"
    EDGE = "edge"


@dataclass(frozen=True, eq=False)
class Handle:
    """A handle, edge or face to grasp or push, in the frame of the link that carries it."""

    carrier: str
    """The link that carries it: the joint's child, or that of one of its mimic joints."""
    center: Float[np.ndarray, "3"]
    """Middle of the whole handle [m]."""
    grip: Float[np.ndarray, "3"]
    """Middle of the part that a hand closes on, without fixings [m]."""
    long: Float[np.ndarray, "3"]
    """Unit vector along the handle."""
    out: Float[np.ndarray, "3"]
    """Unit vector from the part toward the hand, perpendicular to `long`."""
    half_length: float
    """Half the length along `long` [m]."""
    thickness: float
    """Size across, which the fingers must span [m]."""
    depth: float
    """Size along `out` of the part that a hand closes on [m]."""
    found: HandleSource
    kind: HandleKind
    name: str
    """Name of its link or shape, or of the panel without a handle."""
    elements: tuple[Element, ...]
    """Elements that the pads may touch."""
    in_pieces: bool = False
    """Whether collision checks use convex pieces of the part's meshes instead of their hulls."""
    whole: bool = False
    """Whether the part is nothing but this handle, as the lever of a tap."""

    @property
    def knob(self) -> bool:
        """Whether this is a knob."""
        return self.kind is HandleKind.KNOB

    @property
    def edge(self) -> bool:
        """Whether this is a free edge."""
        return self.kind is HandleKind.EDGE

    def __str__(self) -> str:
        how = {
            HandleSource.NAME: f"{self.kind} {self.name!r}, by its name",
            HandleSource.SHAPE: f"{self.kind} {self.name!r}, by its shape",
            HandleSource.EDGE: f"the {self.kind} of {self.name!r}, which has no handle",
        }
        return how[self.found]
