"""COLLADA units apply to all meshes, up axes to those of furniture."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
import tests.meshes as given
from tests import optional
from tests.real import CASES

from momapos.core.errors import UrdfError
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.furniture import read_furniture
from momapos.model.urdf.reader import read_urdf

BOX: given.Box = ((-0.1, -0.2, 0.0), (0.3, 0.2, 0.9))
UPRIGHT = np.array(BOX)


def urdf(folder: Path, asset: str, scale: float = 1.0, attributes: str = "") -> Path:
    triangles = given.triangles_of((BOX,)) * scale
    (folder / "a.dae").write_text(given.collada(triangles, asset))
    shape = f'<geometry><mesh filename="a.dae" {attributes}/></geometry>'
    path = folder / "a.urdf"
    path.write_text(f'<robot name="a"><link name="b"><collision>{shape}</collision></link></robot>')
    return path


def bounds(model: Articulated) -> np.ndarray:
    points = model.hulls["b"][0].vertices
    return np.stack([points.min(0), points.max(0)])


@pytest.mark.parametrize("meters", [1.0, 0.001, 0.01, 0.0254, 0.3048])
def test_sizes_are_in_meters_whatever_the_unit(tmp_path: Path, meters: float) -> None:
    path = urdf(tmp_path, f'<unit name="u" meter="{meters}"/>', 1 / meters)
    for model in (Articulated(read_urdf(path)), Articulated(read_furniture(path))):
        np.testing.assert_allclose(bounds(model), UPRIGHT, atol=1e-5)


def test_a_scale_of_the_urdf_applies_on_top_of_the_unit(tmp_path: Path) -> None:
    path = urdf(tmp_path, '<unit meter="0.01"/>', 50.0, 'scale="2 2 2"')
    np.testing.assert_allclose(bounds(Articulated(read_furniture(path))), UPRIGHT, atol=1e-5)


@pytest.mark.parametrize("meter", ["nan", "0", "-1", "inch", "1e9"])
def test_a_unit_that_is_no_length_is_an_error(tmp_path: Path, meter: str) -> None:
    model = Articulated(read_urdf(urdf(tmp_path, f'<unit meter="{meter}"/>')))
    with pytest.raises(UrdfError, match=r"a.dae.*unit meter"):
        _ = model.hulls


@pytest.mark.parametrize(
    ("axis", "expected"),
    [
        ("Z_UP", UPRIGHT),
        ("Y_UP", np.array([[-0.1, -0.9, -0.2], [0.3, 0.0, 0.2]])),
        ("X_UP", np.array([[-0.2, -0.9, -0.1], [0.2, 0.0, 0.3]])),
    ],
)
def test_furniture_is_turned_so_that_z_is_up(
    tmp_path: Path, axis: str, expected: np.ndarray
) -> None:
    path = urdf(tmp_path, f"<up_axis>{axis}</up_axis>")
    record = read_furniture(path)
    np.testing.assert_allclose(bounds(Articulated(record)), expected, atol=1e-6)
    assert [axis in note for note in record.notes] == [True] * (axis != "Z_UP")
    # As rviz, which shows robots: published ones have Y_UP in files whose z is up.
    np.testing.assert_allclose(bounds(Articulated(read_urdf(path))), UPRIGHT, atol=1e-6)


@pytest.mark.parametrize("axis", ["Y_UP", "X_UP"])
def test_an_uneven_scale_applies_to_the_axes_of_the_file(tmp_path: Path, axis: str) -> None:
    asset, scale = f"<up_axis>{axis}</up_axis>", 'scale="1 2 3"'
    plain = bounds(Articulated(read_furniture(urdf(tmp_path, asset))))
    scaled = bounds(Articulated(read_furniture(urdf(tmp_path, asset, 1.0, scale))))
    # T S p: the scale acts in the link's frame, after the file is turned.
    np.testing.assert_allclose(scaled, plain * [1, 2, 3], atol=1e-6)


def test_a_file_without_an_up_axis_keeps_its_z_up(tmp_path: Path) -> None:
    path = urdf(tmp_path, "")
    np.testing.assert_allclose(bounds(Articulated(read_furniture(path))), UPRIGHT, atol=1e-6)


@pytest.mark.parametrize(
    ("name", "same"), [("bar_inch", "bar_m"), ("dae_mm", "dae_y"), ("dae_inch", "dae_y")]
)
def test_public_cases_have_the_size_of_their_metric_twins(name: str, same: str) -> None:
    items = [
        load_scene(optional.there(CASES / f"furniture/{one}.json")).object("cupboard")
        for one in (name, same)
    ]
    found, expected = (sizes(item) for item in items)
    np.testing.assert_allclose(found, expected, atol=1e-4)


def sizes(item: SceneObject) -> np.ndarray:
    return np.concatenate(
        [np.ptp(hull.vertices, axis=0) for hulls in item.model.hulls.values() for hull in hulls]
    )


def test_a_link_whose_mesh_is_turned_keeps_its_mass(tmp_path: Path) -> None:
    path = urdf(tmp_path, "<up_axis>Y_UP</up_axis>")
    inertial = '<inertial><origin xyz="0 0.1 0.2"/><mass value="30"/></inertial>'
    path.write_text(path.read_text().replace("<collision>", f"{inertial}<collision>"))
    link = read_furniture(path).links["b"]
    assert (link.mass, link.center) == (30.0, (0.0, 0.1, 0.2))
