"""Which joints of a URDF are an arm: the tree of links, and what its names say."""

from __future__ import annotations

import re
from collections.abc import Sequence

from momapos.errors import RobotError
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.urdf import Joint
from momapos.robots.gripper import FINGER, HAND, joints_below

WHEEL = re.compile(r"wheel|caster|castor|track", re.I)
_HEAD = re.compile(r"head|neck|camera|kinect|lidar|laser", re.I)


def _named(pattern: re.Pattern[str], joint: Joint) -> bool:
    return bool(pattern.search(joint.name) or pattern.search(joint.child))


def find_anchor(model: Articulated, notes: list[str]) -> str:
    """The link that carries the base: below the joints that stand for driving, as in Fetch's."""
    anchor, link = model.urdf.root, model.urdf.root
    virtual: list[str] = []
    while not model.urdf.links[link].collisions and len(joints_below(model, link)) == 1:
        joint = joints_below(model, link)[0]
        upright = abs(joint.axis[2]) > 0.99
        slides = joint.kind == "prismatic" and abs(joint.axis[2]) < 0.01
        turns = upright and (joint.kind == "continuous" or joint.upper - joint.lower > 6)
        if joint.movable and not slides and not (virtual and turns):
            break
        link = joint.child
        if joint.movable:
            virtual.append(joint.name)
            anchor = link
    if virtual:
        notes.append(f"{', '.join(virtual)} stand for driving: they are not joints of the arm")
    return anchor


def find_arms(
    model: Articulated, anchor: str, notes: list[str]
) -> tuple[tuple[str, ...], list[tuple[str, ...]]]:
    """The longest chain of movable joints that ends in something like a hand, and its equals."""
    best: tuple[tuple[bool, int], tuple[str, ...]] = ((False, 0), ())
    rivals: list[tuple[str, ...]] = []
    stack: list[tuple[str, tuple[Joint, ...]]] = [(anchor, ())]
    while stack:
        link, path = stack.pop()
        children = joints_below(model, link)
        stack += [(joint.child, (*path, joint)) for joint in reversed(children)]
        if children:
            continue
        joints, tail = _arm_of(model, path)
        names = tuple(joint.name for joint in joints)
        hand = len(joints) > 1 and any(HAND.search(n) or FINGER.search(n) for n in tail)
        key = (hand, len(joints))
        if key > best[0]:
            best, rivals = (key, names), []
        elif names and key == best[0] and names[-1] != best[1][-1] and names not in rivals:
            rivals.append(names)  # a hand's fingers end the same arm
    if not best[1]:
        raise RobotError(
            f"{model.urdf.path}: no chain of movable joints that could be an arm; write the "
            "robot file by hand (see docs/robots.md)"
        )
    notes.append(f"arm_joints: the longest chain that ends in a hand, {', '.join(best[1])}")
    if rivals:
        notes.append(f"there is another arm, which ends in {rivals[0][-1]}; it stays at rest")
    if not best[0][0]:
        notes.append("nothing is named like a hand or tool; the arm is just the longest chain")
    return best[1], rivals


def _arm_of(model: Articulated, path: Sequence[Joint]) -> tuple[list[Joint], list[str]]:
    """Joints of the arm on a way from base to tip, and the names of what comes after them."""
    joints: list[Joint] = []
    for index, joint in enumerate(path):
        if not joint.movable:
            continue
        if _named(WHEEL, joint) or _named(_HEAD, joint):
            return [], []
        movable = [child for child in joints_below(model, joint.parent) if child.movable]
        forks = len(joints) > 2 and len(movable) > 1
        if _named(FINGER, joint) or (forks and _depth(model, joint) <= 3):
            return joints, [n for j in path[index - 1 :] for n in (j.child, j.name)]
        joints.append(joint)
    last = path.index(joints[-1]) if joints else 0
    return joints, [n for j in path[last:] for n in (j.child, j.name)]


def _depth(model: Articulated, joint: Joint) -> int:
    """Movable joints on the longest way down from a joint, itself included."""
    deepest, stack = 0, [(joint, 0)]
    while stack:
        current, above = stack.pop()
        depth = above + current.movable
        deepest = max(deepest, depth)
        stack += [(below, depth) for below in joints_below(model, current.child)]
    return deepest
