"""The worlds that a motion is executed in: the one that is there, and the one the robot knows."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from momapos.model.records import Motion, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .config import ExecutionConfig
from .dynamics import Dynamics
from .model_errors import draw_deviation, mirrored, resisting
from .run_record import Pose
from .simulated_hand import Hand
from .simulated_room import Deviation, Resistance, Seal, draw_resistance, reached_elements, seal_of
from .simulation import Simulation, build_simulation
from .true_worlds import TrueWorld

_STATES = 5
"""States of the motion for which the motors are tuned [-]."""


@dataclass(frozen=True, eq=False)
class Setting:
    """Who executes what: what all worlds of one motion share."""

    scene: Scene
    """The room that the run began with."""
    robot: Robot
    base_pose: Pose
    """x [m], y [m], yaw [rad]."""
    motion: Motion
    task: Task
    hand: Hand
    dynamics: Dynamics
    config: ExecutionConfig

    def build(
        self,
        room: TrueWorld,
        resistance: Resistance,
        deviation: Deviation | None = None,
        begin: float | None = None,
    ) -> Simulation:
        """A simulation of a room.

        Args:
            room: The room, and the task there.
            resistance: Of the part.
            deviation: How the part's joint differs from the room's model.
            begin: Where the part's joint stands at first [rad] or [m]; by default as
                the room has it.
        """
        reached: set[tuple[str, int]] = set()
        if room.task.joint is not None:
            values = room.values(self.motion.object_q, self.scene, self.task)
            thing = room.scene.object(room.task.object)
            motion = replace(self.motion, object_q=values)
            reached = reached_elements(thing, room.task.joint, motion)
        states = np.concatenate([self.motion.approach, self.motion.q])
        tuned = states[np.linspace(0, len(states) - 1, _STATES).astype(int)]
        return build_simulation(
            room.scene, self.robot, self.base_pose, tuned, room.task, self.hand, self.dynamics,
            resistance, deviation, self.config, begin=begin, reached=reached,
        )  # fmt: skip


@dataclass(frozen=True, eq=False)
class Worlds:
    """The worlds of one motion."""

    room: TrueWorld
    """What is really there, and the task in it."""
    there: Simulation
    """The same, simulated."""
    known: Simulation
    """What the robot believes, and asks for room and weight; the same where nothing differs."""
    resistance: Resistance
    """Of the part that is there."""
    seal: Seal


def draw_worlds(
    setting: Setting,
    rng: np.random.Generator,
    *,
    true_world: TrueWorld | None = None,
    believed: Scene | None = None,
    begin: float | None = None,
) -> Worlds:
    """Draw how the part resists and lies, and build what is there and what is known of it.

    Args:
        setting: Who executes what.
        rng: Draws, where the configuration has furniture or joints that differ.
        true_world: What is really there; as the scene says by default.
        believed: What earlier tries left the robot with; None for the first one.
        begin: Where these left the part [rad] or [m].
    """
    there = true_world or TrueWorld(setting.scene, setting.task)
    item = there.scene.object(there.task.object)
    joint = None if there.task.joint is None else item.model.joint(there.task.joint)
    errors = setting.config.errors
    resistance = draw_resistance(item, joint, setting.config.furniture, rng)
    deviation = None
    if errors.any:
        resistance = resisting(resistance, errors, rng)
        axis = np.array([0.0, 0.0, 1.0]) if joint is None else joint.axis
        deviation = draw_deviation(axis, errors, rng)
    seal = seal_of(item, joint, resistance.pull, setting.config.furniture.seal_range)
    world = setting.build(there, resistance, deviation, begin)
    if deviation is not None and joint is not None and item.values()[joint.name] == seal.closed:
        first = world if begin is None else setting.build(there, resistance, deviation)
        # What is shut has not been opened by its weight.
        if seal.outward * first.weight_on_part > resistance.friction:
            deviation = mirrored(deviation, joint.axis)
            world = setting.build(there, resistance, deviation, begin)
    if deviation is None and believed is None and true_world is None:
        return Worlds(there, world, world, resistance, seal)
    known = TrueWorld(believed or setting.scene, setting.task)
    return Worlds(there, world, setting.build(known, resistance), resistance, seal)
