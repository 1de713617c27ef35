"""Laws of Sweet Home 3D furniture: URDFs whose doors and drawers open toward the front."""

from __future__ import annotations

import json
import zipfile
from pathlib import Path

import numpy as np
import pytest
from benchmarks.sweet_home import COUNTER, Model, describe, main, models, paints, write

from momapos.apps.synthetic_scans.surfaces import patches
from momapos.core.geometry.transforms import apply
from momapos.model.urdf.articulated import Articulated
from momapos.model.urdf.reader import Urdf, read_urdf

SIZE = (0.6, 0.5, 0.8)
"""Width, depth and height of the cabinet [m]; its OBJ file is in other units."""
UNIT = 100.0
DOOR = ((-0.3, 0.3, 0.2), (0.3, 0.8, 0.25))
DRAWER = ((-0.28, 0.0, -0.2), (0.28, 0.26, 0.25))
"""Corners of the parts with y up and the front toward z [m]."""
Corners = tuple[tuple[float, float, float], tuple[float, float, float]]


def box(name: str, corners: Corners, material: str = "white", mark: str = "g") -> str:
    """Return a box as a group of an OBJ file."""
    low, high = UNIT * np.array(corners)
    lines = [f"{mark} {name}", f"usemtl {material}"]
    for x in (low[0], high[0]):
        lines += [f"v {x} {y} {z}" for y in (low[1], high[1]) for z in (low[2], high[2])]
    rings = ("1 2 4 3", "5 7 8 6", "1 5 6 2", "3 4 8 7", "1 3 7 5", "2 6 8 4")
    lines += ["f " + " ".join(str(int(k) - 9) for k in ring.split()) for ring in rings]
    return "\n".join(lines) + "\n"


def fitting(x: float, y: float, z: float) -> Corners:
    """Return a hinge fitting: a small box, as in the models."""
    return (x - 0.01, y - 0.01, z - 0.01), (x + 0.01, y + 0.01, z + 0.01)


def cabinet(x: float = -0.3, mark: str = "g") -> str:
    """Return a cabinet with a door above a drawer; the door's fittings are at side x."""
    special = "sweethome3d_"
    return "".join(
        (
            "# a cabinet\n",
            box("carcass", ((-0.3, 0.0, -0.25), (0.3, 0.8, 0.2)), mark=mark),
            box(f"{special}hinge_1_low", fitting(0.9 * x, 0.35, 0.2), mark=mark),
            box(f"{special}hinge_1_high", fitting(0.9 * x, 0.75, 0.2), mark=mark),
            box(f"{special}opening_on_hinge_1_door", DOOR, mark=mark),
            box(f"{special}unique_rail", ((-0.3, 0.0, -0.2), (-0.29, 0.1, 0.2)), mark=mark),
            box(f"{special}opening_on_rail_1_drawer", DRAWER, "red oak", mark),
        )
    )


def model(text: str, colors: dict[str, str] | None = None) -> Model:
    return Model("kitchenCabinet", "someone", SIZE, 0.0, False, text, colors or {})


def written(text: str, folder: Path) -> Urdf:
    return read_urdf(write(model(text), folder))


def travel(urdf: Urdf, joint: str) -> np.ndarray:
    """Return the direction in which the center of a part moves as it begins to open."""
    articulated = Articulated(urdf)
    record = articulated.joint(joint)
    poses = [articulated.link_poses({joint: q})[record.child] for q in (0.0, 0.1 * record.upper)]
    points = np.concatenate([hull.vertices for hull in articulated.hulls[record.child]])
    center = (points.min(axis=0) + points.max(axis=0)) / 2
    move: np.ndarray = np.subtract(*(apply(T, center[None])[0] for T in reversed(poses)))
    return move / np.linalg.norm(move)


@pytest.mark.parametrize("side", [-0.3, 0.3])
def test_a_door_turns_about_its_fittings_toward_the_front(side: float, tmp_path: Path) -> None:
    urdf = written(cabinet(side), tmp_path)
    door = next(joint for joint in urdf.joints if joint.name == "hinge_1")
    assert door.kind == "revolute"
    assert (door.lower, door.upper) == (0.0, pytest.approx(np.pi / 2))
    np.testing.assert_allclose(np.abs(door.axis), (0.0, 0.0, 1.0))
    np.testing.assert_allclose(
        door.T_parent_joint[:3, 3], (0.9 * side, -0.2, 0.55 - 0.4), atol=1e-6
    )
    assert travel(urdf, "hinge_1")[1] < -0.9


def test_a_drawer_slides_forward_by_a_share_of_its_depth(tmp_path: Path) -> None:
    urdf = written(cabinet(), tmp_path)
    drawer = next(joint for joint in urdf.joints if joint.name == "rail_1")
    assert drawer.kind == "prismatic"
    assert (drawer.lower, drawer.upper) == (0.0, pytest.approx(0.7 * 0.45))
    np.testing.assert_allclose(travel(urdf, "rail_1"), (0.0, -1.0, 0.0), atol=1e-9)


def test_a_model_is_as_large_as_its_catalog_says(tmp_path: Path) -> None:
    articulated = Articulated(written(cabinet(), tmp_path))
    poses = articulated.link_poses({})
    points = np.concatenate(
        [apply(poses[n], h.vertices) for n, hulls in articulated.hulls.items() for h in hulls]
    )
    np.testing.assert_allclose(points.min(axis=0), -np.array(SIZE) / 2, atol=1e-5)
    np.testing.assert_allclose(points.max(axis=0), np.array(SIZE) / 2, atol=1e-5)


def other_names() -> dict[str, str]:
    """Return the same cabinet as other programs write it."""
    groups, objects = cabinet(), cabinet(mark="o")
    split = objects.replace("\nusemtl", "\ng Cube_Cube.001\nusemtl")
    return {
        "objects": objects,
        "groups of objects": split,
        "groups within objects": groups.replace("g carcass", "o all\ng carcass"),
        "another case": groups.replace("sweethome3d_o", "SweetHome3D_O").replace("_on_", "_ON_"),
        "Windows": groups.replace("\n", "\r\n"),
        "tabs": groups.replace("g ", "g\t").replace("v ", "v\t").replace("usemtl ", "usemtl\t"),
        "several names": groups.replace("g sweethome3d", "g part sweethome3d"),
    }


@pytest.mark.parametrize("kind", other_names())
def test_joints_do_not_depend_on_how_a_program_writes_groups(kind: str, tmp_path: Path) -> None:
    expected = written(cabinet(), tmp_path / "usual").joints
    found = written(other_names()[kind], tmp_path / "other").joints
    assert [joint.name for joint in found] == [joint.name for joint in expected]
    for one, other in zip(found, expected, strict=True):
        assert (one.kind, one.lower, one.upper) == (other.kind, other.lower, other.upper)
        np.testing.assert_array_equal(one.axis, other.axis)
        np.testing.assert_array_equal(one.T_parent_joint, other.T_parent_joint)


def test_a_hinge_of_two_digits_is_not_that_of_one(tmp_path: Path) -> None:
    text = cabinet().replace("opening_on_hinge_1_", "opening_on_hinge_10_")
    assert [joint.name for joint in written(text, tmp_path).joints] == ["rail_1"]


def test_a_flap_opens_forward_and_a_lid_upward(tmp_path: Path) -> None:
    body = box("carcass", ((-0.3, 0.0, -0.25), (0.3, 0.75, 0.2)))
    flap = box("sweethome3d_opening_on_hinge_1", ((-0.3, 0.1, 0.2), (0.3, 0.7, 0.25)))
    below = box("sweethome3d_hinge_1", ((-0.3, 0.1, 0.2), (0.3, 0.11, 0.21)))
    lid = box("sweethome3d_opening_on_hinge_2", ((-0.3, 0.75, -0.25), (0.3, 0.8, 0.2)))
    behind = box("sweethome3d_hinge_2", ((-0.3, 0.75, -0.25), (0.3, 0.76, -0.24)))
    urdf = written(body + flap + below + lid + behind, tmp_path)
    assert travel(urdf, "hinge_1")[1] < -0.9
    assert travel(urdf, "hinge_2")[2] > 0.9


def test_a_part_that_cannot_turn_is_fixed_and_reported(tmp_path: Path) -> None:
    tap = box("sweethome3d_opening_on_hinge_2_tap", ((0.0, 0.7, 0.0), (0.1, 0.8, 0.5)))
    tap += box("sweethome3d_hinge_2", fitting(0.0, 0.7, 0.0))
    text = cabinet().replace("sweethome3d_hinge_1", "gond") + tap
    assert [joint.name for joint in written(text, tmp_path).joints] == ["rail_1"]
    line = describe(model(text))
    assert line.startswith("1 joints, 2 of 2 materials have no color")
    assert line.endswith("hinge_1 is fixed: no fittings; hinge_2 is fixed: slim")


MATERIALS = """# comment
newmtl white
Ns 10.0
Ka 1 1 1
d 1.0
Kd 0.9 0.8 0.7
illum 2

newmtl red oak-1 (é)
Kd  0.5 0.1 1e-1
Ka 1 1 1
newmtl marble
Kd 0.8 0.8 0.8
map_Kd marble.jpg
newmtl odd
Kd spectral file.rfl
newmtl none
Ka 1 1 1
"""
COLORS = {
    "white": "0.9 0.8 0.7", "red oak-1 (é)": "0.5 0.1 1e-1", "marble": "", "odd": "", "none": "",
}  # fmt: skip


@pytest.mark.parametrize("end", ["\n", "\r\n"])
@pytest.mark.parametrize("indent", ["", "\t"])
def test_colors_are_found_at_any_indent_and_line_end(end: str, indent: str) -> None:
    text = MATERIALS.replace("\nKd", f"\n{indent}Kd").replace("\n", end)
    assert paints(text.encode()) == COLORS


def test_colors_are_found_in_a_class_file() -> None:
    text = MATERIALS.partition("\n")[2].encode()
    data = b"\xca\xfe\xba\xbe\x01\x00\x06newmtl\n\x01\x89\x02\x7f" + text + b"\x02\xf3\x00\x1e\xff"
    assert paints(data) == COLORS


def test_a_urdf_shows_the_colors(tmp_path: Path) -> None:
    file = write(model(cabinet(), {"red oak": "0.5 0.1 0.1"}), tmp_path)
    link = read_urdf(file).links["rail_1"]
    found = {patch.paint for shape in link.visuals for patch in patches(shape, None)}
    assert found == {(0.5, 0.1, 0.1)}


def archive(folder: Path, **others: str) -> None:
    """Write a library with a cabinet and its files."""
    catalog = (
        "name#1=Cabinet\nmodel#1=/a/kitchenCabinet.obj\nwidth#1=60\ndepth#1=50\nheight#1=80\n"
        "elevation#1=145\ncreator#1=Some One\n"
    )
    files = {
        "a/kitchenCabinet.obj": cabinet(), "a/kitchenCabinet.mtl": "newmtl red oak\nKd 1 0 0\n",
        "io/OBJLoader.class": "newmtl white\nKd 1 1 1\nnewmtl red oak\nKd 0 0 0\n",
        "FurnitureCatalog.properties": catalog, **others,
    }  # fmt: skip
    with zipfile.ZipFile(folder / "sweethome3d.jar", "w") as file:
        for name, text in files.items():
            file.writestr(name, text)


def run(monkeypatch: pytest.MonkeyPatch, *options: str | Path) -> None:
    monkeypatch.setattr("sys.argv", ["sweet_home.py", *map(str, options)])
    main()


def test_an_archive_becomes_a_list_of_urdfs(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    archive(tmp_path)
    run(monkeypatch, tmp_path, "--out", tmp_path / "out")
    (row,) = json.loads((tmp_path / "out" / "models.json").read_text())
    assert row == {
        "name": "SweetHome3D/kitchenCabinet/Some One", "urdf": "Some One/kitchenCabinet/model.urdf",
        "above": 1.45, "counter": False,
    }  # fmt: skip
    urdf = read_urdf(tmp_path / "out" / row["urdf"])
    assert {joint.name for joint in urdf.joints} == {"hinge_1", "rail_1"}
    assert "2 joints, 0 of 2 materials have no color" in capsys.readouterr().out


def test_a_low_model_is_placed_on_a_counter(tmp_path: Path) -> None:
    low = "model#1=a/oven.obj\nwidth#1=50\ndepth#1=40\nheight#1=30\ncreator#1=x\n"
    archive(tmp_path, **{"FurnitureCatalog.properties": low, "a/oven.obj": cabinet()})
    (found,) = models(tmp_path)
    assert (found.above, found.counter) == (COUNTER, True)


def test_a_creator_name_cannot_leave_the_folder(tmp_path: Path) -> None:
    entry = "model#1=a/oven.obj\nwidth#1=50\ndepth#1=40\nheight#1=90\ncreator#1=../../x\n"
    archive(tmp_path, **{"FurnitureCatalog.properties": entry, "a/oven.obj": cabinet()})
    (found,) = models(tmp_path)
    assert (tmp_path / found.creator).resolve().parent == tmp_path.resolve()


def test_a_bad_folder_is_a_one_line_error(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    broken = "g sweethome3d_opening_on_hinge_1\nv x\n"
    bad = {
        "contains no sweethome3d.jar": lambda: None,
        "not a furniture library": lambda: (tmp_path / "sweethome3d.jar").write_text("none"),
        "doors or drawers": lambda: archive(tmp_path, **{"FurnitureCatalog.properties": "id#1=x"}),
        "not a usable OBJ file": lambda: archive(tmp_path, **{"a/kitchenCabinet.obj": broken}),
    }
    for words, make in bad.items():
        make()
        with pytest.raises(SystemExit, match=words) as error:
            run(monkeypatch, tmp_path, "--out", tmp_path / "out")
        assert "\n" not in str(error.value)
