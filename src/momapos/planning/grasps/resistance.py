"""Estimate the force that moves a part, which a grasp must transmit."""

from __future__ import annotations

from collections.abc import Mapping
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.scene import SceneObject
from momapos.model.urdf import Articulated, Hull, joint_motion

from .config import ResistanceConfig
from .handle_shapes import CarriedPart

if TYPE_CHECKING:
    from jaxtyping import Float

GRAVITY = 9.81
_PARTS = 1024
"""Number of parts whose mass is cached [-]."""


def resistance_of(
    item: SceneObject,
    joint: str,
    values: Float[np.ndarray, " v"],
    handle_lever: float,
    config: ResistanceConfig,
) -> float:
    """Return the largest torque [Nm] or force [N] that a joint needs over a range of values.

    The sum of seal or latch (pulled at the handle), friction, and the largest weight.

    Args:
        item: The object.
        joint: Its joint.
        values: Joint values [rad] or [m].
        handle_lever: Distance of the handle from the axis [m]; 1 for a slide.
        config: Assumed values.
    """
    record = item.joint(joint)
    slides = record.kind == "prismatic"
    words = f"{item.category} {item.name}".lower()
    sealed = not slides and any(word in words for word in config.sealed)
    pull = config.seal_force if sealed else config.latch_force
    friction = config.slide_friction if slides else config.hinge_friction
    return pull * handle_lever + friction + float(weight_at(item, joint, values, config).max())


def weight_at(
    item: SceneObject, joint: str, values: Float[np.ndarray, " v"], config: ResistanceConfig
) -> Float[np.ndarray, " v"]:
    """Return torque [Nm] or force [N] of a part's weight at joint values [rad], [m]."""
    record = item.joint(joint)
    mass, center = _mass(item.model, joint, config)
    down = (item.link_poses()[record.parent] @ record.T_parent_joint)[:3, :3].T @ [0.0, 0.0, -1.0]
    if record.kind == "prismatic":
        return np.full(len(values), abs(mass * GRAVITY * float(down @ record.axis)))
    lever = np.cross(joint_motion(record, values)[:, :3, :3] @ center, down) @ record.axis
    return np.asarray(mass * GRAVITY * np.abs(lever))


def stays_in_place(item: SceneObject, joint: str, value: float, config: ResistanceConfig) -> bool:
    """Check that friction holds a released part in place."""
    slides = item.joint(joint).kind == "prismatic"
    friction = config.slide_friction if slides else config.hinge_friction
    return float(weight_at(item, joint, np.array([value]), config)[0]) < friction


@lru_cache(maxsize=_PARTS)
def _mass(
    model: Articulated, joint: str, config: ResistanceConfig
) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return mass [kg] and center of mass [m] of the part that a joint moves, in its frame."""
    return _mass_of_links(model, CarriedPart.of(model, joint).poses(model.moved_by(joint)), config)


def mass_of(model: Articulated, config: ResistanceConfig) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return mass [kg] and center of mass [m] of a whole object at rest, in its root's frame."""
    return _mass_of_links(model, model.rest_poses, config)


def _mass_of_links(
    model: Articulated, T_link: Mapping[str, Float[np.ndarray, "4 4"]], config: ResistanceConfig
) -> tuple[float, Float[np.ndarray, "3"]]:
    volumes, centers = [], []
    for link, T in T_link.items():
        for hull in model.hulls[link]:
            volume, center = _volume(hull)
            volumes.append(volume)
            centers.append(T[:3, :3] @ center + T[:3, 3])
    middle = np.average(centers, axis=0, weights=volumes) if sum(volumes) > 0 else np.zeros(3)
    mass = np.clip(config.density * sum(volumes), config.least_mass, config.most_mass)
    return float(mass), middle


def _volume(hull: Hull) -> tuple[float, Float[np.ndarray, "3"]]:
    """Return volume [m^3] and centroid [m] of a hull."""
    a, b, c = (hull.vertices[hull.faces[:, k]] for k in range(3))
    parts = np.einsum("fi,fi->f", np.cross(a, b), c) / 6
    total = float(parts.sum())
    if total <= 0:
        return 0.0, hull.vertices.mean(0)
    return total, ((a + b + c) / 4 * parts[:, None]).sum(0) / total
