"""Laws of the vertices of mesh files that are remembered."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from momapos.model.urdf.meshes import RecentPoints


def test_the_least_recently_used_vertices_go_first() -> None:
    read: list[str] = []

    def points_of(path: Path) -> np.ndarray:
        read.append(path.name)
        return np.zeros((10, 3))

    recent = RecentPoints(size=3 * 240)
    for name in "abcabdab":
        recent.get(Path(name), 0, points_of)
    assert "".join(read) == "abcd"  # d takes the place of c
    assert recent.held == 3 * 240
    recent.get(Path("c"), 0, points_of)
    assert "".join(read) == "abcdc"


def test_a_changed_file_is_read_again() -> None:
    recent = RecentPoints()
    before = recent.get(Path("door.stl"), 1, lambda _: np.zeros((1, 3)))
    after = recent.get(Path("door.stl"), 2, lambda _: np.ones((1, 3)))
    assert (before == 0.0).all()
    assert (after == 1.0).all()


def test_one_mesh_that_is_larger_than_all_is_still_remembered() -> None:
    recent = RecentPoints(size=100)
    recent.get(Path("small"), 0, lambda _: np.zeros((1, 3)))
    large = recent.get(Path("large"), 0, lambda _: np.zeros((1000, 3)))
    assert recent.get(Path("large"), 0, lambda _: np.zeros((0, 3))) is large
    assert recent.held == large.nbytes
