"""Check that the hand holds the part: fingers on both sides of it, or the tool against it.

Everything comes from the URDF: fingers are the bodies that move in the hand without the tool, and
they close where they approach each other. They close by their joints, from the opening of the plan,
until they touch the part. Elements of the part are convex pieces here, so that there is free space
behind a handle that belongs to a panel's mesh.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import product
from typing import TYPE_CHECKING, TypeAlias

import numpy as np

from momapos.core import owner_cache
from momapos.core.geometry import apply, invert
from momapos.model.records import Family, Motion
from momapos.model.urdf import Articulated

from .exact_shapes import (
    Shapes,
    element_pieces,
    hulls_of,
    join,
    prepared,
    triangle_shapes,
)
from .link_bodies import LinkBodies, bodies_of, body_poses
from .moved_part import MovedPart
from .path_checks import DensePath
from .report import Check, Limits, at_most, verdict
from .robot_collision_model import RobotCollisionModel
from .sweep import all_pairs, deepest, first_contact

if TYPE_CHECKING:
    from jaxtyping import Float

DEPTH_CHECK = "open hand in the part"
HOLD_CHECK = "hand off the part that it holds"
"""It depends on the grasp alone, wherever the robot stands."""
PRESS = 0.002
"""How far pads are pressed on after they touch; rubber yields as much [m]."""
MAX_FACING = -0.5
"""Largest cosine between the motions of two fingers that close on each other [-]."""
STEP = 5e-4
"""Travel of a finger between two states in which it is compared with the part [m]."""
_NUDGE = 0.1
"""Share of a joint's range by which it moves to find the direction in which it closes [-]."""
_NEAR = 0.03
"""Elements of the part farther from the hand are ignored [m]."""
_STILL = 1e-9
"""Smaller motions of a joint or a point don't count [rad] or [m]."""


_Element: TypeAlias = tuple[str, int, bool]
"""Link, index among its collision or visual shapes, and whether it is a visual one."""
_Elements: TypeAlias = tuple[list[_Element], np.ndarray, np.ndarray, np.ndarray]
"""Elements, the body of each, and centers and radii of spheres around them [m]."""


@dataclass(frozen=True, eq=False)
class Path:
    """Shapes of the hand on a path relative to the tool, at states `STEP` or less apart."""

    shapes: Shapes
    Ts_tool_shape: Float[np.ndarray, "k m 4 4"]
    travel: Float[np.ndarray, " k"]
    """How far any point has moved, at most [m]."""
    direction: Float[np.ndarray, "k 3"]
    """Unit direction of the motion at each state, in the tool frame."""


@dataclass(frozen=True, eq=False)
class Hand:
    """What moves with the last joint of the arm, in the tool frame."""

    shapes: Shapes
    Ts_tool_shape: Float[np.ndarray, "m 4 4"]
    center: Float[np.ndarray, "3"]
    radius: float
    """Sphere around all shapes [m]."""
    approach: Float[np.ndarray, "3"]
    """Axis of the tool frame that points out of the hand, most nearly."""
    digits: tuple[Path, ...]
    """Each finger or thumb on its way from the planned opening to the end of its joints."""

    @cached_property
    def closing(self) -> Float[np.ndarray, "3"]:
        """Axis along which two fingers first close on each other, or one on a fixed jaw."""
        starts = np.array([digit.direction[0] for digit in self.digits])
        a, b = np.unravel_index(int((starts @ starts.T).argmin()), (len(starts), len(starts)))
        axis = starts[a] - starts[b] if len(starts) > 1 else starts[0]
        return np.asarray(axis / max(float(np.linalg.norm(axis)), _STILL))

    @cached_property
    def presses(self) -> tuple[Float[np.ndarray, "k 3"], ...]:
        """Return the unit direction in which each digit presses, at each of its states.

        Two sides press against each other along the closing axis, also where linkages carry their
        pads along arcs: what both do along the pads moves the object, and presses nothing.
        """
        if len(self.digits) < 2:
            return tuple(digit.direction for digit in self.digits)
        axis = self.closing
        ways = np.array([digit.direction.sum(0) for digit in self.digits])
        two_sided = (np.abs(ways @ axis) > -MAX_FACING * np.linalg.norm(ways, axis=1)).all()
        return tuple(
            np.sign(digit.direction @ axis)[:, None] * axis if two_sided else digit.direction
            for digit in self.digits
        )

    def pushed(self, direction: Float[np.ndarray, "3"], far: float) -> Path:
        """Return the path of the whole hand straight along a direction [m]."""
        return _straight(self.shapes, self.Ts_tool_shape, direction, far)


@owner_cache()
def hand_of(robot: RobotCollisionModel) -> Hand | None:
    """Return the hand of a robot; None if it has no shape."""
    shapes = robot.arm.take(np.flatnonzero(robot.gripper))
    if not len(shapes):
        return None
    Ts = _in_tool(robot, {})[0][shapes.body] @ shapes.Ts_body_shape
    corners = Ts[:, None, :3, 3] + (Ts[:, None, :3, :3] @ _corners(shapes.half)[..., None])[..., 0]
    low, high = corners.min((0, 1)), corners.max((0, 1))
    middle = (low + high) / 2
    axis = int(np.argmax(np.abs(middle)))
    approach = np.zeros(3)
    approach[axis] = -1.0 if middle[axis] > 0.0 else 1.0
    radius = float(np.linalg.norm(corners - middle, axis=2).max())
    return Hand(shapes, Ts, middle, radius, approach, tuple(_digits(robot, shapes)))


def _in_tool(robot: RobotCollisionModel, values: dict[str, np.ndarray]) -> np.ndarray:
    """Return poses of all bodies in the tool frame, which none of the joints moves."""
    Ts = body_poses(robot.bodies, values, np.eye(4))
    return np.asarray(invert(Ts[:1, robot.tool_body] @ robot.T_body_tool)[:, None] @ Ts)


def _digits(robot: RobotCollisionModel, shapes: Shapes) -> Iterator[Path]:
    """Yield the path of each body chain on the palm that closes, with all that it carries."""
    bodies, palm = robot.bodies, _above(robot.bodies, robot.tool_body)
    root: dict[int, int] = {}
    for body in range(len(bodies)):
        if body not in palm and bodies.parent[body] >= 0:
            root[body] = root.get(bodies.parent[body], body)
    of_shape = np.array([root.get(body, -1) for body in shapes.body.tolist()])
    groups = [np.flatnonzero(of_shape == body) for body in np.unique(of_shape[of_shape >= 0])]
    if not groups:
        return
    ends = _closed_values(robot, shapes, groups, set(root))
    if not ends:
        return
    reach = _placed(robot, shapes, {name: np.array(pair) for name, pair in ends.items()})
    far = np.linalg.norm(reach[1, :, :3, 3] - reach[0, :, :3, 3], axis=1).max()
    turn = max(abs(b - a) for a, b in ends.values())
    count = 2 + math.ceil(max(far, 0.1 * turn) / STEP)
    Ts = _placed(robot, shapes, {name: np.linspace(a, b, count) for name, (a, b) in ends.items()})
    for group in groups:
        path = _path(shapes.take(group), Ts[:, group])
        if path.travel[-1] > STEP:
            yield path


def _above(bodies: LinkBodies, body: int) -> set[int]:
    """Return a body and all that carry it."""
    found = set()
    while body >= 0:
        found.add(body)
        body = bodies.parent[body]
    return found


def _closed_values(
    robot: RobotCollisionModel, shapes: Shapes, groups: list[np.ndarray], moved: set[int]
) -> dict[str, tuple[float, float]]:
    """Return the planned value of each finger joint that closes, and its value at the end.

    A joint closes in the direction in which the fingers come nearer to each other and to the tool's
    origin.
    """
    bodies, found = robot.bodies, dict[str, tuple[float, float]]()

    def spread(values: dict[str, np.ndarray]) -> float:
        center = _placed(robot, shapes, values)[0, :, :3, 3]
        points = np.array([*(center[group].mean(0) for group in groups), np.zeros(3)])
        return float(np.linalg.norm(points - points.mean(0), axis=1).sum())

    for body in sorted(moved):
        joint = bodies.joints[body]
        assert joint is not None
        if joint.mimic is not None or joint.name in robot.joints:
            continue
        rest, span = bodies.rest[joint.name], joint.upper - joint.lower
        if not np.isfinite(span):
            continue
        near, ends = spread({}), (joint.lower, joint.upper)
        nudged = [rest + np.clip(end - rest, -_NUDGE * span, _NUDGE * span) for end in ends]
        away = [spread({joint.name: np.array([value])}) for value in nudged]
        best = int(np.argmin(away))
        if away[best] < near - _STILL:
            found[joint.name] = (rest, ends[best])
    return found


def _placed(
    robot: RobotCollisionModel, shapes: Shapes, values: dict[str, np.ndarray]
) -> Float[np.ndarray, "k m 4 4"]:
    return shapes.placed(_in_tool(robot, values))


def _path(shapes: Shapes, Ts: Float[np.ndarray, "k m 4 4"]) -> Path:
    corners = (Ts[:, :, None, :3, :3] @ _corners(shapes.half)[None, ..., None])[..., 0]
    moved = np.diff(corners + Ts[:, :, None, :3, 3], axis=0)
    travel = np.append(0.0, np.cumsum(np.linalg.norm(moved, axis=3).max((1, 2))))
    step = moved.mean((1, 2))
    length = np.linalg.norm(step, axis=1, keepdims=True)
    direction = np.divide(step, length, out=np.zeros_like(step), where=length > _STILL)
    return Path(shapes, np.ascontiguousarray(Ts), travel, np.append(direction, direction[-1:], 0))


def _straight(
    shapes: Shapes, Ts: Float[np.ndarray, "m 4 4"], direction: Float[np.ndarray, "3"], far: float
) -> Path:
    travel = np.linspace(0.0, far, 1 + math.ceil(far / STEP))
    path = np.repeat(Ts[None], len(travel), axis=0)
    path[:, :, :3, 3] += travel[:, None, None] * direction
    return Path(shapes, path, travel, np.repeat(direction[None], len(travel), axis=0))


def _corners(half: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, "m 8 3"]:
    signs = np.array(np.meshgrid([-1.0, 1.0], [-1.0, 1.0], [-1.0, 1.0])).reshape(3, -1).T
    return np.asarray(half[:, None] * signs)


@dataclass(frozen=True, eq=False)
class _Grasp:
    """The hand and the part at one state."""

    family: Family
    near: Shapes
    """Convex pieces of the part near the hand."""
    Ts_tool_near: Float[np.ndarray, "n 4 4"]
    forward: Float[np.ndarray, "3"] | None
    """Unit direction in which the part moves at the tool's origin, in the tool frame; None if it
    rests."""


class HandChecker:
    """Checks how the hand of a robot holds the part of a task."""

    def __init__(
        self,
        robot: RobotCollisionModel,
        grip_force: float | None,
        part: MovedPart,
        model: Articulated,
        limits: Limits,
    ) -> None:
        self.hand, self.part, self.limits = hand_of(robot), part, limits
        self._grip_force = grip_force
        self._surface = _Surface(part, model)

    def checks(
        self,
        motion: Motion,
        path: DensePath,
        Ts_world_tool: Float[np.ndarray, "s 4 4"],
        Ts_world_body: Float[np.ndarray, "s b 4 4"],
    ) -> Iterator[Check]:
        """Check the hand along a path, and whether it holds the part while it should.

        Both ends of each hold are checked, and its middle if the hand turns about the part. A rigid
        object is held where it is picked up or put down: at the first state.

        Args:
            motion: The motion.
            path: Its states, interpolated.
            Ts_world_tool, Ts_world_body: Poses of the tool and of the part's bodies at each.
        """
        if self.hand is None:
            return
        hand, limits = self.hand, self.limits
        Ts_tool_body = invert(Ts_world_tool)[:, None] @ Ts_world_body
        near = self._surface.near(Ts_tool_body, hand, drawn=False)
        depth, state = _overlap(hand, near, Ts_tool_body)
        deep = path.where(state) if depth > limits.hand_depth else ""
        yield at_most(DEPTH_CHECK, 1000 * depth, 1000 * limits.hand_depth, "mm deep", deep)
        worst = (-math.inf, "", "")
        for family, state in _held_states(motion, path, rigid=self.part.joint is None):
            forward, at = None, Ts_tool_body[state]
            if family.leads or not hand.digits:
                forward = self._forward(family, path, state, Ts_world_tool[state], Ts_world_body)
            gap, why = self._gap(_Grasp(family, near, near.placed(at[None])[0], forward))
            if gap > limits.hand_gap:
                drawn = self._surface.near(at[None], hand, drawn=True)
                grasp = _Grasp(family, drawn, drawn.placed(at[None])[0], forward)
                gap, why = min((gap, why), self._gap(grasp))
            worst = max(worst, (gap, f"{path.where(state)}: {why}", why))
        name, (gap, detail, culprit) = HOLD_CHECK, worst
        if math.isinf(gap) and gap > 0.0:  # it misses the part, however close it comes
            yield replace(verdict(name, False, detail), culprit=culprit)
            return
        bad = gap > limits.hand_gap
        yield at_most(
            name, 1000 * gap, 1000 * limits.hand_gap, "mm",
            detail if bad else "", culprit if bad else "",
        )  # fmt: skip

    def pull_shares(
        self,
        motion: Motion,
        path: DensePath,
        Ts_world_tool: Float[np.ndarray, "s 4 4"],
        force: Float[np.ndarray, "s 3"],
    ) -> Float[np.ndarray, " s"]:
        """Return what pulls at the hand as a share of what the grasp transmits, at each state.

        Friction at both pads carries the pull across the closing axis. The force of one finger
        carries the pull along it, which unloads the other pad. Nothing limits hooks and pushes of
        tools without fingers, and a robot whose grip force is unknown.

        Args:
            motion, path, Ts_world_tool: As for `checks`.
            force: Force on the hand in the world [N].
        """
        hand, grip, friction = self.hand, self._grip_force, self.limits.friction
        shares, size = np.zeros(len(force)), np.linalg.norm(force, axis=1)
        if grip is None or hand is None:
            return shares
        by_fingers = shares
        if hand.digits:
            along = np.abs((Ts_world_tool[:, :3, :3] @ hand.closing * force).sum(1))
            across = np.sqrt(np.maximum(0.0, size**2 - along**2))
            by_friction = (across + friction * along) / (2.0 * friction * grip)
            by_fingers = np.maximum(by_friction, along / grip)
        if self.part.joint is None:
            return by_fingers if hand.digits else size / grip
        for hold in motion.grasps:
            held = (path.at >= hold.first) & (path.at <= hold.last)
            held[: path.approach] = False
            if hold.kind.sticks:
                shares[held] = size[held] / grip
            elif hold.kind.closes:
                shares[held] = by_fingers[held]
        return shares

    def _forward(
        self,
        family: Family,
        path: DensePath,
        state: int,
        T_world_tool: Float[np.ndarray, "4 4"],
        Ts_world_body: Float[np.ndarray, "s b 4 4"],
    ) -> Float[np.ndarray, "3"] | None:
        """Return the unit direction in which the part moves at the tool, in the tool frame.

        What is pushed counts where it is nearest to the tool: a rocker is smaller than the hand.
        Where it rests, that of its next motion counts, or of its last one; None without any.
        """
        part, latch_q, point = self.part, path.latch_q, T_world_tool[:3, 3]
        moves = np.abs(np.diff(path.object_q)) > _STILL
        turns = np.zeros_like(moves) if latch_q is None else np.abs(np.diff(latch_q)) > _STILL
        steps = np.flatnonzero(moves | turns)
        if part.joint is None or not len(steps):
            return None
        step = int(steps[min(int(np.searchsorted(steps, state)), len(steps) - 1)])
        if turns[step] and part.latch is not None:
            body = part.latch.body
        else:
            body = part.nearest_body(point, float(path.object_q[state]))
        here, before, after = Ts_world_body[[state, step, step + 1], body]
        local = here[:3, :3].T @ (point - here[:3, 3])
        if family is Family.PUSH:
            local = part.nearest_point(local, body)
        moved = (after - before)[:3] @ np.append(local, 1.0)
        length = float(np.linalg.norm(moved))
        if length < _STILL:
            return None
        turned = here[:3, :3] @ before[:3, :3].T @ moved
        return np.asarray(T_world_tool[:3, :3].T @ turned / length)

    def _gap(self, grasp: _Grasp) -> tuple[float, str]:
        """Return how far the hand is off a grasp of the family [m], and what is wrong if it is."""
        found, hand = list[tuple[float, str]](), self.hand
        assert hand is not None
        family, far = grasp.family, self.limits.hand_gap + PRESS
        if hand.digits and family.closes:
            found.append(self._fingers_gap(hand, grasp))
        closes = [travel for travel, _ in self._contacts(hand, grasp)]
        hooks = not family.is_one_sided or not closes or min(closes) < math.inf  # not a flat face
        if grasp.forward is not None and not family.sticks and hooks:
            ahead = self._meets(hand.pushed(grasp.forward, far), grasp)[0]
            found.append((ahead, "it is not behind it"))
        if family.sticks or (family is Family.UNSTATED and len(hand.digits) < 2):
            ahead = self._meets(hand.pushed(hand.approach, far), grasp)[0]
            found.append((ahead, "it does not face it"))
        return min(found, default=(math.inf, "no tool that it holds with"))

    def _fingers_gap(self, hand: Hand, grasp: _Grasp) -> tuple[float, str]:
        """Return how far the part is off the middle of two fingers that close on it [m].

        A single finger closes on a fixed jaw, which is then this far from the part.
        """
        contacts = self._contacts(hand, grasp)
        touching = [(travel, along) for travel, along in contacts if np.isfinite(travel)]
        gaps = [
            abs(a - b) / 2
            for k, (a, along) in enumerate(touching)
            for b, other in touching[:k]
            if along @ other < MAX_FACING
        ]
        if len(hand.digits) == 1 and touching:
            jaw = hand.pushed(-touching[0][1], self.limits.hand_gap + PRESS)
            gaps.append(self._meets(jaw, grasp)[0])
        if not gaps:
            most = math.degrees(math.atan(self.limits.friction))
            return math.inf, (
                f"its fingers close past it, or press on it more than {most:.0f} deg off its "
                f"normal (friction {self.limits.friction:g})"
            )
        return min(gaps), "its fingers don't meet it together"

    def _contacts(self, hand: Hand, grasp: _Grasp) -> list[tuple[float, Float[np.ndarray, "3"]]]:
        """Return what `_meets` does for each digit of the hand."""
        pairs = zip(hand.digits, hand.presses, strict=True)
        return [self._meets(digit, grasp, press) for digit, press in pairs]

    def _meets(
        self, path: Path, grasp: _Grasp, press: Float[np.ndarray, "k 3"] | None = None
    ) -> tuple[float, Float[np.ndarray, "3"]]:
        """Return the travel until shapes on a path firmly touch the part [m], and how they press.

        The travel is infinite if they don't, or slip off it: friction holds a pad where it presses
        within the friction cone around the normal of the contact, and not with its edge only.

        Args:
            path: The path.
            grasp: The hand and the part.
            press: Unit direction in which they press at each state; None for that of the motion.
        """
        along = path.direction if press is None else press
        state, bite = first_contact(
            path.shapes, path.Ts_tool_shape, path.travel, grasp.near, grasp.Ts_tool_near,
            PRESS * along,
        )  # fmt: skip
        firm = state >= 0 and bite >= math.cos(math.atan(self.limits.friction))
        return float(path.travel[state]) if firm else math.inf, along[state]


def _held_states(motion: Motion, path: DensePath, *, rigid: bool) -> list[tuple[Family, int]]:
    """Return the family and the states to check of each hold."""
    if rigid:
        return [(Family.UNSTATED, path.approach)]
    found = []
    for hold in motion.grasps:
        states = {hold.first, hold.last}
        if hold.turn_axis is not None:
            states.add((hold.first + hold.last) // 2)
        found += [(hold.kind, int(path.planned[state])) for state in sorted(states)]
    return found


def _overlap(
    hand: Hand, near: Shapes, Ts_tool_body: Float[np.ndarray, "s b 4 4"]
) -> tuple[float, int]:
    """Return how deep the hand gets into the part, as open as planned [m], and in which state."""
    pairs = all_pairs(len(near), len(hand.shapes))
    depth, state = deepest(
        near, near.placed(Ts_tool_body), hand.shapes, hand.Ts_tool_shape[None], pairs, 0.0
    )
    worst = int(depth.argmax()) if len(depth) else -1
    return (float(depth[worst]), int(state[worst])) if worst >= 0 else (0.0, 0)


class _Surface:
    """The elements of a part as convex pieces, which are computed where a hand comes near.

    What rests on the part is not held. What is drawn but does not collide counts only where a hand
    holds nothing else.
    """

    def __init__(self, part: MovedPart, model: Articulated) -> None:
        self._part, self._model = part, model
        self._links = [name for name in part.links if name not in model.contents]
        self._joined: dict[tuple[_Element, ...], Shapes] = {}

    def near(
        self, Ts_tool_body: Float[np.ndarray, "s b 4 4"], hand: Hand, *, drawn: bool
    ) -> Shapes:
        """Return the pieces of elements that come near the hand in any state."""
        elements, body, middle, reach = self._drawn if drawn else self._solid
        R = Ts_tool_body[..., :3, :3]
        center = ((hand.center - Ts_tool_body[..., :3, 3])[..., None, :] @ R)[..., 0, :]
        away = np.linalg.norm(center[:, body] - middle, axis=2).min(0)
        close = away < reach + hand.radius + _NEAR
        key = tuple(elements[row] for row in np.flatnonzero(close).tolist())
        if key not in self._joined:
            self._joined[key] = self._join(key)
        return self._joined[key]

    @cached_property
    def _solid(self) -> _Elements:
        links = self._model.urdf.links
        return self._bounded(
            [(name, k, False) for name in self._links for k in range(len(links[name].collisions))]
        )

    @cached_property
    def _drawn(self) -> _Elements:
        links, (solid, *_) = self._model.urdf.links, self._solid
        return self._bounded(
            [
                *solid,
                *((n, k, True) for n in self._links for k in range(len(links[n].visuals))),
            ]
        )

    def _bounded(self, elements: list[_Element]) -> _Elements:
        """Return elements with their bodies, and spheres around them in these bodies."""
        body, middle, reach = [], [], []
        for name, index, drawn in elements:
            at, T = self._part.links[name]
            hull = self._model.hulls[name][index]
            if drawn:
                hull = self._model.hull(name, self._model.urdf.links[name].visuals[index])
            points = apply(T, hull.vertices)
            body.append(at)
            middle.append((points.min(0) + points.max(0)) / 2)
            reach.append(np.linalg.norm(points - middle[-1], axis=1).max())
        return elements, np.array(body, np.int64), np.reshape(middle, (-1, 3)), np.array(reach)

    def _join(self, elements: tuple[_Element, ...]) -> Shapes:
        parts = [element_pieces(self._model, *element) for element in elements]
        body = [
            np.full(len(part), self._part.links[e[0]][0])
            for part, e in zip(parts, elements, strict=True)
        ]
        Ts = [
            self._part.links[e[0]][1] @ part.Ts_body_shape
            for part, e in zip(parts, elements, strict=True)
        ]
        joined = join(parts, [""] * len(parts))
        return replace(
            joined,
            body=np.concatenate([np.zeros(0, np.int64), *body]),
            Ts_body_shape=np.concatenate([np.empty((0, 4, 4)), *Ts]),
        )


def depth_between(
    model: Articulated,
    links: Collection[str],
    values: Mapping[str, float],
    T_tool_object: Float[np.ndarray, "4 4"],
    tool: str,
    size: tuple[float, float, float],
    *,
    surfaces: bool = False,
) -> tuple[float, str]:
    """Return how deep a box overlaps a hand, and the link that it overlaps.

    Args:
        model: The robot.
        links: Links of the hand.
        values: Joint values [rad] or [m]; other joints are at rest.
        T_tool_object: Pose of the box in the tool frame.
        tool: The tool link.
        size: Edges of the box [m].
        surfaces: Whether the triangles of the links count instead of their convex bodies.

    Returns:
        The depth [m], negative for a distance, and the link; no depth and no link without shapes.
    """
    bodies, shapes = (bodies_of(model), _surfaces(model, links)) if surfaces else prepared(model)
    Ts = body_poses(bodies, values, np.eye(4))
    T = Ts[0, bodies.of_link[tool]] @ bodies.T_body_link[tool] @ T_tool_object
    corners = np.array(list(product((-0.5, 0.5), repeat=3))) * size
    box = hulls_of(apply(T, corners), np.array([0, 8]), 0, "")
    hand = shapes.take(np.array([k for k, n in enumerate(shapes.names) if n in links], np.int64))
    if not len(hand):
        return -np.inf, ""
    pairs = all_pairs(len(hand), 1)
    depth, _ = deepest(hand, hand.placed(Ts), box, box.Ts_body_shape[None], pairs, -max(size))
    k = int(depth.argmax())
    return float(depth[k]), hand.names[k]


def _surfaces(model: Articulated, links: Collection[str]) -> Shapes:
    """Return the triangles of some links as shapes of their bodies."""
    bodies, parts = bodies_of(model), []
    for name in (name for name in links if len(model.surface(name))):
        points = apply(bodies.T_body_link[name], model.surface(name).reshape(-1, 3))
        parts.append(triangle_shapes(points.reshape(-1, 3, 3), bodies.of_link[name], name))
    body = np.concatenate([np.zeros(0, np.int64), *(part.body for part in parts)])
    return replace(join(parts, [""] * len(parts)), body=body)
