"""A robot file derived from a URDF alone.

URDFs do not say which link stands on the floor, which joints are the arm, or where the tool is.
This module looks at names and geometry the way a person would, and puts every guess into words,
so that a wrong one is seen and corrected in the file that it writes.
"""

from __future__ import annotations

import json
import os
import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.errors import RobotError
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.chain import Chain, build_chain
from momapos.kinematics.spheres import Spheres, build_spheres
from momapos.kinematics.urdf import Joint, read_urdf
from momapos.robots.gripper import (
    FINGER,
    HAND,
    find_grip,
    find_tool,
    fixed_to,
    joints_below,
    listed,
    points_of,
)  # fmt: skip
from momapos.robots.robot import Robot, read_robot, read_srdf
from momapos.robots.states import inevitable_pairs, resting_state, sample_states, srdf_text, touches

if TYPE_CHECKING:
    from jaxtyping import Float

_WHEEL = re.compile(r"wheel|caster|castor|track", re.I)
_HEAD = re.compile(r"head|neck|camera|kinect|lidar|laser", re.I)
_OMNI = re.compile(r"mecanum|omni|swerve", re.I)
FLOOR_TOLERANCE = 0.03
"""How far the lowest point of the base may be from the base link's z = 0 [m]."""
MAX_CORNERS, MAX_LINKS = 16, 500


@dataclass(frozen=True)
class Derived:
    """What a URDF says about a robot, and what had to be assumed."""

    toml: str
    """Text of the robot file."""
    pairs: dict[tuple[str, str], str]
    """Pairs of links that cannot help touching, with the reason, for an SRDF."""
    assumptions: tuple[str, ...]
    """What was guessed, in words."""


def write_robot(urdf: Path, out: Path | None = None, *, seed: int = 0) -> tuple[Path, Derived]:
    """Derive a robot file from a URDF and write it, with an SRDF beside the URDF if it has none.

    Args:
        urdf: The URDF.
        out: The robot file; the URDF's name with `.toml` where None.
        seed: Seed of the sampled arm states.

    Returns:
        The robot file, and what was derived.

    Raises:
        RobotError: The robot file exists already, cannot be written, or nothing can be derived.
        UrdfError: The URDF cannot be used.
    """
    out = out or urdf.with_suffix(".toml")
    if out.exists():
        raise RobotError(f"{out}: exists already; remove it, or choose another file with --out")
    name = os.path.relpath(urdf.resolve(), out.resolve().parent)
    derived = derive_robot(urdf, urdf_name=Path(name).as_posix(), seed=seed)
    draft, srdf = out.with_name(f".{out.name}.{os.getpid()}"), urdf.with_suffix(".srdf")
    try:
        out.parent.mkdir(parents=True, exist_ok=True)
        draft.write_text(derived.toml, encoding="utf-8")
        read_robot(draft)
        if derived.pairs and not srdf.exists():
            srdf.write_text(srdf_text(out.stem, derived.pairs), encoding="utf-8")
        draft.replace(out)
    except OSError as error:
        raise RobotError(f"{error.filename}: cannot be written ({error.strerror})") from error
    finally:
        draft.unlink(missing_ok=True)
    return out, derived


def derive_robot(urdf: Path, *, urdf_name: str | None = None, seed: int = 0) -> Derived:
    """Derive a robot file from a URDF.

    Args:
        urdf: The file. An SRDF beside it is believed.
        urdf_name: How the robot file names the URDF; its file name where None.
        seed: Seed of the sampled arm states.

    Raises:
        UrdfError: The URDF cannot be used.
        RobotError: It has no arm, no base geometry, or no link at floor height.
    """
    model = Articulated(read_urdf(urdf))
    if len(model.links) > MAX_LINKS:
        raise RobotError(f"{urdf}: {len(model.links)} links; a robot has at most {MAX_LINKS}")
    notes: list[str] = []
    anchor = _anchor(model, notes)
    joints = _arm(model, anchor, notes)
    base_link = _base_link(model, anchor, joints, notes)
    last = model.joint(joints[-1]).child
    tool_link, gripper, fingers = find_tool(model, last, notes)
    approach, closing, opening = find_grip(model, last, tool_link, fingers, notes)
    footprint = _footprint(model, base_link, joints, notes)
    drive = _drive(model, notes)
    chain, segments = build_chain(model, base_link, tool_link, joints)
    known = read_srdf(urdf.with_suffix(".srdf"))
    spheres = build_spheres(model, segments, known, gripper)
    q = sample_states(chain, np.random.default_rng(seed))
    pairs = {} if known else inevitable_pairs(chain, spheres, q, model)
    disabled = known | {frozenset(pair) for pair in pairs}
    spheres = build_spheres(model, segments, disabled, gripper)
    home = _home(chain, spheres, q, notes)
    _note_pairs(pairs, bool(known), notes)
    text = _toml(
        name=re.sub(r"\W+", "_", model.urdf.name).strip("_") or "robot",
        urdf=urdf_name or urdf.name, base_link=base_link, tool_link=tool_link, joints=joints,
        gripper=gripper, home=home, footprint=footprint, drive=drive, approach=approach,
        closing=closing, opening=opening,
    )  # fmt: skip
    return Derived(text, pairs, tuple(notes))


# ------------------------------------------------------------------------------------ the tree


def _named(pattern: re.Pattern[str], joint: Joint) -> bool:
    return bool(pattern.search(joint.name) or pattern.search(joint.child))


def _anchor(model: Articulated, notes: list[str]) -> str:
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


def _arm(model: Articulated, anchor: str, notes: list[str]) -> tuple[str, ...]:
    """The longest chain of movable joints that ends in something like a hand."""
    best: tuple[tuple[bool, int], tuple[str, ...]] = ((False, 0), ())
    rivals: list[str] = []
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
        elif names and key == best[0] and not set(names) & set(best[1]):
            rivals.append(names[-1])
    if not best[1]:
        raise RobotError(
            f"{model.urdf.path}: no chain of movable joints that could be an arm; write the "
            "robot file by hand (see docs/robots.md)"
        )
    notes.append(f"arm_joints: the longest chain that ends in a hand, {', '.join(best[1])}")
    if rivals:
        notes.append(f"there is another arm, which ends in {rivals[0]}; it stays at rest")
    if not best[0][0]:
        notes.append("nothing is named like a hand or tool; the arm is just the longest chain")
    return best[1]


def _arm_of(model: Articulated, path: Sequence[Joint]) -> tuple[list[Joint], list[str]]:
    """Joints of the arm on a way from base to tip, and the names of what comes after them."""
    joints: list[Joint] = []
    for index, joint in enumerate(path):
        if not joint.movable:
            continue
        if _named(_WHEEL, joint) or _named(_HEAD, joint):
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


# ------------------------------------------------------------------------------------ the base


def _base_links(model: Articulated, joints: Sequence[str]) -> list[str]:
    arm = set(model.moved_by(joints[0]))
    return [name for name in model.links if name not in arm]


def _base_link(model: Articulated, anchor: str, joints: Sequence[str], notes: list[str]) -> str:
    """A link fixed to the base whose z = 0 is the floor."""
    rigid = fixed_to(model, anchor)
    usual: tuple[str, ...] = ("base_footprint", "base_link")
    preferred = [name for name in usual if name in rigid]
    body = _base_links(model, joints)
    offsets = {}
    for name in dict.fromkeys([*preferred, anchor, *rigid]):
        points = points_of(model, name, body)
        if not len(points):
            raise RobotError(
                f"{model.urdf.path}: no link below the arm has collision geometry; add the base's"
            )
        offsets[name] = float(points[:, 2].min())
        if abs(offsets[name]) <= FLOOR_TOLERANCE:
            notes.append(f"base_link: {name}, whose x axis is taken as forward")
            return name
    name = (preferred or [anchor])[-1]
    raise RobotError(
        f"{model.urdf.path}: no link of the base lies on the floor: the base's lowest point is "
        f"at z = {offsets[name]:.3f} m in {name!r}; add to the URDF: "
        f'<link name="base_footprint"/><joint name="base_footprint_joint" type="fixed">'
        f'<parent link="{name}"/><child link="base_footprint"/>'
        f'<origin xyz="0 0 {offsets[name]:.4f}"/></joint>'
    )


def _footprint(
    model: Articulated, base_link: str, joints: Sequence[str], notes: list[str]
) -> Float[np.ndarray, "k 2"]:
    """Outline of all that does not move with the arm, seen from above."""
    from scipy.spatial import ConvexHull

    points = points_of(model, base_link, _base_links(model, joints))[:, :2]
    outline = points[ConvexHull(points).vertices]
    if len(outline) > MAX_CORNERS:
        # Around it, so that nothing sticks out: where neighbouring tangents meet.
        angle = np.arange(MAX_CORNERS) * 2 * np.pi / MAX_CORNERS
        normal = np.stack([np.cos(angle), np.sin(angle)], -1)
        reach = (outline @ normal.T).max(0)
        pairs = np.stack([normal, np.roll(normal, -1, 0)], 1)
        ends = np.stack([reach, np.roll(reach, -1)], -1)
        outline = np.linalg.solve(pairs, ends[..., None])[..., 0]
        outline = outline[np.linalg.norm(outline - np.roll(outline, 1, 0), axis=1) > 1e-4]
    size = np.ptp(outline, axis=0)
    notes.append(f"footprint: outline of the base's geometry, {size[0]:.2f} x {size[1]:.2f} m")
    return outline


def _drive(model: Articulated, notes: list[str]) -> str:
    names = [*model.urdf.links, *(joint.name for joint in model.urdf.joints)]
    if any(_OMNI.search(name) for name in names):
        notes.append("drive: omni, as its wheels are named so")
        return "omni"
    wheels = any(_WHEEL.search(name) for name in names)
    why = "" if wheels else " (there are no wheels: is this a mobile robot?)"
    notes.append(f"drive: differential, with speeds that are a guess{why}")
    return "differential"


# ------------------------------------------------------------------------------------ the files


def examine(robot: Robot, *, seed: int = 0) -> list[str]:
    """Say what looks wrong about a robot whose file is consistent; mostly nothing."""
    doubts: list[str] = []
    body = _base_links(robot.model, robot.arm_joints)
    points = points_of(robot.model, robot.base_link, body)
    if not len(points):
        return ["the base has no collision geometry: nothing that it could hit is checked"]
    low = float(points[:, 2].min())
    if abs(low) > FLOOR_TOLERANCE:
        doubts.append(f"the base's lowest point is {low:.3f} m from the z = 0 of {robot.base_link}")
    edge = np.roll(robot.footprint, -1, 0) - robot.footprint
    normal = np.stack([edge[:, 1], -edge[:, 0]], -1) / np.linalg.norm(edge, axis=1)[:, None]
    offset = np.einsum("ij,ij->i", normal, robot.footprint)
    out = float((points[:, :2] @ normal.T - offset).max())
    if out > 0.02:
        doubts.append(f"the base sticks {out:.2f} m out of its footprint")
    if touches(robot.chain, robot.spheres, robot.home[None], floor=True)[0]:
        doubts.append("the arm touches the robot or the floor at home")
    share = touches(
        robot.chain, robot.spheres, sample_states(robot.chain, np.random.default_rng(seed))
    ).mean()
    if share > 0.9:
        doubts.append(
            f"the arm touches the robot in {100 * share:.0f} % of its states: are pairs of links "
            "missing in the SRDF?"
        )
    return doubts


def _note_pairs(pairs: dict[tuple[str, str], str], known: bool, notes: list[str]) -> None:
    if known:
        notes.append("self-collision: the pairs in the SRDF beside the URDF are not checked")
    elif pairs:
        words = ", ".join(f"{a} with {b}" for a, b in pairs)
        notes.append(f"self-collision: never checked, as they touch at rest or always: {words}")


def _home(
    chain: Chain, spheres: Spheres, q: Float[np.ndarray, "m n"], notes: list[str]
) -> Float[np.ndarray, " n"]:
    found = resting_state(chain, spheres, q)
    if found is None:
        notes.append("IMPORTANT: home: no state free of self-collision was found; give one")
        return q[0]
    home, reach = found
    notes.append(
        f"home: of {len(q)} states the one that keeps the arm within {reach:.2f} m of the "
        f"base's origin, {listed(home)}"
    )
    return home


def _toml(**v: Any) -> str:
    """Text of a robot file; the texts are names that came out of an XML file."""

    def quoted(value: str) -> str:
        return json.dumps(value, ensure_ascii=False)

    def names(values: Sequence[str]) -> str:
        return f"[{', '.join(map(quoted, values))}]"

    corners = ", ".join(listed(corner) for corner in v["footprint"])
    return f"""# Derived by 'momapos robot check'; see docs/robots.md for every key.
name = {quoted(v["name"])}
urdf = {quoted(v["urdf"])}
base_link = {quoted(v["base_link"])}
tool_link = {quoted(v["tool_link"])}
arm_joints = {names(v["joints"])}
gripper_links = {names(v["gripper"])}
home = {listed(v["home"])}

[base]
footprint = [{corners}]
drive = {quoted(v["drive"])}
max_speed = 0.5
max_yaw_rate = 1.0
max_acceleration = 0.5
max_yaw_acceleration = 1.0

[tool]
approach_axis = {listed(v["approach"])}
closing_axis = {listed(v["closing"])}
opening = {v["opening"]:g}
"""
