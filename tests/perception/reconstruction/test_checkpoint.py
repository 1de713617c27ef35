"""Untrusted weights are read or refused in one line, and never run."""

from __future__ import annotations

import os
import zipfile
from pathlib import Path
from typing import Any

import pytest
from tests import optional

from momapos.core.errors import FileFormatError
from momapos.perception.reconstruction.checkpoint import load_weights, read_checkpoint

if optional.has("torch"):
    import torch

pytestmark = optional.needs("torch", optional.has("torch"))


class Trap:
    """Touches a file when it is unpickled."""

    def __init__(self, touched: Path) -> None:
        self.touched = touched

    def __reduce__(self) -> tuple[Any, ...]:
        return os.mkdir, (str(self.touched),)


def saved(path: Path, content: object) -> Path:
    torch.save(content, path)
    return path


def refusal(path: Path) -> str:
    """Read the file and return its one-line error."""
    with pytest.raises(FileFormatError) as caught:
        read_checkpoint(path)
    message = str(caught.value)
    assert message.startswith(f"{path}: ")
    assert "\n" not in message
    assert len(message) < len(str(path)) + 250
    return message


def test_saved_tensors_are_read_unchanged(tmp_path: Path) -> None:
    weights = {"a.weight": torch.randn(3, 2), "a.bias": torch.zeros(3)}
    path = saved(tmp_path / "w.pth", {"model_state_dict": weights, "epoch": 7, "loss": 0.5})
    read = read_checkpoint(path)
    assert list(read) == list(weights)
    assert all(torch.equal(read[name], weights[name]) for name in weights)


def test_a_checkpoint_that_would_run_code_is_refused_and_does_not_run(tmp_path: Path) -> None:
    touched = tmp_path / "touched"
    for content in (Trap(touched), {"model_state_dict": {"a": Trap(touched)}}):
        message = refusal(saved(tmp_path / "evil.pth", content))
        assert "would run code" in message
        assert "mkdir" in message
    assert not touched.exists()


def test_a_whole_pickled_network_is_refused(tmp_path: Path) -> None:
    assert "Linear" in refusal(saved(tmp_path / "net.pth", torch.nn.Linear(2, 2)))


def test_a_truncated_file_is_refused(tmp_path: Path) -> None:
    whole = saved(tmp_path / "w.pth", {"model_state_dict": {"a": torch.ones(500)}}).read_bytes()
    cut = tmp_path / "cut.pth"
    for share in (0.0, 0.1, 0.5, 0.9, 0.99):
        cut.write_bytes(whole[: int(share * len(whole))])
        assert "cut off" in refusal(cut)


def test_files_of_another_kind_are_refused(tmp_path: Path) -> None:
    assert "no such file" in refusal(tmp_path / "absent.pth")
    assert "is a folder" in refusal(tmp_path)
    text = tmp_path / "text.pth"
    text.write_text("weights, believe me\n" * 50)
    assert "not written by torch.save" in refusal(text)
    with zipfile.ZipFile(tmp_path / "other.pth", "w") as archive:
        archive.writestr("a.txt", "hello")
    assert "damaged" in refusal(tmp_path / "other.pth")


def test_an_archive_that_grows_when_it_is_unpacked_is_refused(tmp_path: Path) -> None:
    plain = saved(tmp_path / "w.pth", {"model_state_dict": {"a": torch.zeros(100_000)}})
    packed = tmp_path / "packed.pth"
    with (
        zipfile.ZipFile(plain) as source,
        zipfile.ZipFile(packed, "w", zipfile.ZIP_DEFLATED) as target,
    ):
        for name in source.namelist():
            target.writestr(name, source.read(name))
    assert "compressed" in refusal(packed)


@pytest.mark.filterwarnings("ignore:Detected pickle protocol")
def test_a_damaged_pickle_raises_only_our_errors(tmp_path: Path) -> None:
    """The result is one of our errors or a dictionary."""
    plain = saved(tmp_path / "w.pth", {"model_state_dict": {"a": torch.ones(3)}})
    with zipfile.ZipFile(plain) as source:
        entries = {name: source.read(name) for name in source.namelist()}
    pickled = next(name for name in entries if name.endswith("data.pkl"))
    refused = 0
    for at in range(len(entries[pickled])):
        forged = bytearray(entries[pickled])
        forged[at] ^= 0x55
        path = tmp_path / "forged.pth"
        with zipfile.ZipFile(path, "w") as target:
            for name, data in (entries | {pickled: bytes(forged)}).items():
                target.writestr(name, data)
        try:
            read_checkpoint(path)
        except FileFormatError:
            refused += 1
    assert refused > len(entries[pickled]) / 3


def test_an_error_about_a_missing_entry_lists_the_entries(tmp_path: Path) -> None:
    bare = saved(tmp_path / "w.pth", {f"layer{i}.weight": torch.ones(1) for i in range(9)})
    message = refusal(bare)
    assert "'model_state_dict'" in message
    assert "layer0.weight, layer1.weight, layer2.weight and 6 more" in message
    assert "list" in refusal(saved(tmp_path / "l.pth", [1, 2]))
    mixed = saved(tmp_path / "m.pth", {"model_state_dict": {"a": torch.ones(1), "b": "text"}})
    assert "tensors alone, not b" in refusal(mixed)


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"weight": None}, "1 missing (weight)"),
        ({"extra": [1.0], "more": [2.0]}, "2 unexpected (extra, more)"),
        ({"weight": [[1.0]]}, "weight has shape (1, 1), not (2, 3)"),
        ({"bias": [1.0, float("nan")]}, "bias must hold finite"),
        ({"bias": [1, 2]}, "bias must hold finite"),
    ],
)
def test_weights_that_do_not_fit_change_nothing(change: dict[str, Any], said: str) -> None:
    net = torch.nn.Linear(3, 2)
    before = {name: value.clone() for name, value in net.state_dict().items()}
    weights = {name: value + 1.0 for name, value in before.items()}
    for name, value in change.items():
        if value is None:
            del weights[name]
        else:
            weights[name] = torch.tensor(value)
    with pytest.raises(FileFormatError) as caught:
        load_weights(net, weights, Path("part.pth"))
    assert str(caught.value).startswith("part.pth: ")
    assert said in str(caught.value)
    assert all(torch.equal(net.state_dict()[name], before[name]) for name in before)
