"""Sliders that move the joints of an object by hand."""

from __future__ import annotations

import math
from dataclasses import dataclass

from momapos.model.scene import Scene

from .how_far import UNLIMITED

SLIDER_RESOLUTION = 1e-4
"""Joint values that differ by less are equal: sliders have no more digits [rad] or [m]."""
SLIDER_STEP = {"deg": 1.0, "m": 0.01}
"""Largest step of a slider; it is a twentieth of the range where that is less."""


@dataclass(frozen=True)
class JointRange:
    """A joint of the object with a slider."""

    name: str
    low: float
    high: float
    """[rad] or [m]"""
    value: float
    turns: bool

    @property
    def unit(self) -> str:
        """The unit of the slider."""
        return "deg" if self.turns else "m"

    def to_slider(self, value: float) -> float:
        """Convert a joint value to the unit of the slider [deg] or [m]."""
        return math.degrees(value) if self.turns else value

    def from_slider(self, shown: float) -> float:
        """Convert a slider value to a joint value within the limits [rad] or [m]."""
        value = math.radians(shown) if self.turns else shown
        return min(max(value, self.low), self.high)


def joint_ranges(scene: Scene, name: str) -> tuple[JointRange, ...]:
    """Return the joints of an object that the user may move; none where there is no such object."""
    found = []
    for item in (one for one in scene.objects if one.name == name):
        values = item.values()
        for joint in item.model.joints.values():
            limit = UNLIMITED[joint.kind]
            low, high = max(joint.lower, -limit), min(joint.upper, limit)
            if joint.mimic is None and high - low > 1e-6:
                value = min(max(values[joint.name], low), high)
                turns = joint.kind != "prismatic"
                found.append(JointRange(joint.name, low, high, value, turns))
    return tuple(found)
