"""Laws of scanned rooms: they are modeled once, and their tasks match the true room."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of

from momapos.apps.bench import job as answer
from momapos.apps.bench.bench_records import Job, Settings, SuiteTask
from momapos.apps.bench.job import NOT_SEEN, ScannedRoom, answer_job, scanned_room
from momapos.core.errors import InputError
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene

pytestmark = pytest.mark.slow
FRAMES = 16
NAME = "kitchen_small"
FRIDGE = SuiteTask("fridge", "door", NAME, "segway_ur5e", "open", "fridge", "door_hinge")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("results")


@pytest.fixture(scope="module")
def room(folder: Path) -> ScannedRoom:
    return scanned_room(folder, NAME, load_scene(NAME), FRAMES, 0)


def test_a_room_is_scanned_once(
    room: ScannedRoom, folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.delattr(answer, "synthetic_scan")
    again = scanned_room(folder, NAME, load_scene(NAME), FRAMES, 0)
    assert again.record == room.record
    assert [path.name for path in (folder / "scans").iterdir()] == [NAME]


def test_an_incomplete_scan_is_not_used(
    room: ScannedRoom, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def full(*_: object, **__: object) -> None:
        raise OSError(28, "No space left on device")

    incomplete = tmp_path / "scans" / NAME
    incomplete.mkdir(parents=True)
    (incomplete / answer.SCENE).write_text("{}")
    monkeypatch.setattr(answer, "_modeled", full)
    with pytest.raises(InputError, match=r"scans/kitchen_small: cannot be written \(No space"):
        scanned_room(tmp_path, NAME, load_scene(NAME), 1, 0)
    assert [path.name for path in (tmp_path / "scans").iterdir()] == [NAME]
    assert not (incomplete / answer.RECORD).exists()
    monkeypatch.setattr(answer, "_modeled", lambda *_: room.record)
    monkeypatch.setattr(answer, "load_scene", lambda *_, **__: room.scene)
    assert scanned_room(tmp_path, NAME, load_scene(NAME), 1, 0).record == room.record


def test_a_task_refers_to_the_object_at_the_same_place_in_the_scan(room: ScannedRoom) -> None:
    opening = room.task("open", "fridge", "door_hinge", 1.0)
    truth, found = room.truth.object("fridge"), room.scene.object(opening.object)
    (low, high), middle = found.bounds, np.mean(truth.bounds, 0)
    assert (low < middle).all()
    assert (middle < high).all()
    value = found.values()[opening.joint]
    assert abs(float(opening.to or 0.0) - value) == pytest.approx(1.0, abs=1e-6)


def test_an_object_that_the_scan_lacks_has_no_task(room: ScannedRoom) -> None:
    bare = replace(room, scene=Scene("bare", ()))
    assert bare.task("open", "fridge", "door_hinge", None) is None
    assert bare.task("pick", "cup", None, None) is None


def test_poses_are_transformed_to_the_scan_and_back(room: ScannedRoom) -> None:
    turned = replace(room, record=replace(room.record, room=(1.0, -2.0, 2.5)))
    pose = np.array([0.3, 0.7, -3.0])
    there = turned.start(pose)
    x, y, yaw = there.tolist()
    assert turned.in_room((x, y, yaw)) == pytest.approx(pose.tolist())
    assert turned.start(None) is None


def test_the_modeling_time_counts_the_modeled_objects(room: ScannedRoom) -> None:
    names = list(room.record.models)
    everything, nothing = room.modeling(None), room.modeling(())
    assert everything == pytest.approx(sum(room.record.models.values()))
    assert (room.modeling(names), nothing) == (everything, 0.0)
    assert room.surveying == pytest.approx(sum(room.record.survey.values()))


def test_a_room_without_walls_is_not_limited_to_the_scanned_floor(
    room: ScannedRoom, folder: Path
) -> None:
    open_room = replace(load_scene(NAME), floor_polygon=None)
    assert scanned_room(folder, NAME, open_room, FRAMES, 0).scene.floor_polygon is None
    assert room.scene.floor_polygon is not None


def test_the_time_of_a_row_from_a_scan_includes_modeling(
    folder: Path, room: ScannedRoom, monkeypatch: pytest.MonkeyPatch
) -> None:
    job = Job("key", str(folder), FRIDGE, "ours", Settings(timeout=10.0, scan=FRAMES))
    row = answer_job(job)
    assert (row.outcome, row.verified) == ("solved", True)
    assert row.seconds == pytest.approx(sum(row.stages.values()), abs=0.05)
    assert row.stages["survey"] == room.surveying > 0.5 * row.seconds
    assert 0.0 < row.stages["modeling"] < row.stages["survey"]
    bare = replace(room, scene=Scene("bare", ()))
    monkeypatch.setattr(answer, "scanned_room", lambda *_: bare)
    unseen = answer_job(job)
    assert (unseen.outcome, unseen.reason) == ("gave up", NOT_SEEN)


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (
            ["paper-sim", "--scan", "60"],
            "a scan can't show the objects in the drawers of paper-sim",
        ),
        (["smoke", "--scan", "-1"], "--scan must be between 0 and 1000, not -1"),
        (["smoke", "--disturbances", "1001"], "--disturbances must be between 0 and 1000"),
    ],
)
def test_wrong_scan_options_are_reported_in_one_line(
    words: list[str], message: str, tmp_path: Path
) -> None:
    assert message in error_of("bench", "run", *words, "--out", str(tmp_path / "out"))
    assert not (tmp_path / "out").exists()
