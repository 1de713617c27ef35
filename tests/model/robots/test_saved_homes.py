"""Homes are replaced in a robot file, and all else in it stays as it is."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np
import pytest

from momapos.core.errors import MomaposError
from momapos.model.robots.robot import load_arms
from momapos.model.robots.robot_file import save_homes
from momapos.model.robots.robot_names import library_file, library_names


def copied(name: str, folder: Path) -> Path:
    source = library_file(name)
    shutil.copytree(source.parent, folder / name)
    return folder / name / source.name


@pytest.mark.parametrize("name", library_names())
def test_a_saved_home_is_loaded_and_no_other_line_changes(name: str, tmp_path: Path) -> None:
    path = copied(name, tmp_path)
    before, arms, rng = path.read_text(), load_arms(path), np.random.default_rng(0)
    torso = dict.fromkeys(arms[0].arm_joints, 0.5)
    share = {**{j: rng.uniform() for j in arms[0].other_arms}, **torso}  # shared joints are equal
    homes = {}
    for robot in arms:
        low, high = np.maximum(robot.chain.lower, -3.0), np.minimum(robot.chain.upper, 3.0)
        q = low + [share[j] for j in robot.arm_joints] * (high - low)
        homes[robot.arm] = q.tolist()
    save_homes(path, homes)
    for robot in load_arms(path):
        assert robot.home == pytest.approx(homes[robot.arm], abs=1e-6)
    kept = [line for line in path.read_text().splitlines() if not line.startswith("home")]
    assert kept == [line for line in before.splitlines() if not line.startswith("home")]


def test_a_home_over_several_lines_and_a_link_to_the_file_are_kept(tmp_path: Path) -> None:
    path = copied("segway_ur5e", tmp_path)
    (robot,) = load_arms(path)
    path.write_text(path.read_text().replace("home = [", "home = [\n  # of the arm\n  "))
    link = tmp_path / "robot.toml"
    link.symlink_to(path)
    save_homes(link, {"": robot.home.tolist()})
    assert link.is_symlink()
    assert load_arms(path)[0].home == pytest.approx(robot.home)


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ("home = [", 'comment = """\nhome = []\n"""\nhome = [', r"replace it by home = \[0\.1, "),
        ("arm_joints = [", "arm_joints = []\nold = [", "has other arms or joints"),
        ("name =", "name", "not a robot file in TOML"),
    ],
)
def test_a_file_whose_homes_cannot_be_replaced_stays_as_it_is(
    old: str, new: str, words: str, tmp_path: Path
) -> None:
    path = copied("segway_ur5e", tmp_path)
    text = path.read_text()
    assert old in text
    path.write_text(text.replace(old, new, 1))
    before = path.read_text()
    with pytest.raises(MomaposError, match=words):
        save_homes(path, {"": [0.1] * 6})
    assert path.read_text() == before
