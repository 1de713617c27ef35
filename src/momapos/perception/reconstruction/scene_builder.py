"""From what was found in a room to a scene file: models where there are some, boxes elsewhere."""

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
from momapos.model.urdf import Articulated, Joint, opening_of, read_urdf

from .object_model import seen_from

if TYPE_CHECKING:
    from jaxtyping import Float

MISFIT = 0.15
"""A given model may differ in its proportions from the box by this without a warning [-]."""
_NAME = re.compile(r"\w[\w .-]{0,79}")
_UP, _RIGHT = np.array([0.0, 0.0, 1.0]), np.array([1.0, 0.0, 0.0])


@dataclass(frozen=True)
class GivenModel:
    """A URDF that someone has of an object."""

    path: Path
    up: Literal["y", "z"] = "z"
    """Which axis of its root points up."""
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
    """Write a scene with its URDF files, all of them or none.

    Args:
        detections: All objects of the room.
        models: Models of some of them, by name: a `furniture_model`, or a given one, placed by
            `place_model`. All other objects are boxes.
        floor: Corners of the floor [m]; None where it has no known end.
        out: The scene file; URDF files go into the folder `<stem>_urdf` beside it.
        start: Where the robot's base stands at first: x [m], y [m], yaw [rad]; None if not known.

    Returns:
        `out`.

    Raises:
        UnknownNameError: A model is of an object that was not detected.
        InputError: Two objects share a name, a name cannot be a file's, or the place cannot be
            written to.
    """
    names = [detection.name for detection in detections]
    for name in names:
        if not _NAME.fullmatch(name):
            raise InputError(
                f"object name {name!r:.100} cannot be a file's name; use up to 80 letters, "
                "digits, spaces, and _ - ."
            )
        if names.count(name) > 1:
            raise InputError(f"two objects are named {name!r}; names must be unique")
    for name, model in models.items():
        if name not in names:
            raise unknown_name("object", name, names, "the detections")
        if model.name != name:
            raise InputError(f"the model of {name!r} is named {model.name!r}; they must agree")
    things = [models.get(d.name) or _boxed(d) for d in detections]
    pieces = [thing for thing in things if isinstance(thing, Piece)]
    others = [thing for thing in things if isinstance(thing, SceneObject)]
    sure = {d.name: (d.seen, d.score) for d in detections if d.seen is not None}
    return write_kitchen(out, out.stem, pieces, floor, start, others, sure)


def _boxed(detection: Detection) -> Piece:
    """An object as one box."""
    box = detection.box
    return solid(detection.name, detection.label, vec(box.size), vec(box.center), box.yaw)


# ------------------------------------------------------------------------------------ given models


def place_model(
    detection: Detection, facing: float, given: GivenModel
) -> tuple[SceneObject, tuple[str, ...]]:
    """Scale a given model and put it where an object was found.

    One scale serves all three sides, the one whose worst side is off by the least factor. The
    model then stands on the box's bottom, its front flush with the box's and in the middle.

    Args:
        detection: The object with its box.
        facing: Yaw of the outward normal of the box's front [rad]; the nearest side is taken.
        given: The model.

    Returns:
        The placed object, and a warning where its proportions differ from the box's.

    Raises:
        UrdfError: The file cannot be used.
        InputError: It has no shape, or nothing tells where its front is.
    """
    model = Articulated(read_urdf(given.path))
    tilt = rotation_about(_RIGHT, np.pi / 2) if given.up == "y" else np.eye(3)
    front = given.front if given.front is not None else _front(model, tilt, given.path)
    R = rotation_about(_UP, -np.pi / 2 - front) @ tilt
    points = _points(model, model.links)
    if not len(points):
        raise InputError(f"{given.path}: has no shape that could be scaled to a box")
    low, high = (points @ R.T).min(0), (points @ R.T).max(0)
    yaw, size = seen_from(detection.box, facing)
    ratios = np.array(size) / np.maximum(high - low, 1e-9)
    scale = float(np.sqrt(ratios.min() * ratios.max()))
    half = np.array(size) / 2
    shift = np.array([-scale * (low + high)[0] / 2, *(-half[1:] - scale * low[1:])])
    T_world_piece = pose(detection.box.center, rotation_about(_UP, yaw))
    placed = Articulated(read_urdf(given.path, scale=scale))
    item = SceneObject(detection.name, detection.label, T_world_piece @ pose(shift, R), placed)
    off = float(np.sqrt(ratios.max() / ratios.min())) - 1
    if off <= MISFIT:
        return item, ()
    text = " x ".join(f"{v:.2f}" for v in scale * (high - low))
    box = " x ".join(f"{v:.2f}" for v in size)
    return item, (f"{detection.name}: {given.path} is {text} m where the box is {box} m",)


def _front(model: Articulated, tilt: Float[np.ndarray, "3 3"], path: Path) -> float:
    """Yaw of the side that the parts of a model open to [rad], a multiple of a quarter turn.

    Each part counts by how far it moves, so that a door outweighs the knobs.
    """
    way = tilt @ sum((_opening(model, joint) for joint in model.joints.values()), np.zeros(3))
    if float(np.hypot(way[0], way[1])) < 1e-3:
        raise InputError(f"{path}: no part opens to a side, so say where its front is")
    return float(np.round(np.arctan2(way[1], way[0]) / (np.pi / 2)) * np.pi / 2)


def _opening(model: Articulated, joint: Joint) -> Float[np.ndarray, "3"]:
    """How the middle of a part moves as its joint starts to open, in the root's frame.

    One that turns without end opens nothing.
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
    """Corners of the shapes of links at rest, in the root's frame."""
    poses = model.rest_poses
    corners = [apply(poses[n], hull.vertices) for n in links for hull in model.hulls[n]]
    return np.concatenate(corners) if corners else np.zeros((0, 3))
