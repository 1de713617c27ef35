"""Records of arrays that kernels take as arguments."""

from __future__ import annotations

from typing import Annotated, NamedTuple

import numpy as np

from momapos.core.compiled import B1, B2, F1, F2, F3, F4, I1, I2, S2, Array

Counts = Annotated[np.ndarray, Array(np.dtype("i4"), 3)]


class ChainArrays(NamedTuple):
    """`Chain`, with m joints."""

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
    """`IkModel`."""

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
    """An arm with its inverse kinematics."""

    chain: ChainArrays
    limits: JointLimits
    ik: IkArrays


class NewtonRule(NamedTuple):
    """Parameters of `newton`."""

    steps: int
    """Largest number of steps [-]."""
    damping: float
    """Levenberg damping, small near a solution [-]."""
    enough: float
    """Sufficient squared residual [m^2 + rad^2]."""
    within: bool
    """Whether every step stays within the joints' limits."""


class NewtonScratch(NamedTuple):
    """Scratch memory of `newton`."""

    R: F3
    p: F2
    jacobian: F2
    normal: F2
    error: F1
    column: I1
    """Index of each degree of freedom among the active ones, or -1."""


class IkScratch(NamedTuple):
    """Scratch memory of `solve_sample`."""

    branches: F2
    R06: F2
    every: I1
    """All degrees of freedom."""
    order: I1
    """The seeds nearest to the pose, and their distances."""
    distance: F1
    solutions: F2
    """Solutions found from seeds."""
    state: I1
    """(1,): their number; 1 if a sample has a solution."""
    newton: NewtonScratch


class HullArrays(NamedTuple):
    """`LinkHulls`."""

    vertices: F2
    first: I1
    center: F2
    segment: I1
    of_group: I1
    of_base: I1
    neighbors: I1
    neighbors_from: I1
    begin: I2
    margin: float


class SphereArrays(NamedTuple):
    """`Spheres`."""

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
    """Groups that are checked against any box of the base."""


class BoxArrays(NamedTuple):
    """Oriented boxes: (b, 3), (b, 3, 3), (b, 3)."""

    center: F2
    rotation: F3
    half: F2


class ObstacleArrays(NamedTuple):
    """Boxes, and which of them the gripper may touch during a hold (b,)."""

    center: F2
    rotation: F3
    half: F2
    grasped: B1


class ArmScratch(NamedTuple):
    """Scratch memory: segment poses (n + 1, 3, 3), (n + 1, 3) and bounds (groups, 3)."""

    R: F3
    p: F2
    bounds: F2


class WorldArrays(NamedTuple):
    """`World`."""

    center: F2
    rotation: F3
    half: F2
    cylinder: B1
    """Which static boxes are cylinders about their third axis."""
    moving_center: F3
    moving_rotation: F4
    moving_half: F3
    grasped: B1
    grid_origin: F1
    grid_shape: I1
    grid_start: I1
    grid_index: I1
    filled: Counts
    blocks: S2
    """Rows 6k to 6k + 5: lower, then negative upper corners of eight static boxes' bounds."""


class TaskState(NamedTuple):
    """Progress of a task."""

    value: int
    """Index of the object's joint value."""
    holding: bool
    """Whether the gripper may touch the grasped part."""


class CollisionArrays(NamedTuple):
    """Arguments of an arm's collision check."""

    spheres: SphereArrays
    world: WorldArrays
    margin: float
    """Clearance of the spheres [m]."""
