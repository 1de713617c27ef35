"""Laws of suites: equal seeds give equal tasks, and every task is valid."""

from __future__ import annotations

import shutil
from collections import Counter
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.real import DATA

from momapos.apps.bench import dining_rooms, folder, paper_rooms, suites
from momapos.apps.bench.bench_records import Container, Settings, SuiteTask
from momapos.apps.bench.dining_rooms import (
    ACCEPTED,
    MICROWAVE,
    OBJECT_SIZES,
    PLACES,
    DiningRoom,
    known_room,
    make_room,
    microwave_on,
    room_name,
    room_stream,
    stored_rooms,
)
from momapos.apps.bench.methods import opened, without
from momapos.apps.bench.paper_rooms import (
    LABORATORY_FILE,
    SHARED,
    TASKS,
    authors_data,
    data_lines,
    laboratory_tasks,
)
from momapos.apps.bench.suites import (
    ROOMS,
    SMOKE_TASKS,
    SUITES,
    _tasks_of_room,
    can_be_picked,
    kitchen_tasks,
    spread,
)
from momapos.core.errors import FileFormatError, InputError
from momapos.model.collision.arm_collision import FREE
from momapos.model.collision.base_collision import base_hits
from momapos.model.robots.robot import Robot
from momapos.model.scene.kitchens import LAYOUTS, empty_kitchen
from momapos.model.scene.library.kitchen_writer import (
    Box,
    FurniturePart,
    Piece,
    hits,
    obstacles,
    solid,
)
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names
from momapos.model.scene.scene_object import SceneObject, upright_boxes
from momapos.planning.grasps.task_requests import make_task, openable
from momapos.planning.importance.ranking import rank
from momapos.verification.exact_check import PlanVerifier


def test_kitchen_tasks_are_all_doors_drawers_and_graspable_objects(
    monkeypatch: pytest.MonkeyPatch, segway: Robot
) -> None:
    tasks = kitchen_tasks(["segway_ur5e"], 3)
    assert len({task.name for task in tasks}) == len(tasks)
    for kitchen in builtin_names():
        scene = load_scene(kitchen)
        mine = [task for task in tasks if task.scene == kitchen]
        opens = [(task.object, task.joint) for task in mine if task.verb == "open"]
        assert opens == openable(scene)
        picks = {task.object for task in mine if task.verb == "pick"}
        assert "cup" in picks
        assert not picks & {"table", "counter", "wall_back"}
        assert all(can_be_picked(scene, segway, name) for name in picks)
        for task in mine:
            make_task(scene, task.verb, task.object, task.joint, task.to)
    assert {task.seed for task in tasks} == {3}
    monkeypatch.setattr(suites, "kitchen_tasks", lambda *_: tasks)
    made = {
        name: SUITES[name].build(3, ["segway_ur5e"], Path("unused"))
        for name in ("smoke", "openings", "ablations")
    }
    assert made["openings"] == [task for task in tasks if task.verb == "open"]
    assert made["ablations"] == tasks
    smoke = made["smoke"]
    assert len(smoke) == SMOKE_TASKS
    assert {task.name for task in smoke} <= {task.name for task in tasks}
    assert {task.group for task in smoke} == {"door", "drawer", "pick"}


def test_tasks_are_spread_over_groups_as_evenly_as_possible() -> None:
    groups = {
        name: [SuiteTask(f"{name} {k}", name, "", "", "open", "x") for k in range(count)]
        for name, count in (("many", 90), ("few", 4), ("some", 30))
    }
    chosen = Counter(task.group for task in spread(groups, 50))
    assert chosen == {"few": 4, "some": 23, "many": 23}
    assert len({task.name for task in spread(groups, 50)}) == 50
    assert len(spread(groups, 1000)) == 124


@pytest.fixture(scope="module")
def drawn_files(tmp_path_factory: pytest.TempPathFactory) -> tuple[DiningRoom, Path]:
    out = tmp_path_factory.mktemp("room") / room_name(0)
    return make_room("single_wall", np.random.default_rng([0, 0]), out), out


@pytest.fixture(scope="module")
def drawn(drawn_files: tuple[DiningRoom, Path]) -> DiningRoom:
    return drawn_files[0]


@pytest.fixture(scope="module")
def room_file(drawn_files: tuple[DiningRoom, Path]) -> Path:
    return drawn_files[1]


def boxes_overlap(one: SceneObject, other: SceneObject) -> bool:
    """Check that the upright boxes of two objects overlap."""
    own, others = upright_boxes([one]), upright_boxes([other])
    return bool(base_hits(np.zeros((1, 3)), own, others, clearance=0.0)[0] != FREE)


def test_a_room_has_objects_in_every_place_and_none_overlap(
    drawn: DiningRoom, room_file: Path, segway: Robot
) -> None:
    scene = load_scene(room_file)
    assert set(Counter(item.place for item in drawn.objects)) == set(PLACES)
    items = [scene.object(item.name) for item in drawn.objects]
    for one, other in combinations(items, 2):
        assert not boxes_overlap(one, other), (one, other)
    for item in items:  # the exact check uses the furniture's shapes
        task = make_task(scene, "pick", item.name)
        assert PlanVerifier(scene, segway, task).blocked(0.0) is None


def test_objects_are_inside_their_containers(drawn: DiningRoom, room_file: Path) -> None:
    scene = load_scene(room_file)
    for item in drawn.objects:
        low, high = scene.object(item.name).bounds
        kind = item.name.rpartition("_")[0]
        assert sorted(OBJECT_SIZES[kind])[2] >= high[2] - low[2] - 1e-9
        if item.inside is not None:
            around = scene.object(item.inside.object).bounds
            assert (around[0] < low).all()
            assert (high < around[1]).all()


def test_objects_in_a_drawer_move_with_it_and_no_other_objects_do(
    drawn: DiningRoom, room_file: Path
) -> None:
    scene = load_scene(room_file)
    in_drawer = [item for item in drawn.objects if item.place == "in drawer"]
    box = in_drawer[0].inside
    carried = drawn.carried(box)
    assert in_drawer[0].name in carried
    after = opened(scene, box, 0.2, carried)
    for before, now in zip(scene.objects, after.objects, strict=True):
        distance = np.linalg.norm((now.T_world_object - before.T_world_object)[:3, 3])
        assert distance == pytest.approx(0.2 if before.name in carried else 0.0)
    assert _positions_in(after, box, carried) == _positions_in(scene, box, carried)
    assert {item.name for item in without(scene, carried).objects} == (
        {item.name for item in scene.objects} - set(carried)
    )


def _positions_in(scene: Scene, box: Container, carried: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Return positions in the frame of the drawer, rounded to 0.1 mm."""
    holder = scene.object(box.object)
    T = np.linalg.inv(holder.link_poses()[holder.model.joint(box.joint).child])
    positions = {name: (T @ scene.object(name).T_world_object)[:3, 3] for name in carried}
    return {name: tuple(np.round(position, 4)) for name, position in positions.items()}  # type: ignore[misc]


def test_every_task_of_a_room_is_valid(drawn: DiningRoom, room_file: Path) -> None:
    scene = load_scene(room_file)
    tasks = list(_tasks_of_room(drawn, "room.json", "00"))
    assert {task.group for task in tasks} == {
        *PLACES, "open fridge", "open drawer", "open dishwasher", "open microwave"
    }  # fmt: skip
    for task in tasks:
        room = scene.with_joints(task.joints)
        if task.inside is not None:
            make_task(room, "open", task.inside.object, task.inside.joint)
        make_task(room, task.verb, task.object, task.joint, task.to)
        assert {item.name for item in room.objects} >= set(task.carried)


def test_a_microwave_is_hinged_on_the_left_and_its_door_can_swing(
    room_file: Path, segway: Robot
) -> None:
    scene = load_scene(room_file)
    oven = scene.object(MICROWAVE)
    task = make_task(scene, "open", MICROWAVE)
    assert task.to == pytest.approx(np.pi / 2)
    verifier = PlanVerifier(scene, segway, task)
    assert all(verifier.blocked(value) is None for value in np.linspace(0.0, task.to, 7))
    to_front = oven.T_world_object[:3, :3] @ [0.0, -1.0, 0.0]
    opened_by = scene.with_joint(MICROWAVE, task.joint, 0.3).object(MICROWAVE)
    low, high = oven.bounds
    farther = np.abs(opened_by.bounds - oven.bounds).max(0)
    assert farther @ np.abs(to_front) > 0.1
    axis = oven.T_world_object[:3, :3] @ oven.joint(task.joint).axis
    hinge = oven.link_poses()[oven.model.joint(task.joint).child][:3, 3]
    left = np.cross([0.0, 0.0, 1.0], -to_front)
    assert axis[2] == pytest.approx(-1.0)
    assert (hinge - (low + high) / 2) @ left > 0.2


@pytest.mark.parametrize("yaw", [0.0, -np.pi / 2, 2.0])
def test_a_microwave_fits_no_countertop_without_clearance_for_its_door(yaw: float) -> None:
    wide = Box("top", (-0.5, -0.32, -0.02), (0.5, 0.32, 0.02))
    counter = Piece(
        "countertop", "counter", (1.0, 2.0, 0.88), yaw, (FurniturePart("body", (wide,)),)
    )
    c, s = np.cos(yaw), np.sin(yaw)
    ahead = (1.0 + 0.45 * s, 2.0 - 0.45 * c, 1.0)
    wall = solid("wall", "wall", (2.0, 0.2, 2.0), ahead, yaw)
    rng = np.random.default_rng(0)
    found = microwave_on([(counter, wide)], [counter], rng)
    oven, swing = found
    assert not hits(oven, oven.parts[1], np.linspace(0.0, 1.9, 20), obstacles([counter])).any()
    passed = hits(oven, oven.parts[1], np.linspace(0.2, 1.6, 8), obstacles([swing]))
    assert passed.all()
    assert microwave_on([(counter, wide)], [counter, wall], rng) is None
    assert microwave_on([], [counter], rng) is None


def test_the_same_seed_draws_the_same_room(
    drawn: DiningRoom, room_file: Path, tmp_path: Path
) -> None:
    again = make_room("single_wall", np.random.default_rng([0, 0]), tmp_path / room_file.name)
    assert again == drawn
    assert (tmp_path / room_file.name).read_bytes() == room_file.read_bytes()


def test_the_stored_contents_are_those_of_the_drawn_room(drawn: DiningRoom) -> None:
    """If not: `python -m benchmarks.stored_rooms`."""
    assert stored_rooms(dining_rooms.DEFAULT_SEED)[0] == drawn
    assert not stored_rooms(1)


@pytest.mark.slow
@pytest.mark.parametrize("number", range(1, ROOMS))
def test_all_stored_contents_are_those_of_drawn_rooms(number: int, tmp_path: Path) -> None:
    rng, out = room_stream(dining_rooms.DEFAULT_SEED, number), tmp_path / room_name(number)
    room = make_room(LAYOUTS[number % len(LAYOUTS)], rng, out)
    assert stored_rooms(dining_rooms.DEFAULT_SEED)[number] == room


def test_only_the_rooms_of_the_chosen_tasks_are_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    drawn = []

    def draw(_: int, number: int) -> Path:
        drawn.append(number)
        home = tmp_path / f"room {number}"
        home.mkdir()
        (home / room_name(number)).write_text(str(number))
        return home

    def digest(path: Path) -> str:
        return known_room(0, int(path.read_text())).digest

    monkeypatch.setattr(dining_rooms, "drawn_room", draw)
    monkeypatch.setattr(folder, "scene_digest", digest)
    steps = []
    for limit in (1, 2, 2, None):
        made = folder.open_folder(
            tmp_path / "out", "paper-sim", 0, (), Settings(), limit,
            lambda share, what: steps.append((share, what)),
        )  # fmt: skip
        needed = {task.scene for task in made.suite.limited(limit)}
        assert {f"scenes/{room_name(number)}" for number in drawn} == needed
    assert sorted(drawn) == list(range(ROOMS))
    assert all((tmp_path / "out" / name).exists() for name in made.suite.scenes)
    assert (0.0, "room 1 of 1") in steps
    assert all(task in made.suite.limited(5) for task in made.suite.limited(3))


@pytest.mark.slow
@pytest.mark.parametrize("number", ACCEPTED)
def test_a_stored_random_state_skips_only_kitchens_that_are_rejected(
    number: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Accepted(Exception):
        pass

    def accept(*_: object) -> None:
        raise Accepted

    every = np.random.default_rng([dining_rooms.DEFAULT_SEED, number])
    states = []

    def kitchen(layout: str, seed: int) -> object:
        states.append((seed, every.bit_generator.state))
        return empty_kitchen(layout, seed)

    monkeypatch.setattr(dining_rooms, "with_joint_limits", accept)
    monkeypatch.setattr(dining_rooms, "empty_kitchen", kitchen)
    with pytest.raises(Accepted):
        make_room(LAYOUTS[number % len(LAYOUTS)], every, Path("unused"))
    rng = room_stream(dining_rooms.DEFAULT_SEED, number)
    assert states.index((int(rng.integers(2**31)), rng.bit_generator.state)) == len(states) - 1 > 0


def test_a_room_is_drawn_once_and_a_failed_drawing_leaves_nothing(
    drawn: DiningRoom, room_file: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path / "cache"))
    calls = []

    def draw(layout: str, rng: np.random.Generator, out: Path) -> DiningRoom:
        calls.append((layout, rng.bit_generator.state["state"]["state"]))
        if len(calls) == 1:
            out.parent.mkdir()
            out.write_text("half")
            raise KeyboardInterrupt
        shutil.copytree(room_file.parent, out.parent)
        (out.parent / room_file.name).rename(out)
        return drawn

    monkeypatch.setattr(dining_rooms, "make_room", draw)
    with pytest.raises(KeyboardInterrupt):
        dining_rooms.drawn_room(1, 3)
    assert not list((tmp_path / "cache" / "rooms").iterdir())
    for name in "ab":
        dining_rooms.copy_room(1, 3, tmp_path / name)
        assert {path.name for path in (tmp_path / name).iterdir()} == {"room_00_urdf", room_name(3)}
        objects = {item.name for item in load_scene(tmp_path / name / room_name(3)).objects}
        assert objects >= {item.name for item in drawn.objects}
    assert len(calls) == 2
    assert calls[0] == calls[1]
    assert known_room(1, 3) == drawn
    dining_rooms.copy_room(2, 3, tmp_path / "c")
    assert len(calls) == 3  # another seed is another room


def test_trials_differ_in_the_pose_of_the_table(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    optional.there(DATA / "bestman" / LABORATORY_FILE)
    monkeypatch.setenv(SHARED, str(DATA))
    monkeypatch.setattr(paper_rooms, "LABORATORY_TRIALS", 2)
    tasks = laboratory_tasks(0, ["ranger_rm63"], tmp_path)
    assert Counter(task.group for task in tasks) == dict.fromkeys(TASKS, 2)
    rooms = [load_scene(tmp_path / name) for name in dict.fromkeys(task.scene for task in tasks)]
    tables = [room.object(paper_rooms.TABLE).T_world_object for room in rooms]
    assert np.abs(tables[0] - tables[1]).max() > 0.01
    for task in tasks:
        make_task(load_scene(tmp_path / task.scene), task.verb, task.object, task.joint)


def test_without_the_authors_data_the_message_states_the_searched_paths(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SHARED, str(tmp_path / "nowhere"))
    where = r"no .*nowhere/data/bestman/Asset.*b512.json, .*/B512; 'momapos bench data paper-real'"
    with pytest.raises(FileFormatError, match=where):
        authors_data("paper-real")
    lines, complete = data_lines("paper")
    assert not complete
    assert sum(line.endswith("missing") for line in lines) == 9


def test_the_authors_data_are_found_in_a_clone_of_their_repository(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(SHARED, str(tmp_path))
    clone = tmp_path / "bestman"
    (clone / LABORATORY_FILE).parent.mkdir(parents=True)
    (clone / LABORATORY_FILE).write_text("[]")
    with pytest.raises(FileFormatError, match=f"there is no {clone}/Asset/Scene/URDF_models/B512;"):
        authors_data("paper-real")  # a clone without its submodule
    assert not data_lines("paper-real")[1]
    (clone / "Asset/Scene/URDF_models/B512").mkdir(parents=True)
    assert authors_data("paper-real") == clone
    assert data_lines("paper-real")[1]
    with pytest.raises(InputError, match="no data belong to 'smoke'; choose from paper, "):
        data_lines("smoke")


def test_the_authors_bowl_stands_at_each_place_and_what_they_open_is_open(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    optional.there(DATA / "bestman" / "Asset/Scene/Kitchen_models")
    monkeypatch.setenv(SHARED, str(DATA))
    tasks = paper_rooms.simulation_tasks(0, ["segway_ur5e"], tmp_path)
    assert Counter(task.group for task in tasks) == dict.fromkeys(
        paper_rooms.PLACES, paper_rooms.KITCHEN_TRIALS
    )
    for name, place in paper_rooms.PLACES.items():
        scene = load_scene(tmp_path / next(t.scene for t in tasks if t.group == name))
        kept = {item.name for item in scene.objects}
        assert kept >= {*place.kept, paper_rooms.BOWL}
        for item, joint, value in place.opened:
            assert scene.object(item).values()[joint] == pytest.approx(value)
        ranked = rank(scene, paper_rooms.BOWL)
        related = {"near"} if name == "in dishwasher" else {"carries", "contains"}  # a steep tray
        assert related & set(ranked.relations), name
