"""Where a moving part can be held: its handle, or the free edge where it has none."""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.errors import TaskError
from momapos.geometry.transforms import apply, invert
from momapos.kinematics.articulated import Articulated, joint_motion
from momapos.kinematics.opening import opening_of
from momapos.kinematics.urdf import Geometry
from momapos.scene.scene import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float

WORD = "handle"
_POINTS = 9
"""Points on the way of a handle [-]."""
_MODELS = 1024
"""Parts whose geometry is remembered [-]."""
ROUND = 1.5
"""A handle less elongated than this is a knob: it can be turned about freely [-]."""


@dataclass(frozen=True)
class Handle:
    """Something to hold, in the frame of the moving link."""

    center: Float[np.ndarray, "3"]
    long: Float[np.ndarray, "3"]
    """Unit vector along the handle."""
    out: Float[np.ndarray, "3"]
    """Unit vector from the part toward the robot, perpendicular to `long`."""
    half_length: float
    """Half the length along `long` [m]."""
    thickness: float
    """Size across, which the fingers must span [m]."""
    knob: bool
    edge: bool
    """Whether this is a free edge and no handle."""


def has_handle(model: Articulated, joint: str) -> bool:
    """Whether the part that a joint moves has geometry named "handle"."""
    return bool(_handle_shapes(model, joint))


def _handle_shapes(model: Articulated, joint: str) -> list[tuple[str, Geometry]]:
    """Named shapes on the part itself, not on parts that hang from it by further joints."""
    return model.shapes_named(WORD, rigid_links(model, joint))


def rigid_links(model: Articulated, joint: str) -> tuple[str, ...]:
    """Links that a joint moves and that are fixed to each other."""
    links = {model.joint(joint).child}
    for other in model.urdf.joints:
        if other.parent in links and not other.movable:
            links.add(other.child)
    return tuple(name for name in model.links if name in links)


def opening_direction(
    item: SceneObject, joint: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Middle of the part that a joint moves, and where it moves when it opens, in the world."""
    middle, direction = _opening(item.model, joint)
    T_world_part = item.link_poses()[item.model.joint(joint).child]
    return apply(T_world_part, middle[None])[0], T_world_part[:3, :3] @ direction


@lru_cache(maxsize=_MODELS)
def _opening(
    model: Articulated, joint: str
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Middle of a part and where it moves when it opens, in the part's frame."""
    links = rigid_links(model, joint)
    T_link = _poses_in_part(model, joint, links)
    centers = [apply(T_link[n], h.vertices).mean(0) for n in links for h in model.hulls[n]]
    middle = np.mean(centers, axis=0) if centers else np.zeros(3)
    return middle, _motion_direction(model, joint, opening_of(model, joint).sign, middle)


@lru_cache(maxsize=_MODELS)
def find_handle(model: Articulated, joint: str, sign: float) -> Handle:
    """Find what to hold on the part that a joint moves.

    Args:
        model: The object.
        joint: The joint.
        sign: Direction in which the joint opens (+1 or -1); the handle faces that way.

    Raises:
        TaskError: The part has no geometry at all.
    """
    links = rigid_links(model, joint)
    T_link = _poses_in_part(model, joint, links)
    shapes = _handle_shapes(model, joint)
    points = [apply(T_link[name], model.hull(name, shape).vertices) for name, shape in shapes]
    if not points:
        panel = [apply(T_link[name], hull.vertices) for name in links for hull in model.hulls[name]]
        if not panel:
            raise TaskError(f"joint {joint!r} moves nothing that has a shape")
        return _free_edge(np.concatenate(panel), model, joint, sign)
    return _from_box(_largest_cluster(points), model, joint, sign)


def handle_path(item: SceneObject, joint: str, to: float) -> Float[np.ndarray, "k 3"]:
    """Where the handle passes while a joint goes from where it stands to a value, in the world [m].

    Args:
        item: The object.
        joint: The joint.
        to: Value it goes to [rad] or [m].
    """
    record = item.model.joint(joint)
    handle = find_handle(item.model, joint, opening_of(item.model, joint).sign)
    values = np.linspace(item.values()[joint], to, _POINTS)
    T_world_joint = item.link_poses()[record.parent] @ record.T_parent_joint
    return apply(T_world_joint @ joint_motion(record, values), handle.center[None])[:, 0]


def _poses_in_part(
    model: Articulated, joint: str, links: tuple[str, ...]
) -> dict[str, Float[np.ndarray, "4 4"]]:
    poses = model.rest_poses
    T_part_root = invert(poses[model.joint(joint).child])
    return {name: T_part_root @ poses[name] for name in links}


def _largest_cluster(points: list[np.ndarray]) -> np.ndarray:
    """Merge shapes whose boxes touch within 2 cm; return the points of the largest group."""
    low = np.array([p.min(0) for p in points]) - 0.01
    high = np.array([p.max(0) for p in points]) + 0.01
    touch = np.all((low[:, None] <= high[None]) & (low[None] <= high[:, None]), axis=2)
    joined = touch @ touch  # over ever longer chains, until none grows
    while (joined != touch).any():
        touch, joined = joined, joined @ joined
    first = joined.argmax(axis=1)
    groups = [
        np.concatenate([p for p, k in zip(points, first, strict=True) if k == g])
        for g in np.unique(first)
    ]
    return max(groups, key=lambda g: float(np.linalg.norm(np.ptp(g, axis=0))))


def _motion_direction(model: Articulated, joint: str, sign: float, point: np.ndarray) -> np.ndarray:
    """Direction in which a point of the part moves when the joint opens, in the part's frame."""
    record = model.joint(joint)
    if record.kind == "prismatic":
        return sign * record.axis
    velocity = sign * np.cross(record.axis, point)
    length = float(np.linalg.norm(velocity))
    return velocity / length if length > 1e-6 else sign * record.axis


def _from_box(points: np.ndarray, model: Articulated, joint: str, sign: float) -> Handle:
    center, rotation, half = model.box_around(points)
    order = np.argsort(half)
    motion = _motion_direction(model, joint, sign, center)
    # The outward side is the one of the two short axes along which the part moves off.
    long = rotation[:, order[2]]
    across = [order[0], order[1]]
    if abs(motion @ long) > 0.9:
        # A peg that points at the robot: hold it across, whichever of the rest is longer.
        across, long = [order[2], order[0]], rotation[:, order[1]]
    out_axis = max(across, key=lambda k: abs(float(motion @ rotation[:, k])))
    side = next(k for k in range(3) if k != out_axis and abs(rotation[:, k] @ long) < 0.5)
    out = rotation[:, out_axis] * np.sign(motion @ rotation[:, out_axis])
    along = int(np.argmax(np.abs(rotation.T @ long)))
    knob = bool(half[along] < ROUND * half[side])
    return Handle(
        center, long, out, float(half[along]), 2 * float(min(half[side], half[along])), knob, False
    )


def _free_edge(points: np.ndarray, model: Articulated, joint: str, sign: float) -> Handle:
    """The edge of a panel that is farthest from the hinge, or the rim of a drawer's front."""
    center, rotation, half = model.box_around(points)
    record = model.joint(joint)
    motion = _motion_direction(model, joint, sign, center)
    normal = int(np.argmax(np.abs(rotation.T @ motion)))
    out = rotation[:, normal] * np.sign(rotation[:, normal] @ motion)
    plane = [k for k in range(3) if k != normal]
    if record.kind == "prismatic":
        along = max(plane, key=lambda k: half[k])
        far = rotation[:, next(k for k in plane if k != along)]
        front = center + out * half[normal]
        return Handle(front, rotation[:, along], out, float(half[along]), 0.0, False, True)
    along = max(plane, key=lambda k: abs(float(record.axis @ rotation[:, k])))
    across = next(k for k in plane if k != along)
    far = rotation[:, across]
    radial = center - record.axis * float(center @ record.axis)
    far = far * (1.0 if far @ radial >= 0 else -1.0)
    # On the front face, a finger's width inside the edge.
    point = center + far * max(half[across] - 0.02, 0.0) + out * half[normal]
    return Handle(
        point, rotation[:, along], out, float(half[along]), 2 * float(half[normal]), False, True
    )
