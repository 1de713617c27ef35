"""Guess the gripper of a robot from names and from the geometry of its fingers."""

from __future__ import annotations

import re
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert, orthonormal
from momapos.model.urdf import Articulated, Hull, Joint

from .fingers import MAX_PAD_ANGLE, THUMB, TIP_LENGTH, Stroke, jaws, widest

if TYPE_CHECKING:
    from jaxtyping import Float

FINGER = re.compile(
    r"finger|thumb|knuckle|phalanx|crank|jaw|claw|(left|right|[lr])_?gripper|gripper_?(left|right)",
    re.I,
)
HAND = re.compile(
    r"tool|tcp|grasp|gripper|hand|palm|end_?effector|(^|_)eef?(_|$)|vacuum|suction|magnet", re.I
)
_TOOLS = tuple(
    re.compile(pattern, re.I)
    for pattern in (
        r"tcp|tool_?center", r"grasp", r"(^|_)tool", r"(^|_)eef?(_|$)|end_?effector",
        r"suction|vacuum|magnet", r"gripper", r"hand|palm",
    )
)  # fmt: skip
"""Name patterns of tool frames, the best first."""
_SUCTION, _HOOK = re.compile(r"suction|vacuum|magnet", re.I), re.compile(r"hook", re.I)
MAX_TOOL_OFFSET = 0.03
"""Maximum distance of the tool link from the center between the fingers [m]."""
TIP_RANGE = (-0.02, 0.1)
"""Distances of the tool link behind the fingertips at which it counts as the grasp center; the ends
themselves do not count, so that rounding does not decide about hands of round numbers [m]."""
MAX_RIM = 0.005
"""Depth of the rim of a suction cup, distance of the tool link that counts as at it, and depth in a
palm at which a tool link counts as in it [m]."""
MIN_LEANING = 0.01
"""Further gap of leaning fingers that is reported [m]."""
ASSUMED_OPENING = 0.08
"""Assumed opening of a gripper whose geometry does not show it [m]."""


def joints_below(model: Articulated, link: str) -> list[Joint]:
    """Return the child joints of a link."""
    return [joint for joint in model.urdf.joints if joint.parent == link]


def fixed_to(model: Articulated, link: str) -> list[str]:
    """Return the link and everything fixed to it, parents first."""
    links = [link]
    for name in links:
        links += [joint.child for joint in joints_below(model, name) if not joint.movable]
    return links


def points_of(model: Articulated, frame: str, links: Iterable[str]) -> Float[np.ndarray, "n 3"]:
    """Return the hull vertices of links at rest, in the frame of a link [m]."""
    poses = model.rest_poses
    T = invert(poses[frame])
    points = [apply(T @ poses[name], h.vertices) for name in links for h in model.hulls[name]]
    return np.concatenate(points) if points else np.zeros((0, 3))


def find_tool(model: Articulated, last: str, notes: list[str]) -> tuple[str, list[str], list[str]]:
    """Find the tool link, the links of the gripper, and the first links of its fingers.

    Args:
        model: The robot.
        last: Link that the arm's last joint moves.
        notes: Receives the assumptions.
    """
    hand = fixed_to(model, last)
    found = [[name for name in hand if pattern.search(name)] for pattern in _TOOLS]
    matches = next((names for names in found if names), [])
    tool = matches[-1] if matches else hand[-1]
    why = "by its name" if matches else "the last link of the arm, since no name indicates a tool"
    notes.append(f"tool_link: {tool}, {why}")
    roots = [j.child for name in hand for j in joints_below(model, name) if j.movable]
    fingers = _without_linkages(model, last, roots)
    if len(fingers) < len(roots):
        linkages = [name for name in roots if name not in fingers]
        notes.append(f"fingers: {', '.join(fingers)}; {', '.join(linkages)} are linkages")
    moving = [name for root in roots for name in model.links_below(root)]
    palms = {joint.parent for joint in model.urdf.joints if joint.child in roots}
    own = [name for name in hand if HAND.search(name) or FINGER.search(name)]
    held = [name for name in hand if name in palms or (name != last and name in own)]
    gripper = [*(held or hand[1:]), *moving]
    gripper = [name for name in gripper if model.urdf.links[name].collisions] or [last]
    notes.append(f"gripper_links, which may touch a held object: {', '.join(gripper)}")
    return tool, gripper, fingers


def _without_linkages(model: Articulated, last: str, roots: Sequence[str]) -> list[str]:
    """Return the first links of fingers: those that reach as far as the tips, or have no shape.

    Rods and cranks of a linkage end well behind the tips. A thumb does, too, but has a name.
    """
    points = {name: points_of(model, last, model.links_below(name)) for name in roots}
    shaped = [name for name in roots if len(points[name])]
    if len(shaped) < 3 or any(map(THUMB.search, roots)):
        return list(roots)
    middles = np.array([(points[n].min(0) + points[n].max(0)) / 2 for n in shaped])
    along = middles.mean(0)
    if np.linalg.norm(along) < 1e-6:
        return list(roots)
    along /= np.linalg.norm(along)
    reach = {name: float((points[name] @ along).max()) for name in shaped}
    far = [name for name in shaped if reach[name] > max(reach.values()) - TIP_LENGTH]
    return [name for name in roots if name in far] if len(far) > 1 else list(roots)


@dataclass(frozen=True, eq=False)
class GripperGeometry:
    """Approach and closing of a gripper, in the frame of its tool link."""

    approach: Float[np.ndarray, "3"]
    closing: Float[np.ndarray, "3"]
    opening: float
    """Maximum width of an object that fits [m]."""
    grasp: Float[np.ndarray, "3"] | None = None
    """Grasp center [m]; None for the tool link's origin."""
    rest: Mapping[str, float] = field(default_factory=dict)
    """Values of the finger joints at this opening [rad] or [m]."""


def find_grip(
    model: Articulated, last: str, tool: str, fingers: Sequence[str], notes: list[str]
) -> GripperGeometry:
    """Find the approach and closing axes of the gripper, and its opening."""
    back = invert(model.rest_poses[tool]) @ model.rest_poses[last]
    hands = [points_of(model, tool, model.links_below(name)) for name in fingers]
    shaped = [i for i, points in enumerate(hands) if len(points)]
    if len(shaped) == 1:
        jaw = _fixed_jaw(model, last, tool, fingers[shaped[0]])
        if jaw is None:
            return _one_jaw(model, last, tool, fingers[shaped[0]], notes)
        notes.append(f"one jaw moves, {fingers[shaped[0]]}, and closes on the fixed {jaw}")
        fingers = [fingers[shaped[0]], jaw]
        hands = [points_of(model, tool, model.links_below(name)) for name in fingers]
        shaped = [0, 1]
    if not shaped:
        return _bare(model, last, tool, notes)
    if len(shaped) > 2:
        notes.append(
            f"IMPORTANT: a hand of {len(shaped)} fingers is planned as a pinch of two sides; the "
            "URDF does not say how its fingers close together"
        )
    one, other = _opposed(model, [fingers[i] for i in shaped], [hands[i] for i in shaped])
    middle = (one + other) / 2
    if len(shaped) > 2:  # a thumb is next to the other fingers, and shorter
        approach = _snap(other - back[:3, 3])
        across = one - other - ((one - other) @ approach) * approach
        closing = _snap(across) if np.linalg.norm(across) > 0.005 else orthonormal(approach)
    else:
        apart = one - other
        if np.linalg.norm(apart) < 1e-6:  # they rest in each other
            apart = _stroke_of(model, tool, fingers[shaped[0]], middle)
        closing = _snap(apart)
    closing = closing * np.sign(closing[int(np.argmax(abs(closing)))])
    ahead = (other if len(shaped) > 2 else middle) - back[:3, 3]
    ahead = ahead - (ahead @ closing) * closing
    approach = _snap(ahead) if np.linalg.norm(ahead) > 0.01 else orthonormal(closing)
    approach = approach - (approach @ closing) * closing
    approach /= np.linalg.norm(approach)
    axes = np.stack([closing, approach])
    stroke = widest(model, tool, jaws(model, tool, fingers, closing), axes)
    opening = stroke.opening
    words = "measured at the fingertips" if opening else "a guess: the gap is unclear"
    words += _leaning(stroke)
    if stroke.crossing:
        notes.append(
            f"IMPORTANT: {' and '.join(stroke.crossing)} move the fingers through each other and "
            "never apart; check their axes and limits, and set opening"
        )
    if stroke.leaning > opening + MIN_LEANING:
        notes.extend(_curling_tips(model, fingers))
    notes.append(
        f"approach_axis {listed(approach)} points along the fingers, closing_axis "
        f"{listed(closing)} across them; opening {opening or ASSUMED_OPENING:g} m, {words}"
    )
    tip = max(float((hands[i] @ approach).max()) for i in shaped)
    grasp = _grasp(tool, middle, tip, approach, notes, _palm(model, last, tool, fingers))
    return GripperGeometry(approach, closing, opening or ASSUMED_OPENING, grasp, stroke.rest)


def _stroke_of(
    model: Articulated, tool: str, finger: str, at: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the direction in which a finger moves at a point, both in the tool's frame."""
    T = invert(model.rest_poses[tool]) @ model.rest_poses[finger]
    joint = next(j for j in model.urdf.joints if j.child == finger)
    axis = T[:3, :3] @ joint.axis
    return axis if joint.kind == "prismatic" else np.cross(axis, at - T[:3, 3])


def _leaning(stroke: Stroke) -> str:
    """Return how far the tips open with pads that lean too far; "" if hardly farther."""
    if not 0.0 < stroke.opening < stroke.leaning - MIN_LEANING:
        return ""
    return (
        f"; they open to {stroke.leaning:g} m, but lean by more than "
        f"{np.degrees(MAX_PAD_ANGLE):.0f} degrees there, so set opening if wider objects can be "
        "held"
    )


def _curling_tips(model: Articulated, fingers: Sequence[str]) -> Iterator[str]:
    """Report tips that turn with their finger, although they follow it as those of a linkage do.

    A linkage turns the tip against its finger, so that the pads stay parallel. A wrong sign of the
    multiplier makes them curl.
    """
    if any(map(THUMB.search, fingers)) or len(fingers) > 2:
        return
    for finger in fingers:
        root = next(joint for joint in model.joints.values() if joint.child == finger)
        for joint in model.joints.values():
            if joint.parent != finger or joint.mimic is None or joint.kind == "prismatic":
                continue
            ratio = joint.mimic.ratio / (1.0 if root.mimic is None else root.mimic.ratio)
            axis = joint.T_parent_joint[:3, :3] @ joint.axis
            if root.kind != "prismatic" and ratio * (axis @ root.axis) > 0.0:
                yield (
                    f"IMPORTANT: {joint.name} turns the tip in the direction of {root.name}, so "
                    "the pads face each other over a part of the stroke only; check the sign of "
                    "its mimic multiplier, which in a linkage keeps them parallel"
                )


def _palm(model: Articulated, last: str, tool: str, fingers: Sequence[str]) -> list[Hull]:
    """Return the convex bodies of the hand that are no fingers, in the tool's frame."""
    T = invert(model.rest_poses[tool])
    return [
        replace(hull, vertices=apply(T @ model.rest_poses[name], hull.vertices))
        for name in fixed_to(model, last)
        for hull in model.hulls[name]
        if name not in fingers
    ]


def _bare(model: Articulated, last: str, tool: str, notes: list[str]) -> GripperGeometry:
    """Return the geometry of a flange, cup or hook: it approaches along the arm's last axis."""
    T_tool_root = invert(model.rest_poses[tool])
    T = T_tool_root @ model.rest_poses[last]
    joint = next(j for j in model.urdf.joints if j.child == last)
    axis = T[:3, :3] @ joint.axis
    points = points_of(model, tool, fixed_to(model, last))
    # Outward is from the last joint to the tool, or from the joint before, or to the hand's shapes:
    # these lie behind a joint whose frame is in the flange's face.
    before = (T_tool_root @ model.rest_poses[joint.parent])[:3, 3]
    ways = [-T[:3, 3], T[:3, 3] - before, *([points.mean(0) - T[:3, 3]] if len(points) else [])]
    along = next((way @ axis for way in ways if abs(way @ axis) > 0.01), 1.0)
    approach = _snap(axis * np.sign(along))
    closing = orthonormal(approach)
    notes.append(
        f"no fingers: approach_axis {listed(approach)} is the axis of the arm's last joint, "
        f"closing_axis {listed(closing)} is any perpendicular, and the opening of "
        f"{ASSUMED_OPENING} m is a guess"
    )
    held = points_of(model, tool, [n for n in fixed_to(model, last) if _SUCTION.search(n)])
    if not len(held):
        return GripperGeometry(approach, closing, ASSUMED_OPENING)
    tip = float((held @ approach).max())
    rim = held[held @ approach > tip - MAX_RIM]
    cup = (rim.min(0) + rim.max(0)) / 2
    grasp = cup + (tip - cup @ approach) * approach
    if np.linalg.norm(grasp) < MAX_RIM:
        return GripperGeometry(approach, closing, ASSUMED_OPENING)
    notes.append(
        f"{tool} is {np.linalg.norm(grasp):.2f} m from the cup's rim, where it must be: the robot "
        f"file adds a frame at {listed(grasp)} in {tool}"
    )
    return GripperGeometry(approach, closing, ASSUMED_OPENING, grasp)


def _opposed(
    model: Articulated, fingers: Sequence[str], hands: Sequence[Float[np.ndarray, "n 3"]]
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Return the centers of the opposing sides: thumb and fingers, or the two farthest apart."""
    centers = [(points.min(0) + points.max(0)) / 2 for points in hands]
    parts = [len(model.links_below(name)) for name in fingers]
    long = [i for i, count in enumerate(parts) if 2 * count >= max(parts)]
    thumbs = [centers[i] for i in long if THUMB.search(fingers[i])]
    rest = [centers[i] for i in long if not THUMB.search(fingers[i])]
    if thumbs and rest:
        return np.mean(thumbs, axis=0), np.mean(rest, axis=0)
    return max(combinations(centers, 2), key=lambda p: float(np.linalg.norm(p[0] - p[1])))


def _fixed_jaw(model: Articulated, last: str, tool: str, finger: str) -> str | None:
    """Find the link fixed to the hand that a single finger closes on: one of similar reach."""
    back = (invert(model.rest_poses[tool]) @ model.rest_poses[last])[:3, 3]
    moving = points_of(model, tool, model.links_below(finger))
    along = moving.mean(0) - back
    along /= np.linalg.norm(along)
    reach = float((moving @ along).max()) - TIP_LENGTH
    carries = {joint.parent for joint in model.urdf.joints}
    found = {
        name: float((points_of(model, tool, [name]) @ along).max())
        for name in fixed_to(model, last)
        if name != last and name not in carries and model.hulls[name]
    }
    best = max(found, key=lambda name: found[name], default=None)
    return best if best is not None and found[best] > reach else None


def _one_jaw(
    model: Articulated, last: str, tool: str, finger: str, notes: list[str]
) -> GripperGeometry:
    """Return the geometry of a gripper with one moving jaw, which closes on the hand."""
    joint = next(j for j in model.urdf.joints if j.child == finger)
    back = (invert(model.rest_poses[tool]) @ model.rest_poses[last])[:3, 3]
    points = points_of(model, tool, model.links_below(finger))
    tip = points[int(np.argmax(np.linalg.norm(points - back, axis=1)))]
    way = _stroke_of(model, tool, finger, tip)
    closing = _snap(way)
    closing = closing * np.sign(closing[int(np.argmax(abs(closing)))])
    ahead = tip - back
    approach = _snap(ahead - (ahead @ closing) * closing)
    approach = approach - (approach @ closing) * closing
    approach /= np.linalg.norm(approach)
    span = joint.upper - joint.lower
    radius = float(np.linalg.norm(way))
    travel = span if joint.kind == "prismatic" else 2 * radius * np.sin(min(span, np.pi) / 2)
    opening = round(float(travel), 3) if 0.005 < travel < 0.5 else ASSUMED_OPENING
    words = "the travel of its tip"
    others = points_of(model, tool, fixed_to(model, last))
    stroke = Stroke()
    if len(others) and (others @ approach).max() > tip @ approach - TIP_LENGTH:
        axes = np.stack([closing, approach])
        sides = ((finger,), (last,)), ((last,), (finger,))
        stroke = max((widest(model, tool, s, axes) for s in sides), key=lambda s: s.opening)
    if stroke.opening:
        opening = stroke.opening
        words = f"measured between its tip and the fixed side{_leaning(stroke)}"
    notes.append(
        f"one jaw moves, {finger}: approach_axis {listed(approach)}, closing_axis "
        f"{listed(closing)}; opening {opening:g} m, {words}"
    )
    ahead_of_tool = float(tip @ approach)
    grasp = _grasp(tool, tip - (tip @ closing) * closing, ahead_of_tool, approach, notes)
    rest = dict(stroke.rest)
    if not rest and joint.kind == "prismatic" and np.isfinite(span):  # away from the fixed side
        near = others[others @ approach > tip @ approach - TIP_LENGTH]
        facing = near.mean(0) if len(near) else back
        rest[joint.name] = joint.upper if (tip - facing) @ way > 0 else joint.lower
    return GripperGeometry(approach, closing, opening, grasp, rest)


def find_grips(
    model: Articulated,
    last: str,
    fingers: Sequence[str],
    drawn: Collection[str],
    notes: list[str],
) -> str:
    """Return what a tool holds with, as in robot files: fingers, suction or hook.

    Moving fingers close; a tool without any is a suction cup or a hook by its name.

    Args:
        model: The robot.
        last: Link that the arm's last joint moves.
        fingers: First links of its fingers.
        drawn: Links with a shape, drawn ones too.
        notes: Receives the assumptions.
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
        only = [n for name in fingers for n in model.links_below(name) if n in drawn]
        help_ = (
            f"its fingers ({', '.join(only)}) are only drawn: with --visual-hulls of momapos robot "
            "check, or visual_hulls = true in the robot file, the hulls of their drawings count"
            if only
            else "use a URDF with the gripper, or set grips to suction or hook"
        )
        notes.append(
            "IMPORTANT: grips: no finger with a collision shape moves, so the tool holds nothing; "
            + help_
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
    palm: Sequence[Hull] = (),
) -> Float[np.ndarray, "3"] | None:
    """Return the grasp center in the tool's frame [m]; None if the tool link is there.

    It is not there if it is in one of the convex bodies of the palm, also in the tool's frame.
    """
    aside = float(np.linalg.norm(middle - (middle @ approach) * approach))
    between = TIP_RANGE[0] < round(tip, 6) < TIP_RANGE[1]
    within = any(_is_inside(hull) for hull in palm)
    if between and aside < MAX_TOOL_OFFSET and not within:
        return None
    where = f"{abs(tip):.2f} m {'behind' if tip > 0 else 'beyond'} the fingertips"
    if between:
        where = "in the palm" if within else f"{aside:.2f} m to the side of the fingers"
    grasp = middle + (tip - 0.02 - middle @ approach) * approach
    notes.append(
        f"{tool} is {where}, but the tool frame must be at the grasp center: the robot file adds a "
        f"frame at {listed(grasp)} in {tool}"
    )
    return grasp


def _is_inside(hull: Hull) -> bool:
    """Return whether the origin is inside a convex body, and not only at its surface."""
    a, b, c = hull.vertices[hull.faces].transpose(1, 0, 2)
    normal, middle = np.cross(b - a, c - a), hull.vertices.mean(0)
    outward = np.sign(((a - middle) * normal).sum(1))
    depth = outward * (a * normal).sum(1)
    return bool((depth > MAX_RIM * np.linalg.norm(normal, axis=1)).all())


def _snap(v: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """Return the unit vector, snapped to a frame axis within 18 degrees."""
    v = v / np.linalg.norm(v)
    k = int(np.argmax(abs(v)))
    return np.sign(v[k]) * np.eye(3)[k] if abs(v[k]) > 0.95 else v


def listed(v: Float[np.ndarray, " n"]) -> str:
    """Format numbers as a TOML list."""
    return f"[{', '.join(f'{x:.7g}' for x in np.round(v, 6) + 0.0)}]"
