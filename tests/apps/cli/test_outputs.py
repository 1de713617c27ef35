"""Unwritable outputs and out-of-range options are refused before the work."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.core.errors import InputError

COMMANDS = {
    "place --out": ["place", "open", "kitchen_small", "fridge/door_hinge", "--out", "{}"],
    "place --plot": ["place", "open", "kitchen_small", "fridge/door_hinge", "--plot", "{}"],
    "run --out": ["run", "plan.json", "--out", "{}"],
    "run --record": ["run", "plan.json", "--record", "{}"],
    "rank --plot": ["rank", "kitchen_small", "fridge", "--plot", "{}"],
    "scene show --plot": ["scene", "show", "kitchen_small", "--plot", "{}"],
    "scene new --out": ["scene", "new", "galley", "--out", "{}"],
    "scene convert OUT": ["scene", "convert", "kitchen_small", "{}", "--copy"],
    "robot check --out": ["robot", "check", "r.urdf", "--out", "{}"],
    "robot check --plot": ["robot", "check", "r.toml", "--plot", "{}"],
    "reach build --out": ["reach", "build", "fetch", "--out", "{}"],
    "scan --out": ["scan", "scans", "--out", "{}"],
}
FOLDERS = {
    "reach build --cache": ["reach", "build", "fetch", "--cache", "{}"],
    "reach eval --cache": ["reach", "eval", "fetch", "--cache", "{}"],
    "robot export DIR": ["robot", "export", "fetch", "{}"],
    "scene scan --out": ["scene", "scan", "kitchen_small", "--out", "{}"],
}


def refused(args: list[str], where: Path, *words: str) -> None:
    before = sorted(where.rglob("*"))
    error = error_of(*args)
    assert [word for word in words if word not in error] == []
    assert sorted(where.rglob("*")) == before


@pytest.mark.parametrize("command", COMMANDS)
def test_an_output_file_is_not_written_over_a_folder_or_below_a_file(
    command: str, tmp_path: Path
) -> None:
    (tmp_path / "file").write_text("")
    for place, word in ((tmp_path, "is a folder"), (tmp_path / "file" / "x", "is not a folder")):
        args = [arg.format(place) for arg in COMMANDS[command]]
        refused(args, tmp_path, str(place), word)


@pytest.mark.parametrize("command", FOLDERS)
def test_an_output_folder_is_not_created_below_a_file(command: str, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    args = [arg.format(tmp_path / "file") for arg in FOLDERS[command]]
    refused(args, tmp_path, str(tmp_path / "file"), "is not a folder")


@pytest.mark.parametrize(
    "args",
    [
        ["reach", "eval", "fetch", "--seed", "-1"],
        ["rank", "kitchen_small", "fridge", "--seed", "-1"],
        ["place", "open", "kitchen_small", "fridge", "--seed", "-1"],
        ["place", "open", "kitchen_small", "fridge", "--seed", f"1{'0' * 30}"],
        ["run", "plan.json", "--seed", "-1"],
        ["scene", "new", "galley", "--seed", "-1", "--out", "{}/a.json"],
        ["scene", "scan", "kitchen_small", "--seed", "-1", "--out", "{}/a"],
        ["scene", "scan", "kitchen_small", "--frames", "0", "--out", "{}/a"],
        ["scan", "scans", "--set", "scan.voxel=nan", "--out", "{}/a.json"],
        ["scan", "scans", "--set", "scan.voxel=0", "--out", "{}/a.json"],
        ["scan", "scans", "--depth-scale", "inf", "--out", "{}/a.json"],
        ["scan", "scans", "--max-frames", "-5", "--out", "{}/a.json"],
    ],
)
def test_an_option_out_of_range_is_refused(args: list[str], tmp_path: Path) -> None:
    option = next(arg for arg in args if arg.startswith("--") and arg != "--out")
    refused([arg.format(tmp_path) for arg in args], tmp_path, option)


def test_an_input_that_is_not_a_regular_file_is_refused(tmp_path: Path) -> None:
    for args in (
        ["scene", "show", "/dev/zero"],
        ["verify", "/dev/zero"],
        ["robot", "show", "/dev/zero"],
    ):
        refused(args, tmp_path, "/dev/zero")


ROOM = {
    "format": "momapos-scene", "version": 1, "name": "room_$x^2^3$",
    "start": {"x": 1.5, "y": 0, "yaw": 3.14},
    "objects": [
        {"name": "box", "pose": {"xyz": [0, 0, 0.4]}, "box": [0.6, 0.6, 0.8]},
        {"name": "$x^2^3$", "pose": {"xyz": [0, 1.5, 0.4]}, "box": [0.6, 0.6, 0.8]},
        {"name": "can_$a$", "pose": {"xyz": [0.1, 0, 0.86]}, "box": [0.06, 0.06, 0.12]},
    ],
}  # fmt: skip


def test_a_plan_is_written_before_it_is_drawn(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path, plan, plot = (tmp_path / name for name in ("room.json", "plan.json", "plan.png"))
    path.write_text(json.dumps(ROOM))
    words = ["place", "pick", str(path), "can_$a$", "--robot", "fetch", "--out", str(plan)]
    assert main([*words, "--plot", str(plot)]) == 0
    assert plot.stat().st_size > 10_000
    before = plan.read_text()

    def fails(*_: object) -> None:
        raise InputError("no figure")

    plan.unlink()
    monkeypatch.setattr("momapos.apps.plots.draw_answer", fails)
    assert main([*words, "--plot", str(plot)]) == 2
    assert json.loads(plan.read_text())["base_pose"] == json.loads(before)["base_pose"]


def test_a_category_with_commands_of_a_terminal_is_refused(tmp_path: Path) -> None:
    path = tmp_path / "room.json"
    for category in ("a\x1b[2Jb", "\u202e", "a" * 2000, 3):
        objects = [{**ROOM["objects"][0], "category": category}]
        path.write_text(json.dumps({**ROOM, "objects": objects}))
        refused(["scene", "show", str(path)], tmp_path, "category must be")


@pytest.mark.parametrize(
    "words",
    [
        ["scene", "convert", "{room}", "{folder}/out.xml", "--root", "{loop}"],
        ["scene", "show", "{loop}"],
        ["verify", "{loop}"],
        ["scan", "{loop}", "--out", "{folder}/scene.json"],
        ["robot", "check", "{loop}"],
        ["place", "open", "{loop}", "fridge"],
        ["scene", "convert", "{room}", "{loop}/out.json"],
    ],
)
def test_a_cycle_of_links_is_refused_in_one_line(words: list[str], tmp_path: Path) -> None:
    loop, room = tmp_path / "loop.urdf", tmp_path / "room.json"
    loop.symlink_to(loop)
    room.write_text(json.dumps(ROOM))
    error_of(*[word.format(loop=loop, room=room, folder=tmp_path) for word in words])
