"""The seams between stages, where there is more than one real implementation."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from .scans import Cloud, FaceImage, Front, ImageDetection, Instance

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

TravelCost: TypeAlias = "Callable[[Float[np.ndarray, 'n 2']], Float[np.ndarray, ' n']]"
"""Driving length from the start to floor positions [m], infinite where there is no way."""


class ReachScorer(Protocol):
    """Says how well an arm reaches tool poses."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Smallest score over the waypoints, for each base pose and grasp, in [0, 1]."""
        ...


class Segmenter(Protocol):
    """Divides a cloud, z up, into things; what is in none of them is room or noise."""

    def __call__(self, cloud: Cloud) -> list[Instance]: ...


class Detector(Protocol):
    """Finds things in one color image, which was taken upright."""

    @property
    def labels(self) -> frozenset[str]:
        """All labels that it can give; what it never says of them is evidence too."""
        ...

    def __call__(self, color: UInt8[np.ndarray, "h w 3"]) -> list[ImageDetection]: ...


class ArticulationPredictor(Protocol):
    """Finds doors, drawers and their handles on a face of an object."""

    def __call__(self, face: FaceImage, label: str) -> Front: ...
