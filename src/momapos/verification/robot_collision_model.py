"""The robot in the exact check: bodies, shapes, joint limits and pairs to check."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from typing import TYPE_CHECKING, Protocol

import numpy as np

from momapos.core import RobotError, owner_cache, unknown_name
from momapos.core.geometry import apply, invert, pose_planar
from momapos.model.urdf import Articulated

from .exact_shapes import Shapes, of_bodies, piece_names, prepared, without_piece
from .link_bodies import LinkBodies, body_poses
from .part_sweep import depths_below_floor
from .report import DEFAULT, Check
from .sweep import Overlaps, all_pairs, deepest, surfaces_cross

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


class RobotDescription(Protocol):
    """What the check needs of a robot; `Robot` provides it."""

    @property
    def model(self) -> Articulated: ...
    @property
    def base_link(self) -> str: ...
    @property
    def tool_link(self) -> str: ...
    @property
    def moved_joints(self) -> tuple[str, ...]: ...
    @property
    def disabled(self) -> frozenset[frozenset[str]]: ...
    @property
    def claimed(self) -> frozenset[frozenset[str]]: ...
    @property
    def drive(self) -> str | None: ...
    @property
    def min_turning_radius(self) -> float | None: ...
    @property
    def grip_force(self) -> float | None: ...


@dataclass(frozen=True, eq=False)
class RobotCollisionModel:
    """A robot's collision shapes, to be placed at any state."""

    bodies: LinkBodies
    joints: tuple[str, ...]
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    speed: Float[np.ndarray, " n"]
    """Largest joint speeds, infinite where the file names none [rad/s] or [m/s]."""
    acceleration: Float[np.ndarray, " n"]
    """Largest joint accelerations, infinite where the file names none [rad/s^2] or [m/s^2]."""
    T_base_root: Float[np.ndarray, "4 4"]
    """Pose of the root link in the base link's frame."""
    tool_body: int
    T_body_tool: Float[np.ndarray, "4 4"]
    base: Shapes
    """Shapes that do not move with the arm."""
    arm: Shapes
    gripper: Bool[np.ndarray, " a"]
    """Which of the arm's shapes move with its last joint."""
    arm_base_pairs: Int[np.ndarray, "p 2"]
    """Indices into `arm` and `base` of the pairs to check."""
    arm_arm_pairs: Int[np.ndarray, "r 2"]
    surfaces: Callable[[str], Float[np.ndarray, "t 3 3"]]
    """Returns the triangles of a link in its frame, before cutting."""
    claimed_base_pairs: Int[np.ndarray, "c 2"]
    """Pairs like `arm_base_pairs` that are said never to touch; their surfaces decide."""
    claimed_arm_pairs: Int[np.ndarray, "d 2"]

    def body_poses(
        self, base_pose: Sequence[float] | Float[np.ndarray, "s 3"], q: Float[np.ndarray, "s n"]
    ) -> Float[np.ndarray, "s r 4 4"]:
        """Return world poses of all bodies, with the base at one pose or at a pose per state."""
        values = {name: q[:, i] for i, name in enumerate(self.joints)}
        T_world_root = pose_planar(np.array(base_pose)) @ self.T_base_root
        return body_poses(self.bodies, values, T_world_root)

    def poses(
        self, Ts: Float[np.ndarray, "s r 4 4"], *, base_moves: bool = False
    ) -> tuple[
        Float[np.ndarray, "s 4 4"], Float[np.ndarray, "#s b 4 4"], Float[np.ndarray, "s a 4 4"]
    ]:
        """Return world poses of the tool, of the base's shapes and of the arm's, from bodies'.

        The base's shapes have one pose unless the base moves.
        """
        T_tool = Ts[:, self.tool_body] @ self.T_body_tool
        return T_tool, self.base.placed(Ts if base_moves else Ts[:1]), self.arm.placed(Ts)

    def self_check(
        self,
        Ts_base: Float[np.ndarray, "#s b 4 4"],
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        where: Callable[[int], str],
        limit: float,
    ) -> Check:
        """Check how deep the robot overlaps itself; see `self_overlaps`."""
        return self.self_overlaps(Ts_base, Ts_arm, where, limit).check("robot self-collision")

    def self_overlaps(
        self,
        Ts_base: Float[np.ndarray, "#s b 4 4"],
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        where: Callable[[int], str],
        limit: float,
    ) -> Overlaps:
        """Find the pairs of links of the robot that overlap.

        Args:
            Ts_base, Ts_arm: World poses of its shapes.
            where: Returns the name of a state.
            limit: Allowed depth [m].
        """
        found = Overlaps(limit)
        found.add(self.arm, Ts_arm, self.base, Ts_base, self.arm_base_pairs, where)
        found.add(self.arm, Ts_arm, self.arm, Ts_arm, self.arm_arm_pairs, where)
        self._add_claimed(found, self.base, Ts_base, Ts_arm, self.claimed_base_pairs, where)
        self._add_claimed(found, self.arm, Ts_arm, Ts_arm, self.claimed_arm_pairs, where)
        return found

    def _add_claimed(
        self,
        found: Overlaps,
        others: Shapes,
        Ts_others: Float[np.ndarray, "#s b 4 4"],
        Ts_arm: Float[np.ndarray, "s a 4 4"],
        pairs: Int[np.ndarray, "c 2"],
        where: Callable[[int], str],
    ) -> None:
        """Add pairs that are said never to touch, if their surfaces cross where they are deepest.

        Hulls and pieces may overlap where surfaces do not, such as those of a wrist in a fork.
        """
        depth, state = deepest(self.arm, Ts_arm, others, Ts_others, pairs, max(0.0, found.limit))
        for p in np.flatnonzero(state >= 0).tolist():
            i, j = pairs[p].tolist()
            at = min(int(state[p]), len(Ts_others) - 1)
            one = self._surface(self.arm, i, Ts_arm[state[p], i])
            if not surfaces_cross(one, self._surface(others, j, Ts_others[at, j])):
                state[p] = -1
        found.collect(self.arm, others, pairs, depth, state, where)

    def _surface(
        self, shapes: Shapes, index: int, T_world_shape: Float[np.ndarray, "4 4"]
    ) -> Float[np.ndarray, "t 3 3"]:
        """Return the triangles of the link of a shape in the world."""
        link = without_piece(shapes.names[index])
        T = T_world_shape @ invert(shapes.Ts_body_shape[index]) @ self.bodies.T_body_link[link]
        return np.asarray(apply(T, self.surfaces(link).reshape(-1, 3)).reshape(-1, 3, 3))


def robot_collision_model(robot: RobotDescription) -> RobotCollisionModel:
    """Build the collision model of a robot, cached.

    Raises:
        UnknownNameError, RobotError: A link or joint does not exist, or a joint appears twice.
    """
    return _robot_collision_model(
        robot.model, robot.base_link, robot.tool_link, tuple(robot.moved_joints), robot.disabled,
        robot.claimed,
    )  # fmt: skip


@owner_cache(8)
def _robot_collision_model(
    model: Articulated,
    base_link: str,
    tool_link: str,
    arm_joints: tuple[str, ...],
    disabled: frozenset[frozenset[str]],
    claimed: frozenset[frozenset[str]],
) -> RobotCollisionModel:
    bodies, shapes = prepared(model)
    name = model.urdf.name
    for link in (base_link, tool_link):
        if link not in bodies.of_link:
            raise unknown_name("link", link, bodies.of_link, f"robot {name}")
    if len(set(arm_joints)) != len(arm_joints) or not arm_joints:
        raise RobotError(f"robot {name}: joints must be a non-empty list without duplicates")
    joints = [model.joint(joint) for joint in arm_joints]
    moving = set().union(*(bodies.moved_by(joint) for joint in arm_joints))
    last = bodies.moved_by(max(arm_joints, key=bodies.depth))
    T_root_base = _link_pose(bodies, base_link)
    moved = of_bodies(shapes, moving)
    base = np.setdiff1d(np.arange(len(shapes)), moved)
    pairs = self_pairs(bodies, shapes, moved)
    names = [frozenset((shapes.names[i], shapes.names[j])) for i, j in pairs]
    said = pairs[np.array([pair in claimed and pair in disabled for pair in names], bool)]
    pairs = pairs[~np.array([pair in disabled for pair in names], bool)]
    shapes = replace(shapes, names=piece_names(model))
    return RobotCollisionModel(
        bodies=bodies,
        joints=arm_joints,
        lower=np.array([joint.lower for joint in joints]),
        upper=np.array([joint.upper for joint in joints]),
        speed=np.array([joint.velocity for joint in joints]),
        acceleration=np.array([joint.acceleration for joint in joints]),
        T_base_root=invert(T_root_base),
        tool_body=bodies.of_link[tool_link],
        T_body_tool=bodies.T_body_link[tool_link],
        base=shapes.take(base),
        arm=shapes.take(moved),
        gripper=np.isin(shapes.body[moved], list(last)),
        arm_base_pairs=_among(pairs, moved, base),
        arm_arm_pairs=_among(pairs, moved, moved),
        surfaces=model.surface,
        claimed_base_pairs=_among(said, moved, base),
        claimed_arm_pairs=_among(said, moved, moved),
    )


def self_contacts(
    robot: RobotDescription, q: Float[np.ndarray, "s n"], where: Callable[[int], str]
) -> Check:
    """Check how deep a robot overlaps itself in some states.

    Args:
        robot: The robot.
        q: Values of its moved joints [rad] or [m].
        where: Returns the name of a state.
    """
    built = robot_collision_model(robot)
    _, Ts_base, Ts_arm = built.poses(built.body_poses((0.0, 0.0, 0.0), q))
    return built.self_check(Ts_base, Ts_arm, where, DEFAULT.penetration)


@dataclass(frozen=True)
class LinkContact:
    """A link that overlaps another one, or the floor."""

    links: tuple[str, ...]
    """The links; one if it is the floor that the link overlaps."""
    depth: float
    """[m]"""
    words: str
    """Which shapes overlap and how deep."""


def link_contacts(robot: RobotDescription, values: Mapping[str, float]) -> tuple[LinkContact, ...]:
    """Return what overlaps in a state, the deepest first, by the shapes and pairs of the check.

    Unlike in a plan, joints beyond those of one arm may move: all arms, a torso and the fingers.

    Args:
        robot: The robot.
        values: Values of all joints that move, without followers [rad] or [m].
    """
    built = _robot_collision_model(
        robot.model, robot.base_link, robot.tool_link, tuple(values), robot.disabled, robot.claimed
    )
    given = {name: np.array([value]) for name, value in values.items()}
    _, Ts_base, Ts_arm = built.poses(body_poses(built.bodies, given, built.T_base_root))
    overlaps = built.self_overlaps(Ts_base, Ts_arm, lambda _: "this state", 0.0)
    found = [
        LinkContact(pair, depth, words.removesuffix(" at this state"))
        for pair, (depth, words) in overlaps.worst.items()
    ]
    below = depths_below_floor(built.arm, Ts_arm)[0]
    for k in np.flatnonzero(below > 0.0).tolist():
        name, depth = built.arm.names[k], float(below[k])
        words = f"{name} is {1000 * depth:.0f} mm below the floor"
        found.append(LinkContact((without_piece(name),), depth, words))
    return tuple(sorted(found, key=lambda contact: -contact.depth))


def crossing_links(
    robot: RobotDescription, surfaces: Articulated, q: Float[np.ndarray, "s n"]
) -> tuple[tuple[str, str], ...]:
    """Return the pairs of links whose surfaces cross in the first of some states, but not in all.

    Surfaces that always cross are drawn so, such as those of a cover. Pairs are those of the check.

    Args:
        robot: The robot.
        surfaces: The same robot with other shapes, of which every triangle counts.
        q: Values of its moved joints [rad] or [m].
    """
    built = robot_collision_model(robot)
    bodies, moved = built.bodies, set().union(*map(built.bodies.moved_by, built.joints))
    triangles = _triangles(surfaces)
    names = [name for name in triangles if name in bodies.of_link]
    of = {name: bodies.of_link[name] for name in names}
    T_links = np.array([bodies.T_body_link[name] for name in names]).reshape(-1, 4, 4)
    Ts = built.body_poses((0.0, 0.0, 0.0), q)[:, list(of.values())] @ T_links

    def at(state: int, k: int) -> Float[np.ndarray, "t 3 3"]:
        points = triangles[names[k]].reshape(-1, 3)
        return np.asarray(apply(Ts[state, k], points).reshape(-1, 3, 3))

    first = [at(0, k) for k in range(len(names))]
    bounds = np.array([(t.min((0, 1)), t.max((0, 1))) for t in first]).reshape(-1, 2, 3)
    found = []
    for i, j in combinations(range(len(names)), 2):
        one, other = of[names[i]], of[names[j]]
        joined = one == other or other == bodies.parent[one] or one == bodies.parent[other]
        if joined or not {one, other} & moved or frozenset((names[i], names[j])) in robot.disabled:
            continue
        apart = (bounds[i, 0] > bounds[j, 1]) | (bounds[j, 0] > bounds[i, 1])
        if not apart.any() and surfaces_cross(first[i], first[j]):
            every = (surfaces_cross(at(s, i), at(s, j)) for s in range(1, len(q)))
            if len(q) == 1 or not all(every):
                found.append((names[i], names[j]))
    return tuple(found)


@owner_cache()
def _triangles(model: Articulated) -> dict[str, Float[np.ndarray, "t 3 3"]]:
    """Return the triangles of each link that has any, in its frame."""
    every = {name: model.surface(name) for name in model.links}
    return {name: triangles for name, triangles in every.items() if len(triangles)}


def _link_pose(bodies: LinkBodies, link: str) -> Float[np.ndarray, "4 4"]:
    """Return the pose of a link in the root's frame, with all joints at rest."""
    T = body_poses(bodies, {}, np.eye(4))[0, bodies.of_link[link]]
    return np.asarray(T @ bodies.T_body_link[link])


def _among(
    pairs: Int[np.ndarray, "p 2"], first: Int[np.ndarray, " a"], second: Int[np.ndarray, " b"]
) -> Int[np.ndarray, "m 2"]:
    """Return the pairs with one shape in each set, as indices into the sets."""
    flipped = np.isin(pairs[:, 1], first) & ~np.isin(pairs[:, 0], first)
    pairs = np.where(flipped[:, None], pairs[:, ::-1], pairs)
    pairs = pairs[np.isin(pairs[:, 0], first) & np.isin(pairs[:, 1], second)]
    return np.stack([np.searchsorted(first, pairs[:, 0]), np.searchsorted(second, pairs[:, 1])], 1)


def self_pairs(
    bodies: LinkBodies, shapes: Shapes, moved: Int[np.ndarray, " a"]
) -> Int[np.ndarray, "p 2"]:
    """Return the pairs of the robot's shapes that may not overlap, unless its SRDF says so.

    Excluded are pairs of one body and of two bodies connected by a joint. Pairs that touch with all
    joints at rest are not excluded: an arm may be folded into itself there.
    """
    pairs = all_pairs(len(shapes), len(shapes))
    pairs = pairs[pairs[:, 0] < pairs[:, 1]]
    of, parent = shapes.body[pairs], np.array(bodies.parent)[shapes.body[pairs]]
    joined = (of[:, 0] == of[:, 1]) | (parent[:, 0] == of[:, 1]) | (parent[:, 1] == of[:, 0])
    return np.asarray(pairs[~joined & np.isin(pairs, moved).any(1)])
