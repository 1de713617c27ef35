"""Record of what a motion demands of the robot."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from momapos.core import compare_by_content

MAX_EFFORT_SHARE = 0.9
"""Share of an effort limit that a state may need at rest [-]; the rest is for accelerations. In
simulation, a torso that needs 0.92 of its limit for its own weight does not follow its motion."""

MIN_STABILITY = 0.02
"""Least distance from tipping over at rest [m]. In simulation, the accelerations of a UR5e on a
narrow base of 117 kg move the zero moment point by up to 1.6 cm from where it is at rest."""


MOVING_PULL = 4.0
"""What a part pulls in addition while the base moves [N]: wheels slip by 3 %, and a hand that
yields with 400 Ns/m bears that until it has. In simulation, a microwave's door that resists with
7 N pulls a Stretch with up to 11 N, more beyond its resistance than six other parts."""


@compare_by_content
@dataclass(frozen=True, eq=False)
class MotionLoads:
    """The worst loads of a motion, at rest in each of its states."""

    efforts: Mapping[str, float] = field(default_factory=dict)
    """Share of each joint's effort limit, by joint [-]; joints without a limit are missing."""
    stability: float | None = None
    """Distance from the zero moment point to the nearest edge of the area that the wheels stand on
    [m]; None if masses or wheels are unknown."""
    payload: float | None = None
    """Mass of the object in the hand [kg]; None if the task moves a joint."""
    notes: tuple[str, ...] = ()
    """What the robot's files leave open, one line each."""

    @property
    def worst(self) -> tuple[str, float] | None:
        """Return the joint with the largest share, and its share; None if no limit is known."""
        return max(self.efforts.items(), key=lambda item: item[1], default=None)

    def __str__(self) -> str:
        said = []
        if self.payload is not None:
            said.append(f"{self.payload:.3g} kg in the hand")
        if self.worst is not None:
            joint, share = self.worst
            said.append(f"{joint} needs {100 * share:.0f} % of its effort limit")
        if self.stability is not None:
            said.append(f"{100 * self.stability:.0f} cm from tipping over")
        return "; ".join([*said, *self.notes])
