"""The gripper of a robot, guessed from names and from where its fingers are."""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, orthonormal
from momapos.model.urdf import Articulated, Joint

from .fingers import NEAR_TIP, THUMB, jaws, widest

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
ASIDE = 0.03
"""How far from the middle between the fingers the tool link may be [m]."""
GUESS = 0.08
"""How far a gripper opens when its geometry does not tell [m]."""


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
    poses = model.rest_poses
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
    own = [name for name in hand if HAND.search(name) or FINGER.search(name)]
    held = [name for name in hand if name in palms or (name != last and name in own)]
    gripper = [*(held or hand[1:]), *moving]
    gripper = [name for name in gripper if model.urdf.links[name].collisions] or [last]
    notes.append(f"gripper_links, which may touch what is held: {', '.join(gripper)}")
    return tool, gripper, fingers


@dataclass(frozen=True)
class Closing:
    """How a gripper approaches and closes, in the frame of its tool link."""

    approach: Float[np.ndarray, "3"]
    closing: Float[np.ndarray, "3"]
    opening: float
    """Widest thing that fits [m]."""
    grasp: Float[np.ndarray, "3"] | None = None
    """Where things are held [m]; None where the tool link is there."""
    rest: Mapping[str, float] = field(default_factory=dict)
    """Where the joints of its fingers are when it is so far open [rad] or [m]."""


def find_grip(
    model: Articulated, last: str, tool: str, fingers: Sequence[str], notes: list[str]
) -> Closing:
    """Find how the gripper approaches and closes, and how far it opens."""
    back = invert(model.rest_poses[tool]) @ model.rest_poses[last]
    hands = [points_of(model, tool, model.links_below(name)) for name in fingers]
    shaped = [i for i, points in enumerate(hands) if len(points)]
    if len(shaped) == 1:
        jaw = _fixed_jaw(model, last, tool, fingers[shaped[0]])
        if jaw is None:
            return _one_jaw(model, last, tool, fingers[shaped[0]], notes)
        notes.append(f"one jaw moves, {fingers[shaped[0]]}, and closes on {jaw}, which does not")
        fingers = [fingers[shaped[0]], jaw]
        hands = [points_of(model, tool, model.links_below(name)) for name in fingers]
        shaped = [0, 1]
    if not shaped:
        approach = _snap(-back[:3, 3] if np.linalg.norm(back[:3, 3]) > 0.01 else back[:3, 0])
        closing = orthonormal(approach)
        notes.append(
            f"no fingers: approach_axis {listed(approach)} is where the arm points, closing_axis "
            f"{listed(closing)} is any across it, and the opening of {GUESS} m is a guess"
        )
        return Closing(approach, closing, GUESS)
    if len(shaped) > 2:
        notes.append(
            f"IMPORTANT: a hand of {len(shaped)} fingers: it is planned for as a pinch of two "
            "sides; how its fingers close together is not taken from the URDF"
        )
    one, other = _opposed(model, [fingers[i] for i in shaped], [hands[i] for i in shaped])
    middle = (one + other) / 2
    if len(shaped) > 2:  # a thumb stands beside the others, and reaches less far than they
        approach = _snap(other - back[:3, 3])
        across = one - other - ((one - other) @ approach) * approach
        closing = _snap(across) if np.linalg.norm(across) > 0.005 else orthonormal(approach)
    else:
        closing = _snap(one - other)
    closing = closing * np.sign(closing[int(np.argmax(abs(closing)))])
    ahead = (other if len(shaped) > 2 else middle) - back[:3, 3]
    ahead = ahead - (ahead @ closing) * closing
    approach = _snap(ahead) if np.linalg.norm(ahead) > 0.01 else orthonormal(closing)
    approach = approach - (approach @ closing) * closing
    approach /= np.linalg.norm(approach)
    axes = np.stack([closing, approach])
    stroke = widest(model, tool, jaws(model, tool, fingers, closing), axes)
    opening = stroke.opening
    words = "measured at the finger tips" if opening else "a guess: the gap is not clear"
    notes.append(
        f"approach_axis {listed(approach)} points along the fingers, closing_axis "
        f"{listed(closing)} across them; opening {opening or GUESS:g} m, {words}"
    )
    tip = max(float((hands[i] @ approach).max()) for i in shaped)
    grasp = _grasp(tool, middle, tip, approach, notes)
    return Closing(approach, closing, opening or GUESS, grasp, stroke.rest)


def _opposed(
    model: Articulated, fingers: Sequence[str], hands: Sequence[Float[np.ndarray, "n 3"]]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Middles of what closes against each other: thumb and fingers, or the two farthest apart."""
    centers = [(points.min(0) + points.max(0)) / 2 for points in hands]
    parts = [len(model.links_below(name)) for name in fingers]
    long = [i for i, count in enumerate(parts) if 2 * count >= max(parts)]
    thumbs = [centers[i] for i in long if THUMB.search(fingers[i])]
    rest = [centers[i] for i in long if not THUMB.search(fingers[i])]
    if thumbs and rest:
        return np.mean(thumbs, axis=0), np.mean(rest, axis=0)
    return max(combinations(centers, 2), key=lambda p: float(np.linalg.norm(p[0] - p[1])))


def _fixed_jaw(model: Articulated, last: str, tool: str, finger: str) -> str | None:
    """The link fixed to the hand that a lone finger closes on: it reaches as far as that one."""
    back = (invert(model.rest_poses[tool]) @ model.rest_poses[last])[:3, 3]
    moving = points_of(model, tool, model.links_below(finger))
    along = moving.mean(0) - back
    along /= np.linalg.norm(along)
    reach = float((moving @ along).max()) - NEAR_TIP
    carries = {joint.parent for joint in model.urdf.joints}
    found = {
        name: float((points_of(model, tool, [name]) @ along).max())
        for name in fixed_to(model, last)
        if name != last and name not in carries and model.hulls[name]
    }
    best = max(found, key=lambda name: found[name], default=None)
    return best if best is not None and found[best] > reach else None


def _one_jaw(model: Articulated, last: str, tool: str, finger: str, notes: list[str]) -> Closing:
    """A gripper of which one jaw moves, against the hand."""
    T_tool_root = invert(model.rest_poses[tool])
    joint = next(j for j in model.urdf.joints if j.child == finger)
    T = T_tool_root @ model.rest_poses[finger]
    axis, origin = T[:3, :3] @ joint.axis, T[:3, 3]
    back = (T_tool_root @ model.rest_poses[last])[:3, 3]
    points = points_of(model, tool, model.links_below(finger))
    tip = points[int(np.argmax(np.linalg.norm(points - back, axis=1)))]
    way = axis if joint.kind == "prismatic" else np.cross(axis, tip - origin)
    closing = _snap(way)
    closing = closing * np.sign(closing[int(np.argmax(abs(closing)))])
    ahead = tip - back
    approach = _snap(ahead - (ahead @ closing) * closing)
    approach = approach - (approach @ closing) * closing
    approach /= np.linalg.norm(approach)
    span = joint.upper - joint.lower
    radius = float(np.linalg.norm(way))
    travel = span if joint.kind == "prismatic" else 2 * radius * np.sin(min(span, np.pi) / 2)
    opening = round(float(travel), 3) if 0.005 < travel < 0.5 else GUESS
    notes.append(
        f"one jaw moves, {finger}: approach_axis {listed(approach)}, closing_axis "
        f"{listed(closing)}; opening {opening:g} m, as far as its tip goes"
    )
    ahead_of_tool = float(tip @ approach)
    grasp = _grasp(tool, tip - (tip @ closing) * closing, ahead_of_tool, approach, notes)
    rest = {}
    if joint.kind == "prismatic" and np.isfinite(span):  # where it is away from what it closes on
        others = points_of(model, tool, fixed_to(model, last))
        near = others[others @ approach > tip @ approach - NEAR_TIP]
        facing = near.mean(0) if len(near) else back
        rest[joint.name] = joint.upper if (tip - facing) @ way > 0 else joint.lower
    return Closing(approach, closing, opening, grasp, rest)


def find_grips(model: Articulated, last: str, fingers: Sequence[str], notes: list[str]) -> str:
    """Say what a tool holds with, in a robot file's word: fingers, suction or hook.

    Fingers that move close; a tool without any is a suction cup or a hook where it is named so.
    """
    names = " ".join(fixed_to(model, last))
    shaped = [name for name in fingers if any(model.hulls[n] for n in model.links_below(name))]
    moving = bool(shaped)
    grips = "fingers"
    if not moving and _SUCTION.search(names):
        grips = "suction"
    elif not moving and _HOOK.search(names):
        grips = "hook"
    if grips == "fingers" and not moving:
        notes.append(
            "IMPORTANT: grips: no finger with a collision shape moves, so that it holds nothing; "
            "use a URDF with its gripper, or say whether it is a suction cup or a hook"
        )
    else:
        notes.append(f"grips: {grips}, {'which close' if grips == 'fingers' else 'by its name'}")
    return grips


def _grasp(
    tool: str,
    middle: Float[np.ndarray, "3"],
    tip: float,
    approach: Float[np.ndarray, "3"],
    notes: list[str],
) -> Float[np.ndarray, "3"] | None:
    """Where things are held, in the tool's frame [m], if that is not where the tool link is."""
    aside = float(np.linalg.norm(middle - (middle @ approach) * approach))
    if -0.02 <= tip <= 0.1 and aside < ASIDE:
        return None
    where = f"{abs(tip):.2f} m {'behind' if tip > 0 else 'beyond'} the finger tips"
    if -0.02 <= tip <= 0.1:
        where = f"{aside:.2f} m beside the fingers"
    grasp = middle + (tip - 0.02 - middle @ approach) * approach
    notes.append(
        f"{tool} lies {where}, but the tool frame must be where things are held: the robot file "
        f"adds one at {listed(grasp)} in {tool}"
    )
    return grasp


def _snap(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The unit vector, or the frame's axis where that is within 18 degrees."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(abs(v)))
    return np.sign(v[k]) * np.eye(3)[k] if abs(v[k]) > 0.95 else v


def listed(v: Float[np.ndarray, " n"]) -> str:
    """Write numbers as a TOML list."""
    return f"[{', '.join(f'{x:.7g}' for x in np.round(v, 6) + 0.0)}]"
