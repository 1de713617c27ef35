"""Opening and closing force of a gripper, from its joints and shapes."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.urdf import Articulated, slab

if TYPE_CHECKING:
    from jaxtyping import Float, Int

THUMB = re.compile("thumb", re.I)
TIP_LENGTH = 0.03
"""Length of a fingertip that counts for the opening [m]."""
MAX_PAD_ANGLE = 0.2
"""Maximum angle between pads that can still hold a flat object with their faces [rad]."""
PLAUSIBLE_OPENINGS = (0.005, 0.5)
"""Range of plausible openings of a gripper [m]."""
PLAUSIBLE_FORCES = (5.0, 400.0)
"""Range of plausible closing forces [N]; other effort limits are placeholders."""
MIN_DOOR_FORCE = 40.0
"""Closing force below which a gripper cannot open a fridge with a seal [N]."""
_STATES = 61
"""Number of finger states between the ends of their joints [-]."""
_STEP = 1e-3
"""Step of a joint for the derivative of a fingertip's position [rad] or [m]."""
_MIN_LEVER = 0.01
"""Minimum motion of a fingertip along the closing axis per motion of a closing joint [m/rad] or
[-]."""
_MIN_ORIGIN_SPREAD = 1e-3
"""Maximum distance between finger joints that are distinguished by shapes instead [m]."""


@dataclass(frozen=True)
class Stroke:
    """Opening of a gripper."""

    opening: float = 0.0
    """Maximum width of an object that fits [m]; 0 if the geometry does not show it."""
    rest: Mapping[str, float] = field(default_factory=dict)
    """Values of the finger joints at this opening [rad] or [m]."""
    leaning: float = 0.0
    """Widest plausible gap of the tips, however far the pads lean there [m]."""


def jaws(
    model: Articulated, tool: str, fingers: Sequence[str], closing: Float[np.ndarray, "3"]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Split the fingers into the two sides of a gripper, along its closing axis.

    A hand closes between its thumbs and its other fingers. Other fingers are sorted by their joint
    origins, because at rest they can be anywhere and even cross each other.
    """
    poses = model.rest_poses
    T = invert(poses[tool])
    shaped = [name for name in fingers if any(model.hulls[n] for n in model.links_below(name))]
    if not shaped:
        return (), ()
    hinge = np.array([(T @ poses[name])[:3, 3] @ closing for name in shaped])
    middle = np.array([np.mean(_span(model, tool, name, poses, closing)) for name in shaped])
    at = hinge if np.ptp(hinge) > _MIN_ORIGIN_SPREAD else middle
    thumb = np.array([bool(THUMB.search(name)) for name in shaped])
    if thumb.any() and not thumb.all():
        above = thumb if middle[thumb].mean() > middle[~thumb].mean() else ~thumb
    else:
        above = at > (at.min() + at.max()) / 2
    pick = [tuple(np.array(shaped, object)[rows]) for rows in (above, ~above)]
    return pick[0], pick[1]


def widest(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> Stroke:
    """Return the widest gap between the tips of two sides over their joint limits.

    All joints move together from one end to the other; if the limits of some have opposite signs,
    also with these reversed. Rotating pads count while they still face each other.

    Args:
        model, tool: The robot, and the frame of the axes.
        sides: Fingers of both sides, as from `jaws`.
        axes: Closing axis and approach axis.
    """
    best, leaning = Stroke(), 0.0
    for names, states in _strokes(model, sides):
        gap, holds = _holding_gaps(model, tool, sides, names, states, axes)
        k = holds[int(np.argmax(gap[holds]))]
        leaning = max(leaning, float(gap[gap < PLAUSIBLE_OPENINGS[1]].max(initial=0.0)))
        if best.opening < gap[k] and PLAUSIBLE_OPENINGS[0] < gap[k] < PLAUSIBLE_OPENINGS[1]:
            values = dict(zip(names, np.round(states[k], 4).tolist(), strict=True))
            best = Stroke(float(gap[k]), {} if _has_thumb(sides) else values)
    return Stroke(round(best.opening, 3), best.rest, round(leaning, 3))


def narrower(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[tuple[str, ...], Float[np.ndarray, "m n"], Float[np.ndarray, " m"]]:
    """Return how fingers close from their widest gap: joints, states and gaps, the widest first.

    The states are those of the stroke with the widest gap, as long as the gap shrinks and the pads
    face each other; none for a hand with a thumb. Arguments are those of `widest`.
    """
    best: tuple[list[str], np.ndarray, np.ndarray] = ([], np.zeros((0, 0)), np.zeros(0))
    for names, states in [] if _has_thumb(sides) else _strokes(model, sides):
        gap, holds = _holding_gaps(model, tool, sides, names, states, axes)
        first = holds[int(np.argmax(gap[holds]))]
        step = 1 if int(np.argmin(gap)) > first else -1
        rows = np.arange(first, len(gap) if step > 0 else -1, step)
        shrinks = np.isin(rows, holds) & (np.diff(gap[rows], prepend=np.inf) < 0.0)
        rows = rows[: len(rows) if shrinks.all() else int(np.argmin(shrinks))]
        if len(rows) and gap[first] > best[2].max(initial=0.0):
            best = names, states[rows], gap[rows]
    names, states, gap = best
    return tuple(names), states, gap


def _has_thumb(sides: tuple[Sequence[str], Sequence[str]]) -> bool:
    return any(THUMB.search(name) for side in sides for name in side)


def _holding_gaps(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    names: Sequence[str],
    states: Float[np.ndarray, "m n"],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[Float[np.ndarray, " m"], Int[np.ndarray, " k"]]:
    """Return the gap at each state, and the states in which the pads can hold."""
    gap, pads = _gaps(model, tool, sides, names, states, axes)
    met = pads[int(np.argmin(np.abs(gap)))]
    lean = np.arccos(np.clip((pads * met).sum(-1), -1.0, 1.0)).max(-1)
    return gap, np.flatnonzero(_has_thumb(sides) | (lean <= MAX_PAD_ANGLE))


def facing(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[dict[str, float], float]:
    """Find the state in which the pads of rotating fingers face each other, closest to contact.

    Returns:
        Values of their joints, and the width of the gap at rest [m].
    """
    found = []
    for names, states in _strokes(model, sides):
        gap, _ = _gaps(model, tool, sides, names, states, axes)
        k = int(np.argmin(np.abs(gap)))
        found.append((abs(gap[k]), dict(zip(names, states[k].tolist(), strict=True))))
    _, values = min(found, key=lambda one: one[0])
    return values, _gap(model, tool, sides, {}, axes)[0]


def _strokes(
    model: Articulated, sides: tuple[Sequence[str], Sequence[str]]
) -> list[tuple[list[str], Float[np.ndarray, "m n"]]]:
    """Return the names of the finger joints, and their states from one end to the other."""
    inside = {link for side in sides for name in side for link in model.links_below(name)}
    leaders = {
        joint.name if joint.mimic is None else joint.mimic.joint
        for joint in model.joints.values()
        if joint.child in inside
    }
    movers = [
        joint
        for joint in model.joints.values()
        if joint.name in leaders
        and np.isfinite(joint.upper - joint.lower)
        and not inside.issubset(model.links_below(joint.child))  # it moves the whole hand
    ]
    lower, upper = (np.array([getattr(j, end) for j in movers]) for end in ("lower", "upper"))
    flipped = np.abs(lower) > np.abs(upper)
    ends = [(lower, upper), (np.where(flipped, upper, lower), np.where(flipped, lower, upper))]
    if (ends[0][0] == ends[1][0]).all():
        ends = ends[:1]
    share = np.linspace(0.0, 1.0, _STATES)[:, None]
    return [([j.name for j in movers], begin + share * (end - begin)) for begin, end in ends]


def _gaps(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    names: Sequence[str],
    states: Float[np.ndarray, "m n"],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[Float[np.ndarray, " m"], Float[np.ndarray, "m 2 3"]]:
    found = [
        _gap(model, tool, sides, dict(zip(names, q, strict=True)), axes) for q in states.tolist()
    ]
    return np.array([gap for gap, _ in found]), np.array([pads for _, pads in found])


def _gap(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    values: Mapping[str, float],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[float, Float[np.ndarray, "2 3"]]:
    """Return the gap between the tips of two sides [m], negative if they overlap.

    Returns:
        The gap, and the closing axis in the frame of the link at each tip.
    """
    poses = model.link_poses(values)
    T = invert(poses[tool])
    ends, pads = [], []
    for side in sides:
        # The thumb of a hand is shorter, so the whole fingers count.
        near = np.inf if any(map(THUMB.search, side)) or len(side) > 2 else TIP_LENGTH
        links = [n for name in side for n in model.links_below(name) if model.hulls[n]]
        reach = {
            n: max(
                float((_points(T @ poses[n], h.vertices) @ axes[1]).max()) for h in model.hulls[n]
            )
            for n in links
        }
        first = max(reach, key=lambda n: reach[n])
        points = [
            slab(_points(T @ poses[n], h.vertices), h.faces, axes[1], reach[first] - near)
            for n in links
            for h in model.hulls[n]
        ]
        across = np.concatenate(points) @ axes[0]
        ends.append((float(across.min()), float(across.max())))
        pads.append((T @ poses[first])[:3, :3].T @ axes[0])
    return ends[0][0] - ends[1][1], np.array(pads)


def find_force(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
    notes: list[str],
) -> float | None:
    """Derive the closing force of each finger from the effort limits of its joints [N].

    The force is the effort over the motion of the fingertip along the closing axis per motion of
    the joint. Joints that move the tip in other directions, such as a spread, are ignored.

    Returns:
        None if the URDF has no plausible limit.
    """
    found: dict[str, float] = {}
    for finger in (name for side in sides for name in side):
        below = set(model.links_below(finger))
        for joint in model.joints.values():
            if joint.child in below and joint.mimic is None and np.isfinite(joint.effort):
                lever = _lever(model, tool, finger, joint.name, axes)
                if lever > _MIN_LEVER:
                    found[joint.name] = joint.effort / lever
    usable = {
        name: force
        for name, force in found.items()
        if PLAUSIBLE_FORCES[0] <= force <= PLAUSIBLE_FORCES[1]
    }
    if not usable:
        notes.append("force: the URDF has no plausible effort limit; set tool.force")
        return None
    name = min(usable, key=lambda key: usable[key])
    weak = "; doors need more: check the gripper's data sheet"
    notes.append(
        f"force: {usable[name]:.0f} N per finger, from the effort limit of {name}"
        f"{weak if usable[name] < MIN_DOOR_FORCE else ''}"
    )
    return round(usable[name], 1)


def _lever(
    model: Articulated, tool: str, finger: str, joint: str, axes: Float[np.ndarray, "2 3"]
) -> float:
    """Return the motion of a fingertip along the closing axis per motion of a joint."""
    rest = model.rest[joint]
    step = _STEP if rest + _STEP <= model.joint(joint).upper else -_STEP
    poses = model.rest_poses
    T = invert(poses[tool])
    points = {
        n: np.concatenate([h.vertices for h in model.hulls[n]])
        for n in model.links_below(finger)
        if model.hulls[n]
    }
    if not points:
        return 0.0
    reach = {n: (_points(T @ poses[n], points[n]) @ axes[1]).max() for n in points}
    link = max(reach, key=lambda n: reach[n])
    tip = points[link][int((_points(T @ poses[link], points[link]) @ axes[1]).argmax())]
    moved = model.link_poses({joint: rest + step})
    there = _points(invert(moved[tool]) @ moved[link], tip[None])[0]
    return abs(float((there - _points(T @ poses[link], tip[None])[0]) @ axes[0])) / _STEP


def _points(T: Float[np.ndarray, "4 4"], points: Float[np.ndarray, "n 3"]) -> np.ndarray:
    return np.asarray(apply(T, points))


def _span(
    model: Articulated,
    tool: str,
    finger: str,
    poses: Mapping[str, Float[np.ndarray, "4 4"]],
    axis: Float[np.ndarray, "3"],
) -> tuple[float, float]:
    """Return the extent of a finger along an axis of the tool frame [m]."""
    T = invert(poses[tool])
    across = np.concatenate(
        [
            _points(T @ poses[n], h.vertices) @ axis
            for n in model.links_below(finger)
            for h in model.hulls[n]
        ]
    )
    return float(across.min()), float(across.max())
