"""Read the weights of a network from a file that comes from a stranger.

A checkpoint is a pickle inside a zip archive, and a pickle can run code. torch's reader for weights
alone refuses every name but those of tensors; this module guards the archive around it, and turns
all that can go wrong into one line.
"""

from __future__ import annotations

import re
import zipfile
from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.errors import FileFormatError, require

if TYPE_CHECKING:
    from torch import Tensor, nn

MAX_CHECKPOINT_BYTES = 4_000_000_000
"""Weights, and an optimizer's two moments of each, fit several times."""
NAMED = 3
"""How many names an error lists."""
_GLOBAL = re.compile(r"GLOBAL ([\w.]{1,100})")


def read_checkpoint(path: Path, key: str = "model_state_dict") -> dict[str, Tensor]:
    """Read the named tensors of a checkpoint, on the CPU, running none of its code.

    Args:
        path: A file that `torch.save` wrote.
        key: The entry that holds the tensors.

    Raises:
        FileFormatError: The file is absent, no archive of torch, damaged, or holds more than
            tensors and plain values; or it has no such entry.
        MissingExtraError: torch is not installed.
    """
    with require("train"):
        import torch
    _check_archive(path)
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # a forged pickle can make its reader raise anything
        raise FileFormatError(f"{path}: {_reason(error)}") from error
    if not isinstance(content, dict) or not isinstance(content.get(key), dict):
        held = _first(map(str, content)) if isinstance(content, dict) else type(content).__name__
        raise FileFormatError(f"{path}: has no {key!r} with the weights; it holds {held}")
    weights = content[key]
    strange = [name for name, value in weights.items() if not isinstance(value, torch.Tensor)]
    if strange:
        raise FileFormatError(f"{path}: {key!r} must hold tensors alone, not {_first(strange)}")
    return {str(name): value for name, value in weights.items()}


def load_weights(module: nn.Module, weights: dict[str, Tensor], path: Path) -> None:
    """Put weights into a network that must take all of them and need no others.

    Args:
        module: The network; unchanged where the weights do not fit.
        weights: Tensors by name.
        path: Where they come from, for the message.

    Raises:
        FileFormatError: Names are missing or unexpected, or tensors have another shape or
            values that are not finite floating-point numbers.
    """
    wanted = module.state_dict()
    missing = [name for name in wanted if name not in weights]
    unexpected = [name for name in weights if name not in wanted]
    if missing or unexpected:
        faults = [
            f"{len(names)} {kind} ({_first(names)})"
            for kind, names in (("missing", missing), ("unexpected", unexpected))
            if names
        ]
        raise FileFormatError(
            f"{path}: does not fit the network's {len(wanted)} tensors: {' and '.join(faults)}"
        )
    for name, value in wanted.items():
        given = weights[name]
        if given.shape != value.shape:
            raise FileFormatError(
                f"{path}: {name} has shape {tuple(given.shape)}, not {tuple(value.shape)}"
            )
        if not given.is_floating_point() or not given.isfinite().all():
            raise FileFormatError(f"{path}: {name} must hold finite floating-point numbers")
    module.load_state_dict(weights)


def _check_archive(path: Path) -> None:
    """Refuse what is no archive, or one that unpacks to more than its own size."""
    if not path.is_file():
        raise FileFormatError(f"{path}: no such checkpoint file")
    if path.stat().st_size > MAX_CHECKPOINT_BYTES:
        limit = MAX_CHECKPOINT_BYTES // 10**9
        raise FileFormatError(f"{path}: larger than a checkpoint can be ({limit} GB)")
    try:
        with zipfile.ZipFile(path) as archive:
            entries = archive.infolist()
    except (zipfile.BadZipFile, OSError, ValueError, NotImplementedError) as error:
        raise FileFormatError(
            f"{path}: not a checkpoint, or cut off; torch.save writes a zip archive ({error})"
        ) from error
    if any(entry.compress_type != zipfile.ZIP_STORED for entry in entries):
        raise FileFormatError(f"{path}: is compressed; torch.save stores its tensors as they are")


def _reason(error: Exception) -> str:
    """Say in one line why torch refused a file; its own messages fill a screen."""
    found = _GLOBAL.search(str(error))
    if found:
        return (
            f"would run code when loaded ({found[1]}); save its tensors alone: "
            "torch.save({'model_state_dict': ...}, path)"
        )
    first = next(iter(str(error).strip().splitlines()), type(error).__name__)
    return f"damaged, or no checkpoint of weights ({first.split('. ')[0]:.120})"


def _first(names: Iterable[str]) -> str:
    """List the first few names."""
    listed = [f"{name:.80}" for name in names]
    more = f" and {len(listed) - NAMED} more" if len(listed) > NAMED else ""
    return ", ".join(listed[:NAMED]) + more if listed else "nothing"
