"""Suites: the same tasks from the same seed, each of them one that can be asked."""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable
from itertools import combinations
from pathlib import Path

import numpy as np
import pytest
from tests import optional
from tests.real import DATA

from momapos.apps.bench import laboratory, suites
from momapos.apps.bench.bench_records import Container, SuiteTask
from momapos.apps.bench.containers import opened, without
from momapos.apps.bench.dining_rooms import PLACES, THINGS, Room, make_room
from momapos.apps.bench.laboratory import TASKS, laboratory_tasks, shared_data
from momapos.apps.bench.suites import (
    SMOKE_TASKS,
    SUITES,
    _tasks_of_room,
    can_be_picked,
    kitchen_tasks,
    spread,
)
from momapos.core.errors import FileFormatError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene, SceneObject
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names
from momapos.planning.grasps.tasks import make_task, openable
from momapos.verification.exact_check import PlanVerifier


def test_the_kitchens_tasks_are_all_doors_and_drawers_and_what_fits_the_hand(
    robots: Callable[[str], Robot], monkeypatch: pytest.MonkeyPatch
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
        assert all(can_be_picked(scene, robots("segway_ur5e"), name) for name in picks)
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


def test_tasks_are_spread_over_groups_as_evenly_as_these_allow() -> None:
    groups = {
        name: [SuiteTask(f"{name} {k}", name, "", "", "open", "x") for k in range(count)]
        for name, count in (("many", 90), ("few", 4), ("some", 30))
    }
    chosen = Counter(task.group for task in spread(groups, 50))
    assert chosen == {"few": 4, "some": 23, "many": 23}
    assert len({task.name for task in spread(groups, 50)}) == 50
    assert len(spread(groups, 1000)) == 124


@pytest.fixture(scope="module")
def drawn(tmp_path_factory: pytest.TempPathFactory) -> Room:
    """A room with all that the suite asks for."""
    out = tmp_path_factory.mktemp("room") / "room.json"
    return make_room("single_wall", np.random.default_rng([0, 0]), out)


def boxes_overlap(one: SceneObject, other: SceneObject) -> bool:
    """Whether the boxes around two things overlap, by more than a millimeter each way."""
    low = np.maximum(one.bounds[0], other.bounds[0])
    high = np.minimum(one.bounds[1], other.bounds[1])
    return bool((high - low > 1e-3).all())


def test_a_room_has_things_in_every_place_and_none_in_another(
    drawn: Room, robots: Callable[[str], Robot]
) -> None:
    scene = load_scene(drawn.file)
    assert set(Counter(thing.place for thing in drawn.things)) == set(PLACES)
    things = [scene.object(thing.name) for thing in drawn.things]
    for one, other in combinations(things, 2):
        assert not boxes_overlap(one, other), (one, other)
    for thing in things:  # by the exact check, which knows the furniture's shapes
        task = make_task(scene, "pick", thing.name)
        assert PlanVerifier(scene, robots("segway_ur5e"), task).blocked(0.0) is None


def test_things_stand_inside_what_they_are_said_to_be_in(drawn: Room) -> None:
    scene = load_scene(drawn.file)
    for thing in drawn.things:
        low, high = scene.object(thing.name).bounds
        kind = thing.name.rpartition("_")[0]
        assert sorted(THINGS[kind])[2] >= high[2] - low[2] - 1e-9
        if thing.inside is not None:
            around = scene.object(thing.inside.object).bounds
            assert (around[0] < low).all()
            assert (high < around[1]).all()


def test_what_is_in_a_drawer_moves_with_it_and_all_else_stays(drawn: Room) -> None:
    scene = load_scene(drawn.file)
    in_drawer = [thing for thing in drawn.things if thing.place == "in drawer"]
    box = in_drawer[0].inside
    assert box is not None
    carried = drawn.carried(box)
    assert in_drawer[0].name in carried
    after = opened(scene, box, 0.2, carried)
    for before, now in zip(scene.objects, after.objects, strict=True):
        way = np.linalg.norm((now.T_world_object - before.T_world_object)[:3, 3])
        assert way == pytest.approx(0.2 if before.name in carried else 0.0)
    assert _touching(after, box, carried) == _touching(scene, box, carried)
    assert {item.name for item in without(scene, carried).objects} == (
        {item.name for item in scene.objects} - set(carried)
    )


def _touching(scene: Scene, box: Container, carried: tuple[str, ...]) -> dict[str, np.ndarray]:
    """Where things are in the frame of the drawer, to 0.1 mm."""
    holder = scene.object(box.object)
    T = np.linalg.inv(holder.link_poses()[holder.model.joint(box.joint).child])
    places = {name: (T @ scene.object(name).T_world_object)[:3, 3] for name in carried}
    return {name: tuple(np.round(place, 4)) for name, place in places.items()}  # type: ignore[misc]


def test_every_task_of_a_room_can_be_asked(drawn: Room) -> None:
    scene = load_scene(drawn.file)
    tasks = list(_tasks_of_room(drawn, "room.json", "00"))
    assert {task.group for task in tasks} == {
        *PLACES, "open fridge", "open drawer", "open dishwasher"
    }  # fmt: skip
    for task in tasks:
        room = scene.with_joints(task.joints)
        if task.inside is not None:
            make_task(room, "open", task.inside.object, task.inside.joint)
        make_task(room, task.verb, task.object, task.joint, task.to)
        assert {item.name for item in room.objects} >= set(task.carried)


def test_the_same_seed_draws_the_same_room(drawn: Room, tmp_path: Path) -> None:
    again = make_room("single_wall", np.random.default_rng([0, 0]), tmp_path / "room.json")
    assert (again.things, again.openings) == (drawn.things, drawn.openings)
    assert again.file.read_bytes() == drawn.file.read_bytes()


def test_trials_differ_by_where_the_table_is_and_nothing_overlaps(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    optional.there(DATA / laboratory.ROOM)
    monkeypatch.setenv(laboratory.SHARED, str(DATA))
    monkeypatch.setattr(laboratory, "TRIALS", 2)
    tasks = laboratory_tasks(0, ["ranger_rm63"], tmp_path)
    assert Counter(task.group for task in tasks) == dict.fromkeys(TASKS, 2)
    rooms = [load_scene(tmp_path / name) for name in dict.fromkeys(task.scene for task in tasks)]
    tables = [room.object(laboratory.TABLE).T_world_object for room in rooms]
    assert np.abs(tables[0] - tables[1]).max() > 0.01
    for task in tasks:
        make_task(load_scene(tmp_path / task.scene), task.verb, task.object, task.joint)


def test_without_the_authors_data_the_message_says_where_they_were_looked_for(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(laboratory.SHARED, str(tmp_path / "nowhere"))
    with pytest.raises(FileFormatError, match=r"looked for .*nowhere/data.* and .*MOMAPOS_SHARED"):
        shared_data()
