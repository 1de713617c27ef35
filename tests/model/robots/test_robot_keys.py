"""Unknown keys of robot files are reported, and vectors are numbers."""

from __future__ import annotations

import shutil
from pathlib import Path

import pytest

from momapos.core.errors import RobotError
from momapos.model.robots.robot import load_robot
from momapos.model.robots.robot_file import MAX_IGNORED_KEYS, ignored_keys
from momapos.model.robots.robot_names import library_file, library_names


def changed(tmp_path: Path, old: str, new: str) -> Path:
    """Return a copy of a library robot with a line replaced."""
    source = library_file("segway_ur5e")
    shutil.copytree(source.parent, tmp_path / "robot")
    path = tmp_path / "robot" / source.name
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    return path


@pytest.mark.parametrize("name", library_names())
def test_robots_of_the_library_have_no_unknown_keys(name: str) -> None:
    assert not [line for line in load_robot(name).assumed if "not known" in line]


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("max_speed", "max_sped", "'base.max_sped' of segway_ur5e.toml is not known and was "
         "ignored; did you mean 'max_speed'?"),
        ("[tool]", "[tool]\ncolor = 3", "'tool.color' of segway_ur5e.toml is not known and was "
         "ignored"),
        ("name =", "payloed = 3.0\nname =", "did you mean 'payload'?"),
    ],
)  # fmt: skip
def test_unknown_keys_are_named_with_the_key_that_is_meant(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    (line,) = load_robot(changed(tmp_path, old, new)).assumed
    assert words in line


def test_many_unknown_keys_are_counted() -> None:
    lines = ignored_keys({f"key{k}": 1 for k in range(50)}, "robot.toml")
    assert len(lines) == MAX_IGNORED_KEYS + 1
    assert lines[-1].startswith("30 more keys")


@pytest.mark.parametrize("value", ['["1", "2", "3"]', "[true, false, false]", "[1e300, 0, 0]"])
def test_an_axis_of_other_values_than_numbers_is_refused(value: str, tmp_path: Path) -> None:
    path = changed(tmp_path, "approach_axis", f"approach_axis = {value}\nunused")
    with pytest.raises(RobotError, match=r"tool\.approach_axis must be"):
        load_robot(path)
