"""The robot in the physics engine: a heavy base on its tyres, an arm with motors, fingers."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import mujoco
import numpy as np

from momapos.errors import RobotError
from momapos.execution.config import ExecutionConfig
from momapos.execution.dynamics import Dynamics, Inertia
from momapos.execution.shapes import Kind, add_shape, dress, place_body
from momapos.geometry.transforms import apply, invert, pose_planar
from momapos.kinematics.articulated import joint_motion
from momapos.kinematics.urdf import Joint
from momapos.robots.robot import Robot

if TYPE_CHECKING:
    from jaxtyping import Float

BASE_JOINTS = ("base x", "base y", "base yaw")
TOOL_POINT = "tool point"
"""Name of a geom that nothing meets, at the tool's origin."""
UNKNOWN_DENSITY = 500.0
"""Of links whose URDF gives no mass [kg/m^3]."""


@dataclass(frozen=True)
class Finger:
    """A finger that slides."""

    joint: str
    open: float
    """Where the plan has it [m]."""
    closed: float
    """Its end nearest to the other fingers [m]."""


def body_of(link: str) -> str:
    """Name of the body of a robot's link."""
    return f"robot/{link}"


def find_fingers(robot: Robot) -> tuple[Finger, ...]:
    """The sliding joints of a gripper, each with the end at which the gripper is closed."""
    model = robot.model
    hand = set(robot.gripper_links)
    joints = [
        joint
        for joint in model.joints.values()
        if joint.child in hand and joint.name not in robot.arm_joints and joint.kind == "prismatic"
    ]
    if len(joints) < 2 or not all(np.isfinite([j.lower, j.upper]).all() for j in joints):
        return ()
    return tuple(Finger(j.name, model.rest[j.name], _closed_end(robot, j, joints)) for j in joints)


def _closed_end(robot: Robot, joint: Joint, fingers: list[Joint]) -> float:
    """The end of a finger's joint that is nearer to the middle of all fingers."""
    middle = np.mean([_finger_center(robot, j.child, {}) for j in fingers], axis=0)
    ends = (joint.lower, joint.upper)
    gaps = [
        np.linalg.norm(_finger_center(robot, joint.child, {joint.name: end}) - middle)
        for end in ends
    ]
    return ends[int(np.argmin(gaps))]


def _finger_center(robot: Robot, link: str, values: dict[str, float]) -> Float[np.ndarray, "3"]:
    model = robot.model
    poses = model.link_poses(values)
    points = [apply(poses[n], h.vertices) for n in model.links_below(link) for h in model.hulls[n]]
    if not points:
        return poses[link][:3, 3]
    cloud = np.concatenate(points)
    return (cloud.min(0) + cloud.max(0)) / 2


def add_robot(
    spec: Any,
    robot: Robot,
    base_pose: tuple[float, float, float],
    dynamics: Dynamics,
    config: ExecutionConfig,
) -> tuple[Finger, ...]:
    """Add the robot to a world.

    The arm's joints get motors; the fingers slide only where the hold is `contact`. All other
    joints are locked where they rest. The engine's joints keep the URDF's names.

    Returns:
        The fingers that slide.

    Raises:
        RobotError: The hold is `contact`, and the gripper has no sliding fingers.
    """
    fingers = find_fingers(robot) if config.hold == "contact" else ()
    if config.hold == "contact" and not fingers:
        raise RobotError(
            f"{robot.name}: --hold contact needs a gripper with sliding fingers; use --hold weld"
        )
    root = place_body(spec.worldbody.add_body(name="base"), pose_planar(np.array(base_pose)))
    slide, hinge = mujoco.mjtJoint.mjJNT_SLIDE, mujoco.mjtJoint.mjJNT_HINGE
    for name, motion, axis in zip(BASE_JOINTS, (slide, slide, hinge), np.eye(3), strict=True):
        root.add_joint(name=name, type=motion, axis=axis)
    model, moving = robot.model, _arm_links(robot)
    T_root_base = model.rest_poses[robot.base_link]
    free = {*robot.arm_joints, *(finger.joint for finger in fingers)}
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
            _add_joint(body, joint, dynamics, config)
        kind = Kind.BASE
        if link in moving:
            kind = Kind.GRIPPER if link in robot.gripper_links else Kind.ARM
        _add_link(spec, body, robot, link, kind, dynamics, config)
    bodies[robot.tool_link].add_geom(
        name=TOOL_POINT, type=mujoco.mjtGeom.mjGEOM_SPHERE, size=[1e-3, 0, 0], density=0.0,
        contype=0, conaffinity=0, rgba=[0, 0, 0, 0],
    )  # fmt: skip
    _add_motors(spec, robot, fingers, config)
    _add_excludes(spec, robot)
    return fingers


def _arm_links(robot: Robot) -> set[str]:
    return {link for joint in robot.arm_joints for link in robot.model.moved_by(joint)}


def _joint_to(robot: Robot, link: str) -> Joint | None:
    return next((j for j in robot.model.urdf.joints if j.child == link), None)


def _add_joint(body: Any, joint: Joint, dynamics: Dynamics, config: ExecutionConfig) -> None:
    slides = joint.kind == "prismatic"
    kind = mujoco.mjtJoint.mjJNT_SLIDE if slides else mujoco.mjtJoint.mjJNT_HINGE
    added = body.add_joint(name=joint.name, type=kind, axis=joint.axis, actgravcomp=1)
    added.armature = config.control.armature * (10.0 if slides else 1.0)
    if np.isfinite(joint.lower) and np.isfinite(joint.upper):
        added.limited, added.range = 1, [joint.lower, joint.upper]
    effort = dynamics.efforts.get(joint.name)
    if effort is not None:
        added.actfrclimited, added.actfrcrange = 1, [-effort, effort]


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
        geom.density, geom.gap = UNKNOWN_DENSITY, config.near
        if kind is Kind.GRIPPER:
            geom.friction, geom.condim = [config.gripper.friction, 0.01, 1e-4], 4


def _set_inertia(body: Any, inertia: Inertia) -> None:
    xx, yy, zz, xy, xz, yz = inertia.matrix
    R = inertia.T_link_inertia[:3, :3]
    least = 1e-4 * inertia.mass  # a ball of 16 mm: files may give a mass and no inertia
    matrix = R @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ R.T
    if np.linalg.eigvalsh(matrix)[0] <= 0:
        matrix = np.eye(3) * max(float(np.trace(matrix)) / 3, least)
    body.explicitinertial, body.mass = True, inertia.mass
    body.ipos = inertia.T_link_inertia[:3, 3]
    body.fullinertia = [*np.diag(matrix), matrix[0, 1], matrix[0, 2], matrix[1, 2]]


def _add_motors(
    spec: Any, robot: Robot, fingers: tuple[Finger, ...], config: ExecutionConfig
) -> None:
    """One position-controlled motor a joint; `tune` sets the gains when inertias are known."""
    for name in (*BASE_JOINTS, *robot.arm_joints):
        spec.add_actuator(name=name, target=name, trntype=mujoco.mjtTrn.mjTRN_JOINT)
    for finger in fingers:
        motor = spec.add_actuator(
            name=finger.joint, target=finger.joint, trntype=mujoco.mjtTrn.mjTRN_JOINT
        )
        motor.forcelimited = 1
        motor.forcerange = [-config.gripper.force, config.gripper.force]


def _add_excludes(spec: Any, robot: Robot) -> None:
    """Pairs of links that the robot's maker does not check; neighbors the engine leaves out."""
    for pair in robot.disabled:
        names = sorted(pair)
        if len(names) == 2 and all(name in robot.model.urdf.links for name in names):
            spec.add_exclude(bodyname1=body_of(names[0]), bodyname2=body_of(names[1]))


def tune(
    model: Any,
    data: Any,
    robot: Robot,
    states: Float[np.ndarray, "k n"],
    fingers: tuple[Finger, ...],
    config: ExecutionConfig,
) -> None:
    """Set the gains of all motors to the wanted bandwidth.

    The base holds like a spring until the push is more than the friction of its wheels, which
    act where the footprint ends.

    Args:
        model, data: The world; the state is left at the last of the arm's.
        robot: The robot in it.
        states: Of the arm; each joint is tuned for the one in which it moves most [rad] or [m].
        fingers: The fingers that slide.
        config: Names the bandwidths.
    """
    control, sliding = config.control, tuple(finger.joint for finger in fingers)
    names = (*BASE_JOINTS, *robot.arm_joints, *sliding)
    dofs = [int(model.joint(name).dofadr[0]) for name in names]
    arm_q = [int(model.joint(name).qposadr[0]) for name in robot.arm_joints]
    inertia, full = np.zeros(len(names)), np.zeros((model.nv, model.nv))
    for q in states:
        data.qpos[arm_q] = q
        mujoco.mj_forward(model, data)
        mujoco.mj_fullM(model, data, full)
        inertia = np.maximum(inertia, np.diag(full)[dofs])
    for name, mass in zip(names, inertia.tolist(), strict=True):
        motor, base = model.actuator(name).id, name in BASE_JOINTS
        w = control.base_bandwidth if base else control.bandwidth
        stiffness = config.gripper.stiffness if name in sliding else mass * w**2
        set_gains(model, motor, stiffness=stiffness, damping=2 * float(np.sqrt(mass * stiffness)))
        if base:
            limit = control.base_friction * 9.81 * float(inertia[0])
            if name == BASE_JOINTS[2]:
                limit *= float(np.linalg.norm(robot.footprint, axis=1).mean())
            model.actuator_forcelimited[motor] = 1
            model.actuator_forcerange[motor] = [-limit, limit]


def set_gains(model: Any, motor: int, *, stiffness: float, damping: float) -> None:
    """Make a motor a position controller: force = stiffness (control - q) - damping q'."""
    model.actuator_biastype[motor] = mujoco.mjtBias.mjBIAS_AFFINE
    model.actuator_gainprm[motor, 0] = stiffness
    model.actuator_biasprm[motor, :3] = [0.0, -stiffness, -damping]
