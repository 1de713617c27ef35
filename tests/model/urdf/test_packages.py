"""Packages are found near a file, in the workspace around it, and where ROS looks for them."""

from __future__ import annotations

from pathlib import Path

import pytest

from momapos.model.urdf.packages import find_package
from momapos.model.urdf.reader import MeshFinder


def package(folder: Path, name: str) -> Path:
    folder.mkdir(parents=True)
    (folder / "package.xml").write_text(f"<package><name>{name}</name></package>")
    (folder / "plate.stl").write_text("")
    return folder


@pytest.fixture
def source(tmp_path: Path) -> Path:
    """Return a file of a package of a workspace."""
    folder = package(tmp_path / "ws" / "src" / "one" / "mine", "mine") / "urdf"
    folder.mkdir()
    return folder / "robot.urdf"


def found(source: Path, name: str) -> Path | None:
    return find_package(name, list(source.parents)[:5])


@pytest.mark.parametrize("place", ["src/two/other", "src/two/robots/other", "src/one/other_folder"])
def test_a_package_of_another_clone_in_the_workspace_is_found(source: Path, place: str) -> None:
    folder = package(source.parents[4] / place, "other")
    assert found(source, "other") == folder
    assert MeshFinder(source).find("package://other/plate.stl") == folder / "plate.stl"


@pytest.mark.parametrize("place", ["src/.git/other", "src/two/other/inside/nested"])
def test_hidden_folders_and_those_inside_packages_are_not_searched(
    source: Path, place: str
) -> None:
    package(source.parents[4] / place, "nested")
    package(source.parents[4] / "src" / "two" / "other" / "x", "x")
    (source.parents[4] / "src" / "two" / "other" / "package.xml").write_text("<package/>")
    assert found(source, "nested") is None


@pytest.mark.parametrize(
    ("variable", "place"),
    [("ROS_PACKAGE_PATH", "repo/other"), ("AMENT_PREFIX_PATH", "share/other")],
)
def test_the_variables_of_ros_are_followed(
    source: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, variable: str, place: str
) -> None:
    folder = package(tmp_path / "far" / "a" / "b" / "c" / "d" / place, "other")
    assert found(source, "other") is None
    prefix = folder.parents[1]
    monkeypatch.setenv(variable, f"/nowhere:{prefix}")
    assert found(source, "other") == folder
    assert MeshFinder(source).find("package://other/plate.stl") == folder / "plate.stl"


def test_links_that_leave_the_folders_of_a_file_are_not_followed(
    source: Path, tmp_path: Path
) -> None:
    outside = package(tmp_path / "outside", "other")
    link = source.parents[4] / "src" / "other"
    link.symlink_to(outside)
    folders = list(source.parents)[:5]
    assert find_package("other", folders, source.parents[4]) is None
    assert find_package("other", folders) == link
