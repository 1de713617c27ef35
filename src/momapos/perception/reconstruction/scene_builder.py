"""Write a scene file from detected objects: models where available, boxes elsewhere."""

from __future__ import annotations

import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Literal

import numpy as np

from momapos.core import InputError, unknown_name
from momapos.core.geometry import apply, pose, rotation_about
from momapos.model.records import Detection
from momapos.model.scene import SceneObject
from momapos.model.scene.library import Piece, solid, vec, write_kitchen
from momapos.model.urdf import Articulated, Joint, opening_of, read_furniture

from .object_model import seen_from

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_DEVIATION = 0.15
"""Larger differences in proportions between a given model and its box give a warning [-]."""
_UP = np.array([0.0, 0.0, 1.0])
_NAME = re.compile(r"\w[\w .-]{0,79}")
_RIGHT = np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class GivenModel:
    """A URDF that the user has of an object."""

    path: Path
    up: Literal["y", "z"] = "z"
    """Axis of its root that points up."""
    front: float | None = None
    """Yaw of its front's outward normal, seen from above [rad]; None: where its parts open to."""


def build_scene(
    detections: Sequence[Detection],
    models: Mapping[str, Piece | SceneObject],
    floor: Sequence[tuple[float, float]] | None,
    out: Path,
    *,
    start: tuple[float, float, float] | None = None,
) -> Path:
    """Write a scene with its URDF files, all or none.

    Args:
        detections: All objects of the room.
        models: Models of some of them, by name: from `furniture_model` or `place_model`. All other
            objects are boxes.
        floor: Corners of the floor [m]; None if unknown.
        out: The scene file; URDF files go into the folder `<stem>_urdf` next to it.
        start: Initial pose of the robot's base: x [m], y [m], yaw [rad]; None if unknown.

    Returns:
        `out`.

    Raises:
        UnknownNameError: A model is of an object that was not detected.
        InputError: Two objects share a name, a name is not a valid file name, or the folder is not
            writable.
    """
    names = [detection.name for detection in detections]
    for name in names:
        if not _NAME.fullmatch(name):
            raise InputError(
                f"object name {name!r:.100} is not a valid file name; use up to 80 letters, "
                "digits, spaces, and _ - ."
            )
        if names.count(name) > 1:
            raise InputError(f"two objects are named {name!r}; names must be unique")
    for name, model in models.items():
        if name not in names:
            raise unknown_name("object", name, names, "the detections")
        if model.name != name:
            raise InputError(f"the model of {name!r} is named {model.name!r}; the names must agree")
    models_or_boxes = [models.get(d.name) or _boxed(d) for d in detections]
    pieces = [one for one in models_or_boxes if isinstance(one, Piece)]
    others = [one for one in models_or_boxes if isinstance(one, SceneObject)]
    sure = {d.name: (d.seen, d.score) for d in detections if d.seen is not None}
    return write_kitchen(out, out.stem, pieces, floor, start, others, sure)


def _boxed(detection: Detection) -> Piece:
    box = detection.box
    return solid(detection.name, detection.label, vec(box.size), vec(box.center), box.yaw)


# ------------------------------------------------------------------------------------ given models


def place_model(
    detection: Detection, facing: float, given: GivenModel
) -> tuple[SceneObject, tuple[str, ...]]:
    """Scale a given model and place it at a detected object.

    The scale is uniform and minimizes the largest deviation of the three sides. The model stands on
    the box's bottom, centered, with its front flush with the box's.

    Args:
        detection: The object with its box.
        facing: Yaw of the outward normal of the box's front [rad]; the nearest side is used.
        given: The model.

    Returns:
        The placed object, and a warning if its proportions differ from the box's.

    Raises:
        UrdfError: The file is not usable.
        InputError: The model has no shape, or its front is unknown.
    """
    model = Articulated(read_furniture(given.path))
    tilt = rotation_about(_RIGHT, np.pi / 2) if given.up == "y" else np.eye(3)
    front = given.front if given.front is not None else _front(model, tilt, given.path)
    R = rotation_about(_UP, -np.pi / 2 - front) @ tilt
    points = _points(model, model.links)
    if not len(points):
        raise InputError(f"{given.path}: has no shape to scale to the box")
    low, high = (points @ R.T).min(0), (points @ R.T).max(0)
    yaw, size = seen_from(detection.box, facing)
    ratios = np.array(size) / np.maximum(high - low, 1e-9)
    scale = float(np.sqrt(ratios.min() * ratios.max()))
    half = np.array(size) / 2
    shift = np.array([-scale * (low + high)[0] / 2, *(-half[1:] - scale * low[1:])])
    T_world_piece = pose(detection.box.center, rotation_about(_UP, yaw))
    placed = Articulated(read_furniture(given.path, scale=scale))
    item = SceneObject(detection.name, detection.label, T_world_piece @ pose(shift, R), placed)
    off = float(np.sqrt(ratios.max() / ratios.min())) - 1
    if off <= MAX_DEVIATION:
        return item, ()
    text = " x ".join(f"{v:.2f}" for v in scale * (high - low))
    box = " x ".join(f"{v:.2f}" for v in size)
    return item, (f"{detection.name}: {given.path} scaled is {text} m, but the box is {box} m",)


def _front(model: Articulated, tilt: Float[np.ndarray, "3 3"], path: Path) -> float:
    """Return the yaw of the side that the parts of a model open to [rad], a multiple of pi / 2.

    Each part is weighted by how far it moves, so that a door outweighs the knobs.
    """
    direction = tilt @ sum((_opening(model, joint) for joint in model.joints.values()), np.zeros(3))
    if float(np.hypot(direction[0], direction[1])) < 1e-3:
        raise InputError(f"{path}: no part opens to a side, so its front is unknown; give front")
    return float(np.round(np.arctan2(direction[1], direction[0]) / (np.pi / 2)) * np.pi / 2)


def _opening(model: Articulated, joint: Joint) -> Float[np.ndarray, "3"]:
    """Return how the middle of a part moves as its joint starts to open, in the root's frame.

    A continuous joint opens nothing.
    """
    points = _points(model, model.moved_by(joint.name))
    if not np.isfinite([joint.lower, joint.upper]).all() or not len(points):
        return np.zeros(3)
    T = model.rest_poses[joint.parent] @ joint.T_parent_joint
    axis = opening_of(model, joint.name).sign * T[:3, :3] @ joint.axis
    if joint.kind == "prismatic":
        return axis * float(np.linalg.norm(np.ptp(points, axis=0))) / 2
    return np.cross(axis, (points.min(0) + points.max(0)) / 2 - T[:3, 3])


def _points(model: Articulated, links: Sequence[str]) -> Float[np.ndarray, "n 3"]:
    poses = model.rest_poses
    corners = [apply(poses[n], hull.vertices) for n in links for hull in model.hulls[n]]
    return np.concatenate(corners) if corners else np.zeros((0, 3))
