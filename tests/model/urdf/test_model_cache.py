"""Cached values of a model equal computed ones to the last bit."""

from __future__ import annotations

import shutil
from dataclasses import fields, is_dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from momapos.core.cache import Cache
from momapos.core.errors import UrdfError
from momapos.model.robots.robot import load_arms, load_robot
from momapos.model.robots.robot_names import LIBRARY, library_names
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.hulls import Hull, hull_of
from momapos.model.urdf.model_cache import freeze, once
from momapos.model.urdf.reader import Geometry, box_urdf, read_urdf


def assert_same(a: Any, b: Any) -> None:
    """Assert that two values agree in type and in every bit."""
    if isinstance(a, np.ndarray):
        assert (a.dtype, a.shape) == (b.dtype, b.shape)
        assert a.tobytes() == b.tobytes()
    elif is_dataclass(a):
        assert type(a) is type(b)
        for field in fields(a):
            assert_same(getattr(a, field.name), getattr(b, field.name))
    elif isinstance(a, dict):
        assert list(a) == list(b)
        for key in a:
            assert_same(a[key], b[key])
    elif isinstance(a, tuple):
        assert isinstance(b, tuple)
        for x, y in zip(a, b, strict=True):
            assert_same(x, y)
    else:
        assert a == b


@pytest.mark.parametrize("name", library_names())
def test_a_robot_from_the_cache_equals_that_from_its_files(name: str, tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    fresh = load_arms(name, cache=None)[0]
    for _ in range(2):
        kept = load_arms(name, cache=cache)[0]
        assert_same(fresh.model.urdf, kept.model.urdf)
        assert_same(fresh.model.hulls, kept.model.hulls)
        assert_same(fresh.model.boxes, kept.model.boxes)
        assert_same(fresh.spheres, kept.spheres)
        assert_same(fresh.footprint, kept.footprint)


@pytest.mark.parametrize("name", builtin_names())
def test_a_scene_from_the_cache_equals_that_from_its_files(name: str, tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    fresh = load_scene(name, cache=None)
    for _ in range(2):
        kept = load_scene(name, cache=cache)
        for one, other in zip(fresh.objects, kept.objects, strict=True):
            assert_same(one.model.urdf, other.model.urdf)
            assert_same(one.model.hulls, other.model.hulls)
            assert_same(one.model.boxes, other.model.boxes)
            assert_same(one.joints, other.joints)


def test_scenes_and_robots_are_cached_in_the_user_s_folder_by_default(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path / "cache"))
    _ = load_scene("kitchen_small", cache=None).objects[0].model.hulls
    _ = load_robot("fetch", cache=None).spheres
    assert not (tmp_path / "cache").exists()
    _ = load_scene("kitchen_small").objects[0].model.hulls
    _ = load_robot("fetch").spheres
    kinds = {file.name.partition("-")[0] for file in (tmp_path / "cache").iterdir()}
    assert {"urdf", "hulls", "spheres"} <= kinds


def test_a_second_load_computes_nothing(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    cache = Cache(tmp_path)
    spheres = load_robot("fetch", cache=cache).spheres

    def never(*_: object) -> None:
        raise AssertionError("computed again")

    for name in ("articulated.hull_of", "articulated.cover_shape", "reader._parse"):
        monkeypatch.setattr(f"momapos.model.urdf.{name}", never)
    monkeypatch.setattr("momapos.model.robots.robot.arm_spheres", never)
    assert_same(load_robot("fetch", cache=cache).spheres, spheres)


def test_a_changed_file_is_computed_again(tmp_path: Path) -> None:
    shutil.copytree(LIBRARY / "segway_ur5e", tmp_path / "robot")
    file, cache = tmp_path / "robot" / "segway_ur5e.toml", Cache(tmp_path / "cache")
    before = load_robot(file, cache=cache).spheres
    urdf, srdf = file.with_suffix(".urdf"), file.with_suffix(".srdf")
    text = urdf.read_text()
    assert '<cylinder radius="0.0' in text
    urdf.write_text(text.replace('<cylinder radius="0.0', '<cylinder radius="0.1'))
    after = load_robot(file, cache=cache).spheres
    assert after.radius.tobytes() != before.radius.tobytes()
    srdf.write_text("<robot name='r'/>")
    assert len(load_robot(file, cache=cache).spheres.pairs) > len(after.pairs)
    for kept in (tmp_path / "cache").iterdir():
        kept.write_bytes(b"damaged")
    assert_same(load_robot(file, cache=cache).spheres, load_robot(file, cache=None).spheres)


def test_a_changed_mesh_is_computed_again(tmp_path: Path) -> None:
    corners = np.array(np.meshgrid([0, 1], [0, 1], [0, 1])).reshape(3, -1).T

    def write(size: float) -> None:
        rows = (f"v {x} {y} {z}\n" for x, y, z in corners * size)
        (tmp_path / "chest.obj").write_text("".join(rows))

    file, cache = tmp_path / "chest.urdf", Cache(tmp_path / "cache")
    shape = '<collision><geometry><mesh filename="chest.obj"/></geometry></collision>'
    file.write_text(f'<robot name="chest"><link name="a">{shape}</link></robot>')
    for size in (1.0, 0.5):
        write(size)
        urdf = read_urdf(file, cache=cache)
        assert urdf.links["a"].collisions[0].mesh == (tmp_path / "chest.obj").resolve()
        assert Articulated(urdf, cache=cache).hulls["a"][0].vertices.max() == size
    (tmp_path / "chest.obj").unlink()
    with pytest.raises(UrdfError, match="does not exist"):
        read_urdf(file, cache=cache)


def test_values_cached_by_other_code_are_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    cache = Cache(tmp_path)
    assert once(cache, "number", (1, "a"), lambda: 3.5) == 3.5
    assert once(cache, "number", (1, "a"), lambda: 4.5) == 3.5
    assert once(cache, "number", (1, "b"), lambda: 4.5) == 4.5
    monkeypatch.setattr("momapos.model.urdf.model_cache._code", lambda: "newer")
    assert once(cache, "number", (1, "a"), lambda: 5.5) == 5.5


def test_a_read_only_cache_is_not_an_error(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert once(Cache(tmp_path / "file"), "number", (), lambda: 7) == 7


def test_serialized_values_distinguish_numbers_types_and_shapes() -> None:
    assert freeze((1.0, np.float64(2.0))) == freeze((1.0, 2.0))
    assert freeze(np.zeros(3)) != freeze(np.zeros((3, 1)))
    assert freeze(np.zeros(1)) != freeze(np.zeros(1, np.int64))
    assert freeze(0.1) != freeze(np.nextafter(0.1, 1.0))


def test_the_hull_of_a_box_agrees_with_qhull() -> None:
    from momapos.model.urdf.hulls import _convex, _primitive_points

    rng = np.random.default_rng(0)
    for size in 10 ** rng.uniform(-3.9, 3, size=(300, 3)):
        shape = Geometry("box", tuple(size.tolist()), np.eye(4))
        vertices, faces = _convex(_primitive_points(shape), None)
        assert_same(hull_of(shape, "a"), Hull(vertices, faces, "a"))
    assert Articulated(box_urdf("thin", (1.0, 1.0, 1e-7))).hulls["box"][0].vertices.shape == (8, 3)
