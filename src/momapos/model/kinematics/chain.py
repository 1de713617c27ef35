"""The arm as a product of exponentials, and its batched forward kinematics.

In the zero configuration every frame is aligned with the base, so a chain is three arrays: unit
axes `h`, offsets `d` from joint to joint, and joint types. Segment 0 is the base, segment i moves
with joint i. Source: Lynch and Park, Modern Robotics, chapter 4.

Each of the m joints moves by a ratio times one of the n degrees of freedom. In most arms m = n; a
telescope has one degree of freedom in several joints.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise
from typing import TYPE_CHECKING, Annotated, NamedTuple

import numpy as np

from momapos.core import RobotError
from momapos.core.compiled import B1, B2, F1, F2, F3, F4, I1, I2, S2, Array, entry, kernel
from momapos.core.geometry import invert
from momapos.model.urdf import Articulated, Joint, Mimic

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


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
    radius: F1
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


@dataclass(frozen=True, eq=False)
class Chain:
    """A serial chain in the base frame: m joints with n degrees of freedom."""

    names: tuple[str, ...]
    """The leading joint of each degree of freedom, base to tool."""
    joints: tuple[str, ...]
    """All movable joints, base to tool."""
    dof: Int[np.ndarray, " m"]
    """The degree of freedom of each joint."""
    ratio: Float[np.ndarray, " m"]
    """Ratio of each joint to its degree of freedom; 1 for leading joints [-]."""
    offset: Float[np.ndarray, " m"]
    """Value of each joint if its degree of freedom is zero [rad] or [m]."""
    h: Float[np.ndarray, "m 3"]
    """Unit joint axes at zero, in the base frame."""
    d: Float[np.ndarray, "m 3"]
    """Offset of each joint from the previous one, or from the base's origin [m]."""
    slides: Bool[np.ndarray, " m"]
    """Which joints are prismatic."""
    lower: Float[np.ndarray, " n"]
    upper: Float[np.ndarray, " n"]
    """Limits [rad] or [m]; infinite for continuous joints."""
    velocity: Float[np.ndarray, " n"]
    tool_offset: Float[np.ndarray, "3"]
    """Offset of the tool from the last joint at zero, in the base frame [m]."""
    tool_rotation: Float[np.ndarray, "3 3"]
    """Tool axes at zero, in the base frame."""

    @property
    def size(self) -> int:
        """Return the number of degrees of freedom."""
        return len(self.names)

    @property
    def last(self) -> int:
        """Return the tool's segment, which is the number of joints."""
        return len(self.joints)

    @cached_property
    def leads(self) -> Int[np.ndarray, " n"]:
        """Return the leading joint of each degree of freedom."""
        return np.array([self.joints.index(name) for name in self.names], np.int64)

    @cached_property
    def prismatic(self) -> Bool[np.ndarray, " n"]:
        """Return which degrees of freedom are prismatic."""
        return self.slides[self.leads]

    @property
    def coupled(self) -> bool:
        """Return whether any joint follows another."""
        return self.last > self.size

    @property
    def ends_turning(self) -> bool:
        """Return whether the last joint is revolute and no other joint moves with it."""
        alone = np.count_nonzero(self.dof == self.dof[-1]) == 1
        return bool(alone and not self.slides[-1])

    @property
    def upright(self) -> bool:
        """Return whether the first revolute axis, and prismatic axes before it, are vertical."""
        first = self.first_turn
        return first < self.last and bool(np.abs(self.h[: first + 1, 2]).min() >= 1 - 1e-4)

    @property
    def first_turn(self) -> int:
        """Return the first revolute joint, or the number of joints if all are prismatic."""
        return int(np.argmin(np.append(self.slides, False)))

    @cached_property
    def middle(self) -> Float[np.ndarray, " m"]:
        """Return the middle of each joint's range, without its offset; 0 if unlimited."""
        ends = np.stack([self.lower, self.upper])
        middle = np.where(np.isfinite(ends), ends, 0.0).sum(0) / 2
        return self.ratio * middle[self.dof]

    @cached_property
    def half_travel(self) -> Float[np.ndarray, " m"]:
        """Return half the range of each joint [rad] or [m]."""
        return np.abs(self.ratio) * (self.upper - self.lower)[self.dof] / 2

    @cached_property
    def arrays(self) -> ChainArrays:
        """Return the chain as an argument of kernels; see `chain_arrays`."""
        return ChainArrays(
            self.h, self.d, self.slides, self.dof, self.ratio, self.tool_offset,
            self.tool_rotation,
        )  # fmt: skip

    def joint_values(self, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch m"]:
        """Convert values of the degrees of freedom to values of all joints."""
        return np.asarray(q, float)[..., self.dof] * self.ratio + self.offset

    def freedom_values(
        self, values: Float[np.ndarray, "*batch m"]
    ) -> Float[np.ndarray, "*batch n"]:
        """Convert values of all joints to values of the degrees of freedom."""
        return np.asarray(values, float)[..., self.leads]

    def tool_poses(self, q: Float[np.ndarray, "*batch n"]) -> Float[np.ndarray, "*batch 4 4"]:
        """Return tool poses in the base frame."""
        q = np.ascontiguousarray(q, float)  # the layout that the kernel is compiled for
        flat = tool_poses(q.reshape(-1, self.size), chain_arrays(self))
        return flat.reshape(*q.shape[:-1], 4, 4)


@dataclass(frozen=True, eq=False)
class Segments:
    """The segment of the chain with which each link of the robot moves."""

    of_link: dict[str, int]
    T_segment_link: dict[str, Float[np.ndarray, "4 4"]]
    """Pose of the link relative to its segment's joint, in base axes at zero."""
    side_followers: tuple[str, ...] = ()
    """Mimic joints that follow the chain but do not carry the tool, such as a head's."""


def chain_arrays(chain: Chain) -> ChainArrays:
    """Return the chain as an argument of kernels, whose types are checked once for each record."""
    return chain.arrays


def chain_limits(chain: Chain) -> JointLimits:
    """Return the limits of the degrees of freedom as an argument of kernels."""
    return JointLimits(chain.lower, chain.upper)


def build_chain(
    model: Articulated, base_link: str, tool_link: str, names: Sequence[str]
) -> tuple[Chain, Segments]:
    """Extract an arm from a robot, with all joints at rest except the arm's and their mimic joints.

    A mimic joint that does not carry the tool, such as a head that follows the torso, is not in the
    chain; see `Segments.side_followers`.

    Args:
        model: The robot.
        base_link: First link of the chain.
        tool_link: Last link of the chain.
        names: The leading joint of each degree of freedom, base to tool.

    Raises:
        RobotError: The joints do not form a chain from base to tool in this order, or one of them
            is a mimic joint.
    """
    for link in (base_link, tool_link):
        if link not in model.urdf.links:
            from momapos.core import unknown_name

            raise unknown_name("link", link, model.urdf.links, model.urdf.name)
    leaders = [model.joint(name) for name in names]
    _check_order(model, base_link, tool_link, names)
    records = _between(model, tool_link, names)
    zero = _poses_at_zero(model, base_link, names)
    origins = []
    axes = []
    for joint in records:
        # At zero a mimic joint is at its offset, which the pose of its child includes.
        T = zero[joint.parent] @ joint.T_parent_joint
        origins.append(T[:3, 3] if joint.kind != "prismatic" else zero[joint.child][:3, 3])
        axes.append(T[:3, :3] @ joint.axis)
    origin = np.array(origins)
    followed = [joint.mimic or Mimic(joint.name) for joint in records]
    joints = tuple(joint.name for joint in records)
    chain = Chain(
        names=tuple(names),
        joints=joints,
        dof=np.array([list(names).index(mimic.joint) for mimic in followed], np.int64),
        ratio=np.array([mimic.ratio for mimic in followed], float),
        offset=np.array([mimic.offset for mimic in followed], float),
        h=np.array(axes),
        d=np.diff(origin, axis=0, prepend=np.zeros((1, 3))),
        slides=np.array([j.kind == "prismatic" for j in records]),
        lower=np.array([j.lower for j in leaders]),
        upper=np.array([j.upper for j in leaders]),
        velocity=np.array([j.velocity for j in leaders]),
        tool_offset=zero[tool_link][:3, 3] - origin[-1],
        tool_rotation=zero[tool_link][:3, :3].copy(),
    )
    side_followers = tuple(
        joint.name
        for joint in model.joints.values()
        if joint.mimic is not None and joint.mimic.joint in names and joint.name not in joints
    )
    return chain, replace(_segments(model, zero, joints, origin), side_followers=side_followers)


def with_tool_turn(chain: Chain, axis: Float[np.ndarray, "3"], lower: float, upper: float) -> Chain:
    """Return a chain with one more degree of freedom: a turn about an axis through the tool.

    Args:
        chain: The chain.
        axis: Direction of the axis, in the tool frame.
        lower, upper: Limits of the turn [rad].
    """
    h = chain.tool_rotation @ axis
    return replace(
        chain,
        names=(*chain.names, "hand turn"),
        joints=(*chain.joints, "hand turn"),
        dof=np.append(chain.dof, chain.size),
        ratio=np.append(chain.ratio, 1.0),
        offset=np.append(chain.offset, 0.0),
        h=np.vstack([chain.h, h / np.linalg.norm(h)]),
        d=np.vstack([chain.d, chain.tool_offset]),
        slides=np.append(chain.slides, False),
        lower=np.append(chain.lower, lower),
        upper=np.append(chain.upper, upper),
        velocity=np.append(chain.velocity, np.inf),
        tool_offset=np.zeros(3),
    )


def with_base_slides(chain: Chain, directions: Float[np.ndarray, "k 3"], travel: float) -> Chain:
    """Return a chain that begins with slides of the base.

    Args:
        chain: The chain.
        directions: Unit directions in which the base slides, in its own frame.
        travel: How far it slides to either side [m].
    """
    count = len(directions)
    names = tuple(f"base slide {k}" for k in range(count))
    return replace(
        chain,
        names=(*names, *chain.names),
        joints=(*names, *chain.joints),
        dof=np.concatenate([np.arange(count), chain.dof + count]),
        ratio=np.concatenate([np.ones(count), chain.ratio]),
        offset=np.concatenate([np.zeros(count), chain.offset]),
        h=np.vstack([directions, chain.h]),
        d=np.vstack([np.zeros((count, 3)), chain.d]),
        slides=np.concatenate([np.ones(count, bool), chain.slides]),
        lower=np.concatenate([np.full(count, -travel), chain.lower]),
        upper=np.concatenate([np.full(count, travel), chain.upper]),
        velocity=np.concatenate([np.full(count, np.inf), chain.velocity]),
    )


def _between(model: Articulated, tool_link: str, names: Sequence[str]) -> list[Joint]:
    """Return the joints that move with the given ones and carry the tool, base to tool."""
    return [
        joint
        for joint in model.joints.values()
        if (joint.mimic.joint if joint.mimic else joint.name) in names
        and tool_link in model.links_below(joint.child)
    ]


def _poses_at_zero(
    model: Articulated, base_link: str, joints: Sequence[str]
) -> Mapping[str, Float[np.ndarray, "4 4"]]:
    poses = model.link_poses(dict.fromkeys(joints, 0.0))
    T_base_root = invert(poses[base_link])
    return {name: T_base_root @ T for name, T in poses.items()}


def _check_order(model: Articulated, base_link: str, tool_link: str, joints: Sequence[str]) -> None:
    if not joints:
        raise RobotError(
            f"{model.urdf.name}: arm_joints is empty; list the joints from base to tool"
        )
    if len(set(joints)) != len(joints):
        raise RobotError(f"{model.urdf.name}: arm_joints contains a joint twice")
    for name in joints:
        mimic = model.joint(name).mimic
        if mimic is not None:
            raise RobotError(
                f"{model.urdf.name}: joint {name!r} follows {mimic.joint!r}; arm_joints must not "
                "contain mimic joints"
            )
    if tool_link not in model.links_below(model.joint(joints[-1]).child):
        raise RobotError(
            f"{model.urdf.name}: tool link {tool_link!r} does not move with {joints[-1]!r}; "
            "arm_joints must be the chain from base to tool"
        )
    for before, after in pairwise(joints):
        if model.joint(after).child not in model.links_below(model.joint(before).child):
            raise RobotError(
                f"{model.urdf.name}: joint {after!r} does not move with {before!r}; "
                "arm_joints must be a chain from base to tool"
            )
    if base_link in model.moved_by(joints[0]):
        raise RobotError(
            f"{model.urdf.name}: base link {base_link!r} moves with {joints[0]!r}; "
            "the base must come before the arm"
        )


def _segments(
    model: Articulated,
    zero: Mapping[str, Float[np.ndarray, "4 4"]],
    joints: Sequence[str],
    origin: Float[np.ndarray, "m 3"],
) -> Segments:
    of_link = dict.fromkeys(model.links, 0)
    for index, name in enumerate(joints):
        for link in model.links_below(model.joint(name).child):
            of_link[link] = index + 1
    shift = np.vstack([np.zeros((1, 3)), origin])
    local = {}
    for link, segment in of_link.items():
        T = zero[link].copy()
        T[:3, 3] -= shift[segment]
        local[link] = T
    return Segments(of_link, local)


@kernel
def rotate_by(R: np.ndarray, axis: np.ndarray, angle: float, out: np.ndarray) -> None:
    """Write R times the rotation about a unit axis (Rodrigues) to `out` (3, 3)."""
    c, s = np.cos(angle), np.sin(angle)
    x, y, z = axis[0], axis[1], axis[2]
    v = 1.0 - c
    m00, m01, m02 = c + x * x * v, x * y * v - z * s, x * z * v + y * s
    m10, m11, m12 = x * y * v + z * s, c + y * y * v, y * z * v - x * s
    m20, m21, m22 = x * z * v - y * s, y * z * v + x * s, c + z * z * v
    for i in range(3):
        a, b, d = R[i, 0], R[i, 1], R[i, 2]
        out[i, 0] = a * m00 + b * m10 + d * m20
        out[i, 1] = a * m01 + b * m11 + d * m21
        out[i, 2] = a * m02 + b * m12 + d * m22


@entry
def stand_at_origin(R: F3, p: F2) -> None:
    """Put segment 0 at the origin, without array assignments, which are slow to compile."""
    for i in range(3):
        p[0, i] = 0.0
        for j in range(3):
            R[0, i, j] = 1.0 if i == j else 0.0


@entry
def forward(q: F1, chain: ChainArrays, R: F3, p: F2) -> None:
    """Fill rotations R (m + 1, 3, 3) and origins p (m + 1, 3) of segments 1 to m.

    Segment 0 must be given; q (n,) are values of the degrees of freedom.
    """
    h, d, slides = chain.h, chain.d, chain.slides
    for i in range(len(slides)):
        value = chain.ratio[i] * q[chain.dof[i]]
        for k in range(3):
            p[i + 1, k] = (
                p[i, k] + R[i, k, 0] * d[i, 0] + R[i, k, 1] * d[i, 1] + R[i, k, 2] * d[i, 2]
            )
        if slides[i]:
            for k in range(3):
                p[i + 1, k] += value * (
                    R[i, k, 0] * h[i, 0] + R[i, k, 1] * h[i, 1] + R[i, k, 2] * h[i, 2]
                )
                for j in range(3):
                    R[i + 1, k, j] = R[i, k, j]
        else:
            rotate_by(R[i], h[i], value, R[i + 1])


@entry
def tool_poses(q: F2, chain: ChainArrays) -> np.ndarray:
    """Return tool poses (k, 4, 4) in the base frame for configurations (k, n)."""
    count, n = len(q), len(chain.slides)
    tool_offset, tool_rotation = chain.tool_offset, chain.tool_rotation
    out = np.zeros((count, 4, 4))
    R, p = np.empty((n + 1, 3, 3)), np.empty((n + 1, 3))
    stand_at_origin(R, p)
    for m in range(count):
        forward(q[m], chain, R, p)
        for i in range(3):
            out[m, i, 3] = p[n, i]
            for k in range(3):
                out[m, i, 3] += R[n, i, k] * tool_offset[k]
                for j in range(3):
                    out[m, i, j] += R[n, i, k] * tool_rotation[k, j]
        out[m, 3, 3] = 1.0
    return out
