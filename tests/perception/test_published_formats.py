"""Objects of a room survive the export of other programs, at the density of their clouds.

The files are written as the published code does:
- Mask3D, `InstanceSegmentation.export` (trainer/trainer.py): `pred_mask/<scene>_<k>.txt` by
  `numpy.savetxt(..., fmt="%d")`, and rows `pred_mask/... class score`, all masks of all classes.
- OpenMask3D (class_agnostic_mask_computation/trainer/trainer.py): `torch.save` of a numpy array of
  float16, vertices by masks, in `<scene>_masks.pt`.
- Omni3D, `instances_to_coco_json` (cubercnn/evaluation/omni3d_evaluation.py), with the corners of
  `get_cuboid_verts_faces` (cubercnn/util/math_util.py).
"""

from __future__ import annotations

import json
import pickle
import zipfile
from pathlib import Path

import numpy as np
import pytest
from jaxtyping import Float
from tests.furnished import (
    KITCHEN,
    ROOM,
    Corners,
    cloud_of,
    kitchen,
    look_at,
    photograph,
    table_boxes,
)

from momapos.core.errors import FileFormatError
from momapos.core.geometry.transforms import apply, invert
from momapos.core.saved_arrays import load_array
from momapos.model.records.scans import Cloud, Detection, Frame, Instance
from momapos.perception.detection.coco import read_coco
from momapos.perception.recordings.masks import read_instances
from momapos.perception.segmentation.instance_boxes import (
    boxes,
    boxes_in_images,
    without_duplicates,
)
from momapos.perception.segmentation.room_shell import RoomShell, find_room

SPACING = {"scannet": 0.045, "phone": 0.02, "realsense": 0.015}
"""Distance of the points of a ScanNet mesh, a phone's and a fused RealSense's cloud [m]."""
NOISE = {"scannet": 0.004, "phone": 0.008, "realsense": 0.006}
CLASS = {
    "fridge": 24, "row": 3, "slab": 12, "oven": 39, "wall_cabinet": 3, "microwave": 39,
    "bottle": 39, "cup": 39, "table": 7,
}  # fmt: skip
"""Classes of the ScanNet benchmark."""


def truth() -> dict[str, list[Corners]]:
    """Return the boxes of each object."""
    return {**{name: [box] for name, box in KITCHEN.items()}, "table": table_boxes()}


@pytest.fixture(scope="module", params=list(SPACING))
def room(request: pytest.FixtureRequest) -> Cloud:
    """Return a cloud whose points are shifted at random along the surfaces, as in a mesh."""
    rng = np.random.default_rng(7)
    spacing = SPACING[request.param]
    cloud = cloud_of(kitchen(), rng, spacing, NOISE[request.param])
    shift = rng.uniform(-0.3, 0.3, cloud.points.shape) * spacing
    shift -= (shift * cloud.normals).sum(axis=1, keepdims=True) * cloud.normals
    return Cloud(cloud.points + shift, cloud.normals, cloud.colors)


def masks_of(cloud: Cloud) -> np.ndarray:
    """Return the masks (points, objects) of the nearest object, and of nothing for the room."""
    groups = [list(ROOM), *truth().values()]
    away = np.stack([np.min([_distance(cloud.points, b) for b in own], 0) for own in groups], 1)
    return np.argmin(away, axis=1)[:, None] == np.arange(1, len(groups))


def _distance(points: Float[np.ndarray, "n 3"], box: Corners) -> Float[np.ndarray, " n"]:
    low, high = np.array(box)
    outside = np.maximum(np.maximum(low - points, points - high), 0)
    inside = np.minimum(points - low, high - points).min(axis=1)
    return np.linalg.norm(outside, axis=1) + np.maximum(inside, 0)


def write_mask3d(folder: Path, masks: np.ndarray, rows: list[tuple[int, float]]) -> Path:
    (folder / "pred_mask").mkdir()
    with (folder / "scene0000_00.txt").open("w") as file:
        for k, (number, score) in enumerate(rows):
            np.savetxt(folder / f"pred_mask/scene0000_00_{k}.txt", masks[:, k], fmt="%d")
            file.write(f"pred_mask/scene0000_00_{k}.txt {number} {np.float32(score)}\n")
    return folder / "scene0000_00.txt"


def write_openmask3d(path: Path, masks: np.ndarray) -> Path:
    """Write what `torch.save(masks.astype(np.float16), path)` does."""
    with zipfile.ZipFile(path, "w") as archive:
        name = path.stem
        archive.writestr(f"{name}/data.pkl", pickle.dumps(masks.astype(np.float16), protocol=2))
        archive.writestr(f"{name}/byteorder", "little")
        archive.writestr(f"{name}/version", "3\n")
    return path


def assert_objects(found: list[Detection]) -> None:
    """Check that at least 95 % of the objects have a box at their place, and no other is there."""
    near = 0
    for own in truth().values():
        low = np.min([box[0] for box in own], axis=0)
        high = np.max([box[1] for box in own], axis=0)
        near += any(
            np.abs(one.box.center - (low + high) / 2).max() < 0.08
            and np.abs(np.sort(one.box.size) - np.sort(high - low)).max() < 0.12
            for one in found
        )
    assert near >= 0.95 * len(truth()), [(one.name, one.box) for one in found]
    assert len(found) <= len(truth())


def test_the_objects_of_mask3d_survive(room: Cloud, tmp_path: Path) -> None:
    masks = masks_of(room).astype(np.uint8)
    rows = [(number, 0.9 - 0.01 * k) for k, number in enumerate(CLASS.values())]
    # The decoder's best classes of each query: the same masks once more, with smaller scores.
    path = write_mask3d(tmp_path, np.hstack([masks, masks]), [*rows, *((5, 0.1) for _ in rows)])
    read = read_instances(path, len(room.points))
    assert len(read) == 2 * len(CLASS)
    single = without_duplicates(read, len(room.points))
    found = boxes(room, single, find_room(room))
    assert_objects(found)
    assert {one.label for one in found} >= {"refrigerator", "cabinet", "counter", "table"}
    assert "chair" not in {one.label for one in found}


def test_the_objects_of_openmask3d_survive(room: Cloud, tmp_path: Path) -> None:
    path = write_openmask3d(tmp_path / "scene_example_masks.pt", masks_of(room))
    read = read_instances(path, len(room.points))
    assert_objects(boxes(room, without_duplicates(read, len(room.points)), find_room(room)))


@pytest.mark.parametrize("tilt", [0.0, 3.0])
def test_the_boxes_of_omni3d_survive(room: Cloud, tmp_path: Path, tilt: float) -> None:
    rng = np.random.default_rng(2)
    frames, entries = [], []
    eyes = ((0.5, -2.5, 1.5), (-1.5, -2.2, 1.4), (-0.5, -2.8, 1.6))
    for k, eye in enumerate(eyes):
        T = look_at(eye, (-0.8, 0.5, 0.9))
        view = photograph(kitchen(), T)
        frames.append(Frame(f"frame-{k:06d}", view.color, view.depth, view.intrinsics, T))
        for number, own in enumerate(truth().values()):
            low = np.min([box[0] for box in own], axis=0)
            high = np.max([box[1] for box in own], axis=0)
            shift = rng.normal(0, 0.02, 3)
            corners = omni_corners(low + shift, high + shift, T, tilt)
            entries.append({
                "image_id": k, "category_id": number, "bbox": [1.0, 1.0, 20.0, 20.0],
                "score": 0.9 - 0.1 * k, "depth": 2.0, "bbox3D": corners.tolist(),
                "center_cam": corners.mean(axis=0).tolist(), "dimensions": [1.0, 1.0, 1.0],
            })  # fmt: skip
    path = tmp_path / "omni_instances_results.json"
    path.write_text(json.dumps(entries))
    meta = {
        "thing_classes": list(CLASS),
        "thing_dataset_id_to_contiguous_id": {str(k): k for k in range(len(CLASS))},
    }
    (tmp_path / "category_meta.json").write_text(json.dumps(meta))
    found = read_coco(path, frames, tmp_path / "category_meta.json").found
    read = boxes_in_images(found, frames)
    assert [one.label for one in read] == list(CLASS)
    assert_objects(boxes(room, read, find_room(room)))


def omni_corners(
    low: np.ndarray, high: np.ndarray, T_world_camera: np.ndarray, tilt: float
) -> Float[np.ndarray, "8 3"]:
    """Return the corners of a box in a camera's frame, tilted by an angle [deg]."""
    middle, half = (low + high) / 2, (high - low) / 2
    # In the box's own frame y points down.
    signs = [
        (-1, -1, -1), (1, -1, -1), (1, 1, -1), (-1, 1, -1),
        (-1, -1, 1), (1, -1, 1), (1, 1, 1), (-1, 1, 1),
    ]  # fmt: skip
    own = np.array(signs) * half[[0, 2, 1]]
    c, s = np.cos(np.radians(tilt)), np.sin(np.radians(tilt))
    R = np.array([[1.0, 0, 0], [0, 0, 1], [0, -1, 0]]) @ np.array(
        [[c, -s, 0], [s, c, 0], [0, 0, 1]]
    )
    return apply(invert(T_world_camera), own @ R.T + middle)


def test_points_far_beyond_the_spacing_are_outliers_at_any_density(room: Cloud) -> None:
    mask = np.flatnonzero(masks_of(room)[:, 0])
    rng = np.random.default_rng(3)
    stray = rng.uniform((1.0, -3.0, 1.2), (3.0, 0.0, 2.4), (5, 3))
    cloud = Cloud(
        np.vstack([room.points, stray]),
        np.vstack([room.normals, np.tile([1.0, 0, 0], (5, 1))]),
        np.vstack([room.colors, np.zeros((5, 3), np.uint8)]),
    )
    members = np.concatenate([mask, len(room.points) + np.arange(5)])
    (found,) = boxes(cloud, [Instance("fridge", 1.0, members)], RoomShell())
    assert not np.isin(found.members, len(room.points) + np.arange(5)).any()
    assert len(found.members) > 0.9 * len(mask)


def test_masks_without_members_and_of_other_objects_are_no_duplicates() -> None:
    own = [np.arange(0, 60), np.arange(40, 100), np.arange(0, 20), np.zeros(0, int)]
    items = [Instance(str(k), 0.5, members) for k, members in enumerate(own)]
    assert without_duplicates(items, 100) == items
    again = Instance("again", 0.4, np.arange(3, 60))
    assert without_duplicates([again, *items], 100) == items
    assert without_duplicates([], 100) == []


@pytest.mark.parametrize("kind", ["float16", "bool", "uint8", "float32", "int64"])
@pytest.mark.parametrize("order", ["C", "F"])
def test_an_array_of_numpy_in_a_torch_file_is_read_as_saved(
    tmp_path: Path, kind: str, order: str
) -> None:
    values = np.asarray(np.arange(600).reshape(300, 2) % 2, dtype=kind, order=order)
    path = tmp_path / "a_masks.pt"
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("a_masks/data.pkl", pickle.dumps(values, protocol=2))
    read = load_array(path)
    np.testing.assert_array_equal(read, values)
    assert read.dtype == values.dtype


class Attack:
    """Runs code when it is unpickled."""

    def __reduce__(self) -> tuple[object, ...]:
        return (print, ("attacked",))


def test_no_other_pickle_is_loaded_as_an_array(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    attack = np.array([Attack(), Attack()])
    programs = [pickle.dumps(what, 2) for what in (Attack(), attack, [1, 2], np.float16(1))]
    for program in (*programs, b"", b"\x80\x02.", pickle.dumps(np.eye(2), 2)[:-20]):
        path = tmp_path / "a.pt"
        with zipfile.ZipFile(path, "w") as archive:
            archive.writestr("a/data.pkl", program)
        assert load_array(path) is None
    assert "attacked" not in capsys.readouterr().out
    forged = pickle.dumps(np.eye(2), 2).replace(b"K\x02K\x02\x86", b"K\x02K\x03\x86")
    with zipfile.ZipFile(tmp_path / "b.pt", "w") as archive:
        archive.writestr("b/data.pkl", forged)
    with pytest.raises(FileFormatError, match=r"b\.pt: its array is damaged"):
        load_array(tmp_path / "b.pt")
