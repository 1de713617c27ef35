"""The scene record: objects, a floor with named areas, a start."""

from __future__ import annotations

import json
import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import (
    Parents,
    Quantity,
    SceneError,
    dotted,
    finite_number,
    owner_cache,
    parse_quantity,
    read_record,
    read_text_bounded,
    unknown_name,
)
from momapos.core.geometry import signed_area
from momapos.model.records import NO_OVERRIDES, JointResistance, Outline, Overrides
from momapos.model.urdf import Joint

from .contents import poses_after, with_contents
from .scene_members import Corners, IgnoredKey
from .scene_object import MAX_MASS, MAX_VARIANTS, SceneObject, Wall, wall_name, walls_around

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class Scene:
    """A room. Equality is identity."""

    name: str
    objects: tuple[SceneObject, ...]
    path: Path | None = None
    """Scene file, which plans name; `save_scene` sets it for a scene made in code."""
    floor_polygon: Float[np.ndarray, "k 2"] | None = None
    """Outline of the floor [m]; None for an unbounded floor."""
    start: Float[np.ndarray, "3"] | None = None
    """Initial pose of the robot: x [m], y [m], yaw [rad]."""
    warnings: tuple[str, ...] = ()
    """Assumptions of the reader, and ignored keys."""
    ignored_keys: tuple[IgnoredKey, ...] = ()
    """Keys of the file that the reader does not know."""
    areas: Mapping[str, Outline] = field(default_factory=dict)
    """Named areas of the floor."""
    joints_set: Mapping[str, Mapping[str, float]] = field(default_factory=dict)
    """Joint values that differ from the file, by object and joint [rad] or [m]."""
    hypotheses_set: Mapping[str, Mapping[str, int]] = field(default_factory=dict)
    """Index of the used hypothesis of the file, by object and joint; 0 by default."""
    overrides: Overrides = NO_OVERRIDES
    """Resistance and masses that were set and are not in the file."""

    def __repr__(self) -> str:
        floor = (
            "no floor"
            if self.floor_polygon is None
            else f"a floor of {len(self.floor_polygon)} corners"
        )
        return f"<Scene {self.name!r}: {len(self.objects)} objects, {floor}, {self.path}>"

    def _repr_png_(self) -> bytes:
        # Import by name, because drawing depends on records.
        png: bytes = import_module("momapos.apps.plots.notebook_images").scene_png(self)
        return png

    def object(self, name: str) -> SceneObject:
        """Return an object by name; for "", as in a task of the robot alone, one without shapes.

        Raises:
            UnknownNameError: The object does not exist; the message suggests similar names.
        """
        item = self._by_name.get(name, None if name else NOTHING)
        if item is None:
            raise unknown_name("object", name, [o.name for o in self.objects], f"scene {self.name}")
        return item

    @cached_property
    def _by_name(self) -> dict[str, SceneObject]:
        """The objects by name; of equal names the first one counts."""
        return {item.name: item for item in reversed(self.objects)}

    def is_assumed(self, name: str, joint: str | None) -> bool:
        """Check whether a plan for a joint is an assumption.

        It is if the joint's motion is improbable, or if any joint of the scene moves by another
        hypothesis than its most probable one.

        Args:
            name: Object of the task.
            joint: Its joint; None for a rigid object.
        """
        others = [index for taken in self.hypotheses_set.values() for index in taken.values()]
        ways = () if joint is None else self.object(name).hypotheses.get(joint, ())
        return any(others) or not all(way.is_probable for way in ways[:1])

    @property
    def walls(self) -> tuple[Wall, ...]:
        """Return the walls of the room; boxes that only look like walls are none."""
        return tuple(item.wall for item in self.objects if item.wall is not None)

    @cached_property
    def furniture(self) -> Scene:
        """The scene without its walls."""
        others = tuple(item for item in self.objects if item.wall is None)
        return self if len(others) == len(self.objects) else replace(self, objects=others)

    def with_walls(self, walls: Sequence[Wall] | None = None) -> Scene:
        """Return the scene with other walls, as the last objects `wall_1`, `wall_2` and so on.

        Args:
            walls: The walls; by default those along all edges of the floor.

        Raises:
            SceneError: There is no floor to follow, or another object has the name of a wall.
        """
        if walls is None:
            if self.floor_polygon is None:
                raise SceneError(f"{self.path or self.name}: no floor polygon for walls to follow")
            walls = walls_around(self.floor_polygon)
        others = self.furniture.objects
        solid = tuple(SceneObject.of_wall(wall_name(k), one) for k, one in enumerate(walls))
        taken = sorted({item.name for item in others} & {item.name for item in solid})
        if taken:
            raise SceneError(
                f"{self.path or self.name}: object {taken[0]!r} has the name of one of the walls; "
                "rename it"
            )
        return replace(self, objects=others + solid)

    def with_box_proxies(self, keep: Collection[str]) -> Scene:
        """Return the room with all objects as boxes except the named ones.

        Boxes enclose their objects, so free space in it is free in the room, too.
        """
        objects = tuple(item if item.name in keep else item.box_proxy for item in self.objects)
        changed = any(one is not item for one, item in zip(objects, self.objects, strict=True))
        return replace(self, objects=objects) if changed else self

    def without(self, name: str) -> Scene:
        """Return the scene without an object."""
        return replace(self, objects=tuple(item for item in self.objects if item.name != name))

    def with_joint(self, name: str, joint: str, value: float) -> Scene:
        """Return the scene with one joint of one object at another value.

        What rests on the part moves along.

        Raises:
            UnknownNameError: The object or joint does not exist.
            SceneError: The joint is a mimic joint.
        """
        target = self.object(name)
        mimic = target.joint(joint).mimic
        if mimic is not None:
            raise SceneError(f"{name}/{joint} follows {mimic.joint}; set {name}/{mimic.joint}")
        value = finite_number(f"value of {name}/{joint}", value)
        moved = {
            item: replace(self.object(item), T_world_object=T)
            for item, T in poses_after(self.objects, target, joint, value).items()
        }
        moved[name] = replace(target, joints={**target.joints, joint: value})
        return replace(
            self,
            objects=tuple(moved.get(item.name, item) for item in self.objects),
            joints_set={**self.joints_set, name: {**self.joints_set.get(name, {}), joint: value}},
        )

    def with_pose(self, name: str, T_world_object: Float[np.ndarray, "4 4"]) -> Scene:
        """Return the scene with an object somewhere else.

        It is not that of the file any more: `save_scene` writes it, so that plans can name it.

        Raises:
            UnknownNameError: There is no such object.
        """
        item = self.object(name)
        moved = replace(item, T_world_object=T_world_object, on=None)
        objects = tuple(moved if one is item else one for one in self.objects)
        return replace(self, objects=objects, path=None, joints_set={})

    @owner_cache(MAX_VARIANTS)
    def with_contents(self, name: str, joint: str) -> Scene:
        """Return the scene with what moves with a joint as links of its object.

        Raises:
            UnknownNameError: The object or joint does not exist.
        """
        objects = with_contents(self.objects, self.object(name), joint)
        return self if len(objects) == len(self.objects) else replace(self, objects=objects)

    def with_resistance(self, known: Mapping[str, Mapping[str, JointResistance]]) -> Scene:
        """Return the scene with other known resistances, by object and joint.

        Raises:
            UnknownNameError: An object or joint does not exist.
        """
        scene = self
        for name, joints in known.items():
            item = scene.object(name)
            for joint in joints:
                item.joint(joint)
            changed = item.with_resistance(tuple(joints.items()))
            objects = tuple(changed if o is item else o for o in scene.objects)
            set_here = {**scene.overrides.resistance.get(name, {}), **joints}
            resistance = {**scene.overrides.resistance, name: set_here}
            overrides = replace(scene.overrides, resistance=resistance)
            scene = replace(scene, objects=objects, overrides=overrides)
        return scene

    def with_mass(self, name: str, mass: float) -> Scene:
        """Return the scene with the known mass [kg] of an object.

        Raises:
            UnknownNameError: There is no such object.
            InputError: The mass is not above 0.
        """
        item = self.object(name)
        mass = finite_number(f"mass of {name!r}", mass, 1e-6, MAX_MASS)
        changed = item.with_mass(mass)
        overrides = replace(self.overrides, mass={**self.overrides.mass, name: mass})
        objects = tuple(changed if o is item else o for o in self.objects)
        return replace(self, objects=objects, overrides=overrides)

    def with_joints(self, values: Mapping[str, Mapping[str, float]]) -> Scene:
        """Return the scene with other joint values, by object and joint.

        Raises:
            UnknownNameError: An object or joint does not exist.
            SceneError: A value is outside its joint's limits.
        """
        scene = self
        for name, joints in values.items():
            for joint, value in joints.items():
                record = scene.object(name).joint(joint)
                if not record.lower - 1e-6 <= value <= record.upper + 1e-6:
                    raise SceneError(
                        f"{name}/{joint}: {value:g} is outside its limits {record.lower:g} to "
                        f"{record.upper:g}"
                    )
                scene = scene.with_joint(name, joint, value)
        return scene


NOTHING: SceneObject = SceneObject.nothing()
"""The object of tasks that move none."""
_MAX_BYTES = 1_000_000


def read_outline(value: Any, where: str) -> Outline:
    """Read the corners of an area.

    Raises:
        SceneError: The outline has too few or too many corners, or encloses no area.
    """

    def place(parents: Parents) -> str:
        return f"{where}{': ' if parents else ''}{dotted(parents)}"

    return checked_outline(read_record(value, Corners, place, SceneError), where)


def checked_outline(corners: Outline, where: str) -> Outline:
    """Return the corners of an area or a floor.

    Raises:
        SceneError: The outline encloses no area.
    """
    if abs(signed_area(np.array(corners))) < 1e-6:
        raise SceneError(f"{where} encloses no area")
    return corners


def area_name(area: Outline, scene: Scene) -> str:
    """Return an area in words: by its name in the scene, or else by where it is."""
    names = [name for name, one in scene.areas.items() if np.array_equal(one, area)]
    x, y = np.mean(area, axis=0).tolist()
    return f"area {names[0]!r}" if names else f"area around ({x:.2f}, {y:.2f})"


def find_area(words: str, scene: Scene, where: str) -> Outline:
    """Find an area by its name in the scene, a JSON file, or its corners.

    Args:
        words: For example "kitchen", "area.json" or "0,0 2,0 2,1".
        scene: The room.
        where: Name of the argument, for messages.

    Raises:
        SceneError: The words are none of these.
    """
    if words in scene.areas:
        return scene.areas[words]
    if words.endswith(".json"):
        text = read_text_bounded(Path(words), _MAX_BYTES, error=SceneError)
        try:
            value = json.loads(text)
        except (ValueError, RecursionError) as error:
            raise SceneError(f"{where} {words}: damaged JSON ({error})") from error
        return read_outline(value, f"{where} {words}")
    pairs = [pair.split(",") for pair in words.split()]
    try:
        corners = [[float(v) for v in pair] for pair in pairs]
    except ValueError:
        if scene.areas:
            raise unknown_name("area", words, scene.areas, f"scene {scene.name}") from None
        raise SceneError(
            f"{where} {words!r}: the scene names no areas; give the corners, such as "
            '"0,0 2,0 2,1", or a JSON file with corners'
        ) from None
    return read_outline(corners, f"{where} {words!r}")


def joint_value(joint: Joint, quantity: Quantity, what: str) -> float:
    """Return a quantity as a joint value [rad] or [m].

    Args:
        joint: The joint.
        quantity: The quantity.
        what: Name of the argument, for messages.

    Raises:
        TaskError: The unit does not fit the kind of joint.
    """
    return quantity.length(what) if joint.kind == "prismatic" else quantity.angle(what)


def set_joints(scene: Scene, words: Sequence[str]) -> Scene:
    """Return the scene with other joint values.

    Args:
        scene: The room.
        words: For example "fridge/door_hinge=60deg".

    Raises:
        SceneError: The syntax is wrong, or a value is outside the joint's limits.
        TaskError: A value has the wrong unit.
        UnknownNameError: An object or joint does not exist.
    """
    for text in words:
        target, found, value = text.partition("=")
        name, _, joint = target.partition("/")
        if not (found and joint):
            raise SceneError(f"joint {text!r} is not OBJECT/JOINT=VALUE, like fridge/door=60deg")
        record = scene.object(name).joint(joint)
        number = joint_value(record, parse_quantity(value), f"joint {target}:")
        if not math.isfinite(number):
            raise SceneError(f"joint {target}: {value} must be finite")
        scene = scene.with_joints({name: {joint: number}})
    return scene
