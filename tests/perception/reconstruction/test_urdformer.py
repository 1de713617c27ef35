"""URDFormer: its layers and peculiarities, its grid, and its authors' files."""

from __future__ import annotations

import itertools
import json
import math
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from hypothesis import assume, given, settings
from hypothesis import strategies as st
from jaxtyping import Float
from tests import optional
from tests.perception.reconstruction import urdformer_twin

from momapos.core.errors import FileFormatError, InputError, MissingExtraError, UrdfError
from momapos.model.records.scans import FaceImage, Front, Part
from momapos.perception.reconstruction.checkpoint import read_checkpoint
from momapos.perception.reconstruction.urdformer import (
    Prediction,
    UrdformerPredictor,
    boxes_of,
    decode,
    load_urdformer,
    prepare_image,
    to_parts,
)
from momapos.perception.reconstruction.urdformer_files import read_part_boxes, read_predicted_urdf
from momapos.perception.reconstruction.urdformer_format import (
    BASES,
    PARTS,
    SLOTS,
    STEPS,
    Logits,
    Network,
    Rectangle,
)

PHOTOS = ("label3", "label4", "label13", "label29", "label42", "label55")
CASE = Part("door_left", (0.0, 0.0, 0.5, 1.0), 0.9, handle=(0.4, 0.4, 0.45, 0.6))


def prediction(*rows: tuple[str, tuple[int, int], tuple[int, int], int]) -> Prediction:
    """Build one from rows of name, start, end and parent."""
    names, start, end, parents = zip(*rows, strict=True)
    scores = np.linspace(0.5, 0.9, len(rows))
    return Prediction(names, np.array(start), np.array(end), np.array(parents), scores, "cabinet")


def logits_of(shown: Prediction) -> Logits:
    """Build logits whose maxima are these, in the first slots."""
    rng = np.random.default_rng(0)
    out = Logits(
        start=rng.uniform(-1, 1, (SLOTS, 3, STEPS)),
        end=rng.uniform(-1, 1, (SLOTS, 3, STEPS)),
        part=rng.uniform(-1, 1, (SLOTS, len(PARTS))),
        parent=rng.uniform(-1, 1, (SLOTS, SLOTS + 1, 6)),
        base=np.zeros(len(BASES)),
    )
    for slot, name in enumerate(shown.names):
        for axis in range(2):
            out.start[slot, axis + 1, shown.start[slot, axis]] = 5.0
            out.end[slot, axis + 1, shown.end[slot, axis]] = 5.0
        out.part[slot, PARTS.index(name)] = 5.0
        out.parent[slot, shown.parents[slot] + 1, slot % 6] = 5.0
    out.base[BASES.index(shown.base)] = 1.0
    return out


def face(width: int = 40, height: int = 60) -> FaceImage:
    rng = np.random.default_rng(0)
    color = rng.integers(0, 256, (height, width, 3), dtype=np.uint8)
    return FaceImage(color, np.zeros((height, width), np.float32), 0.6, 0.9)


# ---------------------------------------------------------------- reading the output


def test_decoding_finds_the_largest_entries() -> None:
    shown = prediction(
        ("doorR", (12, 0), (6, 9), -1), ("knob", (10, 6), (11, 7), 0), ("none", (0, 0), (1, 1), 5)
    )
    read = decode(logits_of(shown), 3)
    assert read.names == shown.names
    assert read.base == "cabinet"
    np.testing.assert_array_equal(read.start, shown.start)
    np.testing.assert_array_equal(read.end, shown.end)
    np.testing.assert_array_equal(read.parents, [-1, 0, -2])  # the third sits on an empty slot
    assert ((read.scores > 0.9) & (read.scores < 1.0)).all()


def test_a_score_is_the_probability_of_the_class() -> None:
    logits = logits_of(prediction(("drawer", (0, 0), (6, 3), -1)))
    logits.part[0] = math.log(0.05)
    logits.part[0, PARTS.index("drawer")] = math.log(0.6)
    assert decode(logits, 1).scores[0] == pytest.approx(0.6)


def test_parts_lie_on_the_grid_with_heights_from_below() -> None:
    shown = prediction(
        ("drawer", (0, 9), (6, 12), -1),
        ("doorL", (0, 0), (6, 9), -1),
        ("doorR", (12, 0), (6, 9), -1),
        ("doorD", (6, 9), (12, 12), -1),
    )
    parts = to_parts(shown, np.full((4, 4), 0.1))
    assert [part.kind for part in parts] == ["drawer", "door_left", "door_right", "door_down"]
    boxes = np.array([part.box for part in parts])
    np.testing.assert_allclose(
        boxes, [[0, 0, 0.5, 0.25], [0, 0.25, 0.5, 1], [0.5, 0.25, 1, 1], [0.5, 0, 1, 0.25]]
    )


def test_handles_are_placed_from_the_hinge_of_their_part() -> None:
    shown = prediction(
        ("doorL", (0, 0), (6, 12), -1),
        ("doorR", (12, 0), (6, 12), -1),
        ("knob", (10, 6), (11, 7), 0),
        ("handle", (10, 3), (11, 7), 1),
    )
    boxes = np.array([[0, 0, 1, 0.5], [0, 0.5, 1, 0.5], [0.1, 0.1, 0.04, 0.02], [0, 0, 0.06, 0.02]])
    left, right = to_parts(shown, boxes)
    np.testing.assert_allclose(left.handle, (5 / 12 - 0.01, 0.48, 5 / 12 + 0.01, 0.52))
    np.testing.assert_allclose(right.handle, (7 / 12 - 0.01, 0.72, 7 / 12 + 0.01, 0.78))


def test_the_handle_of_an_oven_door_is_where_the_authors_put_it() -> None:
    shown = prediction(("oven_door", (0, 0), (12, 9), -1), ("handle", (1, 1), (2, 2), 0))
    (door,) = to_parts(shown, np.array([[0.25, 0, 0.75, 1], [0, 0, 0.02, 0.4]]))
    assert door.handle is not None
    np.testing.assert_allclose(door.handle, (0.3, 0.365, 0.7, 0.385))


def test_a_handle_without_a_part_goes_to_the_smallest_one_around_it() -> None:
    boxes = np.array([[0, 0, 1, 1], [0.5, 0, 0.5, 0.5], [0.7, 0.2, 0.1, 0.1]])
    shown = prediction(
        ("doorL", (0, 0), (12, 12), -1),
        ("drawer", (0, 0), (6, 6), -1),
        ("handle", (6, 6), (7, 7), -2),
    )
    door, drawer = to_parts(shown, boxes)
    assert door.handle is None
    assert drawer.handle is not None
    np.testing.assert_allclose(drawer.handle, (0.2, 0.7, 0.3, 0.8))


def test_classes_without_a_counterpart_are_dropped() -> None:
    shown = prediction(
        ("none", (0, 0), (6, 6), -1),
        ("drawer", (3, 3), (3, 6), -1),
        ("doorL", (0, 0), (6, 6), -1),
        ("drawer", (1, 1), (2, 2), 2),
    )
    assert [part.kind for part in to_parts(shown, np.full((4, 4), 0.1))] == ["door_left"]


def test_the_more_probable_of_two_handles_is_kept() -> None:
    boxes = np.array([[0, 0, 1, 1], [0, 0, 0.1, 0.1], [0, 0, 0.2, 0.2]])
    shown = prediction(
        ("drawer", (0, 0), (12, 12), -1), ("handle", (6, 6), (7, 7), 0), ("knob", (6, 6), (7, 7), 0)
    )
    (drawer,) = to_parts(shown, boxes)
    assert drawer.handle is not None
    assert drawer.handle[2] - drawer.handle[0] == pytest.approx(0.2)  # scores rise by index


def rows() -> st.SearchStrategy[Any]:
    mark = st.integers(0, STEPS - 1)
    place = st.tuples(mark, mark)
    return st.lists(
        st.tuples(st.sampled_from(PARTS), place, place, st.integers(-2, 5)), min_size=6, max_size=6
    )


@given(rows(), st.integers(0, 2**32 - 1))
@settings(max_examples=150)
def test_parts_lie_on_the_grid_and_handles_on_their_parts(shown: Any, seed: int) -> None:
    rng = np.random.default_rng(seed)
    boxes = rng.uniform(0.0, 0.5, (6, 4))
    for part in to_parts(prediction(*shown), boxes):
        marks = 12 * np.array(part.box)
        np.testing.assert_allclose(marks, np.round(marks), atol=1e-9)
        left, top, right, bottom = part.box
        assert 0.0 <= left < right <= 1.0
        assert 0.0 <= top < bottom <= 1.0
        if part.handle is not None:
            assert left - 1e-9 <= part.handle[0] <= part.handle[2] <= right + 1e-9
            assert top - 1e-9 <= part.handle[1] <= part.handle[3] <= bottom + 1e-9


@given(rows())
@settings(max_examples=100)
def test_a_mirrored_front_has_mirrored_parts(shown: Any) -> None:
    """Marks of handles count from the hinge, so on doors they are their own mirror image."""
    assume(all(row[0] != "washer_door" for row in shown))  # it knows no other hinge side
    swap = {"doorL": "doorR", "doorR": "doorL"}
    mirrored = []
    for name, start, end, parent in shown:
        owner = shown[parent][0] if parent >= 0 else ""
        hinged = name in ("handle", "knob") and owner in swap
        flip = (lambda m: m) if hinged else (lambda m: (STEPS - 1 - m[0], m[1]))
        mirrored.append((swap.get(name, name), flip(start), flip(end), parent))
    boxes = np.tile([0.4, 0.45, 0.2, 0.1], (6, 1))
    one, other = to_parts(prediction(*shown), boxes), to_parts(prediction(*mirrored), boxes)
    turned = {"door_left": "door_right", "door_right": "door_left"}
    assert [turned.get(part.kind, part.kind) for part in one] == [part.kind for part in other]
    for a, b in zip(one, other, strict=True):
        np.testing.assert_allclose(mirror(a.box), b.box, atol=1e-9)
        assert (a.handle is None) == (b.handle is None)
        if a.handle is not None and b.handle is not None:
            np.testing.assert_allclose(mirror(a.handle), b.handle, atol=1e-9)


def mirror(box: Rectangle) -> Rectangle:
    return 1.0 - box[2], box[1], 1.0 - box[0], box[3]


# ---------------------------------------------------------------- the predictor


def test_the_network_gets_the_boxes_of_the_other_predictor() -> None:
    asked: list[np.ndarray] = []

    def network(image: np.ndarray, boxes: np.ndarray) -> Logits:
        assert image.shape == (3, 224, 224)
        assert image.dtype == boxes.dtype == np.float32
        asked.append(boxes)
        door = ("doorR", (12, 0), (6, 12), -1)
        return logits_of(prediction(door, ("knob", (10, 6), (11, 7), 0)))

    front = UrdformerPredictor(network, lambda _face, _label: Front(0.8, (CASE,)))(face(), "fridge")
    assert front.score == 0.8
    assert [part.kind for part in front.parts] == ["door_right"]
    assert front.parts[0].handle is not None
    expected = [[0, 0, 1, 0.5], [0.4, 0.4, 0.2, 0.05]]
    np.testing.assert_allclose(asked[0][:2], expected, atol=1e-6)
    assert not asked[0][2:].any()


def test_the_network_does_not_run_without_boxes() -> None:
    def network(_image: np.ndarray, _boxes: np.ndarray) -> Logits:
        raise AssertionError("asked")

    assert UrdformerPredictor(network, lambda _f, _l: Front(0.3, ()))(face(), "x") == Front(0.3, ())
    assert UrdformerPredictor(network, np.zeros((0, 4)))(face(), "x") == Front(1.0, ())


def test_only_the_best_of_too_many_parts_are_used() -> None:
    def network(_image: np.ndarray, boxes: np.ndarray) -> Logits:
        assert boxes[:, 3].min() > 0.0
        return logits_of(prediction(*[("drawer", (0, 0), (6, 6), -1)] * SLOTS))

    many = [Part("drawer", (0.0, 0.0, 0.01 * k, 0.1), k / 50) for k in range(1, 41)]
    assert boxes_of(Front(1.0, tuple(many)))[0, 3] == pytest.approx(0.4)
    found = UrdformerPredictor(network, lambda _f, _l: Front(1.0, tuple(many)))(face(), "cabinet")
    assert len(found.parts) == SLOTS
    with pytest.raises(InputError, match="32 part boxes, not 33"):
        UrdformerPredictor(network, np.full((33, 4), 0.1))(face(), "cabinet")


def test_an_image_is_resized_and_normalized() -> None:
    color = np.zeros((50, 200, 3), np.uint8)
    color[:, :100] = (255, 0, 0)
    color[:, 100:] = (0, 0, 255)
    image = prepare_image(color)
    assert image.shape == (3, 224, 224)
    restored = image * np.reshape([0.229, 0.224, 0.225], (3, 1, 1))
    restored += np.reshape([0.485, 0.456, 0.406], (3, 1, 1))
    np.testing.assert_allclose(restored[:, 10, 20], (1, 0, 0), atol=1e-6)
    np.testing.assert_allclose(restored[:, 200, 200], (0, 0, 1), atol=1e-6)


# ---------------------------------------------------------------- the network


def expected_names() -> set[str]:
    """List the names in the authors' checkpoint, layer by layer."""

    def linear(*layers: str) -> list[str]:
        return [f"{layer}.{kind}" for layer in layers for kind in ("weight", "bias")]

    def stack(name: str, count: int) -> list[str]:
        return linear(*(f"{name}.{2 * index}" for index in range(count)))

    names = ["img_backbone.cls_token", "img_backbone.pos_embed", "embedding.weight"]
    names += linear("img_backbone.patch_embed.proj", "img_backbone.norm", "fc2")
    names += linear(*(f"pe_layer.fc{axis}" for axis in "xywh"), "norm_layer", "norm_layer1")
    names += stack("fc1", 3) + stack("img_fc1", 2) + stack("img_fc2", 2) + stack("bbox_fc", 3)
    for end, axis in itertools.product(("head", "end"), "xyz"):
        names += stack(f"position_{end}_{axis}", 2)
    for head in ("parent", "child", "mesh_head", "base_mesh_head"):
        names += stack(head, 2)
    for k in range(12):
        seen = ("norm1", "attn.qkv", "attn.proj", "norm2", "mlp.fc1", "mlp.fc2")
        names += linear(*(f"img_backbone.blocks.{k}.{layer}" for layer in seen))
        told = ("norm1", "qkv", "attn.out_proj", "norm2", "mlp.lin1", "mlp.lin2")
        names += linear(*(f"blocks.{k}.{layer}" for layer in told))
        names += [f"blocks.{k}.attn.in_proj_weight", f"blocks.{k}.attn.in_proj_bias"]
    return set(names)


@pytest.fixture(scope="module")
def checkpoint(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Path]:
    """Return a file like the authors', with random weights."""
    torch = optional.module("torch")
    from momapos.perception.reconstruction.urdformer_model import Urdformer

    torch.manual_seed(0)
    state = Urdformer().state_dict()
    for value in state.values():
        value += 0.02 * torch.randn_like(value)  # none is left at 0 or 1
    path = tmp_path_factory.mktemp("urdformer") / "part.pth"
    torch.save({"model_state_dict": state, "epoch": 3}, path)
    yield path
    path.unlink()


def test_the_network_has_the_tensors_of_the_checkpoint(checkpoint: Path) -> None:
    state = read_checkpoint(checkpoint)
    assert len(state) == 393
    assert set(state) == expected_names()
    assert round(sum(value.numel() for value in state.values()) / 1e6, 1) == 80.9


@pytest.fixture(scope="module")
def network(checkpoint: Path) -> Network:
    return load_urdformer(checkpoint)


def asked() -> tuple[np.ndarray, np.ndarray]:
    """Return a prepared image and the boxes of three parts in their slots."""
    boxes = np.zeros((SLOTS, 4), np.float32)
    boxes[:3] = [[0, 0, 1, 0.5], [0, 0.5, 1, 0.5], [0.4, 0.4, 0.2, 0.05]]
    return prepare_image(face().color), boxes


def test_the_network_agrees_with_one_in_plain_numpy(checkpoint: Path, network: Network) -> None:
    image, boxes = asked()
    weights = {
        name: value.numpy().astype(float) for name, value in read_checkpoint(checkpoint).items()
    }
    expected = urdformer_twin.answers(weights, image.astype(float), boxes.astype(float))
    for name, value in network(image, boxes)._asdict().items():
        assert value.shape == expected[name].shape
        np.testing.assert_allclose(value, expected[name], atol=1e-4 * np.std(expected[name]))


def test_answers_are_finite_and_the_same_each_time(network: Network) -> None:
    image, boxes = asked()
    first, again = network(image, boxes), network(image, boxes)
    shapes = [value.shape for value in first]
    assert shapes == [(32, 3, 13), (32, 3, 13), (32, 9), (32, 33, 6), (8,)]
    for one, other in zip(first, again, strict=True):
        assert np.isfinite(one).all()
        np.testing.assert_array_equal(one, other)


def test_the_order_of_the_boxes_does_not_matter(network: Network) -> None:
    image, boxes = asked()
    order = np.random.default_rng(1).permutation(SLOTS)
    first, shuffled = network(image, boxes), network(image, boxes[order])
    np.testing.assert_allclose(shuffled.part, first.part[order], atol=1e-5)
    children = first.parent[order][:, np.concatenate(([0], order + 1))]
    np.testing.assert_allclose(shuffled.parent, children, atol=1e-5)


def test_a_checkpoint_of_another_network_is_refused(tmp_path: Path) -> None:
    torch = optional.module("torch")
    path = tmp_path / "global.pth"
    torch.save({"model_state_dict": {"head.weight": torch.ones(2)}}, path)
    with pytest.raises(FileFormatError) as caught:
        load_urdformer(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: does not fit the network's 393 tensors: 393 missing (")
    assert message.endswith("1 unexpected (head.weight)")
    assert "\n" not in message


def test_torch_is_loaded_only_with_a_checkpoint() -> None:
    modules = ("urdformer", "urdformer_files", "checkpoint", "templates")
    loading = "; ".join(f"import momapos.perception.reconstruction.{name}" for name in modules)
    code = f"import sys; {loading}; sys.exit('torch' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_an_error_about_a_missing_package_names_it(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(sys.modules, "torch", None)
    with pytest.raises(MissingExtraError, match="torch is not installed; pip install"):
        load_urdformer(Path("part.pth"))
    monkeypatch.setitem(sys.modules, "PIL", None)
    with pytest.raises(MissingExtraError, match="is not installed; pip install"):
        prepare_image(face().color)


def pooled_by_hand(
    cells: Float[np.ndarray, "w r c"], box: Float[np.ndarray, "4"], bins: int, scale: float
) -> Float[np.ndarray, "w bins bins"]:
    """Pool one region with loops: two by two bilinear samples in each bin, no alignment."""

    def sample(row: float, column: float) -> Float[np.ndarray, " w"]:
        if not (-1 <= row <= cells.shape[1] and -1 <= column <= cells.shape[2]):
            return np.zeros(len(cells))
        row = min(max(row, 0.0), cells.shape[1] - 1.0)
        column = min(max(column, 0.0), cells.shape[2] - 1.0)
        total = np.zeros(len(cells))
        for i, j in itertools.product((0, 1), repeat=2):
            r, c = math.floor(row) + i, math.floor(column) + j
            share = (1 - abs(row - r)) * (1 - abs(column - c))
            if share > 0.0:
                total += share * cells[:, r, c]
        return total

    left, top, right, bottom = box * scale
    width, height = max(right - left, 1.0) / bins, max(bottom - top, 1.0) / bins
    out = np.zeros((len(cells), bins, bins))
    for r, c in itertools.product(range(bins), repeat=2):
        for i, j in itertools.product((0.25, 0.75), repeat=2):
            out[:, r, c] += sample(top + (r + i) * height, left + (c + j) * width) / 4
    return out


def test_pooling_agrees_with_samples_taken_one_by_one() -> None:
    torch = optional.module("torch")
    from momapos.perception.reconstruction.urdformer_model import roi_align

    rng = np.random.default_rng(2)
    cells = rng.normal(size=(3, 7, 9))
    corners = rng.uniform(-60, 200, (20, 2))
    boxes = np.hstack((corners, corners + rng.uniform(-20, 150, (20, 2))))
    for scale in (1 / 16, 1.0):
        ours = roi_align(torch.tensor(cells), torch.tensor(boxes), 5, scale, samples=2).numpy()
        for mine, box in zip(ours, boxes, strict=True):
            np.testing.assert_allclose(mine, pooled_by_hand(cells, box, 5, scale), atol=1e-5)


def test_regions_are_scaled_twice_and_have_their_axes_exchanged() -> None:
    torch = optional.module("torch")
    from momapos.perception.reconstruction.urdformer_model import regions_of, roi_align

    boxes = torch.tensor([[0.0, 0.0, 1.0, 1.0], [0.75, 0.1, 0.2, 0.4]])
    regions = regions_of(boxes)
    # The second in pixels: top 168, left 22, height 44, width 89; 16 pixels are a cell.
    assert regions.tolist() == [[0, 0, 14, 14], [10, 1, 13, 6]]
    rng = np.random.default_rng(3)
    many = torch.tensor(rng.uniform(0.0, 0.5, (SLOTS, 4)), dtype=torch.float32)
    cells = torch.tensor(rng.normal(size=(2, 14, 14)), dtype=torch.float32)
    near = cells.clone()
    near[:, 3:, :] = near[:, :, 3:] = 0.0
    pool = [roi_align(c, regions_of(many), 14, 1 / 16, 2) for c in (cells, near)]
    assert torch.equal(*pool)  # only the first cells of the map are ever seen
    low = roi_align(cells, regions_of(torch.tensor([[0.5, 0.0, 0.4, 0.1]])), 14, 1 / 16, 2)
    shifted = roi_align(cells, torch.tensor([[7.0, 0.0, 12.0, 1.0]]), 14, 1 / 16, 2)
    assert torch.equal(low, shifted)  # a box in the lower half moves along the columns


# ---------------------------------------------------------------- files


def labeled(path: Path) -> Float[np.ndarray, "n 4"]:
    """Read hand-labeled boxes as rectangles on the front, which is what all of them span."""
    top, left, height, width = read_part_boxes(path).T
    corners = np.stack((left, top, left + width, top + height), axis=-1)
    low, high = corners[:, :2].min(axis=0), corners[:, 2:].max(axis=0)
    return (corners - np.tile(low, 2)) / np.tile(high - low, 2)


def errors_to(labels: Float[np.ndarray, "n 4"], boxes: Any) -> Float[np.ndarray, " parts"]:
    """Largest error of a side, to the nearest labeled rectangle."""
    gaps = np.abs(np.asarray(boxes, float)[:, None] - labels).max(axis=-1)
    return gaps.min(axis=-1)


def test_the_authors_urdfs_match_the_labels_of_their_photos(shared: Path) -> None:
    """Most parts lie within 1.5 steps of the grid; in a frame that is mirrored they do not.

    Half of the cabinets are their own mirror image, so those do not fall to nothing.
    """
    errors: dict[str, list[float]] = {"as read": [], "left for right": [], "upside down": []}
    for name in PHOTOS:
        labels = labeled(shared / "cabinet_photos" / f"{name}.boxes.json")
        boxes = [p.box for p in read_predicted_urdf(shared / "cabinet_photos" / f"{name}.urdf")]
        errors["as read"] += errors_to(labels, boxes).tolist()
        errors["left for right"] += errors_to(labels, [mirror(box) for box in boxes]).tolist()
        turned = [(a, 1 - d, c, 1 - b) for a, b, c, d in boxes]
        errors["upside down"] += errors_to(labels, turned).tolist()
    within = {frame: float(np.mean(np.array(e) < 1.5 / 12)) for frame, e in errors.items()}
    assert within["as read"] > 0.85
    assert max(within["left for right"], within["upside down"]) < 0.65


def test_handles_in_the_authors_urdfs_lie_near_labeled_ones(shared: Path) -> None:
    """That their height and side count from the hinge is seen in the photos."""
    near: list[bool] = []
    for name in PHOTOS:
        labels = labeled(shared / "cabinet_photos" / f"{name}.boxes.json")
        small = labels[np.prod(labels[:, 2:] - labels[:, :2], axis=-1) < 0.02]
        centers = (small[:, :2] + small[:, 2:]) / 2
        for part in read_predicted_urdf(shared / "cabinet_photos" / f"{name}.urdf"):
            if part.handle is not None:
                handle = np.array(part.handle)
                gap = np.linalg.norm(centers - (handle[:2] + handle[2:]) / 2, axis=-1)
                near.append(bool(gap.min() < 1 / 12))
    assert len(near) > 25
    assert np.mean(near) > 0.75


def test_each_photo_has_the_visible_kinds(shared: Path) -> None:
    kinds = [p.kind for p in read_predicted_urdf(shared / "cabinet_photos" / "label13.urdf")]
    assert kinds == ["drawer", "drawer", "door_left", "door_right"]


def predicted_urdf(path: Path, parts: list[tuple[str, str, str, str]], roll: float = 0.0) -> Path:
    """Write links as URDFormer does: name, parent, position and mesh scale of each."""
    text = ["<robot name='r'>", link("base_link", "../meshes/cabinet.obj", "1 1 2")]
    for index, (name, parent, xyz, scale) in enumerate(parts):
        text += [
            link(f"{name}{index}", f"../meshes/parts/{name}.obj", scale),
            f"<joint name='j{index}' type='revolute'><parent link='{parent}'/>"
            f"<child link='{name}{index}'/><origin xyz='{xyz}' rpy='{roll} 0 0'/></joint>",
        ]
    path.write_text("".join([*text, "</robot>"]))
    return path


def link(name: str, mesh: str, scale: str) -> str:
    shape = f"<geometry><mesh filename='{mesh}' scale='{scale}'/></geometry>"
    return f"<link name='{name}'><visual>{shape}</visual></link>"


def test_every_kind_is_read_from_its_own_corner(tmp_path: Path) -> None:
    """The base is twice as high as wide, as the authors write a fridge."""
    parts = [
        ("drawer", "base_link", "0 0 1.5", "1 1.98 1.98"),
        ("doorR", "base_link", "0 1 0", "1 1.99 5.99"),
        ("doorU", "base_link", "0 0.5 2", "1 2 2"),
        ("oven_door", "base_link", "0 0 0", "1 2 4"),
        ("none", "base_link", "0 0 0", "1 2 4"),
        ("drawer", "doorR1", "0 0 0", "1 2 4"),
        ("knob", "doorR1", "0 -0.25 0.75", "1 1 1"),
        ("handle", "base_link", "0 0 0", "1 1 1"),
    ]
    read = read_predicted_urdf(predicted_urdf(tmp_path / "p.urdf", parts))
    assert [part.kind for part in read] == ["drawer", "door_right", "door_up", "door_down"]
    np.testing.assert_allclose(
        [part.box for part in read],
        [(0, 0, 0.5, 0.25), (0.5, 0.25, 1, 1), (0.5, 0, 1, 0.25), (0, 0.5, 0.5, 1)],
        atol=1e-9,
    )
    knob = np.array(read[1].handle)
    np.testing.assert_allclose((knob[:2] + knob[2:]) / 2, (0.75, 0.625))
    assert knob[3] - knob[1] == pytest.approx((knob[2] - knob[0]) / 2)
    assert [part.handle is None for part in read] == [True, False, True, True]


def test_a_handle_on_its_side_is_wide(tmp_path: Path) -> None:
    parts = [
        ("drawer", "base_link", "0 0 0", "1 4 4"),
        ("handle", "drawer0", "0 0.5 0.5", "1 1 1"),
    ]
    for roll, wide in ((0.0, False), (math.pi / 2, True)):
        (drawer,) = read_predicted_urdf(predicted_urdf(tmp_path / "p.urdf", parts, roll))
        left, top, right, bottom = np.array(drawer.handle) * (1, 2, 1, 2)
        assert (right - left > bottom - top) == wide


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "not well-formed"),
        ("<robot", "not well-formed"),
        ("<sdf/>", "must be a <robot>"),
        ("<!DOCTYPE r [<!ENTITY a 'b'>]><robot>&a;</robot>", "entities"),
        ("<robot name='r'/>", "must have one root link, not 0"),
        ("<robot><link name='a'/></robot>", "link 'a' has no mesh"),
        ("<robot>" + link("a", "m.obj", "1 2") + "</robot>", "must be 3 finite numbers"),
        ("<robot>" + link("a", "m.obj", "1 nan 1") + "</robot>", "must be 3 finite numbers"),
        ("<robot>" + link("a", "m.obj", "1 0 1") + "</robot>", "no width or height"),
        ("<robot><joint name='j'/></robot>", "joint 'j' lacks"),
    ],
)
def test_a_urdf_that_is_not_urdformers_is_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "p.urdf"
    path.write_text(text)
    with pytest.raises(UrdfError) as caught:
        read_predicted_urdf(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_written_boxes_are_read_unchanged(tmp_path: Path) -> None:
    path = tmp_path / "boxes.json"
    rows = [[0.1, 0.2, 0.3, 0.4], [0.0, 0.0, 1.0, 1.0]]
    path.write_text(json.dumps({"part_boxes_yxhw_normalized": rows}))
    np.testing.assert_array_equal(read_part_boxes(path), rows)
    path.write_text('{"part_boxes_yxhw_normalized": []}')
    assert read_part_boxes(path).shape == (0, 4)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("", "damaged JSON"),
        ("[" * 100_000, "damaged JSON"),
        ("[]", "'part_boxes_yxhw_normalized' must be a list"),
        ('{"part_boxes_yxhw_normalized": 3}', "must be a list"),
        ('{"part_boxes_yxhw_normalized": [[0, 0, 1]]}', "box 0 must be top, left, height, width"),
        ('{"part_boxes_yxhw_normalized": [[0, 0, 1, 1], [0, 0.5, 1, 1]]}', "box 1 must be"),
        ('{"part_boxes_yxhw_normalized": [[0, 0, 0, 1]]}', "box 0 must be"),
        ('{"part_boxes_yxhw_normalized": [[NaN, 0, 0.5, 1]]}', "box 0 must be"),
        ('{"part_boxes_yxhw_normalized": [["0", 0, 0.5, 1]]}', "box 0 must be"),
        (json.dumps({"part_boxes_yxhw_normalized": [[0, 0, 1, 1]] * 33}), "at most 32"),
    ],
)
def test_damaged_boxes_are_refused(tmp_path: Path, text: str, said: str) -> None:
    path = tmp_path / "boxes.json"
    path.write_text(text)
    with pytest.raises(FileFormatError) as caught:
        read_part_boxes(path)
    assert str(caught.value).startswith(f"{path}: ")
    assert said in str(caught.value)


def test_absent_files_are_named(tmp_path: Path) -> None:
    with pytest.raises(FileFormatError, match=r"absent\.json: no such file"):
        read_part_boxes(tmp_path / "absent.json")
    with pytest.raises(UrdfError, match=r"absent\.urdf: no such file"):
        read_predicted_urdf(tmp_path / "absent.urdf")
