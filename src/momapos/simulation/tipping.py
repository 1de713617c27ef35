"""Watch whether the base of a simulated robot would tip over.

The simulated base cannot leave the floor. The force and torque that hold it there tell where the
floor's reaction would act: the zero moment point (Vukobratovic 1972), accelerations included.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core import GRAVITY
from momapos.core.geometry import contains, edge_distances, local_points

if TYPE_CHECKING:
    from jaxtyping import Float

    from .simulation import Simulation

MAX_TILT = math.radians(1.0)
"""Tilt at which a base counts as tipped over [rad]: a wheel 40 cm from the edge is 7 mm up."""
LEANING_TILT = MAX_TILT / 5
"""Tilt at which the arm stops to pull [rad]."""
LIFTED = -1.0
"""Stability of a base that is pulled off the floor, and the least that counts: a light load on the
floor puts the zero moment point anywhere [m]."""
SMOOTHING_TIME = 0.1
"""Time constant of the filter of the recorded stability, which leaves impacts out [s]."""


class Tipping:
    """The stability of a robot during a run.

    Where the zero moment point is outside the area that the wheels stand on, the robot begins to
    turn about its edge, and falls back when the point returns.
    """

    def __init__(self, world: Simulation, step: float) -> None:
        """`step` is the time between updates [s]."""
        self._world, self._step = world, step
        self._body = world.model.body("base").id
        self._own = np.flatnonzero(world.model.body_rootid == self._body)
        """The robot's bodies."""
        self._velocity = world.data.qvel.copy()
        """Joint velocities at the last update."""
        self._tilt, self._rate = 0.0, 0.0
        self._smooth: float | None = None
        self.stability: float | None = None
        """Least distance of the zero moment point from the edge of the wheels' outline so far [m];
        None if masses or wheels are unknown."""

    @property
    def tips(self) -> bool:
        """Whether the base would tip over."""
        return self._tilt > MAX_TILT

    @property
    def leans(self) -> bool:
        """Whether the base begins to tip over, as the robot knows from its weight and its wrist."""
        return self._tilt > LEANING_TILT

    def update(self) -> None:
        """Take the present state into account."""
        support = self._world.support
        if support is None:
            return
        margin = self._margin(support)
        before = margin if self._smooth is None else self._smooth
        share = self._step / (SMOOTHING_TIME + self._step)
        self._smooth = before + share * (margin - before)
        least = self._smooth if self.stability is None else self.stability
        self.stability = min(least, self._smooth)
        self._turn(margin)

    def _margin(self, support: Float[np.ndarray, "k 2"]) -> float:
        """Return how far inside the wheels' outline the zero moment point is [m]."""
        point = self._zero_moment_point()
        if point is None:
            return LIFTED
        distance = float(edge_distances(point[None], support)[0])
        return distance if contains(support, point[None])[0] else max(-distance, LIFTED)

    def _turn(self, margin: float) -> None:
        """Integrate the turn about the edge, on which the weight acts with a lever."""
        model, data = self._world.model, self._world.data
        mass, at = model.body_mass[self._own], data.xipos[self._own]
        inertia = float(mass @ ((at - data.xpos[self._body]) ** 2).sum(1))
        self._rate -= self._step * GRAVITY * float(mass.sum()) * margin / inertia
        self._tilt += self._step * self._rate
        if self._tilt <= 0.0:
            self._tilt = self._rate = 0.0

    def _zero_moment_point(self) -> Float[np.ndarray, "2"] | None:
        """Return where the floor reacts [m], in the frame of the base; None where it does not."""
        model, data = self._world.model, self._world.data
        # The engine integrates damping implicitly, so that its own accelerations are not the real.
        kept, change = data.qacc.copy(), data.qvel - self._velocity
        data.qacc[:] = change / self._step
        mujoco.mj_rnePostConstraint(model, data)
        data.qacc[:], self._velocity = kept, data.qvel.copy()
        torque_x, torque_y, _, *force = data.cfrc_int[self._body].tolist()
        if force[2] <= 0.0:
            return None
        center = data.subtree_com[model.body_rootid[self._body]].tolist()
        moment_x = torque_x + (center[1] * force[2] - center[2] * force[1])
        moment_y = torque_y + (center[2] * force[0] - center[0] * force[2])
        point = np.array([[-moment_y, moment_x]]) / force[2]
        T = data.xmat[self._body].reshape(3, 3)
        pose = np.array([*data.xpos[self._body][:2], np.arctan2(T[1, 0], T[0, 0])])
        return local_points(pose, point)[0]
