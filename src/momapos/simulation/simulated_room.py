"""Build the room in the physics engine, and the part or object that the task moves."""

from __future__ import annotations

import math
from collections.abc import Collection
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.core.geometry import apply, invert, pose
from momapos.model.records import Hold, Motion, Task
from momapos.model.scene import Scene, SceneObject
from momapos.model.urdf import Geometry, Joint, opening_of

from .config import ExecutionConfig, FurnitureConfig
from .dynamics import hull_volume, volume
from .geoms import Kind, add_hull, add_shape, dress, place_body

if TYPE_CHECKING:
    from jaxtyping import Float

PART = "part"
"""Name of the moved body, and of its joint."""
HANDLE_WORD = "handle"
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
    """Force at the free edge that opens the closed part [N]; 0 for movable objects."""


def draw_resistance(
    item: SceneObject, joint: Joint | None, config: FurnitureConfig, rng: np.random.Generator
) -> PartResistance:
    """Draw the resistance of a part."""
    factor = 1.0 + config.spread * rng.uniform(-1.0, 1.0, 4)
    links = item.model.links if joint is None else item.model.moved_by(joint.name)
    size = sum(volume(s) for link in links for s in item.model.urdf.links[link].collisions)
    mass = config.density * size * factor[0]
    if joint is None:
        return PartResistance(float(np.clip(mass, 0.05, config.most_mass)), 0.0, 0.0, 0.0)
    slides = joint.kind == "prismatic"
    words = f"{item.category} {item.name}".lower()
    sealed = not slides and any(word in words for word in config.sealed)
    values = (
        (config.slide_friction, config.slide_damping)
        if slides
        else (config.hinge_friction, config.hinge_damping)
    )
    return PartResistance(
        mass=float(np.clip(mass, config.least_mass, config.most_mass)),
        friction=float(values[0] * factor[1]),
        damping=float(values[1] * factor[2]),
        pull=float((config.seal_force if sealed else config.latch_force) * factor[3]),
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

    def force(self, value: float) -> float:
        """Return the torque or force at a value of the joint [Nm] or [N]."""
        share = 1.0 - abs(value - self.closed) / self.reach
        return -self.outward * self.pull * max(0.0, share)


def seal_of(item: SceneObject, joint: Joint | None, pull: float, way: float) -> Seal:
    """Return the seal of a part, from the pull at its free edge.

    Args:
        item: The object.
        joint: Joint of the part; None for movable objects, which have no seal.
        pull: Force at the free edge [N].
        way: Travel of the free edge over which it decays [m].
    """
    if joint is None:
        return Seal(0.0, 0.0, 0.0, 1.0)
    opening = opening_of(item.model, joint.name)
    lever = 1.0 if joint.kind == "prismatic" else _width(item, joint)
    return Seal(opening.closed, opening.sign, pull * lever, way / lever)


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

    Each element is a separate body, so that single collision pairs with the part can be excluded.
    """
    floor = spec.worldbody.add_geom(
        name="floor", type=mujoco.mjtGeom.mjGEOM_PLANE, size=[0, 0, 0.05]
    )
    dress(floor, Kind.FLOOR, touched=False)
    for item in scene.objects:
        moved = moved_links(item, task)
        for link, T in _poses(item, task, deviation).items():
            if link in moved:
                continue
            for i, shape in enumerate(item.model.urdf.links[link].collisions):
                name = f"{item.name}/{link}#{i}"
                body = spec.worldbody.add_body(name=name)
                geom = add_shape(spec, body, shape, T, name)
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
) -> None:
    """Add what the task moves: the links beyond its joint, or a movable object.

    Other joints of the part are locked at the scene's values. `reached` names elements as (link,
    index) whose non-convex meshes are split into convex pieces, so that the hand can reach behind a
    handle in the mesh of its panel.
    """
    item = scene.object(task.object)
    poses = _poses(item, task, deviation)
    body = spec.worldbody.add_body(name=PART)
    if task.joint is None:
        T_world_at = poses[item.model.urdf.root]
        place_body(body, T_world_at).add_freejoint(name=PART)
    else:
        joint = item.model.joint(task.joint)
        T_world_at = poses[joint.child]
        place_body(body, T_world_at)
        _add_joint(body, joint, item.values()[task.joint], resistance, deviation)
    links = [link for link in item.model.links if link in moved_links(item, task)]
    shapes = [(link, i, s) for link in links for i, s in _numbered(item, link)]
    density = resistance.mass / max(sum(volume(shape) for _, _, shape in shapes), 1e-9)
    for link, i, shape in shapes:
        T = invert(T_world_at) @ poses[link]
        name = f"{item.name}/{link}#{i}"
        pieces = item.model.pieces(link, i) if (link, i) in reached else ()
        if len(pieces) < 2:
            geoms, fuller = [add_shape(spec, body, shape, T, name)], 1.0
        else:
            geoms = [add_hull(spec, body, h, T, f"{name}.{k}") for k, h in enumerate(pieces)]
            fuller = volume(shape) / sum(map(hull_volume, pieces))
        for geom in geoms:
            dress(geom, Kind.PART, touched=config.hold == "contact", handle=_is_handle(link, shape))
            geom.density = density * fuller


def reached_elements(item: SceneObject, joint: str, motion: Motion) -> set[tuple[str, int]]:
    """Return the elements of a part near its grasps in a motion, as (link, index)."""
    found = set()
    for hold in motion.holds or (Hold(0, len(motion.q) - 1),):
        poses = item.link_poses({joint: float(motion.object_q[hold.first])})
        tool = motion.Ts_world_tool[hold.first, :3, 3]
        for link in item.model.moved_by(joint):
            at = apply(invert(poses[link]), tool[None])[0]
            for i, hull in enumerate(item.model.hulls[link]):
                beyond = np.maximum(hull.vertices.min(0) - at, at - hull.vertices.max(0))
                if np.linalg.norm(np.maximum(beyond, 0.0)) < MAX_HAND_DISTANCE:
                    found.add((link, i))
    return found


def _numbered(item: SceneObject, link: str) -> list[tuple[int, Geometry]]:
    return list(enumerate(item.model.urdf.links[link].collisions))


def _add_joint(
    body: Any, joint: Joint, value: float, resistance: PartResistance, deviation: Deviation | None
) -> None:
    """Add the part's joint to a body whose pose belongs to the given joint value."""
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    axis = joint.axis if deviation is None else deviation.axis
    added = body.add_joint(name=PART, type=kind, axis=axis, ref=value)
    if deviation is not None:
        added.pos = deviation.shift
    added.frictionloss, added.damping = resistance.friction, [resistance.damping, 0, 0]
    if math.isfinite(joint.lower) and math.isfinite(joint.upper):
        added.limited, added.range = 1, [joint.lower, joint.upper]


def _is_handle(link: str, shape: Geometry) -> bool:
    return HANDLE_WORD in link.lower() or HANDLE_WORD in shape.name.lower()
