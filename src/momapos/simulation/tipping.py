"""Watch whether the base of a simulated robot would tip over.

The simulated base cannot leave the floor. The force and torque that hold it there tell where the
floor's reaction would act: the zero moment point (Vukobratovic 1972), accelerations included.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import mujoco
import numpy as np

from momapos.core.geometry import contains, edge_distances, local_points

if TYPE_CHECKING:
    from jaxtyping import Float

    from .simulation import Simulation

TIPPING_TIME = 0.1
"""Time constant of the low-pass filter of the zero moment point: a base does not tip over within
the milliseconds of an impact [s]."""


class Tipping:
    """The stability of a robot during a run."""

    def __init__(self, world: Simulation, step: float) -> None:
        """`step` is the time between updates [s]."""
        self._share = step / (TIPPING_TIME + step)
        self._world = world
        self._body = world.model.body("base").id
        self._point: Float[np.ndarray, "2"] | None = None
        self.stability: float | None = None
        """Least distance of the zero moment point from the edge of the wheels' outline so far [m];
        None if masses or wheels are unknown."""

    @property
    def tips(self) -> bool:
        """Whether the base would tip over."""
        return self.stability is not None and self.stability < 0.0

    def update(self) -> None:
        """Take the present state into account."""
        support = self._world.support
        if support is None:
            return
        point = self._zero_moment_point()
        before = point if self._point is None else self._point
        self._point = before + self._share * (point - before)
        distance = float(edge_distances(self._point[None], support)[0])
        inside = bool(contains(support, self._point[None])[0])
        margin = distance if inside else -distance
        self.stability = margin if self.stability is None else min(self.stability, margin)

    def _zero_moment_point(self) -> Float[np.ndarray, "2"]:
        """Return where the floor's reaction acts [m], in the frame of the base."""
        model, data = self._world.model, self._world.data
        mujoco.mj_rnePostConstraint(model, data)
        torque, force = np.split(data.cfrc_int[self._body], 2)
        center = data.subtree_com[model.body_rootid[self._body]]
        moment = torque + np.cross(center, force)
        if force[2] <= 0.0:
            return np.full(2, np.inf)
        point = np.array([[-moment[1], moment[0]]]) / force[2]
        T = data.xmat[self._body].reshape(3, 3)
        pose = np.array([*data.xpos[self._body][:2], np.arctan2(T[1, 0], T[0, 0])])
        return local_points(pose, point)[0]
