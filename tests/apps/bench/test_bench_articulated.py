"""The suite of articulated objects takes the objects of a folder, at their size, to their goals."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of
from tests.cupboards import BAR, DOOR, SLIDE, carcass, joint, tray

from momapos.apps.bench.articulated import AUTOMOMA, SHARES, articulated_tasks, set_of
from momapos.apps.bench.bench_records import Row, Settings
from momapos.apps.bench.folder import open_folder
from momapos.apps.bench.report_tables import rate_table
from momapos.apps.bench.suites import BASE_USES, SUITES
from momapos.core.errors import InputError
from momapos.model.scene.scene_files import load_scene

HINGE = joint("joint_0", "revolute", ("body", "door"), (-0.262, -0.295, 0.45), (0, 0, 1), (0, 1.6))
OVEN = next(one for one in AUTOMOMA if one.kind == "oven")


def write(folder: Path, kind: str, number: str, *parts: str) -> Path:
    """Write an object as KIND/NUMBER/mobility.urdf."""
    path = folder / kind / number / "mobility.urdf"
    path.parent.mkdir(parents=True)
    path.write_text(f'<robot name="any">{"".join((carcass(), *parts))}</robot>')
    return path


def number_in(wanted: str, kind: str) -> str:
    """Return the first number of an object of a set."""
    names = ((str(k), f"Kitchen_models/models/{kind}/{k}") for k in range(100))
    return next(number for number, name in names if set_of(name) == wanted)


def test_objects_of_automoma_have_their_scale_and_goals(tmp_path: Path) -> None:
    write(tmp_path / "objects", "AnyKind", OVEN.number, HINGE, DOOR)
    write(tmp_path / "objects" / "copies", "Oven", OVEN.number, HINGE, DOOR)
    tasks = articulated_tasks(3, ("tiago", "fetch"), tmp_path / "out", tmp_path / "objects")
    assert [(task.robot, task.to) for task in tasks] == [
        (robot, angle) for robot in ("tiago", "fetch") for angle in OVEN.angles
    ]
    assert {task.group for task in tasks} == {"AutoMoMa oven"}
    assert len({task.name for task in tasks}) == len(tasks)
    assert {task.seed for task in tasks} == {3}
    item = load_scene(tmp_path / "out" / tasks[0].scene).object("oven")
    low, high = item.bounds
    assert high[2] - low[2] == pytest.approx(0.9 * OVEN.scale)
    assert low[2] == pytest.approx(OVEN.above)


@pytest.mark.parametrize(("kind", "height"), [("Oven", 0.9), ("MiniFridge", 1.0)])
def test_doors_and_drawers_of_the_test_set_have_a_usual_size_and_four_goals(
    tmp_path: Path, kind: str, height: float
) -> None:
    write(tmp_path / "objects", kind, number_in("test", kind), HINGE, DOOR, SLIDE, tray(BAR))
    write(tmp_path / "objects", kind, number_in("development", kind), HINGE, DOOR)
    tasks = articulated_tasks(0, ("tiago",), tmp_path / "out", tmp_path / "objects")
    scale = height / 0.9
    by_joint = {name: [t.to for t in tasks if t.joint == name] for name in ("joint_0", "slide")}
    assert by_joint["joint_0"] == pytest.approx([s * np.pi / 2 for s in SHARES], abs=1e-3)
    assert by_joint["slide"] == pytest.approx([s * 0.4 * scale for s in SHARES], abs=1e-3)
    assert len(tasks) == 2 * len(SHARES)
    assert {task.group for task in tasks} == {"door or flap", "drawer"}


def test_fronts_face_the_room_and_small_objects_stand_on_a_counter(tmp_path: Path) -> None:
    microwave = next(one for one in AUTOMOMA if one.counter)
    write(tmp_path / "objects", "Microwave", microwave.number, HINGE, DOOR)
    task = articulated_tasks(0, ("tiago",), tmp_path / "out", tmp_path / "objects")[0]
    scene = load_scene(tmp_path / "out" / task.scene)
    low, high = scene.object("microwave").bounds
    assert low[2] == pytest.approx(0.9)
    assert high[0] == pytest.approx(0.0)  # its back is at the wall, which is toward +x
    assert scene.object("counter").bounds[1][2] < low[2]


def test_a_folder_without_such_objects_is_refused(tmp_path: Path) -> None:
    write(tmp_path / "objects", "Sofa", "1", HINGE, DOOR)
    with pytest.raises(InputError, match="101773"):
        articulated_tasks(0, ("tiago",), tmp_path / "out", tmp_path / "objects")
    with pytest.raises(InputError, match="no folder"):
        articulated_tasks(0, ("tiago",), tmp_path / "out", tmp_path / "none")


def test_a_results_folder_belongs_to_one_folder_of_objects(tmp_path: Path) -> None:
    for folder in ("one", "two"):
        write(tmp_path / folder, "Oven", OVEN.number, HINGE, DOOR)
    out, protocols = tmp_path / "out", SUITES["articulated"].protocols
    given = [
        Settings(protocols=protocols, problems=str(tmp_path / name)) for name in ("one", "two")
    ]
    made = open_folder(out, "articulated", 0, ("tiago",), given[0])
    assert made.suite.methods == BASE_USES
    assert open_folder(out, "articulated", 0, ("tiago",), given[0]) == made
    with pytest.raises(InputError, match="problems"):
        open_folder(out, "articulated", 0, ("tiago",), given[1])


def test_the_rate_counts_the_time_of_failures() -> None:
    rows = [
        Row("a", "t1", "door", "tiago", "ours", 0, "solved", seconds=1.0),
        Row("b", "t2", "door", "tiago", "ours", 0, "infeasible", seconds=2.0),
    ]
    (line,) = rate_table(rows).lines
    assert list(line) == ["ours", "1200"]


@pytest.mark.parametrize(
    ("suite", "options", "words"),
    [
        ("articulated", [], "needs --problems"),
        ("smoke", ["--problems", "."], "--problems is for articulated, motionbenchmaker"),
        ("articulated", ["--problems", ".", "--scan", "3"], "scan"),
    ],
)
def test_wrong_options_are_named(
    suite: str, options: list[str], words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    assert words in error_of("bench", "run", suite, "--out", "out", *options)
