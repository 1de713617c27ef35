"""Protocols of stages that have several implementations."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Protocol, TypeAlias

import numpy as np

from .scans import Cloud, FaceImage, Front, ImageDetection, Instance

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8

TravelCost: TypeAlias = "Callable[[Float[np.ndarray, 'n k']], Float[np.ndarray, ' n']]"
"""Returns the driving length from the start to positions x, y [m] or base poses with the yaw [rad]:
[m], infinite if unreachable."""


class ReachScorer(Protocol):
    """Scores how well an arm reaches tool poses."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the smallest score over the waypoints for each base pose and grasp, in [0, 1]."""
        ...


class InverseKinematics(Protocol):
    """Solves for the states of an arm with its tool at given poses."""

    def __call__(self, Ts_base_tool: Float[np.ndarray, "m 4 4"], /) -> Float[np.ndarray, "m b n"]:
        """Return up to b states of the n arm joints for each tool pose in the base frame.

        Rows without a state are NaN. Joints are ordered as `Robot.chain.names` [rad] or [m]. States
        beyond the joints' limits are not used.
        """
        ...


class GraspSource(Protocol):
    """Proposes grasps of an object or of a part."""

    def __call__(self, name: str, joint: str | None, /) -> Float[np.ndarray, "g 4 4"]:
        """Return poses of the tool link at which an open hand is about to close.

        They are in the frame of the link that the task moves: the child of the joint, or the root
        link of a rigid object. Shape (0, 4, 4) if there are none.

        Args:
            name: The object.
            joint: Its joint; None for a rigid object.
        """
        ...


class Segmenter(Protocol):
    """Segments a cloud (z up) into objects; the remaining points are the room or noise."""

    def __call__(self, cloud: Cloud) -> list[Instance]: ...


class Detector(Protocol):
    """Detects objects in one upright color image."""

    @property
    def labels(self) -> frozenset[str]:
        """Return all labels it can assign; labels that it does not assign are evidence, too."""
        ...

    def __call__(self, color: UInt8[np.ndarray, "h w 3"]) -> list[ImageDetection]: ...


class ArticulationPredictor(Protocol):
    """Detects doors, drawers and their handles on a face of an object."""

    def __call__(self, face: FaceImage, label: str) -> Front: ...
