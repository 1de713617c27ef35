"""Notes on an answer: the hand, the floor, and the guesses about forces on which it depends."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np

from momapos.core.geometry import invert
from momapos.model.records import Hold, JointResistance, Motion, PlacementPlan
from momapos.model.scene import (
    ResistanceConfig,
    SceneObject,
    assumes_springs,
    is_ajar,
    latch_guess,
    loose_joints,
    release_problem,
    resistance_along,
    scene_after,
    stays_in_place,
)
from momapos.planning.grasps import GraspConfig, nearest_shifted, own_poses, shifted_along
from momapos.verification import PlanVerifier, meets_floor_at

from .task_setup import PreparedTask

SPRINGS = "springs are assumed to bear the weight of"
"""Begin of the statement that an answer depends on this guess."""
MIN_LEVER = 1e-3
"""Travel of the hand per unit of a joint below which its pull does not grow [m/rad]."""
ASSUMED, MARGIN = ResistanceConfig(), GraspConfig().grasp_margin
MAX_TILT = 10.0
"""Tilt of a part from which on what rests on it counts as falling: a bottle of 25 x 7 cm tips over
at 16 degrees, and objects slide on smooth shelves from about 11 [deg]."""
TILTED_VALUES = 19
"""Joint values at which that is looked at [-]."""
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
    notes = (
        _hand_note(prepared), _own_note(prepared, plan.motion), _contents_note(plan, prepared),
        _floor_note(plan, prepared),
        _file_note(prepared), _latch_note(prepared), _loose_note(prepared),
        _spring_note(plan, prepared), _release_note(prepared), _press_note(prepared), outside,
    )  # fmt: skip
    return tuple(note for note in notes if note)


def _hand_note(prepared: PreparedTask) -> str:
    """Return how far the hand opens, if not fully."""
    robot = prepared.robot
    if robot.fully_open is None or prepared.task.verb == "press":
        return ""
    when = "as it lets go" if prepared.task.verb == "place" else "before the robot drives"
    return (
        f"the hand opens to {100 * robot.opening:.1f} cm {when}, not to "
        f"{100 * robot.fully_open.opening:.1f} cm: a fully open hand has no room"
    )


def _own_note(prepared: PreparedTask, found: Motion) -> str:
    """Return which of the user's own grasps is taken, and how many can be used, unless all can."""
    robot, task, motion = prepared.robot, prepared.task, prepared.motion
    own = own_poses(robot, task.object, task.joint)
    if not len(own):
        return ""
    target = prepared.scene.object(task.object)
    link = target.model.urdf.root if task.joint is None else target.joint(task.joint).child
    Ts, grasps = target.link_poses()[link] @ own, motion.Ts_world_tool[:, motion.grasp_step]
    # The fingers shift the hand along its closing axis.
    used = int(shifted_along(Ts, grasps, robot.closing_axis).sum())
    away = np.abs(grasps - found.Ts_world_tool[0]).sum((1, 2))
    taken = int(nearest_shifted(grasps[[away.argmin()]], Ts, robot.closing_axis)[0])
    names = getattr(robot.own_grasps, "names", ())
    words = names[taken] if 0 <= taken < len(names) else f"grasp {taken + 1}"
    which = "none of your own grasps is taken" if taken < 0 else f"takes {words} of your own"
    if used == len(own):
        return which
    return (
        f"{used} of {len(own)} grasps of your own can be used; at the others the hand is not free, "
        f"or does not hold {target.name}; {which}"
    )


def _contents_note(plan: PlacementPlan, prepared: PreparedTask) -> str:
    """Return what moves with the part, and whether it would slide or fall off."""
    task, target = plan.task, prepared.scene.object(plan.task.object)
    names = [name for name in sorted(target.model.contents) if "/" not in name]
    if not names or task.joint is None or task.to is None:
        return ""
    several = len(names) > 1
    words = f"{', '.join(names)} {'move' if several else 'moves'} with {task.object}/{task.joint}"
    start = target.values()[task.joint]
    carrier = target.joint(task.joint).child
    poses = target.moving_poses(task.joint, np.linspace(start, task.to, TILTED_VALUES))[carrier]
    up = poses[0, :3, :3].T @ [0.0, 0.0, 1.0]
    tilt = float(np.degrees(np.arccos(np.clip((poses[:, 2, :3] @ up).min(), -1.0, 1.0))))
    if tilt < MAX_TILT:
        return words
    return f"{words}; it tilts by {tilt:.0f} deg, so {'they' if several else 'it'} would fall"


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


def _file_note(prepared: PreparedTask) -> str:
    """Return the friction or damping of the object's file, if most of the pull is due to it."""
    motion, joint = prepared.motion, prepared.task.joint
    if joint is None or motion.resistance is None or motion.resistance.lever is None:
        return ""
    target = prepared.scene.object(prepared.task.object)
    values = motion.object_q[motion.grasp_step :]
    resists = resistance_along(target, joint, values, motion.resistance.lever, ASSUMED)
    source = resists.source(int(resists.total.argmax()))
    return source and f"most of the pull is due to {source}"


def _latch_note(prepared: PreparedTask) -> str:
    """Return which joint on the part may be a latch that the scene does not declare."""
    task = prepared.task
    target = prepared.scene.object(task.object)
    if task.joint is None or is_ajar(target, task.joint):
        return ""
    guess = latch_guess(target, task.joint)
    return guess and (
        f"{guess} stays as it is, on the guess that it is no latch; if it is one, declare it as "
        f"'latch' of {target.name} in the scene"
    )


def _loose_note(prepared: PreparedTask) -> str:
    """Return which joints on the part may move by themselves, which nothing checks."""
    task = prepared.task
    if task.joint is None:
        return ""
    loose = " and ".join(loose_joints(prepared.scene.object(task.object), task.joint))
    return loose and (
        f"{loose} on the part counts as held in place; if it swings or slides by itself, what it "
        "hits is not checked"
    )


def _release_note(prepared: PreparedTask) -> str:
    """Return why the hand must keep holding the part at the end, if it must."""
    task, motion = prepared.task, prepared.motion
    if task.joint is None or task.to is None or motion.release_step is not None:
        return ""
    item = prepared.scene.object(task.object)
    if not item.resistance.get(task.joint, JointResistance()).spring:
        return ""
    problem = release_problem(item, task.joint, task.to, ASSUMED)
    return problem and f"the hand must keep holding the part: {problem}"


def _press_note(prepared: PreparedTask) -> str:
    """Return whether a pressed part springs back, and which model lacks a hole for it."""
    task, scene = prepared.task, prepared.scene
    if task.verb != "press":
        return ""
    name, back = f"{task.object}/{task.joint}", scene_after(scene, task) is scene
    notes = [] if back else [f"{name} counts as staying pressed; state its 'spring' if it returns"]
    sunk = " and ".join(prepared.verifier.part_sweep.sunk_into)
    notes += [f"it sinks into {sunk}, whose model has no hole for it"] if sunk else []
    return "; ".join(notes)


def _spring_note(plan: PlacementPlan, prepared: PreparedTask) -> str:
    """Return why the plan depends on springs that are only assumed; "" if it does not."""
    task, motion = prepared.task, plan.motion
    assert motion is not None
    assert plan.base_pose is not None
    target, known = prepared.scene.object(task.object), prepared.motion.resistance
    if task.joint is None or known is None or not assumes_springs(target, task.joint, ASSUMED):
        return ""
    weighed = {task.object: {task.joint: replace(known, balanced=False)}}
    scene = prepared.scene.with_resistance(weighed)
    target, why = scene.object(task.object), ""
    for hold, following in zip(motion.grasps, (*motion.grasps[1:], None), strict=True):
        why = why or _too_weak(prepared, target, motion, hold)
        end = motion.object_q[hold.last : hold.last + 1]
        if following is not None and not stays_in_place(target, task.joint, end, ASSUMED)[0]:
            why = why or "the part does not stay where the hand lets go"
    if not why:
        verifier = PlanVerifier(scene, prepared.robot, task)
        why = verifier.first_violation(plan.base_pose, motion) or ""
    return why and f"{SPRINGS} {task.object}/{task.joint}; without them, {why}"


def _too_weak(prepared: PreparedTask, target: SceneObject, motion: Motion, hold: Hold) -> str:
    """Return that a hold does not transmit what a part needs, if it does not."""
    joint, grasps = prepared.motion.task.joint, prepared.motion.grasps
    assert joint is not None
    held = slice(hold.first, hold.last + 1)
    values, hand = motion.object_q[held], motion.Ts_world_tool[held, :3, 3]
    moved = float(np.ptp(values))
    if not moved:
        return ""
    lever = float(np.linalg.norm(np.diff(hand, axis=0), axis=1).sum()) / moved
    resists = resistance_along(target, joint, values, lever, ASSUMED)
    at, link = int(resists.total.argmax()), target.joint(joint).child
    begin, now = (
        invert(target.link_poses({joint: float(value)})[link])
        for value in (prepared.motion.object_q[prepared.motion.grasp_step], values[0])
    )
    known = begin @ prepared.motion.Ts_world_tool[:, prepared.motion.grasp_step]
    used = int(np.abs(known - now @ motion.Ts_world_tool[hold.first]).sum((1, 2)).argmin())
    need = MARGIN * float(resists.total[at]) / max(lever, MIN_LEVER)
    if grasps.capacity[used] >= need:
        return ""
    slides = target.joint(joint).kind == "prismatic"
    where = f"{100 * values[at]:.0f} cm" if slides else f"{math.degrees(values[at]):.0f} deg"
    return f"the hand holds {grasps.capacity[used]:.0f} N of {need:.0f} N needed at {where}"
