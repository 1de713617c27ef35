"""Laws of training: files of the shipped form, equal for equal seeds."""

from __future__ import annotations

from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from tests import optional
from training.fronts import generator, pool

from momapos.perception.reconstruction import decode

FACES = 6


@pytest.fixture(scope="module")
def faces(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Write a small pool of faces."""
    folder = tmp_path_factory.mktemp("faces")
    pool.fill(folder, generator.ORDINARY, seed=5, count=FACES, workers=1)
    return folder


def form(data: bytes) -> list[tuple[str, str, list[Any]]]:
    """Return names, types and shapes of a network's inputs and outputs."""
    session = optional.module("onnxruntime").InferenceSession(data)
    return [
        (one.name, one.type, one.shape) for one in (*session.get_inputs(), *session.get_outputs())
    ]


@pytest.mark.parametrize("which", ["face", "part"])
def test_training_writes_reproducible_networks_of_the_shipped_form(
    which: str, faces: Path, tmp_path: Path
) -> None:
    train = optional.module("training.fronts.train", "torch")
    fit = {"face": train.train_face, "part": train.train_part}[which]
    made = []
    for name in ("one", "again"):
        fit([faces, faces], tmp_path / f"{name}.onnx", train.Schedule(steps=3, batch=4), seed=3)
        made.append((tmp_path / f"{name}.onnx").read_bytes())
    assert made[0] == made[1]
    weights = (
        resources.files("momapos.perception.reconstruction") / "weights" / f"front_{which}.onnx"
    )
    assert form(made[0]) == form(weights.read_bytes())


def test_some_training_images_lack_lines_and_some_lack_relief(faces: Path) -> None:
    train = optional.module("training.fronts.train", "torch")
    codes = np.repeat(pool.Pool.read(faces).faces[:1], 200, axis=0)
    stack = train.augmented(np.random.default_rng(1), codes).numpy()
    assert np.abs(pool.unpacked(codes)[0, 5:]).max() > 0
    lines = np.abs(stack[:, 5:]).max(axis=(1, 2, 3)) > 0
    relief = stack[:, 4].max(axis=(1, 2)) > 0
    assert 0.35 < lines.mean() < 0.65
    assert 0.4 < relief.mean() < 0.7


def test_a_network_survives_writing_and_reading(tmp_path: Path) -> None:
    export = optional.module("training.fronts.export", "torch")
    networks = optional.module("training.fronts.networks", "torch")
    weights = resources.files("momapos.perception.reconstruction") / "weights" / "front_part.onnx"
    written, again = tmp_path / "written.onnx", tmp_path / "again.onnx"
    written.write_bytes(weights.read_bytes())
    export.write(export.read(written, networks.PartNetwork()), again)
    one, two = (outputs_of(path.read_bytes()) for path in (written, again))
    for name, value in one.items():
        np.testing.assert_array_equal(value, two[name])


def test_training_on_kinds_changes_nothing_but_kinds(faces: Path, tmp_path: Path) -> None:
    before, after = trained_further("part", "kinds", faces, tmp_path)
    for name in ("edges", "heat", "reach"):
        np.testing.assert_array_equal(before[name], after[name])
    assert np.abs(before["sure"] - after["sure"]).max() > 1e-4


def test_training_on_lifted_doors_changes_nothing_but_their_heat_and_the_front_score(
    faces: Path, tmp_path: Path
) -> None:
    before, after = trained_further("face", "lifts", faces, tmp_path)
    np.testing.assert_array_equal(before["reach"], after["reach"])
    assert (before["front"] != after["front"]).all()
    same = (before["heat"] == after["heat"]).all(axis=(0, 2, 3))
    assert list(np.array(decode.KINDS)[~same]) == ["door_up"]


def trained_further(
    which: str, more: str, faces: Path, folder: Path
) -> list[dict[str, np.ndarray]]:
    """Return a network's outputs after two steps, and after some steps of the last round."""
    train = optional.module("training.fronts.train", "torch")
    path, found = folder / "net.onnx", []
    for fit, steps in ((f"train_{which}", 2), (f"train_{more}", 3)):
        getattr(train, fit)([faces], path, train.Schedule(steps=steps, batch=4), seed=3)
        found.append(outputs_of(path.read_bytes()))
    return found


def outputs_of(data: bytes) -> dict[str, np.ndarray]:
    """Return a network's outputs for random noise."""
    session = optional.module("onnxruntime").InferenceSession(data)
    rng = np.random.default_rng(1)
    given = {
        one.name: rng.normal(size=[2 if n == "n" else n for n in one.shape]).astype(np.float32)
        for one in session.get_inputs()
    }
    values = session.run(None, given)
    return dict(zip([one.name for one in session.get_outputs()], values, strict=True))
