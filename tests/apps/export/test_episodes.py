"""Laws of runs as episodes: LeRobot's and robomimic's files hold the motion of the records."""

from __future__ import annotations

import io
import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import optional
from tests.rooms import Everywhere

from momapos.apps.cli.main import main
from momapos.apps.export.episodes import BASE, RATE, instruction_of
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.records.plans import PlacementPlan, Task
from momapos.model.robots.robot import load_robot
from momapos.model.scene.scene import Scene
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig
from momapos.simulation.run_record import RunMotion, RunRecord, Visit, with_files, write_run

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1))
STAGES = ("drive", "drive", "drive", "approach", "grip", "manipulate", "manipulate")
DOOR = (0.0, 0.0, 0.0, 0.0, 0.0, 0.2, 0.4)
SIZE = (32, 24)


@pytest.fixture(scope="module")
def plans(kitchen: Scene) -> dict[str, PlacementPlan]:
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    return {
        name: plan_base_placement(
            kitchen, load_robot(name), task, Everywhere(), config=CONFIG
        ).plan
        for name in ("segway_ur5e", "fetch")
    }  # fmt: skip


def write(plan: PlacementPlan, folder: Path, name: str, shift: float = 0.0) -> RunRecord:
    """Write the record of a run of 0.6 s that opens the fridge, and its plan."""
    folder.mkdir(parents=True, exist_ok=True)
    write_plan(plan, folder / f"{name}.plan.json")
    count = len(STAGES)
    joints = {name: tuple(0.05 * k + shift for k in range(count)) for name in plan.joints}
    bases = tuple((0.1 * k, shift, 0.0) for k in (0, 1, 2, 2, 2, 2, 2))
    times = tuple(0.1 * k for k in range(count))
    motion = RunMotion(times, STAGES, bases, joints, DOOR)
    visit = Visit(bases[-1], bases[-1], 0.2, 0.2, "")
    record = RunRecord("kitchen_small", plan.robot_name, plan.task, (visit,), None, motion=motion)
    path = folder / f"{name}.json"
    write_run(with_files(record, path, folder / f"{name}.plan.json"), path)
    return record


@pytest.fixture
def runs(plans: dict[str, PlacementPlan], tmp_path: Path) -> Path:
    """Return a folder with two records, their plans, and another file."""
    folder = tmp_path / "runs"
    for k, name in enumerate("ab"):
        write(plans["segway_ur5e"], folder, name, 0.01 * k)
    (folder / "notes.json").write_text("{}")
    return folder


def export(source: Path, to: str, out: Path, *more: str) -> int:
    return main(["export", str(source), "--to", to, "--out", str(out), *more])


def table(path: Path) -> dict[str, list[Any]]:
    """Return a Parquet file as columns."""
    parquet = optional.module("pyarrow.parquet")
    columns: dict[str, list[Any]] = parquet.read_table(path).to_pydict()
    return columns


def test_a_lerobot_set_holds_states_actions_and_indices(
    runs: Path, plans: dict[str, PlacementPlan], tmp_path: Path
) -> None:
    optional.module("pyarrow")
    out, joints = tmp_path / "set", list(plans["segway_ur5e"].joints)
    assert export(runs, "lerobot", out, "--image-size", "32x24") == 0
    info = json.loads((out / "meta" / "info.json").read_text())
    assert (info["codebase_version"], info["robot_type"]) == ("v3.0", "segway_ur5e")
    assert (info["total_episodes"], info["total_frames"], info["fps"]) == (2, 14, RATE)
    names = info["features"]["observation.state"]["names"]
    assert names == [*joints, *BASE, "gripper"]
    for number in range(2):
        file = info["data_path"].format(chunk_index=0, file_index=number)
        rows = table(out / file)
        assert set(rows) == set(info["features"])
        state = np.array(rows["observation.state"])
        np.testing.assert_allclose(state[:, 0], 0.05 * np.arange(7) + 0.01 * number, atol=1e-6)
        np.testing.assert_allclose(
            state[:, len(joints)], [0, 0.1, 0.2, 0.2, 0.2, 0.2, 0.2], atol=1e-6
        )
        assert state[:, -1].tolist() == [0, 0, 0, 0, 1, 1, 1]
        np.testing.assert_array_equal(rows["action"], [*state[1:], state[-1]])
        np.testing.assert_allclose(np.array(rows["observation.part"])[:, 0], DOOR, atol=1e-6)
        assert rows["index"] == list(range(7 * number, 7 * number + 7))
        assert rows["frame_index"] == list(range(7))
        assert rows["episode_index"] == [number] * 7
        np.testing.assert_allclose(rows["timestamp"], np.arange(7) / RATE, atol=1e-6)
    episodes = table(out / "meta" / "episodes" / "chunk-000" / "file-000.parquet")
    assert episodes["dataset_from_index"] == [0, 7]
    assert episodes["dataset_to_index"] == [7, 14]
    assert episodes["tasks"] == [["open the fridge by its door hinge"]] * 2
    assert table(out / "meta" / "tasks.parquet")["task"] == ["open the fridge by its door hinge"]


def test_images_show_the_room_and_what_moves(runs: Path, tmp_path: Path) -> None:
    optional.module("pyarrow")
    from PIL import Image

    assert export(runs / "a.json", "lerobot", tmp_path / "set", "--image-size", "32x24") == 0
    rows = table(tmp_path / "set" / "data" / "chunk-000" / "file-000.parquet")
    for camera in ("room", "hand"):
        images = [
            np.asarray(Image.open(io.BytesIO(one["bytes"])))
            for one in rows[f"observation.images.{camera}"]
        ]
        assert {image.shape for image in images} == {(24, 32, 3)}
        assert all(image.std() > 1.0 for image in images)
        assert any((images[0] != image).any() for image in images[1:])
    stats = json.loads((tmp_path / "set" / "meta" / "stats.json").read_text())
    mean = np.array(stats["observation.images.room"]["mean"])
    assert mean.shape == (3, 1, 1)
    assert ((mean > 0) & (mean < 1)).all()
    state = np.array(rows["observation.state"])
    np.testing.assert_allclose(stats["observation.state"]["std"], state.std(0), atol=1e-5)
    np.testing.assert_allclose(stats["observation.state"]["max"], state.max(0), atol=1e-6)


def test_an_hdf5_file_has_the_layout_of_robomimic(
    runs: Path, plans: dict[str, PlacementPlan], tmp_path: Path
) -> None:
    h5py = optional.module("h5py")
    out, joints = tmp_path / "set.hdf5", len(plans["segway_ur5e"].joints)
    assert export(runs, "hdf5", out, "--image-size", "32x24", "--cameras", "room") == 0
    with h5py.File(out) as file:
        data = file["data"]
        assert sorted(data) == ["demo_0", "demo_1"]
        assert data.attrs["total"] == 14
        assert json.loads(data.attrs["env_args"])["env_kwargs"]["robots"] == "segway_ur5e"
        assert [name.decode() for name in file["mask/train"]] == ["demo_0", "demo_1"]
        demo = data["demo_0"]
        assert demo.attrs["num_samples"] == 7
        assert demo.attrs["language_instruction"] == "open the fridge by its door hinge"
        assert demo["actions"].shape == (7, joints + 4)
        assert demo["states"].shape == (7, joints + 4 + 8)
        assert demo["obs/robot0_joint_pos"].shape == (7, joints)
        assert demo["obs/room_image"].shape == (7, 24, 32, 3)
        assert "hand_image" not in demo["obs"]
        assert demo["dones"][:].tolist() == [0] * 6 + [1]
        for key in demo["obs"]:
            now, then = demo["obs"][key][:], demo["next_obs"][key][:]
            np.testing.assert_array_equal(then[:-1], now[1:])
            np.testing.assert_array_equal(then[-1], now[-1])


def test_a_set_without_cameras_has_no_images(runs: Path, tmp_path: Path) -> None:
    optional.module("pyarrow")
    assert export(runs, "lerobot", tmp_path / "set", "--cameras", "none") == 0
    info = json.loads((tmp_path / "set" / "meta" / "info.json").read_text())
    assert not [name for name in info["features"] if "images" in name]


@pytest.mark.parametrize(
    ("more", "words"),
    [
        (["--cameras", "roof"], "--cameras must name some of room, hand"),
        (["--image-size", "0x10"], "--image-size must be WIDTHxHEIGHT"),
        (["--image-size", "99999x10"], "--image-size must be WIDTHxHEIGHT"),
    ],
)
def test_wrong_options_are_refused_and_nothing_is_written(
    runs: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str], more: list[str], words: str
) -> None:
    assert export(runs, "lerobot", tmp_path / "set", *more) == 2
    assert words in capsys.readouterr().err
    assert not (tmp_path / "set").exists()


def test_unusable_sources_are_refused_and_leave_nothing(
    runs: Path, plans: dict[str, PlacementPlan], tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    optional.module("pyarrow")
    out, empty = tmp_path / "set", tmp_path / "empty"
    empty.mkdir()
    assert export(empty, "lerobot", out) == 2
    assert "needs 1 to" in capsys.readouterr().err
    assert export(runs / "a.plan.json", "lerobot", out) == 2
    assert capsys.readouterr().err.count("\n") == 1
    write(plans["fetch"], runs, "c")
    assert export(runs, "lerobot", out, "--cameras", "none") == 2
    assert "a set holds the runs of one robot" in capsys.readouterr().err
    (runs / "c.json").unlink()
    out.mkdir()
    assert export(runs, "lerobot", out) == 2
    assert "exists already" in capsys.readouterr().err
    assert sorted(path.name for path in tmp_path.iterdir()) == ["empty", "runs", "set"]
    assert not list(out.iterdir())


def test_instructions_name_the_task() -> None:
    assert instruction_of(Task("close", "cabinet_left", "door_hinge", 0.0)) == (
        "close the cabinet left by its door hinge"
    )
    assert instruction_of(Task("pick", "apple")) == "pick up the apple"
    assert instruction_of(Task("place", "cup")) == "put down the cup"


def test_the_published_reader_loads_a_set(runs: Path, tmp_path: Path) -> None:
    optional.module("lerobot")
    assert export(runs, "lerobot", tmp_path / "set", "--image-size", "32x24") == 0
    page = Path(__file__).parents[3] / "docs" / "howto" / "learning.md"
    code = page.read_text().partition("```python\n")[2].partition("```")[0]
    done = subprocess.run(
        [sys.executable, "-c", code, str(tmp_path / "set")], capture_output=True, text=True,
        check=True,
    )  # fmt: skip
    assert "2 episodes, 14 frames" in done.stdout


def test_a_record_without_motion_is_refused_by_its_name(
    plans: dict[str, PlacementPlan], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    optional.module("h5py")
    record = write(plans["segway_ur5e"], tmp_path, "a")
    bare = replace(with_files(record, tmp_path / "a.json", tmp_path / "a.plan.json"), motion=None)
    write_run(bare, tmp_path / "a.json")
    assert export(tmp_path / "a.json", "hdf5", tmp_path / "set.hdf5") == 2
    assert "a.json" in capsys.readouterr().err


@pytest.mark.parametrize("stages", [("drive",), ("drive", "drive", "drive")])
def test_runs_that_end_before_the_arm_moves_are_left_out(
    runs: Path, plans: dict[str, PlacementPlan], tmp_path: Path,
    capsys: pytest.CaptureFixture[str], stages: tuple[str, ...],
) -> None:  # fmt: skip
    """Such as those of a robot that stands off its base pose and finds no motion there."""
    h5py, count = optional.module("h5py"), len(stages)
    record = write(plans["segway_ur5e"], runs, "0")
    drive = RunMotion(tuple(0.1 * k for k in range(count)), stages, ((0.0, 0.0, 0.0),) * count)
    ended = with_files(record, runs / "0.json", runs / "0.plan.json")
    write_run(replace(ended, motion=drive), runs / "0.json")
    assert export(runs, "hdf5", tmp_path / "set.hdf5", "--cameras", "none") == 0
    assert "1 of 3 runs ended before the arm moved" in capsys.readouterr().err
    with h5py.File(tmp_path / "set.hdf5") as file:
        assert sorted(file["data"]) == ["demo_0", "demo_1"]
    assert export(runs / "0.json", "hdf5", tmp_path / "one.hdf5", "--cameras", "none") == 2
    assert "no run came so far that the arm moved" in capsys.readouterr().err
    assert not (tmp_path / "one.hdf5").exists()
