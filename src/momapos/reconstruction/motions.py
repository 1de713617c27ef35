"""How a part of a front may move: hinges at its four edges, and a slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING

from momapos.reconstruction.height_maps import Area
from momapos.scene.library.furniture import Box, JointMotion, Vec
from momapos.types import FaceImage, Hypothesis, PartKind

if TYPE_CHECKING:
    from momapos.reconstruction.model import ModelConfig

LEAST = 0.005
"""What is less probable is no hypothesis [-]."""


@dataclass(frozen=True, eq=False)
class Motions:
    """One part, and how it would move as any kind of part."""

    area: Area
    """On the face, to the middle of its gaps."""
    panel: Box
    """Its leaf, in the frame of the piece."""
    face: FaceImage
    config: ModelConfig
    travel: float
    """How far it would slide [m]."""
    free: tuple[bool, bool]
    """Whether nothing stands beside the object, left and right as seen from the front."""

    def of(self, kind: PartKind) -> JointMotion:
        """The joint of a kind of part; all open with a positive value."""
        if kind == "drawer":
            return JointMotion("prismatic", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), self.travel)
        (left, front, bottom), (right, rear, top) = self.panel.low, self.panel.high
        at_rim = {
            "door_left": self.area.left <= 0.0,
            "door_right": self.area.right >= self.face.width,
            "door_down": self.area.bottom <= 0.0,
            "door_up": self.area.top >= self.face.height,
        }
        depth = self.config.hinge_depth
        if (kind == "door_left" and self.free[0]) or (kind == "door_right" and self.free[1]):
            depth = max(depth, self.config.free_hinge_depth)
        y = min(front + depth, rear) if at_rim[kind] else front
        pivots: dict[str, tuple[Vec, Vec]] = {
            "door_left": ((left, y, 0.0), (0.0, 0.0, -1.0)),
            "door_right": ((right, y, 0.0), (0.0, 0.0, 1.0)),
            "door_down": ((0.0, y, bottom), (1.0, 0.0, 0.0)),
            "door_up": ((0.0, y, top), (-1.0, 0.0, 0.0)),
        }
        return JointMotion("revolute", *pivots[kind], self.config.turn)

    def hypotheses(self, odds: Sequence[tuple[PartKind, float]]) -> tuple[Hypothesis, ...]:
        """All probable ways in which the part may move, the likeliest first.

        Args:
            odds: Kinds with their probabilities, the likeliest first.
        """
        kept = [(kind, share) for kind, share in odds if share >= LEAST]
        total = sum(share for _, share in kept)
        found = []
        for kind, share in kept:
            motion = self.of(kind)
            found.append(Hypothesis(kind, share / total, motion.pivot, motion.axis, motion.upper))
        return tuple(found)
