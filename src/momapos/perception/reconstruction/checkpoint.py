"""Read the weights of a network from an untrusted checkpoint."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

from momapos.core import FileFormatError, load_tensors

if TYPE_CHECKING:
    from torch import Tensor, nn

MAX_LISTED = 3
"""Number of names in an error message."""


def read_checkpoint(path: Path, key: str = "model_state_dict") -> dict[str, Tensor]:
    """Read the named tensors of a checkpoint, on the CPU, without running code in it.

    Args:
        path: A file that `torch.save` wrote.
        key: The entry with the tensors.

    Raises:
        FileFormatError: The file is absent, not an archive of torch, damaged, has more than
            tensors and plain values, or has no such entry.
        MissingExtraError: torch is not installed.
    """
    content = load_tensors(path)
    import torch

    if not isinstance(content, dict) or not isinstance(content.get(key), dict):
        held = _first(map(_name, content)) if isinstance(content, dict) else _name(content)
        raise FileFormatError(f"{path}: has no {key!r} with the weights; it has {held}")
    weights = content[key]
    strange = [
        _name(name)
        for name, value in weights.items()
        if not (isinstance(name, str) and isinstance(value, torch.Tensor))
    ]
    if strange:
        raise FileFormatError(f"{path}: {key!r} must have only tensors, not {_first(strange)}")
    return dict(weights)


def load_weights(module: nn.Module, weights: dict[str, Tensor], path: Path) -> None:
    """Load weights into a network; they must match it exactly.

    Args:
        module: The network; unchanged if the weights do not match.
        weights: Tensors by name.
        path: Source of the weights, for the message.

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
            raise FileFormatError(f"{path}: {name} must have finite floating-point numbers")
    module.load_state_dict(weights)


def _name(value: object) -> str:
    """Return a name, or only the type of a non-string: a forged tuple may be endless as text."""
    return value if isinstance(value, str) else type(value).__name__


def _first(names: Iterable[str]) -> str:
    listed = [f"{name:.80}" for name in names]
    more = f" and {len(listed) - MAX_LISTED} more" if len(listed) > MAX_LISTED else ""
    return ", ".join(listed[:MAX_LISTED]) + more if listed else "nothing"
