"""How a part of a front may move: hinges at its four edges, and a slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

from momapos.model.records import FaceImage, Hypothesis, PartKind
from momapos.model.scene.library import JointMotion, Vec, vec

from .alignment import front_of
from .height_maps import Area

if TYPE_CHECKING:
    from .object_model import ModelConfig

STRIP = 0.03
"""So wide is what is looked at beside a hinge [m]."""
LEAST = 0.005
"""What is less probable is no hypothesis [-]."""
Beside = tuple[float | None, float | None]
"""How far the neighbors of an object stand out of its face, left and right [m]; None: nothing."""


@dataclass(frozen=True, eq=False)
class Motions:
    """One part, and how it would move as any kind of part."""

    area: Area
    """On the face, to the middle of its gaps."""
    out: float
    """How far its front stands out of the face [m]."""
    front: float
    """The y coordinate of its front, in the frame of the piece [m]."""
    thickness: float
    """Of its leaf [m]."""
    face: FaceImage
    config: ModelConfig
    travel: float
    """How far it would slide [m]."""
    beside: Beside
    """How far what stands beside the object stands out of the face [m], left and right as seen
    from the front; None where nothing does."""
    below: bool = False
    """Whether another part adjoins from below."""

    def is_free(self, kind: PartKind) -> bool:
        """Whether the hinge of a kind of part has nothing beside it."""
        if kind == "door_down":
            return not self.below  # a plinth lies farther back
        return self._at_rim(kind) and not self._is_tight(kind)

    def _at_rim(self, kind: PartKind) -> bool:
        """Whether the hinge of a kind of part is at the rim of the face."""
        at_rim = {
            "door_left": self.area.left <= 0.0,
            "door_right": self.area.right >= self.face.width,
            "door_up": self.area.top >= self.face.height,
        }
        return at_rim.get(kind, False)

    def _is_tight(self, kind: PartKind) -> bool:
        """Whether another object is beside the hinge of a kind of part."""
        return self._at_rim(kind) and self._neighbor(kind) is not None

    def _neighbor(self, kind: PartKind) -> float | None:
        """How far what stands beside the object at a hinge stands out of the face [m]."""
        return {"door_left": self.beside[0], "door_right": self.beside[1]}.get(kind)

    def depth(self, kind: PartKind) -> float:
        """How far behind the front the hinge of a kind of part lies [m]."""
        config, depth = self.config, self.config.hinge_depth
        if self._is_tight(kind):
            past = (self._neighbor(kind) or 0.0) - self.out
            depth = config.tight_hinge_depth if past < config.passed * self.area.width else 0.0
        return min(depth, self.thickness)

    def of(self, kind: PartKind) -> JointMotion:
        """The joint of a kind of part; all open with a positive value."""
        if kind == "drawer":
            return JointMotion("prismatic", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), self.travel)
        gap = self.config.gap
        x, z = self.face.width / 2, self.face.height / 2
        left, right = self.area.left + gap - x, self.area.right - gap - x
        bottom, top = self.area.bottom + gap - z, self.area.top - gap - z
        y = self.front + self.depth(kind)
        pivots: dict[str, tuple[Vec, Vec]] = {
            "door_left": ((left, y, 0.0), (0.0, 0.0, -1.0)),
            "door_right": ((right, y, 0.0), (0.0, 0.0, 1.0)),
            "door_down": ((0.0, y, bottom), (1.0, 0.0, 0.0)),
            "door_up": ((0.0, y, top), (-1.0, 0.0, 0.0)),
        }
        pivot, axis = pivots[kind]
        return JointMotion("revolute", vec(pivot), axis, self.config.turn)

    def leaf(self, kind: PartKind) -> Area:
        """The front of a kind of part, with gaps around it.

        The rear edge of a door swings out beyond its width, so the gap opposite the hinge is wider.
        The leaf begins at its axis, so that it does not swing into what is behind; where something
        is beside it, as far from the axis as that lies behind what is beside, so that it stays
        within its width until it has passed that.
        """
        area = self.area.within(self.area, self.config.gap)
        assert area is not None
        if kind == "drawer":
            return area
        width = area.width if kind in ("door_left", "door_right") else area.height
        swing = (self.thickness - self.depth(kind)) ** 2 / (2 * width)
        clear = self.is_free(kind) and kind != "door_down"  # below are a plinth or the floor
        behind = 0.0 if clear else self.depth(kind) + self._beside(kind)
        cut = min(behind, width / 4)
        return {
            "door_left": replace(area, left=area.left + cut, right=area.right - swing),
            "door_right": replace(area, left=area.left + swing, right=area.right - cut),
            "door_down": replace(area, bottom=area.bottom + cut, top=area.top - swing),
            "door_up": replace(area, bottom=area.bottom + swing, top=area.top - cut),
        }[kind]

    def recess(self, kind: PartKind) -> tuple[Area | None, Area]:
        """The strip of a leaf at its hinge that lies behind the rest, and that rest.

        At a right angle the front of a leaf is as far beside its axis as that lies behind it, so
        what passes an object that stands out of the face is set back by that depth.
        """
        leaf, depth = self.leaf(kind), self.depth(kind)
        out = (self._neighbor(kind) or 0.0) - self.out if self._is_tight(kind) else 0.0
        if out <= 0.0 or depth <= 0.0:
            return None, leaf
        past = depth + out + self.config.gap
        if kind == "door_left":
            edge = self.area.left + past
            return replace(leaf, right=edge), replace(leaf, left=edge)
        edge = self.area.right - past
        return replace(leaf, left=edge), replace(leaf, right=edge)

    def _beside(self, kind: PartKind) -> float:
        """How far what is beside a hinge stands out of the part's front [m]."""
        area, face, config = self.area, self.face, self.config
        strip = {
            "door_left": replace(area, left=area.left - STRIP, right=area.left),
            "door_right": replace(area, left=area.right, right=area.right + STRIP),
            "door_down": replace(area, bottom=area.bottom - STRIP, top=area.bottom),
            "door_up": replace(area, bottom=area.top, top=area.top + STRIP),
        }[kind].within(Area(0.0, 0.0, face.width, face.height))
        if strip is None:
            return 0.0
        out = front_of(face, strip, config.alignment.most_height_map)
        return max(0.0, out - self.out) + (config.gap if out > self.out else 0.0)

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
