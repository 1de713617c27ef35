"""The gripper of a robot, guessed from names and from where its fingers are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Sequence
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from momapos.geometry.transforms import apply, invert, orthonormal
from momapos.kinematics.articulated import Articulated
from momapos.kinematics.urdf import Joint

if TYPE_CHECKING:
    from jaxtyping import Float

FINGER = re.compile(
    r"finger|thumb|knuckle|phalanx|crank|jaw|claw|(left|right|[lr])_?gripper|gripper_?(left|right)",
    re.I,
)
HAND = re.compile(r"tool|tcp|grasp|gripper|hand|palm|end_?effector|(^|_)eef?(_|$)|vacuum", re.I)
_TOOLS = tuple(
    re.compile(pattern, re.I)
    for pattern in (
        r"tcp|tool_?center", r"grasp", r"(^|_)tool", r"(^|_)eef?(_|$)|end_?effector", r"gripper",
        r"hand|palm",
    )
)  # fmt: skip
"""Names of tool frames, the best first."""
_SUCTION, _HOOK = re.compile(r"suction|vacuum|magnet", re.I), re.compile(r"hook", re.I)
GUESS = 0.08
"""How far a gripper opens when its geometry does not tell [m]."""
NEAR_TIP = 0.03
"""Shapes that reach this close to the finger tips count for the opening [m]."""


def joints_below(model: Articulated, link: str) -> list[Joint]:
    """The joints that hang from a link."""
    return [joint for joint in model.urdf.joints if joint.parent == link]


def fixed_to(model: Articulated, link: str) -> list[str]:
    """The link and all that is fixed to it, parents first."""
    links = [link]
    for name in links:
        links += [joint.child for joint in joints_below(model, name) if not joint.movable]
    return links


def points_of(model: Articulated, frame: str, links: Iterable[str]) -> Float[np.ndarray, "n 3"]:
    """Hull vertices of links at rest, in the frame of a link [m]."""
    poses = model.link_poses({})
    T = invert(poses[frame])
    points = [apply(T @ poses[name], h.vertices) for name in links for h in model.hulls[name]]
    return np.concatenate(points) if points else np.zeros((0, 3))


def find_tool(model: Articulated, last: str, notes: list[str]) -> tuple[str, list[str], list[str]]:
    """Find the tool link, the links of the gripper, and the links that its fingers begin with.

    Args:
        model: The robot.
        last: The link that the arm's last joint moves.
        notes: Gets the guesses, in words.
    """
    hand = fixed_to(model, last)
    found = [[name for name in hand if pattern.search(name)] for pattern in _TOOLS]
    matches = next((names for names in found if names), [])
    tool = matches[-1] if matches else hand[-1]
    why = "by its name" if matches else "the last link of the arm, for want of a better name"
    notes.append(f"tool_link: {tool}, {why}")
    fingers = [j.child for name in hand for j in joints_below(model, name) if j.movable]
    moving = [name for finger in fingers for name in model.links_below(finger)]
    palms = {joint.parent for joint in model.urdf.joints if joint.child in fingers}
    held = [name for name in hand if name in palms or (name != last and HAND.search(name))]
    gripper = [*(held or hand[1:]), *moving]
    gripper = [name for name in gripper if model.urdf.links[name].collisions] or [last]
    notes.append(f"gripper_links, which may touch what is held: {', '.join(gripper)}")
    return tool, gripper, fingers


def find_grip(
    model: Articulated, last: str, tool: str, fingers: Sequence[str], notes: list[str]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"], float]:
    """Find how the gripper approaches and closes, in the tool frame, and how far it opens [m]."""
    poses = model.link_poses({})
    back = invert(poses[tool]) @ poses[last]
    hands = [points_of(model, tool, model.links_below(name)) for name in fingers]
    hands = [points for points in hands if len(points)]
    if len(hands) < 2:
        approach = _snap(-back[:3, 3] if np.linalg.norm(back[:3, 3]) > 0.01 else back[:3, 0])
        closing = orthonormal(approach)
        notes.append(
            f"no fingers: approach_axis {listed(approach)} is where the arm points, closing_axis "
            f"{listed(closing)} is any across it, and the opening of {GUESS} m is a guess"
        )
        return approach, closing, GUESS
    centers = [(points.min(0) + points.max(0)) / 2 for points in hands]
    one, other = max(combinations(centers, 2), key=lambda p: float(np.linalg.norm(p[0] - p[1])))
    closing = _snap(one - other)
    closing = closing * np.sign(closing[int(np.argmax(abs(closing)))])
    middle = (one + other) / 2
    ahead = middle - back[:3, 3]
    ahead = ahead - (ahead @ closing) * closing
    approach = _snap(ahead) if np.linalg.norm(ahead) > 0.01 else orthonormal(closing)
    approach = approach - (approach @ closing) * closing
    opening = _opening(model, tool, fingers, np.stack([closing, approach]), middle)
    words = "measured at the finger tips" if opening else "a guess: the gap is not clear"
    notes.append(
        f"approach_axis {listed(approach)} points along the fingers, closing_axis "
        f"{listed(closing)} across them; opening {opening or GUESS:g} m, {words}"
    )
    tip = max(float((points @ approach).max()) for points in hands)
    if not -0.02 <= tip <= 0.1:
        _note_tool(tool, middle + (tip - 0.02 - middle @ approach) * approach, tip, notes)
    return approach, closing, opening or GUESS


def find_grips(model: Articulated, last: str, fingers: Sequence[str], notes: list[str]) -> str:
    """Say what a tool holds with, in a robot file's word: fingers, suction or hook.

    Fingers that move close; a tool without any is a suction cup or a hook where it is named so.
    """
    names = " ".join(fixed_to(model, last))
    shaped = [name for name in fingers if any(model.hulls[n] for n in model.links_below(name))]
    moving = len(shaped) >= 2
    grips = "fingers"
    if not moving and _SUCTION.search(names):
        grips = "suction"
    elif not moving and _HOOK.search(names):
        grips = "hook"
    why = "by its name" if grips != "fingers" else "which close"
    if grips == "fingers" and not moving:
        why = "for want of a better guess: none was found that moves"
    notes.append(f"grips: {grips}, {why}; with what force no URDF says: give tool.force")
    return grips


def _note_tool(tool: str, grasp: Float[np.ndarray, "3"], tip: float, notes: list[str]) -> None:
    """Say that the tool frame is not where things are held, and what to add."""
    xyz = " ".join(f"{v:.4f}" for v in grasp + 0.0)
    notes.append(
        f"IMPORTANT: {tool} lies {abs(tip):.2f} m {'behind' if tip > 0 else 'beyond'} the finger "
        f"tips, but the tool frame must be where things are held; add to the URDF: "
        f'<link name="grasp_link"/><joint name="grasp_joint" type="fixed"><parent link="{tool}"/>'
        f'<child link="grasp_link"/><origin xyz="{xyz}"/></joint>'
    )


def _snap(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The unit vector, or the frame's axis where that is within 18 degrees."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(abs(v)))
    return np.sign(v[k]) * np.eye(3)[k] if abs(v[k]) > 0.95 else v


def listed(v: Float[np.ndarray, " n"]) -> str:
    """Write numbers as a TOML list."""
    return f"[{', '.join(f'{x:.7g}' for x in np.round(v, 6) + 0.0)}]"


def _opening(
    model: Articulated,
    tool: str,
    fingers: Sequence[str],
    axes: Float[np.ndarray, "2 3"],
    middle: Float[np.ndarray, "3"],
) -> float:
    """The widest gap between the finger tips over the ends of their joints [m]; 0 if unclear."""
    inside = {link for name in fingers for link in model.links_below(name)}
    movers = [j for j in model.joints.values() if j.child in inside and np.isfinite(j.upper)]
    widest = 0.0
    for end in ("lower", "upper"):
        poses = model.link_poses({j.name: float(getattr(j, end)) for j in movers})
        T = invert(poses[tool])
        shapes = [
            (apply(T @ poses[link], hull.vertices) - middle) @ axes.T
            for link in inside
            for hull in model.hulls[link]
        ]
        tip = max(float(shape[:, 1].max()) for shape in shapes)
        ends = [shape[:, 0] for shape in shapes if shape[:, 1].max() > tip - NEAR_TIP]
        above = [float(c.min()) for c in ends if c.min() + c.max() > 0]
        below = [float(c.max()) for c in ends if c.min() + c.max() <= 0]
        if above and below:
            widest = max(widest, min(above) - max(below))
    return round(widest, 3) if 0.005 < widest < 0.5 else 0.0
