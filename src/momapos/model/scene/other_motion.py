"""Replace the joint of an object's part by another hypothesis, and write the scene file."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element, SubElement, tostring

import numpy as np

from momapos.core import SceneError, UrdfError, parse_xml, read_text_bounded, resolved, write_file
from momapos.core.geometry import apply, invert, pose
from momapos.model.records import Hypothesis, PartKind, PlacementPlan
from momapos.model.urdf import (
    MAX_URDF_BYTES,
    Articulated,
    opening_of,
    origin_pose,
    read_furniture,
)

from .model_copies import copied
from .scene import Scene
from .scene_files import save_scene
from .scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float

MIN_TRAY_DEPTH = 0.08
"""Minimum depth behind the object's front at which a shape belongs to a drawer's tray [m]."""


def with_part_motion(item: SceneObject, joint: str, way: Hypothesis) -> SceneObject:
    """Return the object with another motion of a part; it looks the same while closed.

    A drawer that becomes hinged loses its tray, which could not rotate.

    Args:
        item: The object.
        joint: Joint of the part; it keeps its name, is closed at 0 and opens to `way.upper`.
        way: Motion of the part, in the object's frame.

    Raises:
        SceneError: The joint is a mimic joint or has followers, or the object has no URDF.
    """
    path = item.model.urdf.path
    if path is None:
        raise SceneError(f"{item.name}: is a box without joints")
    cache = item.model.cache
    text = _urdf_text(item, joint, way)
    urdf = read_furniture(path, scale=item.model.urdf.scale, cache=cache, text=text)
    model = Articulated(urdf, item.model.held, cache, _closed_without(item.model, joint))
    others = {name: value for name, value in item.joints.items() if name != joint}
    return replace(item, model=model, joints=others)


def _closed_without(model: Articulated, joint: str) -> dict[str, float]:
    """Return the closed values of a model's joints, without that of a joint that is replaced."""
    return {name: value for name, value in model.closed.items() if name != joint}


def scene_with_part_motion(scene: Scene, name: str, joint: str, way: Hypothesis) -> Scene:
    """Return the room with another motion of a part (see `with_part_motion`), the part closed."""
    target = scene.object(name)
    other = with_part_motion(target, joint, way)
    set_here = {k: v for k, v in scene.joints_set.get(name, {}).items() if k != joint}
    return replace(
        scene,
        objects=tuple(other if o is target else o for o in scene.objects),
        joints_set={**scene.joints_set, name: set_here},
    )


def hypothesis_about(
    item: SceneObject,
    joint: str,
    direction: Float[np.ndarray, "3"],
    point: Float[np.ndarray, "3"],
    moved: float,
) -> Hypothesis:
    """Return the hypothesis for a part that moves about another axis, in its object's frame.

    Args:
        item: The object as believed.
        joint: Its joint.
        direction: Direction of the axis in the world; the joint opens about or along it.
        point: Point on the axis, in the world [m].
        moved: Observed opening of the part [rad] or [m].
    """
    opening = opening_of(item.model, joint)
    back = invert(item.T_world_object)
    axis = opening.sign * back[:3, :3] @ direction
    upper = max(abs(opening.wide - opening.closed), moved)
    on_axis = apply(back, point[None])[0]
    return Hypothesis(_part_kind(item, joint, axis), 1.0, _triple(on_axis), _triple(axis), upper)


def _part_kind(item: SceneObject, joint: str, axis: Float[np.ndarray, "3"]) -> PartKind:
    """Return the kind of part by its joint; for flaps the closest hypothesis of the scene."""
    slides = item.joint(joint).kind == "prismatic"
    ways = item.hypotheses.get(joint, ())
    near = [way for way in ways if (way.kind == "drawer") == slides]
    if near:
        return max(near, key=lambda way: float(np.array(way.axis) @ axis)).kind
    if slides:
        return "drawer"
    return "door_right" if axis[2] >= 0.0 else "door_left"


def _triple(values: Float[np.ndarray, "3"]) -> tuple[float, float, float]:
    x, y, z = values.tolist()
    return x, y, z


def scene_with_hypothesis(scene: Scene, name: str, joint: str, index: int) -> Scene:
    """Return the room with one of a part's hypotheses; more probable ones are ruled out.

    Args:
        scene: The room.
        name, joint: Object and joint of the part, which is then closed.
        index: Index of the hypothesis, from 0.

    Raises:
        UnknownNameError: The object does not exist.
        SceneError: The hypothesis does not exist, or see `with_part_motion`.
    """
    ways = scene.object(name).hypotheses.get(joint, ())
    if not 0 <= index < len(ways):
        raise SceneError(f"{name}/{joint}: no hypothesis {index}; it has {len(ways)}, from 0")
    left = ways[index:]
    total = sum(way.probability for way in left)
    left = tuple(replace(way, probability=way.probability / total) for way in left)
    other = scene_with_part_motion(scene, name, joint, left[0])
    item = other.object(name)
    known = replace(item, hypotheses={**item.hypotheses, joint: left})
    taken = scene.hypotheses_set.get(name, {})
    return replace(
        other,
        objects=tuple(known if o is item else o for o in other.objects),
        hypotheses_set={
            **scene.hypotheses_set, name: {**taken, joint: taken.get(joint, 0) + index},
        },
    )  # fmt: skip


def with_assumptions(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return a scene with the resistance and the mass that a plan assumes.

    What moves with the part of its task is a link of the part's object.

    Raises:
        UnknownNameError: The scene has no such object or joint.
    """
    scene = _loaded(scene, plan).with_resistance(plan.resistance)
    if plan.loads is None or plan.loads.payload is None:
        return scene
    return scene.with_mass(plan.task.object, plan.loads.payload)


def with_overrides(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return a scene with what a plan's user has set of forces and masses.

    Raises:
        UnknownNameError, InputError: The scene has no such object or joint, or a value is unusable.
    """
    scene = scene.with_resistance(plan.overrides.resistance)
    for name, mass in plan.overrides.mass.items():
        scene = scene.with_mass(name, mass)
    return scene


def as_planned(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return a scene as a plan begins, with what moves with its part as links of the part's object.

    Raises:
        UnknownNameError, SceneError: The scene has no such joint, hypothesis or value.
    """
    return _loaded(as_begun(scene, plan), plan)


def _loaded(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return a scene with what moves with a plan's part as links of the part's object."""
    task = plan.task
    return scene if task.joint is None else scene.with_contents(task.object, task.joint)


def as_begun(scene: Scene, plan: PlacementPlan) -> Scene:
    """Return a scene with the hypotheses and joint values of a plan.

    Raises:
        UnknownNameError, SceneError: The scene has no such joint, hypothesis or value.
    """
    for name, taken in plan.scene_hypotheses.items():
        for joint, index in taken.items():
            scene = scene_with_hypothesis(scene, name, joint, index)
    return scene.with_joints(plan.scene_joints)


def save_with_part_motion(
    scene: Scene, name: str, joint: str, way: Hypothesis, value: float, out: Path
) -> Scene:
    """Write a scene with a known motion of a part, and copies of all its files.

    Args:
        scene: The room as believed.
        name, joint, way: See `with_part_motion`.
        value: Value of the joint [rad] or [m].
        out: The new scene file; the copies are written to `<stem>_files` next to it.

    Returns:
        The scene of that file.

    Raises:
        SceneError: The file or that folder exists, or cannot be written.
    """
    if out.exists():
        raise SceneError(f"{out}: exists already; remove it or write to another file")
    target = scene.object(name)
    text = _urdf_text(target, joint, way)
    with copied(scene, out) as near:
        item = near.object(name)
        assert item.model.urdf.path is not None
        file = item.model.urdf.path.with_name(f"{name}_{joint}.urdf")
        write_file(file, text, error=SceneError)
        model = Articulated(
            read_furniture(file, root=resolved(out).parent, scale=item.model.urdf.scale),
            item.model.held,
            closed=_closed_without(item.model, joint),
        )
        known = replace(
            item,
            model=model,
            joints={**item.joints, joint: value},
            hypotheses={**item.hypotheses, joint: (replace(way, probability=1.0),)},
        )
        objects = tuple(known if o is item else o for o in near.objects)
        return save_scene(replace(near, objects=objects), out)


def _urdf_text(item: SceneObject, joint: str, way: Hypothesis) -> str:
    """Return the URDF of an object with the joint of a part replaced."""
    path, scale = item.model.urdf.path, item.model.urdf.scale
    assert path is not None
    # Read the file again: the object may already have another motion.
    model = Articulated(
        read_furniture(path, scale=scale, cache=item.model.cache), item.model.held, item.model.cache
    )
    record = model.joint(joint)
    if record.mimic is not None or model.followers(joint):
        raise SceneError(f"{item.name}: {joint} is coupled to other joints and can't be replaced")
    tree = parse_xml(read_text_bounded(path, MAX_URDF_BYTES, error=UrdfError), path)
    slides = way.kind == "drawer"
    closed_poses = model.link_poses({**item.values(), joint: opening_of(model, joint).closed})
    T_root_child, T_root_parent = closed_poses[record.child], closed_poses[record.parent]
    R = (T_root_parent @ record.T_parent_joint)[:3, :3]
    T_root_joint = pose(np.array(way.point), R)
    shift = invert(T_root_joint) @ T_root_child
    child = _named(tree, "link", record.child, path)
    moved = [child.find("inertial"), *child.findall("collision"), *child.findall("visual")]
    if not slides and record.kind == "prismatic":
        for shape in _tray(model, joint, closed_poses, child):
            child.remove(shape)
            moved.remove(shape)
    moved += [j for j in tree.findall("joint") if _link(j, "parent") == record.child]
    for element in moved:
        if element is not None:
            _set_origin(element, shift @ origin_pose(element.find("origin"), scale), scale)
    here = _named(tree, "joint", joint, path)
    here.set("type", "prismatic" if slides else "revolute")
    _set_origin(here, invert(T_root_parent) @ T_root_joint, scale)
    _child(here, "axis").set("xyz", _numbers(R.T @ np.array(way.axis)))
    limit = _child(here, "limit")
    limit.set("lower", "0")
    limit.set("upper", f"{way.upper / (scale if slides else 1.0):.9g}")
    for key in ("effort", "velocity"):
        limit.set(key, limit.get(key, "1"))
    return tostring(tree, encoding="unicode")


def _tray(
    model: Articulated,
    joint: str,
    closed_poses: Mapping[str, Float[np.ndarray, "4 4"]],
    child: Element,
) -> list[Element]:
    """Return the collision and visual elements of a drawer that reach far behind the front."""
    record = model.joint(joint)
    out = (closed_poses[record.parent] @ record.T_parent_joint)[:3, :3] @ record.axis
    out = opening_of(model, joint).sign * out
    still = [name for name in model.links if name not in model.moved_by(joint)]
    rest = [
        float((apply(closed_poses[n], h.vertices) @ out).max())
        for n in still
        for h in model.hulls[n]
    ]
    front = max(rest, default=-np.inf)
    link, found = model.urdf.links[record.child], []
    for tag, shapes in (("collision", link.collisions), ("visual", link.visuals)):
        # Drawn shapes that count as collision shapes come after those of the file.
        for element, shape in zip(child.findall(tag), shapes, strict=False):
            points = model.hull(record.child, shape).vertices
            end = float((apply(closed_poses[record.child], points) @ out).min())
            if end < front - MIN_TRAY_DEPTH:
                found.append(element)
    return found


def _named(tree: Element, tag: str, name: str, path: Path) -> Element:
    for element in tree.findall(tag):
        if element.get("name") == name:
            return element
    raise UrdfError(f"{path}: has no {tag} {name!r}")


def _link(joint: Element, tag: str) -> str:
    found = joint.find(tag)
    return "" if found is None else found.get("link", "")


def _child(element: Element, tag: str) -> Element:
    found = element.find(tag)
    return SubElement(element, tag) if found is None else found


def _set_origin(element: Element, T: Float[np.ndarray, "4 4"], scale: float) -> None:
    from scipy.spatial.transform import Rotation  # slow to import

    origin = _child(element, "origin")
    origin.attrib.pop("quat_xyzw", None)
    origin.set("xyz", _numbers(T[:3, 3] / scale))
    origin.set("rpy", _numbers(Rotation.from_matrix(T[:3, :3]).as_euler("xyz")))


def _numbers(values: Float[np.ndarray, "3"]) -> str:
    return " ".join(f"{float(value) + 0.0:.9g}" for value in values)
