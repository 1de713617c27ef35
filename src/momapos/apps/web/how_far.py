"""How far a part is opened or closed: a slider over the range of its joint."""

from __future__ import annotations

import math
from dataclasses import dataclass

from momapos.core import TaskError, parse_quantity
from momapos.model.scene import Scene
from momapos.planning.grasps import make_task

UNLIMITED = {"revolute": math.pi, "continuous": math.pi, "prismatic": 1.0}
"""Joints without limits get sliders from minus to plus this [rad] or [m]."""
STEPS = {"deg": 1.0, "cm": 0.5}
"""Steps of the slider."""


@dataclass(frozen=True)
class HowFar:
    """Values that a task may move a part to."""

    unit: str
    """deg or cm"""
    low: float
    high: float
    usual: float
    """The value of the verb; all in the unit."""

    @property
    def step(self) -> float:
        """Step of the slider; a twentieth of the range where that is less."""
        return min(STEPS[self.unit], (self.high - self.low) / 20)

    def clipped(self, value: float) -> float:
        """Return the nearest value of the slider."""
        return min(max(round(value, 2), self.low), self.high)

    def text(self, value: float) -> str:
        """Return a value as a user of the command line types it; "" for the usual one."""
        return "" if abs(value - self.usual) < self.step / 2 else f"{value:g}{self.unit}"

    def value(self, text: str) -> float:
        """Return the slider's value for a text.

        Raises:
            TaskError: The text is no quantity.
        """
        if not text or text == "max":
            return self.usual
        quantity = parse_quantity(text).value
        return self.clipped(math.degrees(quantity) if self.unit == "deg" else 100 * quantity)


def how_far(scene: Scene, verb: str, target: str) -> HowFar | None:
    """Return the values for a part; None where the task moves a whole object.

    Args:
        scene: The room.
        verb: The verb of the task.
        target: The object and joint as "object/joint".
    """
    name, _, joint_name = target.partition("/")
    if verb not in ("open", "close") or not joint_name:
        return None
    item = scene.object(name)
    joint = item.joint(joint_name)
    if joint.mimic is not None:  # a task moves the leader
        joint = item.joint(joint.mimic.joint)
    unit, factor = ("cm", 100.0) if joint.kind == "prismatic" else ("deg", math.degrees(1.0))
    most = UNLIMITED[joint.kind]
    low = math.ceil(10 * factor * max(joint.lower, -most) - 1e-6) / 10
    high = math.floor(10 * factor * min(joint.upper, most) + 1e-6) / 10
    if high - low < 1e-3:
        return None
    try:
        goal = make_task(scene, verb, name, joint_name).to
    except TaskError:  # the part is there already; the answer says so
        goal = item.values()[joint.name]
    usual = min(max(round(factor * (goal or 0.0), 2), low), high)
    return HowFar(unit, low, high, usual)
