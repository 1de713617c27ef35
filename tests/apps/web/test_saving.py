"""Files named on the page stay in the working folder and never overwrite others."""

from __future__ import annotations

from pathlib import Path

import pytest
from tests.apps.web.pages import serve

from momapos.apps.web.extras import file_in, save_plan, save_room
from momapos.core.errors import InputError
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene


@pytest.mark.parametrize(
    "name",
    ["../plan.json", "/tmp/plan.json", "a/b.json", "..", ".json", ".hidden.json", "plan", "plan.py",
     "plan.json\n", "a\0.json", "C:\\plan.json", "x" * 200 + ".json", "", "~/plan.json"],
)  # fmt: skip
def test_names_outside_of_the_folder_are_refused(tmp_path: Path, name: str) -> None:
    with pytest.raises(InputError, match="invalid file name"):
        file_in(tmp_path, name)


def test_nothing_is_overwritten(tmp_path: Path) -> None:
    (tmp_path / "plan.json").write_text("mine")
    (tmp_path / "link.json").symlink_to(tmp_path / "elsewhere.json")
    for name in ("plan.json", "link.json"):
        with pytest.raises(InputError, match="file exists"):
            file_in(tmp_path, name)
    assert (tmp_path / "plan.json").read_text() == "mine"


def test_without_an_answer_there_is_no_plan_to_save(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="no answer yet"):
        save_plan(tmp_path, "plan.json", None)
    assert not list(tmp_path.iterdir())


def test_a_saved_scene_has_the_joint_values_of_the_page(tmp_path: Path, kitchen: Scene) -> None:
    path = save_room(tmp_path, "room.json", kitchen, "fridge", {"door_hinge": 0.5})
    assert load_scene(path).object("fridge").values()["door_hinge"] == pytest.approx(0.5)


@pytest.mark.parametrize("started_here", [True, False])
def test_a_saved_scene_is_offered_at_once(
    started_here: bool, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if started_here:
        monkeypatch.chdir(tmp_path)
    with serve(tmp_path) as (page, _):
        assert page.work.wait(60.0)
        page.files.save_scene("mine.json")
        assert page.files.work.wait(60.0)
        scene = page.state.panel.scene
        assert scene.options == (
            "kitchen_small", "mine.json" if started_here else str(tmp_path / "mine.json")
        )  # fmt: skip
        assert scene.value == "kitchen_small"
        assert len(load_scene(scene.options[1]).objects) > 5
