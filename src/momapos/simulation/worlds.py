"""Build the worlds of a motion: the true one, and the one that the robot believes."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import orthonormal
from momapos.model.records import Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .config import ExecutionConfig, ModelErrorConfig
from .robot_dynamics import Dynamics, SimulatedHand
from .run_record import Pose
from .simulated_room import (
    Deviation,
    PartResistance,
    Seal,
    draw_resistance,
    held_link,
    reached_elements,
    seal_of,
)
from .simulation import Simulation, build_simulation
from .true_worlds import TrueWorld

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


_TUNED_STATES = 5
"""Number of arm states for which the motors are tuned [-]."""


@dataclass(frozen=True, eq=False)
class WorldSetup:
    """Robot, motion and configuration that all worlds of one motion share."""

    scene: Scene
    """Room at the start of the run."""
    robot: Robot
    base_pose: Pose
    """x [m], y [m], yaw [rad]."""
    motion: Motion
    task: Task
    hand: SimulatedHand
    dynamics: Dynamics
    config: ExecutionConfig

    def build(
        self,
        room: TrueWorld,
        resistance: PartResistance,
        deviation: Deviation | None = None,
        begin: float | None = None,
    ) -> Simulation:
        """Build the simulation of a room.

        Args:
            room: The room, and the task in it.
            resistance: Resistance of the part.
            deviation: Difference of the part's joint from the room's model.
            begin: Initial value of the part's joint [rad] or [m]; by default the room's.
        """
        reached: set[tuple[str, int]] = set()
        held = ""
        if room.task.joint is not None:
            values = room.values(self.motion.object_q, self.scene, self.task)
            item = room.scene.object(room.task.object)
            motion = replace(self.motion, object_q=values)
            reached = reached_elements(item, room.task.joint, motion)
            held = held_link(item, room.task.joint, motion)
        states = np.concatenate([self.motion.approach, self.motion.q])
        tuned = states[np.linspace(0, len(states) - 1, _TUNED_STATES).astype(int)]
        return build_simulation(
            room.scene, self.robot, self.base_pose, tuned, room.task, self.hand, self.dynamics,
            resistance, deviation, self.config, begin=begin, reached=reached, held=held,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Worlds:
    """The worlds of one motion."""

    room: TrueWorld
    """The true room, and the task in it."""
    there: Simulation
    """Simulation of the true room."""
    known: Simulation
    """Simulation of the believed room, for clearance and weight; `there` if they are the same."""
    resistance: PartResistance
    """Resistance of the true part."""
    seal: Seal


def draw_worlds(
    setting: WorldSetup,
    rng: np.random.Generator,
    *,
    true_world: TrueWorld | None = None,
    believed: Scene | None = None,
    begin: float | None = None,
) -> Worlds:
    """Draw resistance and deviation of the part, and build the true and the believed world.

    Args:
        setting: What all worlds share.
        rng: Draws resistance and model errors, as configured.
        true_world: The true room; by default the setting's.
        believed: Robot's scene after earlier attempts; None for the first one.
        begin: Value of the part's joint after these [rad] or [m].
    """
    there = true_world or TrueWorld(setting.scene, setting.task)
    item = there.scene.object(there.task.object)
    joint = None if there.task.joint is None else item.model.joint(there.task.joint)
    errors = setting.config.errors
    resistance = draw_resistance(item, joint, setting.config.furniture, rng)
    deviation = None
    if errors.any:
        resistance = draw_resistance_error(resistance, errors, rng)
        axis = np.array([0.0, 0.0, 1.0]) if joint is None else joint.axis
        deviation = draw_deviation(axis, errors, rng)
    seal = seal_of(item, joint, resistance.pull, setting.config.furniture)
    world = setting.build(there, resistance, deviation, begin)
    if deviation is not None and joint is not None and item.values()[joint.name] == seal.closed:
        first = world if begin is None else setting.build(there, resistance, deviation)
        # A deviating joint must not let the weight open a closed part.
        if seal.outward * first.weight_on_part > resistance.friction:
            deviation = mirrored(deviation, joint.axis)
            world = setting.build(there, resistance, deviation, begin)
    if deviation is None and believed is None and true_world is None:
        return Worlds(there, world, world, resistance, seal)
    known = TrueWorld(believed or setting.scene, setting.task)
    return Worlds(there, world, setting.build(known, resistance), resistance, seal)
