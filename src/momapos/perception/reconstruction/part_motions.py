"""Compute the joints that a part of a front may have: hinges at its four edges, and a slide."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

from momapos.model.records import FaceImage, Hypothesis, PartKind
from momapos.model.scene.library import JointMotion, Vec, vec

from .alignment import MAX_HEIGHT_MAP, front_of
from .height_maps import Area
from .model_config import MAX_PASSED, PART_GAP, ModelConfig

STRIP = 0.03
"""Width of the strip next to a hinge in which the height map is read [m]."""
MIN_PROBABILITY = 0.005
"""Less probable kinds are not hypotheses [-]."""
Neighbors = tuple[float | None, float | None]
"""Protrusion of an object's neighbors beyond its face, left and right [m]; None: no neighbor."""


@dataclass(frozen=True, eq=False)
class Motions:
    """The motions that one part would have as any kind of part."""

    area: Area
    """Area on the face, up to the middle of its gaps."""
    out: float
    """Protrusion of its front beyond the face [m]."""
    front: float
    """y coordinate of its front, in the frame of the piece [m]."""
    thickness: float
    """Thickness of its leaf [m]."""
    face: FaceImage
    config: ModelConfig
    travel: float
    """Range of its slide [m]."""
    neighbors: Neighbors
    """Protrusion of the object's neighbors beyond the face, left and right as seen from the front
    [m]; None without a neighbor."""
    below: bool = False
    """Whether another part adjoins from below."""

    def is_free(self, kind: PartKind) -> bool:
        """Check whether the hinge of a kind of part has no neighbor."""
        if kind == "door_down":
            return not self.below  # a plinth lies farther back
        return self._at_rim(kind) and not self._is_tight(kind)

    def _at_rim(self, kind: PartKind) -> bool:
        at_rim = {
            "door_left": self.area.left <= 0.0,
            "door_right": self.area.right >= self.face.width,
            "door_up": self.area.top >= self.face.height,
        }
        return bool(at_rim.get(kind, False))

    def _is_tight(self, kind: PartKind) -> bool:
        """Check whether another object is next to the hinge of a kind of part."""
        return self._at_rim(kind) and self._neighbor(kind) is not None

    def _neighbor(self, kind: PartKind) -> float | None:
        return {"door_left": self.neighbors[0], "door_right": self.neighbors[1]}.get(kind)

    def depth(self, kind: PartKind) -> float:
        """Return how far behind the front the hinge of a kind of part lies [m]."""
        config, depth = self.config, self.config.hinge_depth
        if self._is_tight(kind):
            past = (self._neighbor(kind) or 0.0) - self.out
            depth = config.tight_hinge_depth if past < MAX_PASSED * self.area.width else 0.0
        return min(depth, self.thickness)

    def of(self, kind: PartKind) -> JointMotion:
        """Return the joint of a kind of part; all open with a positive value."""
        if kind == "drawer":
            return JointMotion("prismatic", (0.0, 0.0, 0.0), (0.0, -1.0, 0.0), self.travel)
        gap = PART_GAP
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
        """Return the front of a kind of part, with gaps around it.

        The rear edge of a door swings out beyond its width, so the gap opposite the hinge is wider.
        The leaf starts at its axis, so that it does not swing into what is behind. With a neighbor
        it starts as far from the axis as the axis lies behind the neighbor's front, so that it
        stays within its width until it has passed the neighbor.
        """
        area = self.area.within(self.area, PART_GAP)
        assert area is not None
        if kind == "drawer":
            return area
        width = area.width if kind in ("door_left", "door_right") else area.height
        swing = (self.thickness - self.depth(kind)) ** 2 / (2 * width)
        clear = self.is_free(kind) and kind != "door_down"  # a plinth or the floor is below
        behind = 0.0 if clear else self.depth(kind) + self._surroundings(kind)
        cut = min(behind, width / 4)
        return {
            "door_left": replace(area, left=area.left + cut, right=area.right - swing),
            "door_right": replace(area, left=area.left + swing, right=area.right - cut),
            "door_down": replace(area, bottom=area.bottom + cut, top=area.top - swing),
            "door_up": replace(area, bottom=area.bottom + swing, top=area.top - cut),
        }[kind]

    def recess(self, kind: PartKind) -> tuple[Area | None, Area]:
        """Split a leaf into the recessed strip at its hinge, if there is one, and the rest.

        At 90 degrees, the front of a leaf is as far to the side of its axis as it is in front of
        it when closed. So the strip that passes a protruding neighbor is set back by the depth of
        the axis.
        """
        leaf, depth = self.leaf(kind), self.depth(kind)
        out = (self._neighbor(kind) or 0.0) - self.out if self._is_tight(kind) else 0.0
        if out <= 0.0 or depth <= 0.0:
            return None, leaf
        past = depth + out + PART_GAP
        if kind == "door_left":
            edge = self.area.left + past
            return replace(leaf, right=edge), replace(leaf, left=edge)
        edge = self.area.right - past
        return replace(leaf, left=edge), replace(leaf, right=edge)

    def _surroundings(self, kind: PartKind) -> float:
        """Return how far the area next to a hinge protrudes beyond the part's front [m]."""
        area, face = self.area, self.face
        strip = {
            "door_left": replace(area, left=area.left - STRIP, right=area.left),
            "door_right": replace(area, left=area.right, right=area.right + STRIP),
            "door_down": replace(area, bottom=area.bottom - STRIP, top=area.bottom),
            "door_up": replace(area, bottom=area.top, top=area.top + STRIP),
        }[kind].within(Area(0.0, 0.0, face.width, face.height))
        if strip is None:
            return 0.0
        out = front_of(face, strip, MAX_HEIGHT_MAP)
        return max(0.0, out - self.out) + (PART_GAP if out > self.out else 0.0)

    def hypotheses(self, odds: Sequence[tuple[PartKind, float]]) -> tuple[Hypothesis, ...]:
        """Return all probable motions of the part, the most probable first.

        Args:
            odds: Kinds with their probabilities, the most probable first.
        """
        kept = [(kind, share) for kind, share in odds if share >= MIN_PROBABILITY]
        total = sum(share for _, share in kept)
        found = []
        for kind, share in kept:
            motion = self.of(kind)
            found.append(Hypothesis(kind, share / total, motion.pivot, motion.axis, motion.upper))
        return tuple(found)
