"""Laws of opened plans: what comes with the package is loaded once, files of the user each time."""

from __future__ import annotations

import gc
import json
import shutil
from pathlib import Path

import pytest
from tests.rooms import Everywhere

from momapos.apps.cli.loading import file_format, open_plan
from momapos.apps.cli.view import kind_of, scenes_in
from momapos.model.plan_files.plan_format import write_plan
from momapos.model.robots.robot import load_robot
from momapos.model.robots.robot_names import library_file
from momapos.model.scene.scene_files import load_scene
from momapos.model.urdf.articulated import Articulated
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import plan_base_placement
from momapos.planning.placement.config import PlaceConfig

CONFIG = PipelineConfig(place=PlaceConfig(count=256, polish=1))


def a_plan(robot: str | Path, folder: Path) -> Path:
    """Write a plan to open the fridge."""
    kitchen = load_scene("kitchen_small")
    task = make_task(kitchen, "open", "fridge", "door_hinge")
    found = plan_base_placement(kitchen, load_robot(robot), task, Everywhere(), config=CONFIG)
    path = folder / "plan.json"
    write_plan(found.plan, path)
    return path


LATE = {"a": ["x" * 50] * 20}
"""What pushes the other members of a file away from its beginning."""


@pytest.mark.parametrize("name", ["scene", "plan", "run", "tour"])
def test_a_file_is_known_by_its_format_wherever_it_stands(name: str, tmp_path: Path) -> None:
    path, kinds = tmp_path / "file.json", {"run": "run", "plan": "plan", "tour": "plan"}
    for content in (
        {**LATE, "format": f"momapos-{name}"}, {"format": f"momapos-{name}", **LATE},
    ):  # fmt: skip
        for mark in ("", "\ufeff"):
            path.write_text(mark + json.dumps(content))
            assert file_format(path) == f"momapos-{name}"
            assert kind_of(str(path)) == kinds.get(name, "scene")
            assert scenes_in(tmp_path) == (("file.json",) if name == "scene" else ())
    path.write_text(json.dumps({"format": f"momapos-{name}", **LATE})[:-5])
    assert file_format(path) == f"momapos-{name}"
    for content in ("", "[1]", "{", json.dumps({"format": 3, **LATE}), json.dumps(LATE)):
        path.write_text(content)
        assert file_format(path) == ""


def test_plans_share_the_kitchens_and_robots_of_the_package(tmp_path: Path) -> None:
    path = a_plan("fetch", tmp_path)
    _, room, robot = open_plan(path, None, None, "to read", allow_assumed=False)
    _, again, same = open_plan(path, None, None, "to read", allow_assumed=False)
    assert same is robot
    assert [one.model for one in again.objects] == [one.model for one in room.objects]


def test_a_process_that_opens_plans_does_not_collect_models(tmp_path: Path) -> None:
    path = a_plan("fetch", tmp_path)

    def models() -> int:
        gc.collect()
        return sum(type(one) is Articulated for one in gc.get_objects())

    open_plan(path, None, None, "to read", allow_assumed=False)
    before = models()
    for _ in range(20):
        open_plan(path, None, None, "to read", allow_assumed=False)
    assert models() <= before


def test_a_robot_of_the_user_is_read_each_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    own = tmp_path / "robot"
    shutil.copytree(library_file("fetch").parent, own)
    monkeypatch.chdir(tmp_path)
    path = a_plan(own / "fetch.toml", tmp_path)
    _, _, robot = open_plan(path, None, None, "to read", allow_assumed=False)
    toml = own / "fetch.toml"
    toml.write_text(toml.read_text() + "\n# another version\n")
    _, _, other = open_plan(path, None, None, "to read", allow_assumed=False)
    assert other is not robot
