"""What a URDF holds: links with their shapes, and the joints between them."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

if TYPE_CHECKING:
    from jaxtyping import Float

JointKind = Literal["revolute", "continuous", "prismatic", "fixed"]


@dataclass(frozen=True)
class Geometry:
    """One shape of a link."""

    kind: Literal["box", "cylinder", "sphere", "mesh"]
    size: tuple[float, ...]
    """box: edges; cylinder: radius, length; sphere: radius [m]; mesh: scale per axis [-]."""
    T_link_geometry: Float[np.ndarray, "4 4"]
    """Pose in the link frame; cylinders lie along z."""
    name: str = ""
    """Name of the `collision` or `visual` element, often empty."""
    mesh: Path | None = None


@dataclass(frozen=True)
class Link:
    """A rigid body."""

    name: str
    collisions: tuple[Geometry, ...]
    visuals: tuple[Geometry, ...]


@dataclass(frozen=True)
class Mimic:
    """How a joint follows another: its value is ratio times the other's, plus an offset."""

    joint: str
    """The joint that it follows, which follows none."""
    ratio: float = 1.0
    offset: float = 0.0
    """[rad] or [m]"""

    def at(self, value: float) -> float:
        """Where the joint is when the one that it follows is at a value."""
        return self.ratio * value + self.offset


@dataclass(frozen=True)
class Joint:
    """A joint between two links."""

    name: str
    kind: JointKind
    parent: str
    child: str
    T_parent_joint: Float[np.ndarray, "4 4"]
    axis: Float[np.ndarray, "3"]
    """Unit axis in the joint frame."""
    lower: float
    upper: float
    """Limits [rad] or [m]; infinite for continuous joints."""
    velocity: float
    """Speed limit [rad/s] or [m/s]; infinite when the file gives none."""
    mimic: Mimic | None = None
    """What it follows; None where it moves by itself."""
    effort: float = math.inf
    """Greatest torque [Nm] or force [N]; infinite when the file gives none."""

    @property
    def movable(self) -> bool:
        """Whether the joint moves at all."""
        return self.kind != "fixed"


@dataclass(frozen=True)
class Urdf:
    """A tree of links and joints, parents before children."""

    name: str
    path: Path | None
    root: str
    links: dict[str, Link]
    joints: tuple[Joint, ...]
    scale: float = 1.0
    """What all lengths of the file were multiplied by [-]."""
    rigid: tuple[str, ...] = ()
    """Joints that the file calls planar or floating and that carry the whole model: taken as
    fixed."""
