"""Build the room in the physics engine, and the part or object that the task moves."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.core.geometry import apply, invert, pose
from momapos.model.records import Latch, Motion, Task
from momapos.model.scene import (
    Scene,
    SceneObject,
    known_resistance,
    latch_to_turn,
    object_mass,
    part_masses,
    resistance_along,
    stated_resistance,
)
from momapos.model.urdf import Geometry, Hull, Joint, opening_of, opens_both_ways

from .config import WELD_TIME, ExecutionConfig, FurnitureConfig
from .geoms import Kind, add_hull, add_shape, dress, place_body
from .robot_dynamics import hull_volume, volume

if TYPE_CHECKING:
    from jaxtyping import Float


LOCK = "latch"
"""Name of the constraint that locks the part."""
MAX_CLOSED_OFFSET = 0.01
"""A part within this of its closed value can be locked again [rad] or [m]; see `latch_to_turn`."""


@dataclass(frozen=True)
class SimulatedLatch:
    """A latch, and its addresses in the model.

    It has dry friction and damping, and no spring: where the hand leaves it, it stays.
    """

    joint: str
    """Joint of the latch, in the scene."""
    start: float
    """Value in the scene [rad] or [m]."""
    to: float
    """Value from which on the part is free [rad] or [m]."""
    closed: float
    """Value of the part's joint in the scene [rad] or [m]."""
    value_q: int
    part_q: int
    lock: int

    def turned(self, q: Float[np.ndarray, " q"], tolerance: float) -> bool:
        """Check whether the latch has made its travel, up to a share of it."""
        travel = self.to - self.start
        return bool((float(q[self.value_q]) - self.start) / travel >= 1.0 - tolerance)

    def update(self, data: Any, tolerance: float) -> None:
        """Lock the part while it is closed and the latch is not turned; else release it."""
        near = abs(float(data.qpos[self.part_q]) - self.closed) < MAX_CLOSED_OFFSET
        data.eq_active[self.lock] = near and not self.turned(data.qpos, tolerance)

    def place(self, q: Float[np.ndarray, " q"], value: float) -> None:
        """Set the latch where the robot expects it while the part is at a value."""
        q[self.value_q] = self.start if value == self.closed else self.to


def carriers_of(item: SceneObject, joint: str) -> dict[str, str]:
    """Return the links that a joint moves, each with the link whose body carries it in physics."""
    latch = latch_to_turn(item, joint)
    return item.model.rigid_groups(joint, *(() if latch is None else (latch.joint,)))


def add_lock(spec: Any, part: str) -> None:
    """Add the constraint that keeps a part's joint at its value in the scene.

    Args:
        spec: The world.
        part: The part's joint in it.
    """
    lock = spec.add_equality(
        name=LOCK, type=mujoco.mjtEq.mjEQ_JOINT, objtype=mujoco.mjtObj.mjOBJ_JOINT, active=True
    )
    lock.name1 = part
    lock.data = [0.0] * len(lock.data)
    lock.solref = [WELD_TIME, 1.0]


def add_friction(added: Any, item: SceneObject, latch: Latch, config: FurnitureConfig) -> None:
    """Give the joint of a latch its known or assumed friction and damping."""
    known = known_resistance(item, latch.joint, config)
    assert known.friction is not None
    assert known.damping is not None
    added.frictionloss = known.friction
    added.damping = [known.damping, 0, 0]


def find_latch(model: Any, item: SceneObject, joint: str, part: str) -> SimulatedLatch | None:
    """Return the latch of a compiled world; None if no latch must be turned.

    Args:
        model: The world.
        item: The object in the scene.
        joint: The joint that the task moves.
        part: The same joint in the world.
    """
    latch = latch_to_turn(item, joint)
    if latch is None:
        return None
    values = item.values()
    return SimulatedLatch(
        latch.joint, values[latch.joint], latch.to, values[joint],
        value_q=int(model.joint(f"{part}/{latch.joint}").qposadr[0]),
        part_q=int(model.joint(part).qposadr[0]),
        lock=model.equality(LOCK).id,
    )  # fmt: skip


PART = "part"
"""Name of the moved body, and of its joint."""
HANDLE_WORD = "handle"
FREE_RANGE = 1e3
"""Range of a joint without a limit that stops at one side [rad] or [m]."""
CATCH_PLAY = 0.1
"""Share of its travel within which the catch of a swing door pulls less than fully [-]."""
MIN_OBJECT_MASS = 0.05
"""Minimum mass of a movable object without a mass in its file [kg]."""
MIN_BODY_MASS = 1e-3
"""Minimum mass of a body; the engine needs one [kg]."""
MAX_HAND_DISTANCE = 0.1
"""Distance from the tool at the grasp within which elements touch the hand [m]."""


@dataclass(frozen=True)
class PartResistance:
    """Resistance of a part, as drawn for one run."""

    mass: float
    """[kg]"""
    friction: float
    """Dry friction of its joint [Nm] or [N]; 0 for movable objects."""
    damping: float
    """Damping of its joint [Nms/rad] or [Ns/m]; 0 for movable objects."""
    pull: float
    """Force at the handle or free edge that opens the closed part [N]; 0 for movable objects."""


def draw_resistance(
    item: SceneObject, joint: Joint | None, config: FurnitureConfig, rng: np.random.Generator
) -> PartResistance:
    """Draw the resistance of a part around its known or assumed values."""
    factor = 1.0 + config.spread * rng.uniform(-1.0, 1.0, 4)
    if joint is None:
        mass, _ = object_mass(item, replace(config, least_mass=MIN_OBJECT_MASS))
        return PartResistance(float(mass * factor[0]), 0.0, 0.0, 0.0)
    known = known_resistance(item, joint.name, config)
    assert known.mass is not None
    assert known.friction is not None
    assert known.damping is not None
    assert known.seal_force is not None
    return PartResistance(
        mass=float(known.mass * factor[0]),
        friction=float(known.friction * factor[1]),
        damping=float(known.damping * factor[2]),
        pull=float(known.seal_force * factor[3]),
    )


@dataclass(frozen=True, eq=False)
class Deviation:
    """Difference between the task's object and the scene that the plan is based on."""

    offset: Float[np.ndarray, "3"]
    """Translation of the object, in the world [m]."""
    shift: Float[np.ndarray, "3"]
    """Translation of its joint, in the joint's frame [m]."""
    axis: Float[np.ndarray, "3"]
    """Axis of its joint, in that frame."""


PRESS_STOP = [0.004, 1.0]
"""Time constant [s] and damping ratio of the stop of a pressed part: the engine's own gives way by
millimeters to a fingertip, since buttons weigh little."""
CLOSER_SPEED = 0.5
"""Speed at which a closer lets a part close [rad/s] or [m/s]: a door takes 3 s from 90 deg."""


@dataclass(frozen=True)
class Seal:
    """Seal or catch that keeps a closed part closed."""

    closed: float
    """[rad] or [m]"""
    outward: float
    """Direction in which the joint opens, 1 or -1; 0 without a seal."""
    pull: float
    """Torque or force at the closed joint [Nm] or [N]."""
    reach: float
    """Travel over which it decays [rad] or [m]."""
    two_sided: bool = False
    """Whether the part opens in both directions, such as a swing door."""
    spring: float = 0.0
    """Torque or force that pulls the part back toward its closed value, everywhere [Nm] or [N]."""

    def force(self, value: float) -> float:
        """Return the torque or force at a value of the joint [Nm] or [N]."""
        away = (value - self.closed) / self.reach
        share = max(0.0, 1.0 - abs(away))
        toward = np.clip(away / CATCH_PLAY, -1.0, 1.0) if self.two_sided else self.outward
        return float(-toward * (self.pull * share + self.spring))


def seal_of(item: SceneObject, joint: Joint | None, pull: float, config: FurnitureConfig) -> Seal:
    """Return the seal of a part.

    The pull and its travel are known at the handle if a plan or the scene gives its lever;
    otherwise they are those of the free edge.

    Args:
        item: The object.
        joint: Joint of the part; None for movable objects, which have no seal.
        pull: Force that opens the closed part [N].
        config: Assumed values.
    """
    if joint is None:
        return Seal(0.0, 0.0, 0.0, 1.0)
    opening, known = opening_of(item.model, joint.name), known_resistance(item, joint.name, config)
    assert known.seal_travel is not None
    lever = known.lever or (1.0 if joint.kind == "prismatic" else _width(item, joint))
    both = opens_both_ways(item.model, joint.name)
    return Seal(
        opening.closed, opening.sign, pull * lever, known.seal_travel / lever, both,
        known.spring or 0.0,
    )  # fmt: skip


def push_of(item: SceneObject, task: Task, config: FurnitureConfig) -> float:
    """Return the push that a part needs on its way to a task's goal [N]; a rocker halfway out."""
    assert task.joint is not None
    assert task.to is not None
    joint = item.joint(task.joint)
    lever = 1.0 if joint.kind == "prismatic" else _width(item, joint) / 2
    values = np.array([item.values()[joint.name], task.to])
    return resistance_along(item, joint.name, values, lever, config).largest / lever


def _width(item: SceneObject, joint: Joint) -> float:
    """Return the distance of a part's free edge from its hinge [m]."""
    poses = item.link_poses()
    back = invert(poses[joint.child])
    hulls = [
        apply(back @ poses[link], hull.vertices)
        for link in item.model.moved_by(joint.name)
        for hull in item.model.hulls[link]
    ]
    if not hulls:
        return 1.0
    points = np.concatenate(hulls)
    arms = points - np.outer(points @ joint.axis, joint.axis)
    return max(0.05, float(np.linalg.norm(arms, axis=1).max()))


def add_room(spec: Any, scene: Scene, task: Task, deviation: Deviation | None) -> None:
    """Add everything fixed: the floor, and all elements of all objects except the part's.

    What lies flat on the floor is left out: wheels climb it, and the base is not driven by wheels.
    Each element is a separate body, so that single collision pairs with the part can be excluded.
    """
    floor = spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05]
    )
    dress(floor, Kind.FLOOR, touched=False)
    for item in scene.objects:
        if item.is_flat and item.name != task.object:
            continue
        moved = moved_links(item, task)
        for link, T in _poses(item, task, deviation).items():
            if link in moved:
                continue
            elements = item.model.static_elements[link]
            for i, shape in enumerate(item.model.urdf.links[link].collisions):
                name, hulls = f"{item.name}/{link}#{i}", elements[i].hulls
                body = spec.worldbody.add_body(name=name)
                if len(hulls) == 1:
                    geoms = [add_shape(spec, body, shape, T, name)]
                else:
                    geoms = [add_hull(spec, body, h, T, f"{name}.{k}") for k, h in enumerate(hulls)]
                for geom in geoms:
                    dress(geom, Kind.ROOM, touched=False, handle=_is_handle(link, shape))


def moved_links(item: SceneObject, task: Task) -> frozenset[str]:
    """Return the links of an object that the task moves."""
    if item.name != task.object:
        return frozenset()
    return frozenset(item.model.links if task.joint is None else item.model.moved_by(task.joint))


def _poses(
    item: SceneObject, task: Task, deviation: Deviation | None
) -> dict[str, Float[np.ndarray, "4 4"]]:
    poses = item.link_poses()
    if deviation is None or item.name != task.object:
        return poses
    T = pose(deviation.offset)
    return {link: T @ T_world_link for link, T_world_link in poses.items()}


def add_part(
    spec: Any,
    scene: Scene,
    task: Task,
    resistance: PartResistance,
    deviation: Deviation | None,
    config: ExecutionConfig,
    reached: Collection[tuple[str, int]] = (),
    held: str = "",
) -> None:
    """Add what the task moves: the links beyond its joint and its mimic joints, or an object.

    The links that a mimic joint moves are a body of their own, and so is a latch that must be
    turned, which locks the part. Other joints of the part are locked at the scene's values.

    Args:
        spec: The world.
        scene: The room.
        task: The task.
        resistance: Resistance of the part.
        deviation: Difference of the part's joint from the scene.
        config: Model parameters.
        reached: Elements as (link, index) whose non-convex meshes are split into convex pieces, so
            that the hand can reach behind a handle in the mesh of its panel.
        held: The link whose body the hand holds; by default the child of the task's joint.
    """
    item = scene.object(task.object)
    poses = _poses(item, task, deviation)
    links = [link for link in item.model.links if link in moved_links(item, task)]
    size = sum(volume(s) for link in links for s in item.model.urdf.links[link].collisions)
    shapes = PartShapes(item, poses, resistance.mass / max(size, 1e-9), config, set(reached))
    if task.joint is None:
        body = spec.worldbody.add_body(name=PART)
        place_body(body, poses[item.model.urdf.root]).add_freejoint(name=PART)
        shapes.add(spec, body, item.model.urdf.root, links)
        return
    latch = latch_to_turn(item, task.joint)
    groups, bodies = carriers_of(item, task.joint), dict[str, Any]()
    held = held or item.model.joint(task.joint).child
    balanced = bool(known_resistance(item, task.joint, config.furniture).balanced)
    for carrier in dict.fromkeys(groups.values()):
        joint = next(j for j in item.model.joints.values() if j.child == carrier)
        above = groups.get(joint.parent)
        onto = spec.worldbody if above is None else bodies[above]
        T = poses[carrier] if above is None else invert(poses[above]) @ poses[carrier]
        body = onto.add_body(name=PART if carrier == held else f"{PART}/{carrier}")
        bodies[carrier] = place_body(body, T)
        body.gravcomp = float(balanced)
        leads = joint.name == task.joint
        added = _add_joint(body, joint, item.values()[joint.name], deviation if leads else None)
        added.name = PART if leads else f"{PART}/{joint.name}"
        if leads:
            _add_stop(added, item, joint, task)
            added.frictionloss = resistance.friction
            added.damping = [max(resistance.damping, _braking(item, joint.name)), 0, 0]
        elif latch is not None and joint.name == latch.joint:
            add_friction(added, item, latch, config.furniture)
        else:
            _couple(spec, joint, task.joint)
        shapes.add(spec, body, carrier, [link for link, on in groups.items() if on == carrier])
    if latch is not None:
        add_lock(spec, PART)


def _braking(item: SceneObject, joint: str) -> float:
    """Return the damping by which a closer brakes the part that its spring closes, else 0."""
    known = stated_resistance(item, joint)
    return (known.spring or 0.0) / CLOSER_SPEED if known.closer else 0.0


def set_masses(
    spec: Any, model: Any, item: SceneObject, task: Task, mass: float, config: FurnitureConfig
) -> None:
    """Give the bodies of a part the masses and centers of mass that planning assumes.

    Their inertias keep the distribution of the shapes.

    Args:
        spec: The world; see `add_part`.
        model: The same, compiled.
        item: The task's object.
        task: The task.
        mass: Mass of the whole part [kg].
        config: Assumed values.
    """
    links = tuple(link for link in item.model.links if link in moved_links(item, task))
    masses, poses = part_masses(item.model, links, config, mass), item.link_poses()
    if task.joint is None:
        groups = dict.fromkeys(links, item.model.urdf.root)
    else:
        groups = carriers_of(item, task.joint)
    for carrier in dict.fromkeys(groups.values()):
        on, back = [link for link in links if groups[link] == carrier], invert(poses[carrier])
        weights = np.array([masses[link][0] for link in on])
        centers = np.array([apply(back @ poses[n], masses[n][1][None])[0] for n in on])
        body = spec.body(f"{PART}/{carrier}") or spec.body(PART)
        shapes = model.body(body.name)
        body.explicitinertial = True
        body.mass = max(float(weights.sum()), MIN_BODY_MASS)
        body.inertia = shapes.inertia * body.mass / shapes.mass
        body.iquat = shapes.iquat
        body.ipos = weights @ centers / weights.sum() if weights.sum() > 0 else shapes.ipos


def is_part(name: str) -> bool:
    """Check whether a body or joint belongs to the part, by its name."""
    return name == PART or name.startswith(f"{PART}/")


@dataclass(frozen=True, eq=False)
class PartShapes:
    """Adds the shapes of a part to its bodies."""

    item: SceneObject
    poses: Mapping[str, Float[np.ndarray, "4 4"]]
    """Poses of its links in the world."""
    density: float
    """[kg/m^3]"""
    config: ExecutionConfig
    reached: Collection[tuple[str, int]]
    """See `add_part`."""

    def add(self, spec: Any, body: Any, at: str, links: Sequence[str]) -> None:
        """Add the shapes of links to a body, whose frame is that of a link."""
        item, back = self.item, invert(self.poses[at])
        for link in links:
            for i, shape in enumerate(item.model.urdf.links[link].collisions):
                T, name = back @ self.poses[link], f"{item.name}/{link}#{i}"
                pieces = item.model.pieces(link, i) if (link, i) in self.reached else ()
                if len(pieces) < 2:
                    geoms, fuller = [add_shape(spec, body, shape, T, name)], 1.0
                else:
                    geoms = [
                        add_hull(spec, body, h, T, f"{name}.{k}") for k, h in enumerate(pieces)
                    ]
                    fuller = volume(shape) / sum(map(hull_volume, pieces))
                for geom in geoms:
                    contact, handle = self.config.hold == "contact", _is_handle(link, shape)
                    dress(geom, Kind.PART, touched=contact, handle=handle)
                    geom.density = self.density * fuller


def held_link(item: SceneObject, joint: str, motion: Motion) -> str:
    """Return the link whose body is nearest to the hand when it grasps the part in a motion."""
    latch = latch_to_turn(item, joint)
    if latch is not None and motion.latch_q is not None:
        return item.model.joint(latch.joint).child
    first = motion.holds[0].first if motion.holds else 0
    poses = item.link_poses({joint: float(motion.object_q[first])})
    tool, groups = motion.Ts_world_tool[first, :3, 3], carriers_of(item, joint)
    gaps = dict.fromkeys(groups.values(), np.inf)
    for link, carrier in groups.items():
        at = apply(invert(poses[link]), tool[None])[0]
        for hull in item.model.hulls[link]:
            gaps[carrier] = min(gaps[carrier], _distance_to_box(hull, at))
    return min(gaps, key=gaps.__getitem__)


def _distance_to_box(hull: Hull, point: Float[np.ndarray, "3"]) -> float:
    """Return the distance of a point from the box around a hull [m]."""
    beyond = np.maximum(hull.vertices.min(0) - point, point - hull.vertices.max(0))
    return float(np.linalg.norm(np.maximum(beyond, 0.0)))


def reached_elements(item: SceneObject, joint: str, motion: Motion) -> set[tuple[str, int]]:
    """Return the elements of a part near its grasps in a motion, as (link, index)."""
    found = set()
    for hold in motion.grasps:
        poses = item.link_poses({joint: float(motion.object_q[hold.first])})
        tool = motion.Ts_world_tool[hold.first, :3, 3]
        for link in item.model.moved_by(joint):
            at = apply(invert(poses[link]), tool[None])[0]
            for i, hull in enumerate(item.model.hulls[link]):
                if _distance_to_box(hull, at) < MAX_HAND_DISTANCE:
                    found.add((link, i))
    return found


def _add_joint(body: Any, joint: Joint, value: float, deviation: Deviation | None) -> Any:
    """Add a joint to a body whose pose belongs to the given joint value."""
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    axis = joint.axis if deviation is None else deviation.axis
    added = body.add_joint(type=kind, axis=axis, ref=value)
    if deviation is not None:
        added.pos = deviation.shift
    if math.isfinite(joint.lower) and math.isfinite(joint.upper) and joint.mimic is None:
        added.limited, added.range = 1, [joint.lower, joint.upper]
    return added


def _add_stop(added: Any, item: SceneObject, joint: Joint, task: Task) -> None:
    """Stop a part where it is closed, if its file lets it go farther and it is no swing door.

    Contacts with the frame, which stop a real door, are excluded as bearings.
    """
    if task.verb == "press":
        added.solref_limit = PRESS_STOP
    if opens_both_ways(item.model, joint.name):
        return
    opening, free = opening_of(item.model, joint.name), [joint.lower, joint.upper]
    values = [item.values()[joint.name], opening.closed, *([] if task.to is None else [task.to])]
    if opening.sign > 0:
        free[0] = max(joint.lower, min(values))
    else:
        free[1] = min(joint.upper, max(values))
    added.limited, added.range = 1, np.clip(free, -FREE_RANGE, FREE_RANGE)


def _couple(spec: Any, joint: Joint, part: str) -> None:
    """Make a mimic joint of the part follow its leader: the part's joint or the latch's."""
    assert joint.mimic is not None
    coupling = spec.add_equality(
        name=f"{PART}/{joint.name}", type=mujoco.mjtEq.mjEQ_JOINT,
        objtype=mujoco.mjtObj.mjOBJ_JOINT, active=True,
    )  # fmt: skip
    leader = joint.mimic.joint
    coupling.name1 = f"{PART}/{joint.name}"
    coupling.name2 = PART if leader == part else f"{PART}/{leader}"
    # Relative to the reference values, which satisfy the relation with its offset.
    coupling.data = [0.0, joint.mimic.ratio, *np.zeros(len(coupling.data) - 2)]
    coupling.solref = [WELD_TIME, 1.0]


def _is_handle(link: str, shape: Geometry) -> bool:
    return HANDLE_WORD in link.lower() or HANDLE_WORD in shape.name.lower()
