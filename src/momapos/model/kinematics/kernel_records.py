"""What kernels take: the arrays of an arm, its spheres, boxes and a room, by name."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from momapos.core.compiled import B1, B2, F1, F2, F3, F4, I1, I2, Array

Counts = Annotated[np.ndarray, Array(np.dtype("i4"), 3)]


class ChainArrays(NamedTuple):
    """A chain of m joints, see `Chain`."""

    h: F2
    d: F2
    slides: B1
    dof: I1
    ratio: F1
    tool_offset: F1
    tool_rotation: F2


class JointLimits(NamedTuple):
    """Limits of n joints [rad] or [m]."""

    lower: F1
    upper: F1


class IkArrays(NamedTuple):
    """How an arm is inverted, see `IkModel`."""

    kind: int
    reverse: bool
    active: I1
    prismatic: B1
    samples: F2
    h: F3
    o: F3
    wrist: F2
    R_tool: F3
    p_tool: F2
    seeds: F2
    seed_poses: F2
    tries: int


class ArmArrays(NamedTuple):
    """What it takes to invert an arm."""

    chain: ChainArrays
    limits: JointLimits
    ik: IkArrays


class NewtonRule(NamedTuple):
    """When Newton stops, see `newton`."""

    steps: int
    """Maximum number of steps [-]."""
    damping: float
    """Levenberg damping [-]; tiny near a solution, larger from far away."""
    enough: float
    """Squared residual at which to stop [m^2 + rad^2]."""
    within: bool
    """Whether every step stays within the joints' limits."""


class NewtonScratch(NamedTuple):
    """Memory of `newton`."""

    R: F3
    p: F2
    jacobian: F2
    normal: F2
    error: F1
    column: I1
    """Where each degree of freedom stands among those that may move, or -1."""


class IkScratch(NamedTuple):
    """Memory of `solve_sample`."""

    branches: F2
    R06: F2
    every: I1
    """All degrees of freedom."""
    order: I1
    """The seeds nearest to the pose, and their distances."""
    distance: F1
    solutions: F2
    """What was found from seeds."""
    state: I1
    """(1,) how many of these there are; 1 where a sample gave a solution."""
    newton: NewtonScratch


class HullArrays(NamedTuple):
    """The collision shapes of a robot as convex hulls, see `LinkHulls`."""

    vertices: F2
    first: I1
    center: F2
    segment: I1
    of_group: I1
    of_base: I1
    beside: I1
    beside_from: I1
    begin: I2
    room: float


class SphereArrays(NamedTuple):
    """The spheres of an arm and the boxes of its base, see `Spheres`."""

    center: F2
    radius: F1
    start: I1
    segment: I1
    bound_center: F2
    bound_radius: F1
    gripper: I1
    pairs: I2
    base_center: F2
    base_rotation: F3
    base_half: F2
    base_pairs: B2
    base_bounds: F2
    base_radius: F1
    hulls: HullArrays
    exact: B1
    base_exact: B2
    against_base: I1
    """The groups that are held against any box of the base."""


class BoxArrays(NamedTuple):
    """Oriented boxes: (b, 3), (b, 3, 3), (b, 3)."""

    center: F2
    rotation: F3
    half: F2


class ObstacleArrays(NamedTuple):
    """Boxes, and which of them a gripper may touch while it holds (b,)."""

    center: F2
    rotation: F3
    half: F2
    grasped: B1


class ArmScratch(NamedTuple):
    """Memory of the checks: segment poses (n + 1, 3, 3), (n + 1, 3) and bounds (groups, 3)."""

    R: F3
    p: F2
    bounds: F2


class WorldArrays(NamedTuple):
    """A room and what moves in it, see `World`."""

    center: F2
    rotation: F3
    half: F2
    moving_center: F3
    moving_rotation: F4
    moving_half: F3
    grasped: B1
    grid_origin: F1
    grid_shape: I1
    grid_start: I1
    grid_index: I1
    filled: Counts


class TaskState(NamedTuple):
    """How far a task has come."""

    value: int
    """Index of the object's joint value."""
    holding: bool
    """Whether the gripper may touch what is grasped."""


class CollisionArrays(NamedTuple):
    """What an arm is checked with."""

    spheres: SphereArrays
    world: WorldArrays
    margin: float
    """Distance that the spheres keep [m]."""
