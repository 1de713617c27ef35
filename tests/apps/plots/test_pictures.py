"""The file ending of a figure determines its format."""

from __future__ import annotations

from pathlib import Path

import pytest
from matplotlib.figure import Figure
from tests.commands import error_of

from momapos.apps.cli.main import main
from momapos.apps.plots.graph_plot import draw_importance
from momapos.apps.plots.image_files import save_figure
from momapos.apps.plots.robot_figures import draw_robot
from momapos.apps.plots.room_plot import draw_scene
from momapos.core.errors import InputError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import hand_path
from momapos.planning.importance.ranking import rank

HEADS = {"png": b"\x89PNG", "svg": b"<?xml", "pdf": b"%PDF", "SVG": b"<?xml"}


@pytest.mark.parametrize("ending", HEADS)
def test_the_file_ending_determines_the_format(ending: str, tmp_path: Path) -> None:
    path = tmp_path / "new" / f"a.{ending}"
    save_figure(Figure(), path, dpi=50)
    assert path.read_bytes().startswith(HEADS[ending])
    assert list(path.parent.iterdir()) == [path]


@pytest.mark.parametrize("ending", ["svg", "pdf", "png"])
def test_the_same_figure_gives_the_same_file(ending: str, tmp_path: Path) -> None:
    one, other = tmp_path / f"one.{ending}", tmp_path / f"other.{ending}"
    for path in (one, other):
        save_figure(Figure(), path, dpi=50)
    assert one.read_bytes() == other.read_bytes()


@pytest.mark.parametrize("name", ["a.jpg", "a", "a.png.txt", "a.svgz"])
def test_an_unknown_format_is_refused_and_nothing_is_written(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\.png, \.svg, \.pdf"):
        save_figure(Figure(), tmp_path / name, dpi=50)
    assert not list(tmp_path.iterdir())


@pytest.mark.parametrize(
    "words",
    [
        ["place", "open", "no_such_scene", "fridge"],
        ["rank", "no_such_scene", "fridge"],
        ["scene", "show", "no_such_scene"],
        ["robot", "check", "no_such_robot.urdf"],
    ],
)
def test_every_command_refuses_an_unknown_format_before_it_works(words: list[str]) -> None:
    assert "a.jpg: unsupported figure format; use .png, .svg, .pdf" in error_of(
        *words, "--plot", "a.jpg"
    )


def test_a_figure_is_written_even_if_printing_fails(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reader of the pipe is gone when the answer is printed."""

    def gone(*_: object, file: object = None, **__: object) -> None:
        if file is None:
            raise BrokenPipeError

    monkeypatch.setattr("builtins.print", gone)
    plan, plot = tmp_path / "plan.json", tmp_path / "plan.svg"
    words = ["place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e"]
    assert main([*words, "--out", str(plan), "--plot", str(plot)]) == 0
    assert plan.is_file()
    assert plot.read_bytes().startswith(HEADS["svg"])


@pytest.mark.parametrize("ending", ["png", "svg", "pdf"])
def test_every_figure_has_the_format_of_its_file_ending(
    ending: str, tmp_path: Path, kitchen: Scene, segway: Robot
) -> None:
    fridge = rank(kitchen, "fridge", path=hand_path(kitchen, "fridge", "door_hinge"))
    scene_file, robot_file, graph_file = (tmp_path / f"{i}.{ending}" for i in range(3))
    draw_scene(kitchen, scene_file)
    draw_robot(segway, robot_file)
    draw_importance(kitchen, fridge, graph_file)
    for path in (scene_file, robot_file, graph_file):
        assert path.read_bytes().startswith(HEADS[ending]), path
