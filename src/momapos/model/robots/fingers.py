"""Opening and closing force of a gripper, from its joints and shapes."""

from __future__ import annotations

import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import apply, invert
from momapos.model.urdf import Articulated, slab

if TYPE_CHECKING:
    from jaxtyping import Bool, Float

THUMB = re.compile("thumb", re.I)
TIP_LENGTH = 0.03
"""Length of a fingertip that counts for the opening [m]."""
MAX_PAD_ANGLE = 0.2
"""Maximum angle between a pad and the face of a flat object that it still holds [rad]."""
MIN_PAD_COSINE = 0.5
"""Minimum cosine between a pad's normal and the closing axis, where the tips meet [-]."""
MIN_FLAT_COSINE, MIN_FLAT_SHARE = 0.996, 0.3
"""Cosine above which faces are one flat face (5 degrees), and the share of a tip's inner area that
makes it the pad [-]; round tips have none."""
_SAME_LEAN = 0.02
"""Difference of angles below which pads count as equally parallel [rad]."""
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
    crossing: tuple[str, ...] = ()
    """Joints that move the tips through each other and never apart, which no gripper does."""


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
    also with these reversed. Pads count while they face each other, within `MAX_PAD_ANGLE`.

    Args:
        model, tool: The robot, and the frame of the axes.
        sides: Fingers of both sides, as from `jaws`; a fixed side may carry the other.
        axes: Closing axis and approach axis.
    """
    best, leaning, crossing = Stroke(), 0.0, dict[str, None]()
    for closing in _closings(model, tool, sides, axes):
        gap, k = closing.gap, closing.widest
        if gap.max() < PLAUSIBLE_OPENINGS[0] and gap.min() < -PLAUSIBLE_OPENINGS[0]:
            crossing |= dict.fromkeys(closing.names)
        leaning = max(leaning, float(gap[gap < PLAUSIBLE_OPENINGS[1]].max(initial=0.0)))
        if best.opening < gap[k] and PLAUSIBLE_OPENINGS[0] < gap[k] < PLAUSIBLE_OPENINGS[1]:
            values = {} if _has_thumb(sides) else _rounded(model, closing.values(k))
            best = Stroke(float(gap[k]), values)
    opening, crossing = round(best.opening, 3), {} if best.opening else crossing
    return Stroke(opening, best.rest, round(leaning, 3), tuple(crossing))


def _rounded(model: Articulated, values: Mapping[str, float]) -> dict[str, float]:
    """Return joint values with 4 decimals, but none beyond its limits."""
    joints = {name: model.joint(name) for name in values}
    return {
        name: min(max(round(value, 4), joints[name].lower), joints[name].upper)
        for name, value in values.items()
    }


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
    best: tuple[Sequence[str], np.ndarray, np.ndarray] = ([], np.zeros((0, 0)), np.zeros(0))
    for closing in [] if _has_thumb(sides) else _closings(model, tool, sides, axes):
        gap, first = closing.gap, closing.widest
        step = 1 if int(np.argmin(gap)) > first else -1
        rows = np.arange(first, len(gap) if step > 0 else -1, step)
        shrinks = closing.holds[rows] & (np.diff(gap[rows], prepend=np.inf) < 0.0)
        rows = rows[: len(rows) if shrinks.all() else int(np.argmin(shrinks))]
        if len(rows) and gap[first] > best[2].max(initial=0.0):
            best = closing.names, closing.states[rows], gap[rows]
    names, states, gap = best
    return tuple(names), states, gap


def facing(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[dict[str, float], float]:
    """Find the state in which the pads of rotating fingers are parallel, closest to contact.

    Returns:
        Values of their joints, and the width of the gap at rest [m].
    """
    found = []
    for closing in _closings(model, tool, sides, axes):
        near = np.abs(closing.gap)
        parallel = closing.lean <= closing.lean.min() + _SAME_LEAN
        k = int(np.argmin(np.where(parallel, near, np.inf)))
        found.append((near.min(), closing.values(k)))
    _, values = min(found, key=lambda one: one[0])
    poses = model.link_poses({})
    return values, _gap(model, invert(poses[tool]), poses, sides, axes)[0]


@dataclass(frozen=True, eq=False)
class _Closing:
    """How the fingers of two sides close, from one end of their joints to the other."""

    names: Sequence[str]
    states: Float[np.ndarray, "m n"]
    gap: Float[np.ndarray, " m"]
    """Distance between the tips [m], negative if they overlap."""
    lean: Float[np.ndarray, " m"]
    """Largest angle between a pad and the closing axis [rad]; 0 where the hand has a thumb."""

    @property
    def holds(self) -> Bool[np.ndarray, " m"]:
        """Mark the states in which the pads can hold; at least the one with the least lean."""
        return np.asarray(self.lean <= max(MAX_PAD_ANGLE, float(self.lean.min())))

    @property
    def widest(self) -> int:
        """Return the index of the widest gap of the states in which the pads can hold."""
        return int(np.argmax(np.where(self.holds, self.gap, -np.inf)))

    def values(self, k: int, digits: int = 12) -> dict[str, float]:
        """Return the values of the joints in a state."""
        return dict(zip(self.names, np.round(self.states[k], digits).tolist(), strict=True))


def _has_thumb(sides: tuple[Sequence[str], Sequence[str]]) -> bool:
    return any(THUMB.search(name) for side in sides for name in side)


def _closings(
    model: Articulated,
    tool: str,
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> Iterator[_Closing]:
    for names, states in _strokes(model, sides):
        every = [model.link_poses(dict(zip(names, q, strict=True))) for q in states.tolist()]
        found = [_gap(model, invert(poses[tool]), poses, sides, axes) for poses in every]
        gap = np.array([one[0] for one in found])
        met = int(np.argmin(np.abs(gap)))
        pads = []
        for link, inward in zip(found[met][1], (-axes[0], axes[0]), strict=True):
            if _has_thumb(sides) or _is_compliant(model, link, sides):
                pads.append(np.broadcast_to(inward, (len(gap), 3)))
                continue
            Ts = np.array([invert(poses[tool]) @ poses[link] for poses in every])
            pads.append(Ts[:, :3, :3] @ _pad_normal(model, link, Ts[met], inward, axes))
        one, other = pads
        cosines = [one @ -axes[0], other @ axes[0]]
        lean = np.arccos(np.clip(cosines, -1.0, 1.0)).max(0)
        if _carries(model, sides):  # the object turns half of the angle between jaw and hand
            lean = np.arccos(np.clip(-(one * other).sum(-1), -1.0, 1.0)) / 2
        yield _Closing(names, states, gap, lean)


def _carries(model: Articulated, sides: tuple[Sequence[str], Sequence[str]]) -> bool:
    """Return whether one side carries the other: a jaw that closes on the hand."""
    one, other = ({n for name in side for n in model.links_below(name)} for side in sides)
    return bool(one & other)


def _is_compliant(
    model: Articulated, link: str, sides: tuple[Sequence[str], Sequence[str]]
) -> bool:
    """Return whether a tip is a separate link on a turning finger, whose pads stay facing.

    Soft cups and flexible strips are modeled so; see `hand_openings.pivots`. Tips of linkages turn
    themselves.
    """
    joint = next(j for j in model.urdf.joints if j.child == link)
    driver = next((j for j in model.joints.values() if j.child == joint.parent), None)
    if joint.movable or driver is None or driver.kind == "prismatic" or driver.mimic is not None:
        return False
    return any(driver.child == name for side in sides for name in side)


def _pad_normal(
    model: Articulated,
    link: str,
    T_tool_link: Float[np.ndarray, "4 4"],
    inward: Float[np.ndarray, "3"],
    axes: Float[np.ndarray, "2 3"],
) -> Float[np.ndarray, "3"]:
    """Return the normal of a pad in the frame of its link: of the largest flat face of the tip.

    Args:
        model, link: The tip.
        T_tool_link: Its pose where the tips meet.
        inward: Unit vector to the other side, in the tool frame.
        axes: Closing axis and approach axis.

    Returns:
        The unit normal; `inward` where the tips meet for round tips.
    """
    T = T_tool_link
    hulls = [_points(T, hull.vertices)[hull.faces] for hull in model.hulls[link]]
    middle = np.concatenate([np.broadcast_to(f.reshape(-1, 3).mean(0), (len(f), 3)) for f in hulls])
    faces = np.concatenate(hulls)
    normal = np.cross(faces[:, 1] - faces[:, 0], faces[:, 2] - faces[:, 0])
    outward = np.sign(((faces.mean(1) - middle) * normal).sum(1, keepdims=True))
    normal *= outward / np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    height = faces @ axes[1]
    area = _area_above(faces, height - (height.max() - TIP_LENGTH))
    area = np.where(normal @ inward > MIN_PAD_COSINE, area, 0.0)
    alike = normal @ normal.T > MIN_FLAT_COSINE
    shared = alike @ area
    best = int(np.argmax(shared))
    pad = inward
    if shared[best] > MIN_FLAT_SHARE * area.sum() > 0.0:
        pad = (area * alike[best]) @ normal
        pad = pad / np.linalg.norm(pad)
    return np.asarray(T[:3, :3].T @ pad)


def _area_above(
    faces: Float[np.ndarray, "f 3 3"], height: Float[np.ndarray, "f 3"]
) -> Float[np.ndarray, " f"]:
    """Return the area of the part of each triangle with a height above zero [m^2]."""
    a, b, c = faces.transpose(1, 0, 2)
    area = np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2
    low, middle, high = np.sort(height, axis=1).T
    with np.errstate(divide="ignore", invalid="ignore"):
        tip = high**2 / ((high - low) * (high - middle))
        base = 1.0 - low**2 / ((high - low) * (middle - low))
    share = np.where(middle > 0.0, base, tip)
    share = np.where(low >= 0.0, 1.0, np.where(high <= 0.0, 0.0, share))
    return np.asarray(area * share)


def _strokes(
    model: Articulated, sides: tuple[Sequence[str], Sequence[str]]
) -> list[tuple[list[str], Float[np.ndarray, "m n"]]]:
    """Return the names of the finger joints, and their states from one end to the other."""
    one, other = ({n for name in side for n in model.links_below(name)} for side in sides)
    moving, hand = one & other or one | other, one | other  # a fixed side may carry the other
    leaders = {
        joint.name if joint.mimic is None else joint.mimic.joint
        for joint in model.joints.values()
        if joint.child in moving
    }
    movers = [
        joint
        for joint in model.joints.values()
        if joint.name in leaders
        and np.isfinite(joint.upper - joint.lower)
        and not hand.issubset(model.links_below(joint.child))  # it moves the whole hand
    ]
    lower, upper = (np.array([getattr(j, end) for j in movers]) for end in ("lower", "upper"))
    flipped = np.abs(lower) > np.abs(upper)
    ends = [(lower, upper), (np.where(flipped, upper, lower), np.where(flipped, lower, upper))]
    if (ends[0][0] == ends[1][0]).all():
        ends = ends[:1]
    share = np.linspace(0.0, 1.0, _STATES)[:, None]
    return [([j.name for j in movers], begin + share * (end - begin)) for begin, end in ends]


def _gap(
    model: Articulated,
    T_tool_root: Float[np.ndarray, "4 4"],
    poses: Mapping[str, Float[np.ndarray, "4 4"]],
    sides: tuple[Sequence[str], Sequence[str]],
    axes: Float[np.ndarray, "2 3"],
) -> tuple[float, list[str]]:
    """Return the gap between the tips of two sides [m], negative if they overlap.

    Returns:
        The gap, and the link at the tip of each side.
    """
    ends, tips = [], []
    for side, others in (sides, sides[::-1]):
        # The thumb of a hand is shorter, so the whole fingers count.
        near = np.inf if any(map(THUMB.search, side)) or len(side) > 2 else TIP_LENGTH
        away = {n for o in others for n in model.links_below(o)} - set(side)
        links = [
            n for name in side for n in model.links_below(name) if model.hulls[n] and n not in away
        ]
        reach = {
            n: max(
                float((_points(T_tool_root @ poses[n], h.vertices) @ axes[1]).max())
                for h in model.hulls[n]
            )
            for n in links
        }
        first = max(reach, key=lambda n: reach[n])
        points = [
            slab(_points(T_tool_root @ poses[n], h.vertices), h.faces, axes[1], reach[first] - near)
            for n in links
            for h in model.hulls[n]
        ]
        across = np.concatenate(points) @ axes[0]
        ends.append((float(across.min()), float(across.max())))
        tips.append(first)
    return ends[0][0] - ends[1][1], tips


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
