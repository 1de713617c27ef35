"""Drive the simulated base along a path: late, with slipping wheels, and within its limits.

The robot knows its base by odometry, and moves its arm accordingly. Where the wheels slip, the true
base is elsewhere, and the hand feels it.
"""

from __future__ import annotations

from collections import deque
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core.geometry import compose, local_points
from momapos.model.robots import Robot

from .config import (
    BASE_ASIDE,
    BASE_BANDWIDTH,
    BASE_FOLLOW_RATE,
    BASE_STEERING,
    BASE_YIELD,
    SLIP_TIME,
    BaseTrackingConfig,
)
from .simulation import Simulation

if TYPE_CHECKING:
    from jaxtyping import Float

_AT_REST = 0.01
"""Speed below which a base stands still [m/s] or [rad/s]."""


class BaseDrive:
    """The base's motors, its odometry, and what its wheels do.

    All poses are in the coordinates of the base's joints: relative to the pose for which the world
    was built. A base that is never sent anywhere holds its pose.
    """

    def __init__(
        self,
        world: Simulation,
        robot: Robot,
        first: Float[np.ndarray, "3"],
        config: BaseTrackingConfig | None,
        step: float,
        rng: np.random.Generator | None = None,
    ) -> None:
        """Start at a path's first pose, for which the world was built.

        Args:
            world: The world.
            robot: The robot, with the limits of its base.
            first: The first pose of the base's path.
            config: How it follows its path; None to be where it is sent, at once.
            step: Time between updates [s].
            rng: Draws the slip of the wheels.
        """
        self._whole_turns = first - initial_base_pose(world)
        self._whole_turns = np.round(self._whole_turns / (2.0 * np.pi)) * [0.0, 0.0, 2.0 * np.pi]
        self._world, self._robot = world, robot
        self._exact, self._config = config is None, config or BaseTrackingConfig(0.0, 0.0)
        self._step, self._rng = step, rng or np.random.default_rng(0)
        self.goal = np.zeros(3)
        """Commanded pose."""
        self.odometry, self.velocity = np.zeros(3), np.zeros(3)
        """Pose and velocity, as the robot knows them."""
        self.traveled = 0.0
        """Length of its way so far, by odometry [m]."""
        self._true, self._slip, self._late = np.zeros(3), np.zeros(3), np.zeros(3)
        waiting = 1 + round(self._config.delay / step)
        self._sent = deque([np.zeros(3)] * waiting, maxlen=waiting)
        self.moves = False
        self._aside, self._relieves = np.zeros(3), False
        """Offset from the path by which the base relieves the hand, and whether it does now."""

    def put(self, pose: Float[np.ndarray, "3"]) -> None:
        """Put the base at a pose in the world, before a run begins."""
        self.go(pose)
        self.odometry = self._late = self._true = self.goal.copy()
        self._world.data.qpos[self._world.base_q] = self.goal
        self._world.data.ctrl[self._world.base_motor] = self.goal
        mujoco.mj_forward(self._world.model, self._world.data)

    def go(self, pose: Float[np.ndarray, "3"]) -> None:
        """Send the base to a pose in the world: x [m], y [m], yaw [rad], without jumps of a turn.

        Consecutive poses are one step apart; see `update`.
        """
        if not self._relieves:
            self._aside = self._aside * (1.0 - min(1.0, BASE_FOLLOW_RATE * self._step))
        self._relieves = False
        there = base_coordinates(self._world, pose[None])[0]
        self.goal, self.moves = there - self._whole_turns + self._aside, True

    def relieve(self, missing: Float[np.ndarray, "3"]) -> None:
        """Leave the path a little as the hand would, as far as the arm has no joint for that.

        Call it in every step after `go`; otherwise the base returns to its path.

        Args:
            missing: What the arm lacks of the hand's velocity, in the world [m/s].
        """
        first = float(initial_base_pose(self._world)[2])
        ahead, _ = _in_frame(np.append(missing[:2], 0.0), first + float(self.odometry[2]))
        if self._robot.drive != "omni":
            ahead[1] = 0.0
        way = _in_world(np.append(ahead, 0.0), self.odometry[2])
        aside = self._aside + self._step * BASE_YIELD * way
        self._aside = aside * min(1.0, BASE_ASIDE / max(float(np.hypot(*aside[:2])), 1e-12))
        self._relieves = True

    def doubt_since(self, traveled: float) -> float:
        """Return the standard deviation of the base's position by odometry since a way length [m].

        The slip of wheels is about the same all the time, at worst.
        """
        return self._config.slip * (self.traveled - traveled)

    def distances_to(self, poses: Float[np.ndarray, "m 3"]) -> Float[np.ndarray, " m"]:
        """Return how far poses in the world are, by odometry [m]; a radian counts as a meter."""
        off = base_coordinates(self._world, poses) - self._whole_turns + self._aside - self.odometry
        return np.hypot(off[:, 0], off[:, 1]) + np.abs(off[:, 2])

    def stop(self) -> None:
        """Stay here; the brakes act at once."""
        self.goal = self._late = self.odometry.copy()
        self._sent.extend([self.goal] * len(self._sent))

    def localize(self) -> None:
        """Know the true pose, as after a drive to a base pose, if the base has come to rest."""
        if np.abs(self.velocity).max() < _AT_REST:
            self.odometry = self._true.copy()

    def update(self) -> None:
        """Advance by one step: what was commanded before the delay moves the wheels."""
        if not self.moves:
            return
        if self._exact:
            self.velocity, before = (self.goal - self.odometry) / self._step, self.odometry
            self.odometry = self._true = self.goal
            self.traveled += float(np.hypot(*(self.goal - before)[:2]))
            self._command(self.velocity)
            return
        self._sent.append(self.goal)
        late, before, h = self._sent[0], self._late, self._step
        self._late = late
        ahead, turn = _in_frame((late - before) / h, self.odometry[2])
        off, heading = _in_frame(late - self.odometry, self.odometry[2])
        wish = np.append(ahead + BASE_FOLLOW_RATE * off, turn + BASE_FOLLOW_RATE * heading)
        if self._robot.drive != "omni":  # it steers back to its path
            wish[2] += BASE_STEERING * ahead[0] * off[1]
            wish[1] = 0.0
        wish = self._within_limits(wish)
        spread = self._config.slip * np.sqrt(2.0 * h / SLIP_TIME)
        self._slip += -h / SLIP_TIME * self._slip + spread * self._rng.normal(size=3)
        self.velocity = _in_world(wish, self.odometry[2])
        self.odometry = self.odometry + h * self.velocity
        self.traveled += h * float(np.hypot(*self.velocity[:2]))
        true = _in_world(wish * (1.0 + self._slip), self._true[2])
        self._true = self._true + h * true
        self._command(true)

    def _command(self, velocity: Float[np.ndarray, "3"]) -> None:
        # The motors push in proportion to the error; this lead makes them follow without lag.
        lead = 2.0 / BASE_BANDWIDTH * velocity
        self._world.data.ctrl[self._world.base_motor] = self._true + lead

    def _within_limits(self, wish: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Return a velocity in the base's frame that the base can have [m/s], [m/s], [rad/s]."""
        robot = self._robot
        wish[:2] *= min(1.0, robot.max_speed / max(float(np.hypot(wish[0], wish[1])), 1e-12))
        most = robot.max_yaw_rate
        if robot.drive == "car":
            most = min(most, abs(float(wish[0])) / robot.min_turning_radius)
        wish[2] = np.clip(wish[2], -most, most)
        return wish


def base_coordinates(
    world: Simulation, poses: Float[np.ndarray, "m 3"]
) -> Float[np.ndarray, "m 3"]:
    """Return the values of the base's joints for poses in the world, up to whole turns."""
    start = initial_base_pose(world)
    return np.column_stack([local_points(start, poses[:, :2]), poses[:, 2] - start[2]])


def initial_base_pose(world: Simulation) -> Float[np.ndarray, "3"]:
    """Return the pose of the base for which a world was built: x [m], y [m], yaw [rad]."""
    body = world.model.body("base")
    w, _, _, z = body.quat
    return np.array([body.pos[0], body.pos[1], 2 * np.arctan2(z, w)])


def base_pose_of(world: Simulation, q: Float[np.ndarray, " v"]) -> Float[np.ndarray, "3"]:
    """Return the pose of the base in a state of the world: x [m], y [m], yaw [rad]."""
    return compose(initial_base_pose(world), q[world.base_q][None])[0]


def _in_frame(change: Float[np.ndarray, "3"], yaw: float) -> tuple[Float[np.ndarray, "2"], float]:
    """Return a change of a pose in the frame of a base: ahead and left, and its turn."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, turn = change.tolist()
    return np.array([c * x + s * y, c * y - s * x]), turn


def _in_world(velocity: Float[np.ndarray, "3"], yaw: float) -> Float[np.ndarray, "3"]:
    """Return a velocity of a base in the frame in which its yaw is given."""
    c, s = np.cos(yaw), np.sin(yaw)
    x, y, turn = velocity.tolist()
    return np.array([c * x - s * y, s * x + c * y, turn])
