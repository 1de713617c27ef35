"""Physics world of one run: room, part and robot, compiled and indexed."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace
from itertools import product
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.core import InputError
from momapos.core.geometry import invert
from momapos.model.records import Task
from momapos.model.robots import Robot, support_outline
from momapos.model.scene import Scene, SceneObject
from momapos.verification import obstructing_links

from .config import PAD_TIME, TOUCH_DISTANCE, WELD_TIME, ExecutionConfig
from .geoms import HAND, ROBOT, Kind, matrix_quat
from .robot_dynamics import Dynamics, Finger, SimulatedHand
from .simulated_robot import BASE_JOINTS, TOOL_POINT, add_robot, body_of, tune
from .simulated_room import (
    PART,
    Deviation,
    PartResistance,
    SimulatedLatch,
    add_part,
    add_room,
    find_latch,
    is_part,
    set_masses,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Int


def set_followers(model: Any, q: Float[np.ndarray, " q"]) -> None:
    """Set the mimic joints of the part to where its joint takes them."""
    for follower, leader, ratio in couplings(model):
        x, y = model.joint(leader).qposadr[0], model.joint(follower).qposadr[0]
        q[y] = model.qpos0[y] + ratio * (q[x] - model.qpos0[x])


def couplings(model: Any) -> list[tuple[str, str, float]]:
    """Return the mimic joints of the part, with their leader and ratio."""
    return [
        (
            model.joint(model.eq_obj1id[i]).name,
            model.joint(model.eq_obj2id[i]).name,
            float(model.eq_data[i, 1]),
        )
        for i in range(model.neq)
        if is_part(model.equality(i).name)
    ]


WELD = "hold"
_CONTACT_SAMPLES = 30
"""Number of joint values at which contacts of the part are checked [-]."""
_REST_TOLERANCE = 1e-3
"""Deviation from its rest value up to which a joint is at rest [rad] or [m]."""
_NOSLIP_ITERATIONS = 5
"""Solver iterations that remove the slow slip of soft frictional contacts [-]."""


@dataclass(frozen=True, eq=False)
class Simulation:
    """A compiled world; its state is in `data`."""

    model: Any
    data: Any
    kinds: Int[np.ndarray, " g"]
    """Kind of each geom."""
    names: tuple[str, ...]
    """Owner of each geom: OBJECT/LINK, or a link of the robot."""
    arm_q: Int[np.ndarray, " n"]
    """Addresses of the arm joints' positions."""
    arm_v: Int[np.ndarray, " n"]
    """Addresses of the arm joints' velocities."""
    arm_motor: Int[np.ndarray, " n"]
    base_q: Int[np.ndarray, "3"]
    base_v: Int[np.ndarray, "3"]
    base_motor: Int[np.ndarray, "3"]
    part_q: int
    part_v: int
    part_body: int
    tool_body: int
    weld: int
    hand: SimulatedHand
    hand_bodies: Int[np.ndarray, " b"]
    """Bodies of the gripper."""
    pad_side: Int[np.ndarray, " g"]
    """Side of the tool on which the geom of a pad is, 1 or -1; 0 for other geoms."""
    fingers: tuple[tuple[Finger, int], ...]
    """Moving fingers, with their motors."""
    loose: tuple[str, ...]
    """Bodies whose contacts with the part are excluded, because they touch it in the scene."""
    support: Float[np.ndarray, "k 2"] | None
    """Outline of the area that the robot's wheels stand on, in the base frame [m]; None if masses
    or wheels are unknown."""
    balanced: tuple[str, ...]
    """Joints whose effort limits are below the arm's weight, so that springs must bear it."""
    latch: SimulatedLatch | None = None
    """The latch that locks the part; None if none must be turned."""

    @property
    def weight_on_part(self) -> float:
        """Torque or force of gravity on the part's joint at its present value, positive toward
        larger values [Nm] or [N]."""
        weight = self.data.qfrc_gravcomp - self.data.qfrc_bias
        found = float(weight[self.part_v])
        for follower, leader, ratio in couplings(self.model):
            if leader == PART:
                found += ratio * float(weight[self.model.joint(follower).dofadr[0]])
        return found

    @property
    def T_world_tool(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the tool link in the world."""
        return self._pose(self.tool_body)

    @property
    def T_world_part(self) -> Float[np.ndarray, "4 4"]:
        """Pose of the part in the world."""
        return self._pose(self.part_body)

    @property
    def part_roots(self) -> list[int]:
        """Bodies of the part that no other one of them carries."""
        bodies = [self.model.body(name).id for name in _part_bodies(self.model)]
        return [body for body in bodies if self.model.body_parentid[body] == 0]

    def fixed_pose(self, body: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a body in its parent with all joints at their reference values."""
        T = np.eye(4)
        mujoco.mju_quat2Mat(rotation := np.empty(9), self.model.body_quat[body])
        T[:3, :3], T[:3, 3] = rotation.reshape(3, 3), self.model.body_pos[body]
        return T

    def _pose(self, body: int) -> Float[np.ndarray, "4 4"]:
        T = np.eye(4)
        T[:3, :3] = self.data.xmat[body].reshape(3, 3)
        T[:3, 3] = self.data.xpos[body]
        return T

    def grip_gap(self, most: float) -> float:
        """Return the distance from the gripper or tool origin to the part [m], capped at `most`."""
        hand = np.isin(self.kinds, HAND)
        hand[self.model.geom(TOOL_POINT).id] = True
        return min(
            float(mujoco.mj_geomDistance(self.model, self.data, one, other, most, None))
            for one in np.flatnonzero(hand).tolist()
            for other in np.flatnonzero(self.kinds == Kind.PART).tolist()
        )

    def attach(self, *, turns: bool = False) -> None:
        """Weld the part to the tool at their present poses; `turns` welds the position only."""
        T_tool_part = invert(self.T_world_tool) @ self.T_world_part
        values = self.model.eq_data[self.weld]
        values[:3] = invert(T_tool_part)[:3, 3]  # the tool's origin in the part's frame
        values[3:6] = 0.0  # and in the tool frame
        values[6:10] = matrix_quat(T_tool_part[:3, :3])
        values[10] = 0.0 if turns else 1.0
        self.data.eq_active[self.weld] = 1

    @property
    def welded(self) -> bool:
        """Whether the weld is active."""
        return bool(self.data.eq_active[self.weld])

    def release(self) -> None:
        """Open the weld."""
        self.data.eq_active[self.weld] = 0


def build_simulation(
    scene: Scene,
    robot: Robot,
    base_pose: tuple[float, float, float],
    states: Float[np.ndarray, "k n"],
    task: Task,
    hand: SimulatedHand,
    dynamics: Dynamics,
    resistance: PartResistance,
    deviation: Deviation | None,
    config: ExecutionConfig,
    *,
    begin: float | None = None,
    reached: Collection[tuple[str, int]] = (),
    held: str = "",
) -> Simulation:
    """Build the world of a run, with the arm at the first of some states.

    Some pairs touch by design or for lack of exact models, and are excluded from collisions:
    furniture that touches the part in the scene, elements of the part's own object that touch it
    anywhere on its path while its other joints are closed, and robot links that touch at rest.
    What the exact check says the part hits on its path stays an obstacle.

    Args:
        scene: The room.
        robot: The robot.
        base_pose: x [m], y [m], yaw [rad] of its base.
        states: Arm states for which the motors are tuned [rad] or [m].
        task: Names the part.
        hand: Hand of the robot.
        dynamics: Masses and efforts of the robot.
        resistance: Resistance of the part.
        deviation: Difference of the task's object from the scene; None for none.
        config: Model parameters.
        begin: Value of the part's joint [rad] or [m]; by default as in the scene.
        reached: Elements of the part that the hand touches, see `add_part`.
        held: Link of the part that the hand holds, see `add_part`.

    Raises:
        InputError: The engine rejects the model.
    """
    spec = _spec(config)
    add_room(spec, scene, task, deviation)
    add_part(spec, scene, task, resistance, deviation, config, reached, held)
    add_robot(spec, robot, base_pose, hand, dynamics, config)
    _add_weld(spec, robot)
    fingers = hand.fingers if config.hold == "contact" else ()
    item = scene.object(task.object)
    value = None if task.joint is None else item.values()[task.joint]
    try:
        model = spec.compile()
        touching = _touching(model, _values(model, {PART: value}))
        if task.joint is not None:
            touching += _bearings(model, item, task.joint)
            hit = obstructing_links(scene, task)
            touching = [pair for pair in touching if not _names_any(pair, hit)]
        touching = list(dict.fromkeys(touching))
        apart = touching
        if deviation is not None and task.joint is not None:
            # A deviating joint would move the part through its frame: exclude all fixed bodies.
            pairs = product(_part_bodies(model), _standing(model))
            apart = list(dict.fromkeys([*touching, *pairs]))
        set_masses(spec, model, item, task, resistance.mass, config.furniture)
        for one, other in apart:
            spec.add_exclude(bodyname1=one, bodyname2=other)
        model = spec.compile()
        model.geom_solref[kinds_of(model) == Kind.PAD] = (PAD_TIME, 1.0)
    except ValueError as error:
        raise InputError(
            f"the physics engine rejects the model of {robot.name} in {scene.name}: {error}"
        ) from error
    driven = {finger.joint: finger.open for finger in fingers}
    at = {**driven, **dict(zip(robot.moved_joints, states[0].tolist(), strict=True))}
    followers = {n: m.at(driven[m.joint]) for n, m in hand.followers.items() if m.joint in driven}
    values = {PART: value if begin is None else begin, **at, **followers}
    balanced = tune(model, _values(model, values), robot, states, fingers, config)
    data = _values(model, values)
    for name, rest in at.items():
        data.ctrl[model.actuator(name).id] = rest
    loose = [
        one if is_part(other) else other
        for one, other in touching
        if is_part(one) or is_part(other)
    ]
    names = tuple(dict.fromkeys("floor" if n == "world" else n.split("#")[0] for n in loose))
    latch = None if task.joint is None else find_latch(model, item, task.joint, PART)
    return replace(_index(model, data, robot, hand, fingers, names, balanced), latch=latch)


def _support(robot: Robot) -> Float[np.ndarray, "k 2"] | None:
    """Return the outline of the wheels; None if the file has no mass of the base."""
    moved = {link for joint in robot.moved_joints for link in robot.model.moved_by(joint)}
    base = [link for link in robot.model.links if link not in moved]
    if not sum(robot.model.urdf.links[link].mass for link in base):
        return None
    return support_outline(robot.model, robot.base_link, base)


def _spec(config: ExecutionConfig) -> Any:
    spec = mujoco.MjSpec()
    spec.compiler.balanceinertia = True
    spec.compiler.boundmass, spec.compiler.boundinertia = 1e-4, 1e-7
    spec.compiler.degree = False
    option = spec.option
    option.timestep = config.timestep
    option.integrator = mujoco.mjtIntegrator.mjINT_IMPLICITFAST
    option.disableflags |= mujoco.mjtDisableBit.mjDSBL_AUTORESET
    if config.hold == "contact":
        option.cone, option.impratio = mujoco.mjtCone.mjCONE_ELLIPTIC, 10.0
        option.noslip_iterations = _NOSLIP_ITERATIONS
    spec.visual.headlight.ambient, spec.visual.headlight.diffuse = [0.45] * 3, [0.55] * 3
    spec.visual.global_.offwidth, spec.visual.global_.offheight = 1280, 960
    return spec


def _add_weld(spec: Any, robot: Robot) -> None:
    weld = spec.add_equality(
        name=WELD, type=mujoco.mjtEq.mjEQ_WELD, objtype=mujoco.mjtObj.mjOBJ_BODY, active=False
    )
    weld.name1, weld.name2 = body_of(robot.tool_link), PART
    weld.solref = [WELD_TIME, 1.0]


def _values(model: Any, values: dict[str, float | None]) -> Any:
    """Return a state with some joints set; None leaves a joint unchanged."""
    data = mujoco.MjData(model)
    for name, value in values.items():
        if value is not None:
            data.qpos[model.joint(name).qposadr[0]] = value
    set_followers(model, data.qpos)
    mujoco.mj_forward(model, data)
    return data


def _part_bodies(model: Any) -> list[str]:
    return [name for name in (model.body(i).name for i in range(model.nbody)) if is_part(name)]


def _touching(model: Any, data: Any) -> list[tuple[str, str]]:
    """Return the pairs of bodies that touch at rest: robot links, or a jointed part and the room.

    A movable object rests on something; its contacts remain.
    """
    kinds = kinds_of(model)
    fixed = model.joint(PART).type[0] != mujoco.mjtJoint.mjJNT_FREE
    pairs = []
    for one, other in _near_pairs(model, data, TOUCH_DISTANCE if fixed else 0.0):
        both = {kinds[one], kinds[other]}
        own = both <= set(ROBOT) and _gap(data, one, other) < 0.0
        furniture = fixed and both in ({Kind.PART, Kind.ROOM}, {Kind.PART, Kind.FLOOR})
        if own or furniture:
            bodies = sorted(model.body(model.geom_bodyid[g]).name for g in (one, other))
            pairs.append((bodies[0], bodies[1]))
    return list(dict.fromkeys(pairs))


def _bearings(model: Any, item: SceneObject, joint: str) -> list[tuple[str, str]]:
    """Return the part and the elements of its own object that touch it somewhere on its path.

    A door moves freely in its frame, but not in the convex hull of a hollow frame. Elements that
    another joint of the object has moved from rest can be real obstacles, and stay.
    """
    values, rest = item.values(), item.model.rest
    moved = {
        link
        for name in item.model.joints
        if name != joint and abs(values[name] - rest[name]) > _REST_TOLERANCE
        for link in item.model.moved_by(name)
    }
    own = {f"{item.name}/{link}" for link in item.model.links if link not in moved}
    record = item.model.joint(joint)
    low, high = (
        float(np.clip(end, rest[joint] - np.pi, rest[joint] + np.pi))
        for end in (record.lower, record.upper)
    )
    way = [rest[joint], *np.linspace(low, high, _CONTACT_SAMPLES).tolist()]
    pairs = [p for v in way for p in _touching(model, _values(model, {PART: v}))]
    return [
        pair
        for pair in pairs
        if any(map(is_part, pair)) and any(n.rpartition("#")[0] in own for n in pair)
    ]


def _names_any(pair: tuple[str, str], links: frozenset[str]) -> bool:
    """Check whether one of two bodies is an element of some links, named as object/link."""
    return any(name.rpartition("#")[0] in links for name in pair)


def _near_pairs(model: Any, data: Any, gap: float) -> list[tuple[int, int]]:
    kept = model.geom_gap.copy()
    model.geom_gap[:] = gap
    mujoco.mj_collision(model, data)
    model.geom_gap[:] = kept
    return [(int(a), int(b)) for a, b in np.unique(data.contact.geom, axis=0)]


def _gap(data: Any, one: int, other: int) -> float:
    rows = (data.contact.geom == [one, other]).all(1)
    return float(data.contact.dist[rows].min())


def _standing(model: Any) -> list[str]:
    """Return the names of the fixed bodies."""
    still = np.isin(kinds_of(model), (Kind.ROOM, Kind.FLOOR))
    return [model.body(body).name for body in np.unique(model.geom_bodyid[still]).tolist()]


def kinds_of(model: Any) -> Int[np.ndarray, " g"]:
    """Return the kind of each geom of a model."""
    return np.array(model.geom_contype, int)


def _index(
    model: Any,
    data: Any,
    robot: Robot,
    hand: SimulatedHand,
    fingers: tuple[Finger, ...],
    loose: tuple[str, ...],
    balanced: tuple[str, ...],
) -> Simulation:
    def addresses(names: tuple[str, ...], key: str) -> Int[np.ndarray, " n"]:
        return np.array([int(getattr(model.joint(name), key)[0]) for name in names])

    def motors(names: tuple[str, ...]) -> Int[np.ndarray, " n"]:
        return np.array([model.actuator(name).id for name in names])

    names = [model.geom(i).name.split("#")[0] for i in range(model.ngeom)]
    sides = {body_of(link): int(side) for link, side in hand.pads.items()}
    return Simulation(
        model=model,
        data=data,
        kinds=kinds_of(model),
        names=tuple(name.removeprefix(body_of("")) for name in names),
        arm_q=addresses(robot.moved_joints, "qposadr"),
        arm_v=addresses(robot.moved_joints, "dofadr"),
        arm_motor=motors(robot.moved_joints),
        base_q=addresses(BASE_JOINTS, "qposadr"),
        base_v=addresses(BASE_JOINTS, "dofadr"),
        base_motor=motors(BASE_JOINTS),
        part_q=int(model.joint(PART).qposadr[0]),
        part_v=int(model.joint(PART).dofadr[0]),
        part_body=model.body(PART).id,
        tool_body=model.body(body_of(robot.tool_link)).id,
        weld=model.equality(WELD).id,
        hand=hand,
        hand_bodies=np.array([model.body(body_of(n)).id for n in robot.gripper_links], int),
        pad_side=np.array([sides.get(name, 0) for name in names]),
        fingers=tuple((finger, model.actuator(finger.joint).id) for finger in fingers),
        loose=loose,
        support=_support(robot),
        balanced=balanced,
    )
