"""Build the robot in the physics engine: a heavy base on tires, a motorized arm, fingers."""

from __future__ import annotations

from collections.abc import Mapping
from itertools import combinations
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.core.geometry import invert, pose_planar
from momapos.model.robots import Pivot, Robot
from momapos.model.urdf import Joint, Mimic, joint_motion

from .config import (
    ARMATURE,
    BANDWIDTH,
    BASE_BANDWIDTH,
    BASE_FRICTION,
    OBSERVED_DISTANCE,
    ExecutionConfig,
)
from .geoms import Kind, add_shape, dress, place_body
from .robot_dynamics import Dynamics, Finger, Inertia, SimulatedHand

if TYPE_CHECKING:
    from jaxtyping import Float

BASE_JOINTS = ("base x", "base y", "base yaw")
TOOL_POINT = "tool point"
"""Name of a geom without collisions at the tool's origin."""
_TIP_ARMATURE = 0.02
"""Inertia of a rotating fingertip through its linkage; less makes it softer [kg m^2]."""
UNKNOWN_DENSITY = 500.0
"""Density of links whose URDF gives no mass [kg/m^3]."""


def body_of(link: str) -> str:
    """Return the body name of a robot's link."""
    return f"robot/{link}"


def add_robot(
    spec: Any,
    robot: Robot,
    base_pose: tuple[float, float, float],
    hand: SimulatedHand,
    dynamics: Dynamics,
    config: ExecutionConfig,
) -> None:
    """Add the robot to a world.

    The arm's joints get motors; joints outside the chain that follow them are coupled to them; the
    fingers move only where the hold is `contact`. All other joints are locked where they rest. The
    engine's joints keep the URDF's names.
    """
    fingers = hand.fingers if config.hold == "contact" else ()
    followers = dict(hand.followers) if config.hold == "contact" else {}
    for name in robot.segments.side_followers:
        mimic = robot.model.joint(name).mimic
        assert mimic is not None
        followers[name] = mimic
    root = place_body(spec.worldbody.add_body(name="base"), pose_planar(np.array(base_pose)))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, motion, axis in zip(BASE_JOINTS, (slide, slide, hinge), np.eye(3), strict=True):
        root.add_joint(name=name, type=motion, axis=axis)
    model, moving = robot.model, _arm_links(robot)
    T_root_base = model.rest_poses[robot.base_link]
    driven = {finger.joint for finger in fingers}
    turning = {pivot.link: pivot for pivot in hand.pivots if fingers}
    free = {*robot.moved_joints, *driven, *followers}
    bodies: dict[str, Any] = {}
    for link in model.links:
        parent, T, joint = root, invert(T_root_base), _joint_to(robot, link)
        if joint is not None:
            parent, T = bodies[joint.parent], joint.T_parent_joint
            if joint.movable and joint.name not in free:
                T = T @ joint_motion(joint, model.rest[joint.name])
        body = place_body(parent.add_body(name=body_of(link), gravcomp=1.0), T)
        bodies[link] = body
        if joint is not None and joint.name in free:
            limit = dynamics.efforts.get(joint.name) if joint.name in robot.moved_joints else None
            _add_joint(body, joint, limit)
        if link in turning:
            _add_pivot(body, turning[link])
        kind = Kind.BASE
        if link in moving:
            kind = Kind.GRIPPER if link in robot.gripper_links else Kind.ARM
            kind = Kind.PAD if link in hand.pads else kind
        _add_link(spec, body, robot, link, kind, dynamics, config)
    bodies[robot.tool_link].add_geom(
        name=TOOL_POINT, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0, 0], density=0.0,
        contype=0, conaffinity=0, rgba=[0, 0, 0, 0],
    )  # fmt: skip
    _add_motors(spec, robot, fingers)
    _add_couplings(spec, fingers, followers)
    _add_excludes(spec, robot, {*hand.pads} if turning else set(), {*turning})


def _arm_links(robot: Robot) -> set[str]:
    return {link for joint in robot.moved_joints for link in robot.model.moved_by(joint)}


def _joint_to(robot: Robot, link: str) -> Joint | None:
    return next((j for j in robot.model.urdf.joints if j.child == link), None)


def _add_joint(body: Any, joint: Joint, effort: float | None) -> None:
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    added = body.add_joint(name=joint.name, type=kind, axis=joint.axis, actgravcomp=1)
    added.armature = ARMATURE * (10.0 if slides else 1.0)
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        added.limited, added.range = 1, [joint.lower, joint.upper]
    if effort is not None:
        added.actfrclimited, added.actfrcrange = 1, [-effort, effort]


def _add_pivot(body: Any, pivot: Pivot) -> None:
    hinge = mujoco.mjtJoint.mjJNT_HINGE
    added = body.add_joint(name=pivot.name, type=hinge, axis=pivot.axis, pos=pivot.center)
    added.armature = _TIP_ARMATURE


def _add_link(
    spec: Any,
    body: Any,
    robot: Robot,
    link: str,
    kind: Kind,
    dynamics: Dynamics,
    config: ExecutionConfig,
) -> None:
    inertia = dynamics.inertias.get(link)
    if inertia is not None and inertia.mass > 0:
        _set_inertia(body, inertia)
    touched = config.hold == "contact"
    for i, shape in enumerate(robot.model.urdf.links[link].collisions):
        geom = add_shape(spec, body, shape, np.eye(4), f"{body.name}#{i}")
        dress(geom, kind, touched=touched)
        geom.density, geom.gap = UNKNOWN_DENSITY, OBSERVED_DISTANCE
        if kind is Kind.PAD:
            geom.friction, geom.condim = [config.gripper.friction, 0.01, 1e-4], 4
            geom.priority = 1  # otherwise the larger friction of the two applies


def _set_inertia(body: Any, inertia: Inertia) -> None:
    xx, yy, zz, xy, xz, yz = inertia.matrix
    R = inertia.T_link_inertia[:3, :3]
    least = 1e-4 * inertia.mass  # a ball of 16 mm, for files with a mass but no inertia
    matrix = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        matrix = np.eye(3) * max(float(np.trace(matrix)) / 3, least)
    body.explicitinertial, body.mass = True, inertia.mass
    body.ipos = inertia.T_link_inertia[:3, 3]
    body.fullinertia = [*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]]


def _add_motors(spec: Any, robot: Robot, fingers: tuple[Finger, ...]) -> None:
    """Add a position-controlled motor to each joint; `tune` sets the gains later."""
    for name in (*BASE_JOINTS, *robot.moved_joints):
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    for finger in fingers:
        motor = spec.add_actuator(
            name=finger.joint, target=finger.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        force = robot.grip_force * finger.lever
        motor.forcelimited, motor.forcerange = 1, [-force, force]


def _add_couplings(spec: Any, fingers: tuple[Finger, ...], followers: Mapping[str, Mimic]) -> None:
    """Couple followers to their drivers; two motorized fingers close together, as the jaws of a
    parallel gripper with one motor."""
    pairs = [(name, m.joint, m.offset, m.ratio) for name, m in followers.items()]
    if len(fingers) == 2:
        one, other = fingers
        factor = (other.closed - other.open) / (one.closed - one.open)
        pairs.append((other.joint, one.joint, other.open - factor * one.open, factor))
    for name, driver, offset, factor in pairs:
        added = spec.add_equality(
            name=f"{name} follows {driver}", type=mujoco.mjtEq.mjEQ_JOINT,
            objtype=mujoco.mjtObj.mjOBJ_JOINT, active=True,
        )  # fmt: skip
        added.name1, added.name2 = name, driver
        added.data[:2] = [offset, factor]


def _add_excludes(spec: Any, robot: Robot, fingers: set[str], tips: set[str]) -> None:
    """Exclude link pairs that the robot's SRDF disables; the engine excludes neighbors itself.

    If tips rotate on their fingers, only tips collide with tips: a flexible finger is modeled
    rigid, and would touch the other side first.
    """
    pairs = {tuple(sorted(pair)) for pair in robot.disabled if len(pair) == 2}
    pairs |= {pair for pair in combinations(sorted(fingers), 2) if len(tips.intersection(pair)) < 2}
    for one, other in sorted(pairs):
        if one in robot.model.urdf.links and other in robot.model.urdf.links:
            spec.add_exclude(bodyname1=body_of(one), bodyname2=body_of(other))


def tune(
    model: Any,
    data: Any,
    robot: Robot,
    states: Float[np.ndarray, "k n"],
    fingers: tuple[Finger, ...],
    config: ExecutionConfig,
) -> tuple[str, ...]:
    """Set the gains of all motors to the wanted bandwidth.

    The base holds like a spring until the push is more than the friction of its wheels, which
    act where the footprint ends. A joint whose effort by the URDF is less than the arm's own weight
    takes has springs or a counterweight, as they are left out of URDFs: its motor bears no weight.

    Args:
        model, data: The world; the state is left at the last of the arm's.
        robot: The robot in it.
        states: Of the arm; each joint is tuned for the one in which it moves most [rad] or [m].
        fingers: Those that move.
        config: Names the stiffness of the fingers.

    Returns:
        The joints that are balanced so.
    """
    levers = {finger.joint: finger.lever for finger in fingers}
    names = (*BASE_JOINTS, *robot.moved_joints, *levers)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    arm_q = [int(model.joint(name).qposadr[0]) for name in robot.moved_joints]
    inertia, full = np.zeros(len(names)), np.zeros((model.nv, model.nv))
    weight = np.zeros(model.nv)
    for q in states:
        data.qpos[arm_q] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, np.diag(full)[dofs])
        weight = np.maximum(weight, np.abs(data.qfrc_gravcomp))
    for name, mass in zip(names, inertia.tolist(), strict=True):
        motor, base = model.actuator(name).id, name in BASE_JOINTS
        w = BASE_BANDWIDTH if base else BANDWIDTH
        lever = levers.get(name)
        stiffness = mass * w**2 if lever is None else config.gripper.stiffness * lever**2
        set_gains(model, motor, stiffness=stiffness, damping=2 * float(np.sqrt(mass * stiffness)))
        if base:
            limit = BASE_FRICTION * 9.81 * float(inertia[0])
            if name == BASE_JOINTS[2]:
                limit *= float(np.linalg.norm(robot.footprint, axis=1).mean())
            model.actuator_forcelimited[motor] = 1
            model.actuator_forcerange[motor] = [-limit, limit]
    joints = [(name, model.joint(name).id) for name in robot.moved_joints]
    balanced = [
        (name, j)
        for name, j in joints
        if model.jnt_actfrclimited[j] and weight[model.jnt_dofadr[j]] > model.jnt_actfrcrange[j, 1]
    ]
    model.jnt_actgravcomp[[j for _, j in balanced]] = 0
    return tuple(name for name, _ in balanced)


def set_gains(model: Any, motor: int, *, stiffness: float, damping: float) -> None:
    """Make a motor a position controller: force = stiffness (control - q) - damping q'."""
    model.actuator_biastype[motor] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[motor, 0] = stiffness
    model.actuator_biasprm[motor, :3] = [0.0, -stiffness, -damping]
