"""Read one numpy array that `torch.save` stored, without running or loading its pickle.

`torch.save` stores what is no tensor as a plain pickle in its archive. OpenMask3D saves its masks
as an array of numpy, which torch's weights-only reader refuses. The few instructions of such a
pickle are matched here.
"""

from __future__ import annotations

import pickletools
import zipfile
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from .errors import FileFormatError
from .files import MAX_BYTES, check_archive, open_regular

if TYPE_CHECKING:
    from jaxtyping import Shaped

_GLOBALS = {"numpy ndarray", "numpy dtype", "_codecs encode"}
_RECONSTRUCT = {"numpy.core.multiarray _reconstruct", "numpy._core.multiarray _reconstruct"}
_INTEGERS = {"BININT", "BININT1", "BININT2"}
_OTHERS = {
    "PROTO", "BINPUT", "LONG_BINPUT", "BINGET", "LONG_BINGET", "MARK", "TUPLE", "TUPLE1", "TUPLE2",
    "TUPLE3", "REDUCE", "BUILD", "NONE", "NEWTRUE", "NEWFALSE", "BINUNICODE", "GLOBAL", "STOP",
}  # fmt: skip
_TYPES = {"b1", "u1", "i1", "u2", "i2", "u4", "i4", "u8", "i8", "f2", "f4", "f8"}
_ORDERS = {"<", ">", "|"}


def load_array(path: Path) -> Shaped[np.ndarray, "..."] | None:
    """Read an array of numbers from a file of `torch.save`.

    Returns:
        The array; None if the file holds something else, such as a tensor.

    Raises:
        FileFormatError: The file is missing, damaged, or not an archive of torch.
    """
    with open_regular(path, MAX_BYTES) as file:
        check_archive(file, path)
        with zipfile.ZipFile(file) as archive:
            names = [name for name in archive.namelist() if name.endswith("/data.pkl")]
            program = archive.read(names[0]) if len(names) == 1 else b""
    steps = _steps(program)
    if steps is None:
        return None
    try:
        return _array(steps)
    except (ValueError, IndexError, StopIteration, UnicodeError) as error:
        raise FileFormatError(f"{path}: its array is damaged ({error})") from error


def _steps(program: bytes) -> list[tuple[str, object]] | None:
    """Return the instructions of the pickle of one array, without those about its memo."""
    steps: list[tuple[str, object]] = []
    try:
        for code, argument, _ in pickletools.genops(program):
            if code.name not in _INTEGERS | _OTHERS:
                return None
            if code.name == "GLOBAL" and argument not in _GLOBALS | _RECONSTRUCT:
                return None
            if not code.name.endswith(("PUT", "GET")):
                steps.append((code.name, argument))
    except ValueError:
        return None
    first = next((argument for name, argument in steps if name == "GLOBAL"), None)
    return steps if first in _RECONSTRUCT else None


def _array(steps: list[tuple[str, object]]) -> Shaped[np.ndarray, "..."]:
    """Rebuild the array from its state: version, shape, type, order of axes, bytes."""
    state = [name for name, _ in steps].index("MARK") + 2
    shape = []
    while steps[state][0] in _INTEGERS:
        shape.append(int(str(steps[state][1])))
        state += 1
    place = steps.index(("GLOBAL", "numpy dtype"))
    kind = next(argument for name, argument in steps[place:] if name == "BINUNICODE")
    place = next(k for k in range(place, len(steps)) if steps[k][0] == "MARK")
    order = next(argument for name, argument in steps[place:] if name == "BINUNICODE")
    built = next(k for k in range(place, len(steps)) if steps[k][0] == "BUILD")
    text = next(argument for name, argument in steps[built:] if name == "BINUNICODE")
    if kind not in _TYPES or order not in _ORDERS or not isinstance(text, str):
        raise ValueError(f"numbers of type {order!r:.10}{kind!r:.10}")
    values = np.frombuffer(text.encode("latin1"), np.dtype(f"{order}{kind}"))
    return values.reshape(shape, order="F" if steps[built + 1][0] == "NEWTRUE" else "C")
