"""How the fingers of a gripper open and how hard they close, as their joints and shapes tell."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.urdf import Articulated, slab

if TYPE_CHECKING:
    from jaxtyping import Float

THUMB = re.compile("thumb", re.I)
NEAR_TIP = 0.03
"""What is this near to the tip of a finger counts for the opening [m]."""
LEAN = 0.2
"""Pads that lean from facing each other by less still meet what is flat with their faces [rad]."""
OPENINGS = (0.005, 0.5)
"""Between these lies how far grippers open [m]."""
FORCES = (5.0, 400.0)
"""Closing forces that grippers have [N]; other effort limits are placeholders."""
WEAK = 40.0
"""A gripper that closes with less cannot hold against the seal of a fridge [N]."""
_STATES = 61
"""States of the fingers that are looked at, from one end of their joints to the other [-]."""
_STEP = 1e-3
"""Step of a joint over which the way of a tip is measured [rad] or [m]."""
_LEAST_LEVER = 0.01
"""Joints whose tip moves less along the closing axis do not close a finger [m/rad] or [-]."""
_SAME = 1e-3
"""Fingers whose joints begin within this of each other are told apart by their shapes [m]."""


@dataclass(frozen=True)
class Stroke:
    """How far a gripper opens."""

    opening: float = 0.0
    """Widest thing that fits [m]; 0 where the geometry does not tell."""
    rest: Mapping[str, float] = field(default_factory=dict)
    """Where the joints of its fingers are then [rad] or [m]."""


def jaws(
    model: Articulated, tool: str, fingers: Sequence[str], closing: Float[np.ndarray, "3"]
) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The fingers on both sides of a gripper, those farther along its closing axis first.

    A hand closes between its thumbs and its other fingers. Other fingers are sorted by where they
    are hinged: at rest they may be anywhere, and cross each other.
    """
    poses = model.rest_poses
    T = invert(poses[tool])
    shaped = [name for name in fingers if any(model.hulls[n] for n in model.links_below(name))]
    if not shaped:
        return (), ()
    hinge = np.array([(T @ poses[name])[:3, 3] @ closing for name in shaped])
    middle = np.array([np.mean(_span(model, tool, name, poses, closing)) for name in shaped])
    at = hinge if np.ptp(hinge) > _SAME else middle
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
    """The widest gap between the tips of two sides over what their joints can take.

    All joints go from one end to the other together; where the limits of some have the opposite
    sign, also these the other way. Pads that turn as they open count while they
    still face each other.

    Args:
        model, tool: The robot, and the frame that the axes are in.
        sides: Fingers above and below, as `jaws` sorts them.
        axes: The closing axis and the approach axis.
    """
    thumb = any(THUMB.search(name) for side in sides for name in side)
    best = Stroke()
    for names, states in _ways(model, sides):
        gap, pads = _gaps(model, tool, sides, names, states, axes)
        met = pads[int(np.argmin(np.abs(gap)))]
        lean = np.arccos(np.clip((pads * met).sum(-1), -1.0, 1.0)).max(-1)
        holds = np.flatnonzero(thumb | (lean <= LEAN))
        k = holds[int(np.argmax(gap[holds]))]
        if best.opening < gap[k] and OPENINGS[0] < gap[k] < OPENINGS[1]:
            rest = {} if thumb else dict(zip(names, np.round(states[k], 4).tolist(), strict=True))
            best = Stroke(float(gap[k]), rest)
    return Stroke(round(best.opening, 3), best.rest)


def facing(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[dict[str, float], float]:
    """Where the pads of fingers that turn face each other: as near to meeting as they come.

    Returns:
        Values of their joints, and how wide the gap is at rest [m].
    """
    found = []
    for names, states in _ways(model, sides):
        gap, _ = _gaps(model, tool, sides, names, states, axes)
        k = int(np.argmin(np.abs(gap)))
        found.append((abs(gap[k]), dict(zip(names, states[k].tolist(), strict=True))))
    _, values = min(found, key=lambda one: one[0])
    return values, _gap(model, tool, sides, {}, axes)[0]


def _ways(
    model: Articulated, sides: tuple[Sequence[str], Sequence[str]]
) -> list[tuple[list[str], Float[np.ndarray, "m n"]]]:
    """Names of the fingers' joints, and states of them from one end to the other."""
    inside = {link for side in sides for name in side for link in model.links_below(name)}
    movers = [
        joint
        for joint in model.joints.values()
        if joint.child in inside and joint.mimic is None and np.isfinite(joint.upper - joint.lower)
    ]
    lower, upper = (np.array([getattr(j, end) for j in movers]) for end in ("lower", "upper"))
    flipped = np.abs(lower) > np.abs(upper)
    ends = [(lower, upper), (np.where(flipped, upper, lower), np.where(flipped, lower, upper))]
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
    """What `_gap` says of some states."""
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
    """The gap between the tips of two sides [m], negative where they overlap.

    Returns:
        The gap, and the closing axis in the frame of the link at each tip.
    """
    poses = model.link_poses(values)
    T = invert(poses[tool])
    ends, pads = [], []
    for side in sides:
        # Of a hand with a thumb, which is shorter, all counts.
        near = np.inf if any(map(THUMB.search, side)) or len(side) > 2 else NEAR_TIP
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
    """The force that each finger closes with, by the effort limits of their joints [N].

    A joint's effort, divided by how far the tip of its finger moves along the closing axis for a
    step of it; joints that move the tip elsewhere, as those that spread fingers, say nothing.

    Returns:
        None where the URDF gives none that a gripper could have.
    """
    found: dict[str, float] = {}
    for finger in (name for side in sides for name in side):
        below = set(model.links_below(finger))
        for joint in model.joints.values():
            if joint.child in below and joint.mimic is None and np.isfinite(joint.effort):
                lever = _lever(model, tool, finger, joint.name, axes)
                if lever > _LEAST_LEVER:
                    found[joint.name] = joint.effort / lever
    usable = {name: force for name, force in found.items() if FORCES[0] <= force <= FORCES[1]}
    if not usable:
        notes.append("force: no URDF limits say how strong the gripper is; give tool.force")
        return None
    name = min(usable, key=lambda key: usable[key])
    weak = "; doors need more: what does the gripper's data sheet say?"
    notes.append(
        f"force: {usable[name]:.0f} N of each finger, from the effort limit of {name}"
        f"{weak if usable[name] < WEAK else ''}"
    )
    return round(usable[name], 1)


def _lever(
    model: Articulated, tool: str, finger: str, joint: str, axes: Float[np.ndarray, "2 3"]
) -> float:
    """How far the tip of a finger moves along the closing axis for a step of a joint."""
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
    """From where to where a finger is along an axis of the tool's frame [m]."""
    T = invert(poses[tool])
    across = np.concatenate(
        [
            _points(T @ poses[n], h.vertices) @ axis
            for n in model.links_below(finger)
            for h in model.hulls[n]
        ]
    )
    return float(across.min()), float(across.max())
