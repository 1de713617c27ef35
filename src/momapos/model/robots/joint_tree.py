"""Find the arms in a URDF's tree of joints, also by their names."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from momapos.core import RobotError
from momapos.model.urdf import Articulated, Joint, Mimic

from .gripper_guess import FINGER, HAND, fixed_to, joints_below
from .running_gear import WHEEL

_HEAD = re.compile(r"head|neck|camera|kinect|lidar|laser|antenna|suspension", re.I)
_LEG = re.compile(
    r"(^|_)(leg|hip|knee|ankle|foot|thigh|calf|shank|hfe|kfe|haa)s?(_|\d|$)|leg_", re.I
)
_GRIPPER = re.compile(r"gripper|hand", re.I)
_SIDE = re.compile("left|right", re.I)
_TURNS = re.compile(r"wrist|roll|yaw|pitch|flex|rotat|lift", re.I)
MIN_ARM_JOINTS = 4
"""Minimum number of joints of an arm [-]."""
MAX_HAND_SIZE = 0.35
"""Size of a fork in the tree that separates a hand (smaller) from a body with two arms [m]."""


@dataclass(frozen=True)
class ArmChain:
    """An arm of a robot."""

    joints: tuple[str, ...]
    """Joints from base to tool, without mimic joints."""
    last: str
    """Link that the last joint moves."""
    coupled: tuple[tuple[str, Mimic], ...] = ()
    """Stages of a telescope, which follow its first stage."""


@dataclass(frozen=True)
class _Path:
    """Path from the base to the last movable joint or to a hand."""

    joints: tuple[Joint, ...]
    hand: bool
    """Whether the path ends at a hand."""


def find_anchor(model: Articulated, notes: list[str]) -> str:
    """Return the link that carries the base, below virtual driving joints such as Fetch's."""
    anchor, link = model.urdf.root, model.urdf.root
    run: list[Joint] = []
    while not model.urdf.links[link].collisions and len(joints_below(model, link)) == 1:
        (joint,) = joints_below(model, link)
        upright = abs(joint.axis[2]) > 0.99
        endless = joint.kind == "continuous" or joint.upper - joint.lower > 6
        slides = joint.kind == "prismatic" and abs(joint.axis[2]) < 0.01
        if joint.movable and not slides and not (upright and endless):
            break
        link = joint.child
        run += [joint] if joint.movable else []
    virtual: list[str] = []
    if any(joint.kind == "prismatic" for joint in run):
        anchor, virtual = run[-1].child, [joint.name for joint in run]
    virtual += model.urdf.rigid
    if virtual:
        notes.append(f"{', '.join(virtual)} represent driving: they are not joints of the arm")
    return anchor


def find_arms(
    model: Articulated,
    anchor: str,
    fingers: Collection[str],
    gear: Collection[str],
    notes: list[str],
) -> list[ArmChain]:
    """Find all arms of a robot: chains of joints that end where a hand begins.

    Args:
        model: The robot.
        anchor: Link that carries the base.
        fingers: Links of hands according to an SRDF.
        gear: Joints of wheels and their steering.
        notes: Receives the assumptions.

    Raises:
        RobotError: There is no arm; the message says what would help.
    """
    paths = _paths(model, anchor, fingers, gear)
    legs = [path for path in paths if any(_named(_LEG, joint) for joint in path.joints)]
    arms = [
        path for path in paths if path not in legs and len(_leaders(path.joints)) >= MIN_ARM_JOINTS
    ]
    wheels = bool(gear) or any(_named(WHEEL, joint) for joint in model.urdf.joints)
    if len(legs) > 1 and not wheels:
        raise RobotError(_walks(model, legs, arms))
    if not arms:
        raise _no_arm(model, paths, wheels)
    if not wheels and _only_a_hand(model, anchor):
        raise RobotError(_hand_alone(model, "only fingers move"))
    named = [path for path in arms if path.hand]
    longest = max(len(path.joints) for path in arms)
    chosen = named or [path for path in arms if len(path.joints) == longest]
    chains = [_chain(model, path.joints, notes) for path in _distinct(chosen)]
    for chain in chains:
        notes.append(f"arm_joints: a chain that ends in a hand, {', '.join(chain.joints)}")
    if not named:
        notes[-1] = notes[-1].replace("a chain that ends in a hand", "the longest chain")
        notes.append("no name indicates a hand or tool; the arm is the longest chain")
    return chains


def arm_names(model: Articulated, chains: Sequence[ArmChain]) -> list[str]:
    """Name the arms: left and right by joint names or by their positions, else by number."""
    if len(chains) == 1:
        return [""]
    own = [
        next(
            name for name in chain.joints if all(name not in c.joints for c in chains if c != chain)
        )
        for chain in chains
    ]
    aside = [float(model.rest_poses[model.joint(name).child][1, 3]) for name in own]
    if len(chains) == 2 and all(_SIDE.search(name) for name in own):
        sides = ["left" if re.search("left", name, re.I) else "right" for name in own]
        if sides[0] != sides[1]:
            return sides
    if len(chains) == 2 and abs(aside[0] - aside[1]) > 0.02:
        return ["left" if y == max(aside) else "right" for y in aside]
    return [f"arm{index + 1}" for index in range(len(chains))]


def _paths(
    model: Articulated, anchor: str, fingers: Collection[str], gear: Collection[str]
) -> list[_Path]:
    found: list[_Path] = []
    stack: list[tuple[str, tuple[Joint, ...]]] = [(anchor, ())]
    while stack:
        link, joints = stack.pop()
        body = fixed_to(model, link)
        below = [
            joint
            for name in body
            for joint in joints_below(model, name)
            if joint.movable
            and joint.name not in gear
            and not _named(WHEEL, joint)
            and not _named(_HEAD, joint)
        ]
        begins = bool(below) and _is_hand(model, joints, below, fingers)
        if below and not begins:
            stack += [(joint.child, (*joints, joint)) for joint in reversed(below)]
        elif joints:
            own = [joints[-1].child, *(name for name in body if name != link)]
            hand = begins or any(HAND.search(name) or FINGER.search(name) for name in own)
            found.append(_Path(joints, hand))
    return found


def _is_hand(
    model: Articulated, joints: Sequence[Joint], below: Sequence[Joint], fingers: Collection[str]
) -> bool:
    """Return whether the joints below a body are those of fingers."""
    if len(below) == 1 and _moves_palm(model, below[0]):
        return False
    if any(joint.child in fingers or _is_finger(model, joint) for joint in below):
        return True
    return len(joints) >= MIN_ARM_JOINTS and len(below) > 1 and _size(model, below) < MAX_HAND_SIZE


def _moves_palm(model: Articulated, joint: Joint) -> bool:
    """Return whether several fingers begin at what a joint moves: a wrist, whatever its name."""
    begin = [
        other
        for link in fixed_to(model, joint.child)
        for other in joints_below(model, link)
        if other.movable and _named(FINGER, other)
    ]
    return len(begin) > 1 and not _named(FINGER, joint)


def _only_a_hand(model: Articulated, anchor: str) -> bool:
    """Return whether the base carries only fingers, even with as many joints as an arm."""
    if anchor != model.urdf.root:
        return False
    below = [j for name in fixed_to(model, anchor) for j in joints_below(model, name) if j.movable]
    return len(below) > 2 and _size(model, below) < MAX_HAND_SIZE


def _is_finger(model: Articulated, joint: Joint) -> bool:
    if _named(FINGER, joint):
        return True
    text = f"{joint.name} {joint.child}"
    return bool(_GRIPPER.search(text)) and not _TURNS.search(text) and _depth(model, joint) <= 8


def _size(model: Articulated, below: Sequence[Joint]) -> float:
    """Return the extent of the links below some joints, from the joints' parent [m]."""
    poses = model.rest_poses
    return max(
        float(np.linalg.norm(poses[link][:3, 3] - poses[joint.parent][:3, 3]))
        for joint in below
        for link in model.links_below(joint.child)
    )


def _depth(model: Articulated, joint: Joint) -> int:
    """Return the number of movable joints on the longest path down from a joint, including it."""
    deepest, stack = 0, [(joint, 0)]
    while stack:
        current, above = stack.pop()
        depth = above + current.movable
        deepest = max(deepest, depth)
        stack += [(below, depth) for below in joints_below(model, current.child)]
    return deepest


def _named(pattern: re.Pattern[str], joint: Joint) -> bool:
    return bool(pattern.search(joint.name) or pattern.search(joint.child))


def _leaders(joints: Sequence[Joint]) -> list[Joint]:
    return [joint for joint in joints if joint.mimic is None]


def _distinct(paths: Sequence[_Path]) -> list[_Path]:
    """Return the paths that no other one continues, without duplicate ends."""
    ends = {path.joints[-1].name: path for path in paths}
    inner = {joint.name for path in paths for joint in path.joints[:-1]}
    return [path for name, path in ends.items() if name not in inner]


def _chain(model: Articulated, joints: Sequence[Joint], notes: list[str]) -> ArmChain:
    """Return an arm with each telescope as one joint."""
    coupled: list[tuple[str, Mimic]] = []
    names = [joint.name for joint in _leaders(joints)]
    poses = model.rest_poses
    for before, after in pairwise(joints):
        if after.mimic is None and _stage(before, after, poses):
            follows = dict(coupled).get(before.name)
            leader = before.name if follows is None else follows.joint
            coupled.append((after.name, Mimic(leader)))
            names.remove(after.name)
    if coupled:
        stages = [coupled[0][1].joint, *(name for name, _ in coupled)]
        notes.append(f"coupled: {', '.join(stages)} are stages of a telescope and act as one joint")
    return ArmChain(tuple(names), joints[-1].child, tuple(coupled))


def _stage(before: Joint, after: Joint, poses: dict[str, np.ndarray]) -> bool:
    """Return whether two successive joints slide along the same direction by the same travel."""
    if not before.kind == after.kind == "prismatic":
        return False
    axes = [poses[joint.child][:3, :3] @ joint.axis for joint in (before, after)]
    ends = np.array([[joint.lower, joint.upper] for joint in (before, after)])
    return float(axes[0] @ axes[1]) > 0.999 and bool(np.allclose(ends[0], ends[1], atol=1e-4))


def _walks(model: Articulated, legs: Sequence[_Path], arms: Sequence[_Path]) -> str:
    names = ", ".join(path.joints[0].name for path in legs[:4])
    arm = "" if arms else " and has no arm"
    return (
        f"{model.urdf.path}: the robot walks on {len(legs)} legs ({names}){arm}; momapos plans for "
        "bases that drive. "
        + (
            'To plan as if it drove, make the leg joints type="fixed" in the URDF, in a standing '
            "pose"
            if arms
            else "Give a robot with an arm on a driving base"
        )
    )


class NoArmError(RobotError):
    """A description has neither an arm nor a hand; it may be a base."""


def _no_arm(model: Articulated, paths: Sequence[_Path], wheels: bool) -> RobotError:
    path = model.urdf.path
    hands = any(way.hand for way in paths) or any(_named(FINGER, j) for j in model.urdf.joints)
    most = max((len(_leaders(way.joints)) for way in paths), default=0)
    if wheels:
        return NoArmError(
            f"{path}: the base has no arm: no chain of movable joints ends in a hand; put one on "
            "it: momapos robot build --base FILE --arm FILE --at X,Y,Z (docs/robots.md)"
        )
    if hands and most < MIN_ARM_JOINTS:
        why = f"it has fingers, but no arm with at least {MIN_ARM_JOINTS} joints"
        return RobotError(_hand_alone(model, why))
    return NoArmError(
        f"{path}: no chain of movable joints can be an arm: the longest has {most}, an arm needs "
        f"at least {MIN_ARM_JOINTS}; give the URDF of the whole robot, or write the robot file by "
        "hand (docs/robots.md)"
    )


def _hand_alone(model: Articulated, why: str) -> str:
    return f"{model.urdf.path}: the robot is a hand alone: {why}; give the URDF of the whole arm"
