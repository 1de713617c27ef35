"""Small rooms for tests, and a reach scorer that excludes nothing."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
from jaxtyping import Float

from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.records.plans import JointResistance
from momapos.model.scene.model_copies import copied
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene, save_scene

CABINET = """<robot name="cabinet">
<link name="body">
 {walls}
</link>
<link name="door">
 <collision><origin xyz="{x} -0.011 0"/><geometry><box size="0.56 0.02 0.6"/></geometry></collision>
</link>
<link name="door_handle">
 <collision><geometry><box size="0.016 0.016 0.2"/></geometry></collision>
</link>
<joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
 <origin xyz="{hinge} -0.25 0.8"/><axis xyz="0 0 {sign}"/>
 <limit lower="0" upper="1.9" effort="1" velocity="1"/></joint>
<joint name="grip" type="fixed"><parent link="door"/><child link="door_handle"/>
 <origin xyz="{grip} -0.065 0"/></joint>
</robot>"""
WALL = (
    '<collision><origin xyz="{0} {1} {2}"/>'
    '<geometry><box size="{3} {4} {5}"/></geometry></collision>'
)
WALLS = (
    (0, -0.01, 0.8, 0.6, 0.02, 0.6),
    (-0.29, -0.13, 0.8, 0.02, 0.24, 0.6),
    (0.29, -0.13, 0.8, 0.02, 0.24, 0.6),
    (0, -0.13, 1.09, 0.6, 0.24, 0.02),
    (0, -0.13, 0.51, 0.6, 0.24, 0.02),
)


class Everywhere:
    """A reach scorer that gives every base pose the same score."""

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return score 1 for all."""
        return np.ones((len(bases), len(Ts_world_tool)), np.float32)


def cabinet_room(folder: Path, *, left: bool = False, extra: str = "") -> Scene:
    """Build a cabinet with one door that faces -y, hinged on its right as seen from the front."""
    side = -1.0 if left else 1.0
    walls = "\n ".join(WALL.format(*wall) for wall in WALLS)
    folder.mkdir(parents=True, exist_ok=True)
    (folder / "cabinet.urdf").write_text(
        CABINET.format(walls=walls, x=-0.28 * side, hinge=0.28 * side, sign=side, grip=-0.5 * side)
    )
    (folder / "room.json").write_text(
        '{"format": "momapos-scene", "version": 1, "name": "room",'
        ' "start": {"x": 0, "y": -2.5, "yaw": 1.57},'
        ' "objects": [{"name": "cabinet", "category": "cabinet",'
        ' "pose": {"xyz": [0, 0, 0], "wxyz": [1, 0, 0, 0]}, "urdf": "cabinet.urdf",'
        f' "scale": 1.0, "joints": {{}}}}{extra}]}}'
    )
    return load_scene(folder / "room.json")


def corridor_room(folder: Path, *, end: float = 2.2, extra: str = "") -> Scene:
    """Build the cabinet in a corridor with a dead end on the hinge side, up to x = `end` [m].

    A base of 64 cm does not pass the open door: at 1.2 rad or more it leaves at most 54 cm.
    """
    floor = np.array([[-4.0, -1.3], [end, -1.3], [end, 0.1], [-4.0, 0.1]])
    start = np.array([-2.8, -0.8, 0.0])
    return replace(cabinet_room(folder, extra=extra), floor_polygon=floor, start=start)


def move_scene(scene: Scene, x: float, y: float, yaw: float) -> Scene:
    """Return the scene turned about the world's z, then shifted."""
    R = rotation_about(np.array([0.0, 0.0, 1.0]), yaw)
    T = pose((x, y, 0.0), R)
    objects = tuple(replace(o, T_world_object=T @ o.T_world_object) for o in scene.objects)
    floor = None if scene.floor_polygon is None else scene.floor_polygon @ R[:2, :2].T + [x, y]
    start = scene.start
    if start is not None:
        start = np.array([*(R[:2, :2] @ start[:2] + [x, y]), start[2] + yaw])
    return replace(scene, objects=objects, floor_polygon=floor, start=start)


def without_springs(scene: Scene, name: str, joint: str = "door_hinge") -> Scene:
    """Return a room in which the weight of a drop-down door acts."""
    return scene.with_resistance({name: {joint: JointResistance(balanced=False)}})


def kitchen_without_springs(folder: Path) -> Path:
    """Write `kitchen_small` with a dishwasher whose door falls open; the Fetch cannot let go of it.

    It pulls the door until the floor is in its way, and would otherwise take it from inside.
    """
    path = folder / "kitchen.json"
    with copied(without_springs(load_scene("kitchen_small"), "dishwasher"), path) as near:
        save_scene(near, path)
    return path
