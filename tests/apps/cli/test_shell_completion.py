"""Shells complete names; help has no colors and messages no choices that are none."""

from __future__ import annotations

import json
import os
import pty
import re
import shlex
import subprocess
import sys
from pathlib import Path
from shutil import which

import pytest
from tests.commands import output_of
from tests.optional import skip

from momapos.apps.cli.main import main
from momapos.apps.cli.names import names_for
from momapos.model.robots.robot_names import library_names
from momapos.model.scene.scene_names import builtin_names

START = "from momapos.apps.cli.main import entry; entry()"


@pytest.mark.parametrize(
    ("line", "some"),
    [
        ("place open", builtin_names()),
        ("scene show", builtin_names()),
        ("rank", builtin_names()),
        ("place open kitchen_small", ("fridge", "fridge/door_hinge")),
        ("place open --robot fetch kitchen_small", ("fridge/door_hinge",)),
        ("place pick kitchen_small", ("apple", "bottle")),
        ("place open kitchen_small fridge then pick", ("apple",)),
        ("place open kitchen_small fridge then close", ("fridge/door_hinge",)),
        ("place open kitchen_small fridge --robot", library_names()),
        ("robot check", library_names()),
        ("bench run", ("smoke",)),
    ],
)
def test_names_fit_their_place_in_the_line(line: str, some: tuple[str, ...]) -> None:
    assert set(some) <= set(names_for(line.split()))


@pytest.mark.parametrize(
    "line", ["run", "place", "", "place open kitchen_small fridge", "place open gone.json", "x y"]
)
def test_elsewhere_there_are_no_names(line: str) -> None:
    assert names_for(line.split() or [""]) == []


def test_objects_of_a_file_of_ones_own_are_completed(tmp_path: Path) -> None:
    scene = tmp_path / "room.json"
    objects = [{"name": "box", "box": [1, 1, 1]}, {"name": "chest", "urdf": "chest.urdf"}]
    scene.write_text("\ufeff" + json.dumps({"format": "momapos-scene", "objects": objects}))
    (tmp_path / "chest.urdf").write_text(
        '<robot name="c"><joint name="tray" type="prismatic"/>'
        '<joint name="j" type="fixed"/></robot>'
    )
    assert names_for(["place", "pick", str(scene)]) == ["box", "chest"]
    assert names_for(["place", "open", str(scene)]) == ["chest", "chest/tray"]
    scene.write_text("[1, 2")
    assert names_for(["place", "open", str(scene)]) == []


SHELLS = {
    "bash": """
eval "$(momapos --tyro-print-completion bash)"
COMP_WORDS=(momapos place open kitchen_small fridge --robot fet); COMP_CWORD=6
_momapos_names momapos fet --robot; echo "${COMPREPLY[@]}"
""",
    "zsh": """
eval "$(momapos --tyro-print-completion zsh)"
compadd() { print -l -- ${(P)2}; }
_describe() { print -l -- ${(P)2}; }
_files() { :; }
words=(momapos place open kitchen_small fridge --robot fet); CURRENT=7
_momapos_names
""",
    "fish": """
momapos --tyro-print-completion fish | source
complete -C "momapos place open kitchen_small fridge --robot fet"
""",
}


@pytest.mark.parametrize("shell", SHELLS)
def test_a_shell_completes_the_name_of_a_robot(shell: str, tmp_path: Path) -> None:
    assert "fetch" in completed(shell, SHELLS[shell], tmp_path).split()


def completed(shell: str, text: str, folder: Path) -> str:
    """Run a script in a shell, in a folder, and return what it prints."""
    if which(shell) is None:
        skip(shell)
    program = folder / "momapos"
    program.write_text(f'#!/bin/sh\nexec {sys.executable} -c "{START}" "$@"\n')
    program.chmod(0o755)
    script = folder / "complete"
    script.write_text(text)
    path = {
        "PATH": f"{folder}:{os.environ['PATH']}", "PYTHONPATH": ":".join(sys.path),
        "HOME": str(folder),
    }  # fmt: skip
    done = subprocess.run(
        [shell, str(script)], capture_output=True, text=True, env=path, cwd=folder
    )
    assert done.stderr == ""
    return done.stdout


HOSTILE = ("$(touch run)", "`touch run`", "${HOME}", "~", "it's", "a b", "x;touch run", "*")
OF_ROOM = {
    "bash": """
eval "$(momapos --tyro-print-completion bash)"
COMP_WORDS=(momapos place pick room.json ""); COMP_CWORD=4
_momapos_names momapos "" room.json; printf '%s\n' "${COMPREPLY[@]}"
""",
    "zsh": """
eval "$(momapos --tyro-print-completion zsh)"
compadd() { print -rl -- ${(P)2}; }
_describe() { :; }
_files() { :; }
words=(momapos place pick room.json ""); CURRENT=5
_momapos_names
""",
    "fish": """
momapos --tyro-print-completion fish | source
complete -C "momapos place pick room.json "
""",
}


@pytest.mark.parametrize("shell", OF_ROOM)
def test_no_shell_expands_the_name_of_an_object(shell: str, tmp_path: Path) -> None:
    objects = [{"name": name} for name in (*HOSTILE, "two\nlines", "\x1b[31mred")]
    room = {"format": "momapos-scene", "objects": objects}
    (tmp_path / "room.json").write_text(json.dumps(room))
    lines = completed(shell, OF_ROOM[shell], tmp_path).splitlines()
    assert not (tmp_path / "run").exists()
    if shell == "bash":  # it inserts the words as they are
        lines = [word for line in lines for word in shlex.split(line)]
    assert set(HOSTILE) <= set(lines)
    assert not any(line == "lines" or "\x1b" in line for line in lines)


def test_bash_inserts_the_only_name_that_fits(tmp_path: Path) -> None:
    script = """
eval "$(momapos --tyro-print-completion bash)"
COMP_WORDS=(momapos place open kitchen_small micro); COMP_CWORD=4
_momapos_names momapos micro kitchen_small
for word in "${COMPREPLY[@]}"; do echo "<$word>"; done
"""
    words = completed("bash", script, tmp_path).split()
    assert words == ["<microwave>", "<microwave/door_hinge>"]


@pytest.mark.parametrize("shell", SHELLS)
def test_scripts_are_the_same_each_time_and_offer_no_none(shell: str) -> None:
    script = output_of("--tyro-print-completion", shell)
    choices = re.findall(r"choices\\?': \[([^]]*)\]", script)
    assert len(choices) > 10
    assert all(words.split(", ") == sorted(words.split(", ")) for words in choices)
    assert not any("None" in words for words in choices)
    (specification,) = re.findall(r"^COMPLETION_SPEC = .*$", script, re.MULTILINE)
    assert "\\n" not in specification  # a description of two lines would be two words


@pytest.mark.parametrize(("variable", "colored"), [("1", False), ("", True)])
def test_help_has_no_colors_if_the_user_wants_none(variable: str, colored: bool) -> None:
    master, slave = pty.openpty()
    call = [sys.executable, "-c", START, "verify", "--help"]
    child = subprocess.Popen(
        call, stdout=slave, stderr=slave, close_fds=True,
        env={**os.environ, "NO_COLOR": variable, "TERM": "xterm"},
    )  # fmt: skip
    os.close(slave)
    shown = b""
    while True:
        try:
            part = os.read(master, 65536)
        except OSError:  # the other end is closed
            break
        if not part:
            break
        shown += part
    os.close(master)
    assert child.wait() == 0
    assert b"scene-root" in shown
    assert (b"\x1b[" in shown) is colored


def test_a_wrong_word_lists_the_choices_and_not_none(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["bench", "run", "smoke", "--out", "x", "--commit", "wrong"]) == 2
    error = capsys.readouterr().err
    assert "None" not in error
    assert "first" in error
    assert "retry" in error
