"""Notes on an answer: how far the hand is open, and where the floor ends the motion."""

from __future__ import annotations

import math

from momapos.model.records import PlacementPlan
from momapos.verification import meets_floor_at

from .task_setup import PreparedTask

LOOK_AHEAD = 10
"""Degrees or centimeters beyond the end in which the floor is looked for [-]."""


def notes_on(plan: PlacementPlan, prepared: PreparedTask) -> tuple[str, ...]:
    """Return what the user should know about a plan beyond its motion.

    Args:
        plan: The plan.
        prepared: Its scene, robot and task.
    """
    if plan.motion is None or plan.base_pose is None:
        return ()
    outside = prepared.verifier.outside_note(plan.base_pose, plan.motion)
    notes = (_hand_note(prepared), _floor_note(plan, prepared), outside)
    return tuple(note for note in notes if note)


def _hand_note(prepared: PreparedTask) -> str:
    """Return how far the hand opens, if not fully."""
    robot = prepared.robot
    if robot.fully_open is None:
        return ""
    when = "as it lets go" if prepared.task.verb == "place" else "before the robot drives"
    return (
        f"the hand opens to {100 * robot.opening:.1f} cm {when}, not to "
        f"{100 * robot.fully_open.opening:.1f} cm: a fully open hand has no room"
    )


def _floor_note(plan: PlacementPlan, prepared: PreparedTask) -> str:
    """Return at which value the part meets the floor, if that is why it opens no farther."""
    task = plan.task
    if task.joint is None or task.to is None or task.verb != "open":
        return ""
    target = prepared.scene.object(task.object)
    joint, start = target.joint(task.joint), target.values()[task.joint]
    turns = joint.kind != "prismatic"
    unit = math.radians(1.0) if turns else 0.01
    beyond = task.to + math.copysign(LOOK_AHEAD * unit, task.to - start)
    contact = meets_floor_at(target, joint.name, min(max(beyond, joint.lower), joint.upper))
    if contact is None or abs(contact - task.to) > unit:
        return ""
    value = f"{math.degrees(contact):.0f} deg" if turns else f"{100 * contact:.0f} cm"
    return f"{task.object}/{joint.child} meets the floor at {value}, so it opens no farther"
