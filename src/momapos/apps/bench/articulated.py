"""Build the suite `articulated`: real articulated objects, each alone in a small room.

The first tasks are AutoMoMa's: their objects at their scale, opened to their goal angles. The
others are the doors and drawers of further objects of the same collection, PartNet-Mobility, at
their usual size, each opened to four values.
"""

from __future__ import annotations

import hashlib
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from momapos.core import InputError
from momapos.core.geometry import pose_planar
from momapos.model.scene import Scene, SceneObject, copied, save_scene
from momapos.model.urdf import Articulated, Joint
from momapos.planning.grasps import make_task, opening_direction

from .bench_records import SuiteTask

MODEL = "mobility.urdf"
"""The URDF of an object of PartNet-Mobility, in a folder KIND/NUMBER or NUMBER."""
MAX_OBJECTS = 500
SETS = ("development", "test")
SHARES = (0.4, 0.6, 0.8, 1.0)
"""Goals of a door or drawer, as shares of the usual opening [-]."""
MIN_SIZE, MIN_TRAVEL = 0.2, 0.1
"""Minimum size and travel of a door or drawer; smaller ones are knobs [m], [m] or [rad]."""
MARGIN = 0.05
"""Gap between an object's box and the wall [m]."""
PLINTH = 0.1
"""Height of the plinth below an appliance [m]."""
COUNTER = 0.9
"""Height of the counter on which small objects stand [m]."""


@dataclass(frozen=True)
class Usual:
    """Usual size and height above the floor of a kind of furniture."""

    height: float
    """[m]"""
    above: float
    """Height of its lower side above the floor [m]."""
    counter: bool = False
    """Whether it stands on a counter."""
    front: tuple[float, float] | None = None
    """Direction of its front in its own frame; None to derive it from the opening parts."""


USUAL = {
    "Fridge": Usual(1.75, 0.0),
    "MiniFridge": Usual(1.0, 0.0),
    "Dishwasher": Usual(0.85, 0.0),
    "Oven": Usual(0.9, 0.0),
    "Microwave": Usual(0.32, COUNTER, counter=True),
    "CabinetLower": Usual(0.9, 0.0),
    "CabinetTall": Usual(2.0, 0.0),
    "CabinetTop": Usual(0.7, 1.4),
    "CabinetUpper": Usual(0.8, 1.3),
    "CabinetAboeOven": Usual(0.5, 1.4),
    "MiniFridgeBase": Usual(0.8, 0.0),
    "DishwasherBox": Usual(0.85, 0.0),
    "OvenCounter": Usual(0.9, 0.0),
    "KitchenCounter": Usual(0.9, 0.0),
    "SinkBase": Usual(0.9, 0.0),
    "DiningTable": Usual(0.75, 0.0),
    "Drawer": Usual(0.51, 0.0),
    "Fridge_K": Usual(1.46, 0.0),
    "Mic": Usual(0.25, COUNTER, counter=True),
}
"""Usual sizes by the names of the folders in which the objects are published."""


@dataclass(frozen=True)
class GoalAngles:
    """Tasks of AutoMoMa with one object."""

    number: str
    """Of the object in PartNet-Mobility."""
    kind: str
    scale: float
    """[-]"""
    joint: str
    angles: tuple[float, ...]
    """[rad]"""
    above: float = 0.0
    """Height of its lower side above the floor [m]."""
    counter: bool = False
    """Whether it stands on a counter."""


AUTOMOMA = (
    GoalAngles(
        "7221", "microwave", 0.3562990018302636, "joint_0", (1.333, 1.23, 1.074, 0.997), COUNTER,
        counter=True,
    ),
    GoalAngles("11622", "dishwasher", 0.6446, "joint_0", (0.772, 0.699, 0.571, 0.515)),
    GoalAngles("103634", "bin", 0.48385408192053975, "joint_0", (1.241, 0.888, 0.761, 0.685)),
    GoalAngles("46197", "cabinet", 0.5113198146209817, "joint_0", (1.718, 1.376, 0.946, 0.628)),
    # The door reaches below its hinge, so that it needs the usual plinth.
    GoalAngles(
        "101773", "oven", 0.7231779244463762, "joint_0", (1.015, 0.81, 0.697, 0.497), PLINTH
    ),
)  # fmt: skip
"""The tasks of AutoMoMa (arXiv 2604.12565): configs/plan.yaml of github.com/fi6/automoma, commit
d63b38d."""


def set_of(name: str) -> str:
    """Return the set of an object by a hash of its name; the test set is only counted."""
    return SETS[hashlib.sha256(name.encode()).digest()[0] % 2]


def parts(model: Articulated) -> Iterator[Joint]:
    """Yield the doors and drawers of an object."""
    for joint in model.joints.values():
        points = [h.vertices for link in model.moved_by(joint.name) for h in model.hulls[link]]
        size = np.ptp(np.concatenate(points), axis=0).max() if points else 0.0
        if size > MIN_SIZE and MIN_TRAVEL < joint.upper - joint.lower < np.inf:
            yield joint


def lone_room(name: str, item: SceneObject, usual: Usual) -> Scene:
    """Build a room with one object at a wall, its front toward -x.

    Args:
        name: The room's name.
        item: The object, with at least one door or drawer.
        usual: How it stands; its height is not used.
    """
    opens = [opening_direction(item, j.name)[1][:2] for j in parts(item.model)]
    front = np.sum(opens, axis=0) if usual.front is None else np.array(usual.front)
    yaw = np.round((np.pi - np.arctan2(front[1], front[0])) / (np.pi / 2)) * np.pi / 2
    item = replace(item, T_world_object=pose_planar(np.array([0.0, 0.0, yaw])))
    low, high = item.bounds
    T = item.T_world_object.copy()
    T[:3, 3] = [-high[0], -(low[1] + high[1]) / 2, usual.above - low[2]]
    item = replace(item, T_world_object=T)
    low, high = item.bounds
    width = max(3.0, high[1] - low[1] + 1.0)
    others = [SceneObject.box("wall", (0.1, width, 2.6), (0.05 + MARGIN, 0.0, 1.3))]
    if usual.counter:
        size = (high[0] - low[0] + 0.1, 2.0, usual.above - 0.005)
        others.append(SceneObject.box("counter", size, (-size[0] / 2, 0.0, size[2] / 2)))
    y = width / 2
    floor = np.array([[-3.5, -y], [MARGIN, -y], [MARGIN, y], [-3.5, y]])
    return Scene(name, (item, *others), floor_polygon=floor)


def articulated_tasks(
    seed: int, robots: Sequence[str], folder: Path, objects: Path
) -> list[SuiteTask]:
    """Return the tasks with the objects of a folder; write their rooms below another.

    Args:
        seed: Seed of every task.
        robots: Robots of the library.
        folder: Results folder; rooms with copies of the objects go below it.
        objects: Folder that contains the objects at any depth: AutoMoMa's by their number, and
            others in a folder named after a kind of `USUAL`, of which the test set is used.

    Raises:
        InputError: The folder has no such object.
        UrdfError: A URDF is invalid.
    """
    files = _files(objects)
    tasks = [*_automoma_tasks(files, folder), *_test_tasks(files, folder)]
    if not tasks:
        raise InputError(
            f"--problems: {objects} has none of the objects "
            f"{', '.join(one.number for one in AUTOMOMA)} as .../NUMBER/{MODEL}, and no object of "
            f"the test set as .../KIND/NUMBER/{MODEL}"
        )
    return [
        replace(task, name=f"{robot} {task.name}", robot=robot, seed=seed)
        for robot in robots
        for task in tasks
    ]


def _files(objects: Path) -> list[Path]:
    if not objects.is_dir():
        raise InputError(f"--problems: there is no folder {objects}")
    files = sorted(objects.rglob(f"*/{MODEL}"), key=lambda file: file.parts[-3:])
    if len(files) > MAX_OBJECTS:
        raise InputError(
            f"--problems: {objects} has {len(files)} objects, more than {MAX_OBJECTS}; give a "
            "smaller folder"
        )
    return files


def _automoma_tasks(files: Sequence[Path], folder: Path) -> Iterator[SuiteTask]:
    for one in AUTOMOMA:
        file = next((file for file in files if file.parent.name == one.number), None)
        if file is None:
            continue
        usual = Usual(0.0, one.above, counter=one.counter)
        name = _write_room(one.kind, one.number, file, one.scale, usual, folder)[0]
        for angle in one.angles:
            yield SuiteTask(
                f"automoma {one.kind} {one.number} {angle:g}", f"AutoMoMa {one.kind}", name, "",
                "open", one.kind, one.joint, angle,
            )  # fmt: skip


def _test_tasks(files: Sequence[Path], folder: Path) -> Iterator[SuiteTask]:
    first = {file.parts[-3:-1]: file for file in reversed(files)}
    for (kind, number), file in sorted(first.items()):
        usual, known = USUAL.get(kind), number in {one.number for one in AUTOMOMA}
        published = f"Kitchen_models/models/{kind}/{number}"
        if usual is None or known or set_of(published) != "test":
            continue
        item = SceneObject.from_urdf("object", file, (0.0, 0.0, 0.0))
        if not list(parts(item.model)):
            continue
        scale = usual.height / float(np.ptp(item.bounds[:, 2]))
        what = kind.lower()
        name, room = _write_room(what, number, file, scale, usual, folder)
        for joint in parts(room.object(what).model):
            task = make_task(room, "open", what, joint.name)
            assert task.to is not None
            start = room.object(what).values()[joint.name]
            group = "drawer" if joint.kind == "prismatic" else "door or flap"
            for share in SHARES:
                to = round(start + share * (task.to - start), 3)
                label = f"{what} {number} {joint.name} {to:g}"
                yield SuiteTask(label, group, name, "", "open", what, joint.name, to)


def _write_room(
    what: str, number: str, file: Path, scale: float, usual: Usual, folder: Path
) -> tuple[str, Scene]:
    """Write the room of an object; return its name in the suite, and the room."""
    item = SceneObject.from_urdf(what, file, (0.0, 0.0, 0.0), scale=scale, category=what)
    name = f"scenes/{what}_{number}.json"
    out = folder / name
    out.parent.mkdir(parents=True, exist_ok=True)
    with copied(lone_room(f"{what} {number}", item, usual), out) as near:
        return name, save_scene(near, out)
