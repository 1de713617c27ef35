"""The figure of the scene graph is drawn for every room, and its nodes do not overlap."""

from __future__ import annotations

import struct
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from scipy.spatial.distance import pdist
from tests.planning.importance.small_rooms import SHELF_TOP, bowl, box, fridge, room

from momapos.apps.plots.graph_plot import draw_importance, spread
from momapos.core.errors import InputError
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.importance.config import ImportanceConfig
from momapos.planning.importance.ranking import Importance, rank

FAST = ImportanceConfig(scorer="distance")


def drawn(scene: Scene, result: Importance, path: Path) -> tuple[int, int]:
    draw_importance(scene, result, path)
    head = path.read_bytes()[:24]
    assert head[:8] == b"\x89PNG\r\n\x1a\n"
    return struct.unpack(">II", head[16:24])


@pytest.mark.parametrize(
    ("kitchen", "target"), [("kitchen_small", "cup"), ("kitchen_island", "can")]
)
def test_a_ranking_becomes_a_png_of_1600_by_1200(kitchen: str, target: str, tmp_path: Path) -> None:
    scene = load_scene(kitchen)
    assert drawn(scene, rank(scene, target, FAST), tmp_path / "new" / "a.png") == (1600, 1200)


def test_every_kind_of_relation_is_drawn(tmp_path: Path) -> None:
    scene = room(
        fridge(1.5), bowl((0, 0, SHELF_TOP)), box("apple", (0.07, 0.07, 0.07), (0, 0, 0.82)),
        box("box", (0.2, 0.2, 0.2), (0, 0, 1.6)), box("bin", (0.3, 0.3, 0.4), (0.8, 0, 0)),
    )  # fmt: skip
    assert drawn(scene, rank(scene, "bowl"), tmp_path / "a.png") == (1600, 1200)


def test_one_object_and_three_hundred_at_one_place_are_drawn_too(tmp_path: Path) -> None:
    one = box("b0", (0.3, 0.3, 0.3), (1, 1, 0))
    many = room(*(replace(one, name=f"b{k}") for k in range(300)))
    for scene in (room(one), many):
        assert drawn(scene, rank(scene, "b0", FAST), tmp_path / "a.png") == (1600, 1200)


def test_equal_rankings_give_equal_figures(tmp_path: Path, kitchen: Scene) -> None:
    for name in "ab":
        draw_importance(kitchen, rank(kitchen, "fridge"), tmp_path / f"{name}.png")
    assert (tmp_path / "a.png").read_bytes() == (tmp_path / "b.png").read_bytes()


def test_close_nodes_are_pushed_apart_and_distant_ones_do_not_move() -> None:
    coincident = np.zeros((6, 2))
    apart = np.array([[5.0, 0.0], [0.0, 5.0]])
    moved = spread(np.concatenate([coincident, apart]), 0.2)
    assert pdist(moved).min() > 0.17
    assert np.abs(moved[6:] - apart).max() < 1e-3


def test_an_unwritable_path_is_reported(tmp_path: Path, kitchen: Scene) -> None:
    (tmp_path / "graph.png").mkdir()
    with pytest.raises(InputError, match="cannot be written"):
        draw_importance(kitchen, rank(kitchen, "fridge", FAST), tmp_path / "graph.png")
