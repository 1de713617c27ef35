"""Check what a plan states about its robot and its scene against their files."""

from __future__ import annotations

import math
from collections.abc import Collection, Iterator, Mapping
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import Cache
from momapos.model.records import FAMILIES, JointResistance, Overrides, PlacementPlan, Task
from momapos.model.robots import (
    Robot,
    drive_by_wheels,
    library_file,
    library_names,
    load_robot,
)
from momapos.model.scene import (
    ResistanceConfig,
    Scene,
    SceneObject,
    assumed_with,
    known_resistance,
    object_mass,
    stated_resistance,
)
from momapos.model.urdf import Articulated, Geometry, Joint, Urdf

from .report import Check, Limits, at_most, verdict

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_REST_DIFFERENCE = 1e-3
"""Largest difference of a rest value from the robot file's [rad] or [m]: files are rounded."""
MAX_RADIUS_SHARE = 1e-3
"""Largest difference of a turning radius from the robot file's, as a share of it [-]."""
MAX_URDF_DIFFERENCE = 1e-6
"""Largest difference of two readings of one URDF [rad], [m] or in their units: the plan's copy
prints its numbers again."""
_MOBILITY = ("car", "differential", "omni")
"""Drives, each able to do what those before it can."""


def find_robot_file(plan: PlacementPlan, urdf: Path, folders: Collection[Path]) -> Path | None:
    """Return the robot file that a plan names, or the one of its URDF; None if there is none.

    Args:
        plan: The plan.
        urdf: Its URDF.
        folders: Folders to search for a file that the plan names.
    """
    named = plan.robot_file
    if named in library_names():
        return library_file(str(named))
    given = [] if named is None else [folder / named for folder in folders]
    found = next((path for path in (*given, urdf.with_suffix(".toml")) if path.is_file()), None)
    ours = library_file(plan.robot_name) if plan.robot_name in library_names() else None
    return ours if found is None and ours and ours.with_suffix(".urdf") == urdf else found


def read_robot_of(
    plan: PlacementPlan, urdf: Path, folders: Collection[Path], cache: Cache | None
) -> Robot | None:
    """Read the robot file of a plan; None if there is none.

    Raises:
        RobotError, FileFormatError, UnknownNameError: The file is unusable, or lacks the arm.
    """
    path = find_robot_file(plan, urdf, folders)
    return None if path is None else load_robot(path, arm=plan.robot_arm, cache=cache)


def robot_checks(
    plan: PlacementPlan, model: Articulated, robot: Robot | None, limits: Limits
) -> Iterator[Check]:
    """Check that the plan's robot is the one of its file, and that it can rest and drive so.

    Args:
        plan: The plan.
        model: The robot by the plan's URDF.
        robot: The robot by its robot file; None without one.
        limits: Largest allowed errors.
    """
    yield from rest_checks(plan.robot_rest, model, plan.joints, limits)
    if robot is None:
        yield from _wheel_checks(plan, model)
        return
    stated = plan.base_link, plan.tool_link, plan.joints
    own = robot.base_link, robot.tool_link, robot.moved_joints
    names = ("base_link", "tool_link", "joints")
    wrong = [name for name, one, other in zip(names, stated, own, strict=True) if one != other]
    if wrong:
        k = names.index(wrong[0])
        detail = f"{wrong[0]} {_words(stated[k])}, {robot.path.name} has {_words(own[k])}"
    yield verdict("robot is that of its robot file", not wrong, detail if wrong else "")
    difference = urdf_difference(model.urdf, robot.model.urdf)
    yield verdict("URDF is that of the robot file", not difference, difference)
    yield from stated_checks(plan, robot)


def stated_checks(plan: PlacementPlan, robot: Robot) -> Iterator[Check]:
    """Check rest values, drive and grasps that a plan states against the robot's file."""
    yield _rest_check(plan.robot_rest, robot, plan.joints)
    drive, radius = plan.robot_drive, plan.robot_min_turning_radius
    same = drive in (None, robot.drive)
    detail = "" if same else f"the plan states {drive}, {robot.path.name} {robot.drive}"
    yield verdict("drive is that of the robot file", same, detail)
    if robot.drive == "car" and radius is not None:
        off = abs(radius / robot.min_turning_radius - 1.0)
        detail = f"{radius:g} m, {robot.path.name} has {robot.min_turning_radius:g} m"
        name = "turning radius is that of the robot file (difference)"
        yield at_most(name, 100 * off, 100 * MAX_RADIUS_SHARE, "%", detail)
    able = [family for family in FAMILIES if robot.grips in family.tools]
    holds = () if plan.motion is None else plan.motion.holds
    wrong = [hold.family for hold in holds if hold.family not in ("", *able)]
    detail = f"{wrong[0]!r:.60}; {robot.grips} can {', '.join(able)}" if wrong else ""
    yield verdict("the tool can hold as the plan states", not wrong, detail)


def robot_notes(plan: PlacementPlan, robot: Robot | None) -> Iterator[str]:
    """Yield what a plan leaves out or states about its robot without a file to compare with."""
    if robot is None:
        named = "" if plan.robot_file is None else f" {plan.robot_file!r:.80}"
        yield (
            f"there is no robot file{named}: drive, base link, tool link and rest values of the "
            "plan are compared with the URDF alone"
        )
        return
    absent = [
        name for name, value in robot.model.held.items()
        if name not in plan.robot_rest and abs(value) > MAX_REST_DIFFERENCE
    ]  # fmt: skip
    if absent:
        names = ", ".join(absent)
        yield f"the plan states no rest value of {names}; that of the robot file is used"


def rest_checks(
    rest: Mapping[str, float], model: Articulated, moved: Collection[str], limits: Limits
) -> Iterator[Check]:
    """Check that rest values belong to other joints than the arm's, and are within their limits."""
    joints = model.joints
    unknown = [name for name in rest if name not in joints or name in moved]
    detail = f"{unknown[0]!r:.80}" if unknown else ""
    yield verdict("rest values are of joints that the plan does not move", not unknown, detail)
    known = {name: value for name, value in rest.items() if name in joints}
    excess = {
        name: max(joints[name].lower - value, value - joints[name].upper)
        if np.isfinite(value)
        else np.inf
        for name, value in known.items()
    }
    worst = max(excess, key=excess.__getitem__, default="")
    most = max(0.0, excess.get(worst, 0.0))
    if most > limits.joint:
        joint = joints[worst]
        worst = f"{worst} at {known[worst]:g}; limits {joint.lower:g} to {joint.upper:g}"
    yield at_most("rest values within joint limits (excess)", most, limits.joint, "rad|m", worst)


def _rest_check(rest: Mapping[str, float], robot: Robot, moved: Collection[str]) -> Check:
    """Check that all joints but the fingers', which a plan may open less, rest as in the file."""
    model, fingers = robot.model, finger_joints(robot)
    off = {
        name: abs(value - model.rest[name])
        for name, value in rest.items()
        if name in model.joints and name not in fingers and name not in moved
        and model.joints[name].mimic is None
    }  # fmt: skip
    worst = max(off, key=off.__getitem__, default="")
    most = off.get(worst, 0.0)
    detail = ""
    if most > MAX_REST_DIFFERENCE:
        detail = f"{worst} at {rest[worst]:g}, {robot.path.name} has {model.rest[worst]:g}"
    name = "rest values are those of the robot file (difference)"
    return at_most(name, most, MAX_REST_DIFFERENCE, "rad|m", detail)


def finger_joints(robot: Robot) -> set[str]:
    """Return the joints that move links of the gripper, but not the tool."""
    model, gripper = robot.model, set(robot.gripper_links)
    moved = {name: set(model.moved_by(name)) for name in model.joints}
    return {n for n, links in moved.items() if links & gripper and robot.tool_link not in links}


def _wheel_checks(plan: PlacementPlan, model: Articulated) -> Iterator[Check]:
    """Check that the wheels of the URDF can drive as a plan states; none if they do not tell."""
    guess = drive_by_wheels(model)
    if plan.robot_drive is None or guess is None or guess.doubt:
        return
    able = _MOBILITY.index(plan.robot_drive) <= _MOBILITY.index(guess.drive)
    detail = f"the plan states {plan.robot_drive}; {guess.drive}: {guess.why}"
    yield verdict("the wheels can drive as the plan states", able, detail)
    if able and plan.robot_drive == guess.drive == "car" and guess.radius > 0.0:
        short = 1.0 - (plan.robot_min_turning_radius or 0.0) / guess.radius
        name = "turning radius below what the wheels can"
        yield at_most(name, 100 * short, 100 * MAX_RADIUS_SHARE, "%", guess.why)


def urdf_difference(one: Urdf, other: Urdf) -> str:
    """Return the first joint or link in which two URDFs differ, in words; "" if there is none.

    Joints with their limits, masses and the places of collision shapes are compared; of meshes the
    name of their file.
    """
    if one is other:
        return ""
    ours, theirs = ({joint.name: joint for joint in urdf.joints} for urdf in (one, other))
    if ours.keys() != theirs.keys() or one.links.keys() != other.links.keys():
        lone = sorted((ours.keys() ^ theirs.keys()) or (one.links.keys() ^ other.links.keys()))
        return f"{lone[0]!r:.60} is in one of them only"
    for name, joint in ours.items():
        found = _joint_difference(joint, theirs[name])
        if found:
            return f"joint {name}: {found}"
    for name, link in one.links.items():
        stated = other.links[name]
        masses = (link.mass, *link.center), (stated.mass, *stated.center)
        if not _close(*map(np.array, masses)):
            return f"link {name}: mass {link.mass:g} kg, the robot file has {stated.mass:g} kg"
        shapes = [
            [(shape.kind, _mesh_name(shape)) for shape in both.collisions]
            for both in (link, stated)
        ]
        if shapes[0] != shapes[1] or not all(
            _close(np.array(a.size), np.array(b.size))
            and _close(a.T_link_geometry, b.T_link_geometry)
            for a, b in zip(link.collisions, stated.collisions, strict=True)
        ):
            return f"link {name}: another collision shape"
    return ""


def _joint_difference(one: Joint, other: Joint) -> str:
    if (one.kind, one.parent, one.child) != (other.kind, other.parent, other.child):
        return "another kind or other links"
    for key in ("lower", "upper", "velocity", "acceleration", "effort"):
        ours, theirs = getattr(one, key), getattr(other, key)
        if not _close(np.array(ours), np.array(theirs)):
            return f"{key} limit {ours:g}, the robot file has {theirs:g}"
    if not (_close(one.T_parent_joint, other.T_parent_joint) and _close(one.axis, other.axis)):
        return "another place or axis"
    return "" if one.mimic == other.mimic else "follows another joint"


def _close(one: Float[np.ndarray, "..."], other: Float[np.ndarray, "..."]) -> bool:
    return bool(np.allclose(one, other, rtol=MAX_URDF_DIFFERENCE, atol=MAX_URDF_DIFFERENCE))


def _mesh_name(shape: Geometry) -> str:
    return shape.mesh.name if isinstance(shape.mesh, Path) else shape.piece


def _words(value: str | tuple[str, ...]) -> str:
    return value if isinstance(value, str) else ", ".join(value)


SAME_SHARE = 0.01
"""Largest difference of a resistance or mass from the file's, as a share of it [-]: files and plans
are rounded."""
SAME_VALUE = 1e-6
"""Joint values that differ by less are the same [rad] or [m]."""


def scene_checks(plan: PlacementPlan, scene: Scene) -> Iterator[Check]:
    """Check that task, resistance and mass of a plan do not contradict its scene file.

    Args:
        plan: The plan.
        scene: The scene of the file, with joints as in the plan and what its user has set.
    """
    item, task = scene.object(plan.task.object), plan.task
    if task.follower:
        joint = item.model.joints.get(task.follower)
        follows = joint is not None and joint.mimic is not None and joint.mimic.joint == task.joint
        yield verdict("task.follower follows task.joint", follows, f"{task.follower!r:.80}")
    known, found = _stated(item, task), []
    for name, value in _assumed(plan).items():
        if name in known and not _equal(value, known[name]):
            found.append(f"{name} {value:g}, the scene states {known[name]:g}")
    yield verdict("resistance and mass are as the scene states", not found, "; ".join(found))


def scene_notes(plan: PlacementPlan, scene: Scene, filed: Scene) -> Iterator[str]:
    """Yield what a plan assumes about its scene that the file does not state.

    Args:
        plan: The plan.
        scene: The scene of the file, with joints as in the plan and what its user has set.
        filed: The scene of the file.
    """
    for name, joints in plan.scene_joints.items():
        before = filed.object(name).values()
        for joint, value in joints.items():
            if abs(value - before[joint]) > SAME_VALUE:
                yield (
                    f"the plan begins with {name}/{joint} at {value:.4g}, where the scene file has "
                    f"{before[joint]:.4g}"
                )
    yield from _override_notes(plan.overrides)
    item, assumed = scene.object(plan.task.object), _assumed(plan)
    if plan.task.joint is not None and not assumed:
        yield (
            f"the plan states no resistance of {item.name}/{plan.task.joint}; what the scene "
            "states, or momapos assumes, is used"
        )
    usual, stated = _usual(item, plan), _stated(item, plan.task)
    other = [
        f"{name} {value:.4g}, usually {usual[name]:.4g}"
        for name, value in assumed.items()
        if name not in stated and usual[name] is not None and not _equal(value, usual[name])
    ]
    if other:
        yield (
            f"the plan assumes of {item.name} what no file states, and other values than usual: "
            f"{'; '.join(other)}; its loads are checked with both"
        )


def assumes_otherwise(plan: PlacementPlan, scene: Scene) -> bool:
    """Return whether a plan assumes another resistance or mass than its files and momapos do."""
    usual = _usual(scene.object(plan.task.object), plan)
    return any(
        usual[name] is None or not _equal(value, usual[name])
        for name, value in _assumed(plan).items()
    )


def _assumed(plan: PlacementPlan) -> dict[str, float]:
    """Return the resistance of the task's joint, or the object's mass, that a plan states."""
    task = plan.task
    if task.joint is None:
        payload = None if plan.loads is None else plan.loads.payload
        return {} if payload is None else {"mass": payload}
    stated = plan.resistance.get(task.object, {}).get(task.joint, JointResistance())
    return stated.members()


def _stated(item: SceneObject, task: Task) -> dict[str, float]:
    """Return the resistance of the task's joint, or the mass, that the scene's files state."""
    links = item.model.links
    if task.joint is None:
        mass = all(item.model.urdf.links[link].mass > 0.0 for link in links)
        stated = {} if item.mass is None else {"mass": item.mass}
        return stated or ({"mass": object_mass(item, ResistanceConfig())[0]} if mass else {})
    known = stated_resistance(item, task.joint).members()
    links = item.model.moved_by(task.joint)
    if "mass" not in known and all(item.model.urdf.links[link].mass > 0.0 for link in links):
        mass_of = known_resistance(item, task.joint, ResistanceConfig()).mass
        assert mass_of is not None
        known["mass"] = mass_of
    return known


def _usual(item: SceneObject, plan: PlacementPlan) -> Mapping[str, float | None]:
    """Return the resistance of the task's joint, or the mass, by the files and what is assumed."""
    config = assumed_with(plan.overrides.assumed)
    if plan.task.joint is None:
        return {"mass": object_mass(item, config)[0]}
    known = known_resistance(item, plan.task.joint, config)
    return {**dict.fromkeys(_FIELDS), **known.members()}


def with_usual(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return the scene with the usual resistance of the task's joint, or the usual mass."""
    item, config = scene.object(plan.task.object), assumed_with(plan.overrides.assumed)
    if plan.task.joint is None:
        return scene.with_mass(item.name, object_mass(item, config)[0])
    known = known_resistance(item, plan.task.joint, config)
    return scene.with_resistance({item.name: {plan.task.joint: known}})


def _override_notes(overrides: Overrides) -> Iterator[str]:
    set_by_user = [f"the mass of {name} to {mass:g} kg" for name, mass in overrides.mass.items()]
    set_by_user += [
        f"{key} of {name}/{joint} to {value:g}"
        for name, joints in overrides.resistance.items()
        for joint, known in joints.items()
        for key, value in known.members().items()
    ]
    set_by_user += [f"the assumed {key} to {value:g}" for key, value in overrides.assumed.items()]
    if set_by_user:
        yield f"the user of the plan has set {', '.join(set_by_user)}"


_FIELDS = tuple(JointResistance.__dataclass_fields__)


def _equal(one: float, other: float | None) -> bool:
    return other is not None and math.isclose(one, other, rel_tol=SAME_SHARE, abs_tol=1e-6)
