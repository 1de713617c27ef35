"""The command line: exit status, one line for unusable input, one object for --json."""

from __future__ import annotations

import json
import math
import os
import re
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest
from tests.commands import error_of, json_of, output_of

from momapos.apps.cli.base_pose_words import parse_pose
from momapos.apps.cli.main import COMMANDS
from momapos.apps.cli.names import SHELLS
from momapos.core.errors import TaskError
from momapos.core.units import parse_quantity


@pytest.fixture(autouse=True)
def own_cache(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path / "cache"))


def test_help_names_every_command() -> None:
    shown = output_of("--help")
    assert all(name in shown for name in COMMANDS)


def test_names_are_printed_where_the_terminal_lacks_their_letters(tmp_path: Path) -> None:
    item = {"name": "Kühlschrank ✓", "pose": {"xyz": [0, 0, 0.5]}, "box": [1, 1, 1]}
    room = {"format": "momapos-scene", "version": 1, "objects": [item]}
    (tmp_path / "room.json").write_text(json.dumps(room))
    for encoding, shown in (("ascii", b"K\\xfchlschrank \\u2713"), ("latin-1", b"K\xfchl")):
        done = subprocess.run(
            [sys.executable, "-m", "momapos", "scene", "show", tmp_path / "room.json"],
            capture_output=True, env={**os.environ, "PYTHONIOENCODING": encoding},
        )  # fmt: skip
        assert done.returncode == 0
        assert shown in done.stdout


@pytest.mark.parametrize("words", [["--help"], ["--version"], ["robot", "list"]])
def test_a_reader_that_closes_the_output_is_no_error(words: list[str]) -> None:
    command = [sys.executable, "-m", "momapos", *words]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE) as running:
        running.stdout.close()
        assert running.stderr.read() == b""
        assert running.wait() == 0


GROUPS = {name: group for name, (_, group) in COMMANDS.items() if isinstance(group, dict)}


@pytest.mark.parametrize("name", GROUPS)
def test_every_subcommand_has_help(name: str) -> None:
    shown = output_of(name, "--help")
    for sub in GROUPS[name]:
        assert f"  {sub} " in shown
        assert f"momapos {name} {sub}" in output_of(name, sub, "--help")


@pytest.mark.parametrize("shell", SHELLS)
def test_every_shell_completes_every_command(shell: str) -> None:
    shown = output_of("--tyro-print-completion", shell)
    assert all(name in shown for name in COMMANDS)
    assert all(sub in shown for group in GROUPS.values() for sub in group)
    assert "--method" in shown
    assert "habitat" in shown


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["plaec"], "did you mean place"),
        (["place", "opne"], "did you mean open"),
        (["--tyro-print-completion"], "needs one of bash, zsh"),
        (["--tyro-print-completion", "basch"], "needs one of bash, zsh"),
        (["place", "open", "kitchen_smal", "fridge"], "kitchen_small"),
        (["place", "open", "kitchen_small", "fridg"], "did you mean fridge"),
        (["place", "open", "kitchen_small", "fridge"], "several moving parts"),
        (["place", "open", "kitchen_small", "microwave", "--robot", "fetsh"], "fetch"),
        (["place", "open", "kitchen_small", "microwave", "--to", "500deg"], "outside its limits"),
        (["place", "open", "kitchen_small", "microwave", "--to", "wide"], "not a value"),
        (["place", "open", "kitchen_small", "microwave", "--start", "1,2"], "X,Y,YAW"),
        (
            ["place", "open", "kitchen_small", "microwave", "--at", "1,2"],
            "--at '1,2' is not X,Y,YAW",
        ),
        (
            [
                "place",
                "close",
                "kitchen_small",
                "microwave",
                "--joint",
                "microwave/door_hinge=60deg",
                "--to",
                "max",
            ],
            "close always closes a part completely",
        ),
        (["place", "pick", "kitchen_small", "cup", "--at", "1,2,90"], "did you mean 90deg"),
        (
            ["place", "pick", "kitchen_small", "cup", "--seed", "x"],
            "--seed 'x' is not a whole number",
        ),
        (
            ["place", "pick", "kitchen_small", "cup", "--polish", "1.5"],
            "'1.5' is not a whole number",
        ),
        (
            ["place", "pick", "kitchen_small", "cup", "--alpha", "no"],
            "--alpha 'no' is not a number",
        ),
        (["place", "open", "kitchen_small", "microwave", "--timeout", "0"], "timeout"),
        (["verify", "no_such_plan.json"], "no_such_plan.json"),
    ],
)
def test_unusable_input_is_one_line_and_status_2(words: list[str], hint: str) -> None:
    assert hint in error_of(*words)


def test_a_lack_of_memory_is_one_line_and_status_2(monkeypatch: pytest.MonkeyPatch) -> None:
    def too_large() -> int:
        return len(np.zeros(2**62, np.uint8))

    monkeypatch.setattr("momapos.apps.cli.robot.robot_list", too_large)
    assert "not enough memory" in error_of("robot", "list")


def test_a_solved_task_is_status_0_and_its_plan_is_valid(tmp_path: Path) -> None:
    plan = tmp_path / "plan.json"
    words = ["place", "open", "kitchen_small", "microwave", "--robot", "segway_ur5e"]
    shown = json_of(*words, "--out", str(plan), "--json")
    assert shown["status"] == "solved"
    written = json.loads(plan.read_text())
    assert set(written.pop("hashes")) == {"scene", "robot"}  # of the files, which only it names
    assert shown == written | {key: shown[key] for key in ("scene", "robot")}
    assert "VALID" in output_of("verify", str(plan))


def test_an_infeasible_task_is_status_3_with_reasons() -> None:
    words = ["place", "open", "kitchen_small", "cabinet_right/drawer_bottom_slide"]
    shown = output_of(*words, "--robot", "segway_ur5e", "--no-advice", status=3)
    assert "infeasible" in shown
    assert "out of reach" in shown


def test_values_and_start_poses_have_units() -> None:
    assert parse_quantity("90deg").angle("a") == pytest.approx(math.pi / 2)
    assert parse_quantity("30cm").length("a") == pytest.approx(0.3)
    assert parse_quantity("-1.2").angle("a") == parse_quantity("-1.2").length("a") == -1.2
    assert parse_pose("1, 2.5, 180deg", "start") == pytest.approx([1.0, 2.5, math.pi])
    for wrong in ("", "90 degrees", "nan", "1..2", "9m9"):
        with pytest.raises(TaskError):
            parse_quantity(wrong)


@pytest.mark.parametrize(
    ("start", "words"),
    [
        ("1,2", "not X,Y,YAW"),
        ("1,2,90", "did you mean 90deg?"),
        ("1deg,2,0", "start: X 1deg is not a length"),
        ("1,2,30cm", "start: YAW 30cm is not an angle"),
    ],
)
def test_a_start_pose_in_wrong_units_is_refused(start: str, words: str) -> None:
    with pytest.raises(TaskError, match=re.escape(words)):
        parse_pose(start, "start")
