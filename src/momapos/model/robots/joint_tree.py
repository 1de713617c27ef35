"""Which joints of a URDF are arms: the tree of links, and what its names say."""

from __future__ import annotations

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from momapos.core import RobotError
from momapos.model.urdf import Articulated, Joint, Mimic

from .gripper_guess import FINGER, HAND, fixed_to, joints_below

WHEEL = re.compile(r"wheel|caster|castor|track(?!ing)|roller", re.I)
_HEAD = re.compile(r"head|neck|camera|kinect|lidar|laser|antenna|suspension", re.I)
_LEG = re.compile(
    r"(^|_)(leg|hip|knee|ankle|foot|thigh|calf|shank|hfe|kfe|haa)s?(_|\d|$)|leg_", re.I
)
_GRIPPER = re.compile(r"gripper|hand", re.I)
_TURNS = re.compile(r"wrist|roll|yaw|pitch|flex|rotat|lift", re.I)
LEAST = 4
"""Joints that an arm has at least [-]."""
HAND_SIZE = 0.35
"""What forks and is smaller than this is a hand, what is larger a body with two arms [m]."""


@dataclass(frozen=True)
class ArmChain:
    """An arm of a robot."""

    joints: tuple[str, ...]
    """Base to tool; those that follow another are left out."""
    last: str
    """The link that the last of them moves."""
    coupled: tuple[tuple[str, Mimic], ...] = ()
    """Stages of a telescope, which follow its first."""


@dataclass(frozen=True)
class _Path:
    """A way from the base to where movable joints end, or a hand begins."""

    joints: tuple[Joint, ...]
    hand: bool
    """Whether something like a hand is there."""


def find_anchor(model: Articulated, notes: list[str]) -> str:
    """The link that carries the base: below the joints that stand for driving, as in Fetch's."""
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
        notes.append(f"{', '.join(virtual)} stand for driving: they are not joints of the arm")
    return anchor


def find_arms(
    model: Articulated, anchor: str, fingers: Collection[str], notes: list[str]
) -> list[ArmChain]:
    """All arms of a robot: chains of joints that end where a hand begins.

    Args:
        model: The robot.
        anchor: The link that carries the base.
        fingers: Links that belong to hands, as an SRDF says.
        notes: Gets the guesses, in words.

    Raises:
        RobotError: It has none; the message says what it is instead, and what would help.
    """
    paths = _paths(model, anchor, fingers)
    legs = [path for path in paths if any(_named(_LEG, joint) for joint in path.joints)]
    arms = [path for path in paths if path not in legs and len(_leaders(path.joints)) >= LEAST]
    wheels = any(_named(WHEEL, joint) for joint in model.urdf.joints)
    if len(legs) > 1 and not wheels:
        raise RobotError(_walks(model, legs, arms))
    if not arms:
        raise RobotError(_no_arm(model, paths, wheels))
    if not wheels and _only_a_hand(model, anchor):
        raise RobotError(_hand_alone(model, "all that moves is fingers"))
    named = [path for path in arms if path.hand]
    longest = max(len(path.joints) for path in arms)
    chosen = named or [path for path in arms if len(path.joints) == longest]
    chains = [_chain(model, path.joints, notes) for path in _distinct(chosen)]
    for chain in chains:
        notes.append(f"arm_joints: a chain that ends in a hand, {', '.join(chain.joints)}")
    if not named:
        notes[-1] = notes[-1].replace("a chain that ends in a hand", "the longest chain")
        notes.append("nothing is named like a hand or tool; the arm is just the longest chain")
    return chains


def _paths(model: Articulated, anchor: str, fingers: Collection[str]) -> list[_Path]:
    found: list[_Path] = []
    stack: list[tuple[str, tuple[Joint, ...]]] = [(anchor, ())]
    while stack:
        link, joints = stack.pop()
        body = fixed_to(model, link)
        below = [
            joint
            for name in body
            for joint in joints_below(model, name)
            if joint.movable and not _named(WHEEL, joint) and not _named(_HEAD, joint)
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
    """Whether what hangs from a body is a hand's fingers."""
    if any(joint.child in fingers or _is_finger(model, joint) for joint in below):
        return True
    return len(joints) >= LEAST and len(below) > 1 and _size(model, below) < HAND_SIZE


def _only_a_hand(model: Articulated, anchor: str) -> bool:
    """Whether what hangs from the base are the fingers of a hand, of as many joints as arms."""
    if anchor != model.urdf.root:
        return False
    below = [j for name in fixed_to(model, anchor) for j in joints_below(model, name) if j.movable]
    return len(below) > 2 and _size(model, below) < HAND_SIZE


def _is_finger(model: Articulated, joint: Joint) -> bool:
    if _named(FINGER, joint):
        return True
    text = f"{joint.name} {joint.child}"
    return bool(_GRIPPER.search(text)) and not _TURNS.search(text) and _depth(model, joint) <= 8


def _size(model: Articulated, below: Sequence[Joint]) -> float:
    """How far links lie from where joints begin that one body carries [m]."""
    poses = model.rest_poses
    return max(
        float(np.linalg.norm(poses[link][:3, 3] - poses[joint.parent][:3, 3]))
        for joint in below
        for link in model.links_below(joint.child)
    )


def _depth(model: Articulated, joint: Joint) -> int:
    """Movable joints on the longest way down from a joint, itself included."""
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
    """The paths that no other one goes on from, and each end but once."""
    ends = {path.joints[-1].name: path for path in paths}
    inner = {joint.name for path in paths for joint in path.joints[:-1]}
    return [path for name, path in ends.items() if name not in inner]


def _chain(model: Articulated, joints: Sequence[Joint], notes: list[str]) -> ArmChain:
    """An arm with its telescopes as one joint each."""
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
        notes.append(f"coupled: {', '.join(stages)} are the stages of a telescope: one joint")
    return ArmChain(tuple(names), joints[-1].child, tuple(coupled))


def _stage(before: Joint, after: Joint, poses: dict[str, np.ndarray]) -> bool:
    """Whether two joints in a row slide along one line, by as much."""
    if not before.kind == after.kind == "prismatic":
        return False
    axes = [poses[joint.child][:3, :3] @ joint.axis for joint in (before, after)]
    ends = np.array([[joint.lower, joint.upper] for joint in (before, after)])
    return float(axes[0] @ axes[1]) > 0.999 and bool(np.allclose(ends[0], ends[1], atol=1e-4))


def _walks(model: Articulated, legs: Sequence[_Path], arms: Sequence[_Path]) -> str:
    names = ", ".join(path.joints[0].name for path in legs[:4])
    arm = "" if arms else ", and it has no arm"
    return (
        f"{model.urdf.path}: it walks on {len(legs)} legs ({names}){arm}; momapos plans for bases "
        "that drive. "
        + (
            'To use its arm as if it drove: make the joints of the legs type="fixed" in the URDF, '
            "as it stands"
            if arms
            else "An arm is needed, on a base that drives"
        )
    )


def _no_arm(model: Articulated, paths: Sequence[_Path], wheels: bool) -> str:
    path = model.urdf.path
    hands = any(way.hand for way in paths) or any(_named(FINGER, j) for j in model.urdf.joints)
    most = max((len(_leaders(way.joints)) for way in paths), default=0)
    if wheels:
        return (
            f"{path}: a base without an arm: no chain of movable joints ends in a hand; put an arm "
            "on it with the table [mount] of a robot file (see docs/robots.md)"
        )
    if hands and most < LEAST:
        return _hand_alone(model, f"it has fingers, but no arm with {LEAST} joints or more")
    return (
        f"{path}: no chain of movable joints that could be an arm: the longest has {most}, an arm "
        f"needs {LEAST}; give the URDF of the whole robot, or write the robot file by hand (see "
        "docs/robots.md)"
    )


def _hand_alone(model: Articulated, why: str) -> str:
    return f"{model.urdf.path}: a hand alone: {why}; give the URDF of the arm that carries it"
