"""Random differences between the true world and the scene that a plan is based on."""

from __future__ import annotations

from dataclasses import replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import orthonormal

from .config import ModelErrorConfig
from .simulated_room import Deviation, PartResistance

if TYPE_CHECKING:
    from jaxtyping import Float


def draw_deviation(
    axis: Float[np.ndarray, "3"], config: ModelErrorConfig, rng: np.random.Generator
) -> Deviation:
    """Draw the deviation of the task's object.

    Args:
        axis: Axis of the joint, in its own frame.
        config: Sizes of the errors.
        rng: Draws the directions.
    """
    away, across, about = _unit(rng.normal(size=3)), *_perpendicular(axis, rng)
    turned = np.cos(config.tilt) * axis + np.sin(config.tilt) * np.cross(about, axis)
    return Deviation(config.handle * away, config.axis * across, turned)


def mirrored(deviation: Deviation, axis: Float[np.ndarray, "3"]) -> Deviation:
    """Return the deviation with the opposite joint offset and tilt.

    Args:
        deviation: Deviation of the object.
        axis: Axis of the joint as modeled, in its own frame.
    """
    across = deviation.axis - (deviation.axis @ axis) * axis
    return replace(deviation, shift=-deviation.shift, axis=deviation.axis - 2.0 * across)


def draw_resistance_error(
    resistance: PartResistance, config: ModelErrorConfig, rng: np.random.Generator
) -> PartResistance:
    """Draw each resistance of a part up or down by the configured share."""
    up, down = 1.0 + config.resistance, 1.0 - config.resistance
    mass, friction, damping, pull = rng.choice([up, down], 4).tolist()
    return replace(
        resistance,
        mass=resistance.mass * mass,
        friction=resistance.friction * friction,
        damping=resistance.damping * damping,
        pull=resistance.pull * pull,
    )


def _perpendicular(
    axis: Float[np.ndarray, "3"], rng: np.random.Generator
) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    one = orthonormal(axis)
    other = np.cross(axis, one)
    angles = rng.uniform(-np.pi, np.pi, 2)
    first, second = (np.cos(angle) * one + np.sin(angle) * other for angle in angles)
    return first, second


def _unit(vector: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    return np.asarray(vector / np.linalg.norm(vector))
