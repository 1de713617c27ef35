"""One tensor out of a file written by `torch.save`, without running anything that is in it.

Such a file is a zip archive of raw numbers and a pickle that says what shape they have. A pickle
is a program, and unpickling runs it. Here its instructions are read one by one, and only the few
that describe a tensor have a meaning; anything else is refused.
"""

from __future__ import annotations

import pickletools
import zipfile
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from momapos.errors import FileFormatError

MAX_PROGRAM_BYTES = 100_000
MAX_DATA_BYTES = 8_000_000_000
_DTYPES = {
    "FloatStorage": "<f4",
    "DoubleStorage": "<f8",
    "HalfStorage": "<f2",
    "LongStorage": "<i8",
    "IntStorage": "<i4",
    "ShortStorage": "<i2",
    "CharStorage": "i1",
    "ByteStorage": "u1",
    "BoolStorage": "?",
}
_REBUILD = "torch._utils _rebuild_tensor_v2"
_ORDERED = "collections OrderedDict"
_ALLOWED = {_REBUILD, _ORDERED, *(f"torch {name}" for name in _DTYPES)}
_CONSTANTS = {
    "BINUNICODE",
    "SHORT_BINUNICODE",
    "BINUNICODE8",
    "BININT",
    "BININT1",
    "BININT2",
    "LONG1",
}
_LITERALS = {"NONE": None, "NEWTRUE": True, "NEWFALSE": False}
_NO_EFFECT = {"PROTO", "FRAME"}
_TUPLES = {"EMPTY_TUPLE": 0, "TUPLE1": 1, "TUPLE2": 2, "TUPLE3": 3}


@dataclass(frozen=True)
class _Name:
    """A global that the program mentions; it is never looked up."""

    name: str


@dataclass(frozen=True)
class _Storage:
    key: str
    dtype: str
    count: int


@dataclass(frozen=True)
class _Tensor:
    storage: _Storage
    offset: int
    shape: tuple[int, ...]
    strides: tuple[int, ...]


class _Mark:
    """Where the items of a tuple begin on the stack."""


def read_tensor(path: Path) -> np.ndarray:
    """Read the one tensor in a file.

    Args:
        path: What `torch.save(tensor, path)` has written.

    Returns:
        The tensor, of any shape; it may not be writable.

    Raises:
        FileFormatError: It holds anything but one dense tensor, would run code, or is damaged.
    """
    try:
        with zipfile.ZipFile(path) as archive:
            return _read(archive, path)
    except (OSError, zipfile.BadZipFile, NotImplementedError, RuntimeError) as error:
        raise FileFormatError(f"{path}: damaged archive ({error})") from error


def _read(archive: zipfile.ZipFile, path: Path) -> np.ndarray:
    programs = [name for name in archive.namelist() if name.endswith("data.pkl")]
    if len(programs) != 1:
        raise FileFormatError(f"{path}: is no file of torch.save; it holds no data.pkl")
    root = programs[0][: -len("data.pkl")]
    if f"{root}byteorder" in archive.namelist():
        order = _entry(archive, f"{root}byteorder", 16, path)
        if order.strip() != b"little":
            raise FileFormatError(f"{path}: is not little-endian; save it on an ordinary machine")
    try:
        found = _Interpreter(path).run(_entry(archive, programs[0], MAX_PROGRAM_BYTES, path))
    except (ValueError, IndexError, KeyError, TypeError, AttributeError) as error:
        raise FileFormatError(f"{path}: its data.pkl is damaged ({error})") from error
    if not isinstance(found, _Tensor):
        raise FileFormatError(f"{path}: does not hold one tensor; save it by torch.save(masks, …)")
    name = f"{root}data/{found.storage.key}"
    raw = np.frombuffer(_entry(archive, name, MAX_DATA_BYTES, path), found.storage.dtype)
    return _shaped(raw, found, path)


def _shaped(raw: np.ndarray, tensor: _Tensor, path: Path) -> np.ndarray:
    shape, strides = tensor.shape, tensor.strides
    sane = len(shape) == len(strides) <= 8 and min((*shape, *strides, tensor.offset, 0)) >= 0
    count = int(np.prod([int(n) for n in shape], dtype=object)) if sane else -1
    last = tensor.offset + sum((n - 1) * step for n, step in zip(shape, strides, strict=False))
    # A tensor whose elements share memory could be far larger than its file.
    if not sane or count > len(raw) or (count and last >= len(raw)):
        raise FileFormatError(f"{path}: its tensor {shape} does not fit its data ({len(raw)})")
    steps = tuple(step * raw.itemsize for step in strides)
    return np.lib.stride_tricks.as_strided(raw[tensor.offset :], shape, steps, writeable=False)


def _entry(archive: zipfile.ZipFile, name: str, limit: int, path: Path) -> bytes:
    try:
        info = archive.getinfo(name)
    except KeyError:
        raise FileFormatError(f"{path}: lacks the entry {name!r}; it is damaged") from None
    if info.compress_type != zipfile.ZIP_STORED or info.file_size > limit:
        raise FileFormatError(f"{path}: its entry {name!r} is compressed or too large")
    return archive.read(info)


class _Interpreter:
    """Follows the instructions of a pickle that describes a tensor."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.stack: list[Any] = []
        self.memo: dict[int, Any] = {}

    def run(self, program: bytes) -> Any:
        for instruction, argument, _ in pickletools.genops(program):
            if instruction.name == "STOP":
                return self.stack.pop()
            self.step(instruction.name, argument)
        raise ValueError("it does not end")

    def step(self, name: str, argument: Any) -> None:
        if name in _NO_EFFECT:
            return
        if name in _CONSTANTS:
            self.stack.append(argument)
        elif name in _LITERALS:
            self.stack.append(_LITERALS[name])
        elif name in _TUPLES:
            self.stack.append(tuple(self.take(_TUPLES[name])))
        elif name in ("BINPUT", "LONG_BINPUT"):
            self.memo[argument] = self.stack[-1]
        elif name in ("BINGET", "LONG_BINGET"):
            self.stack.append(self.memo[argument])
        elif name in _STEPS:
            _STEPS[name](self, argument)
        else:
            raise FileFormatError(
                f"{self.path}: refused, its pickle does more than describe a tensor ({name})"
            )

    def take(self, count: int) -> list[Any]:
        if count > len(self.stack):
            raise ValueError("it takes more than it has")
        items = self.stack[len(self.stack) - count :]
        del self.stack[len(self.stack) - count :]
        return items

    def mark(self, _: Any) -> None:
        self.stack.append(_Mark())

    def close_tuple(self, _: Any) -> None:
        start = max(i for i, item in enumerate(self.stack) if isinstance(item, _Mark))
        items = tuple(self.take(len(self.stack) - start)[1:])
        self.stack.append(items)

    def memoize(self, _: Any) -> None:
        self.memo[len(self.memo)] = self.stack[-1]

    def name_global(self, argument: Any) -> None:
        if argument not in _ALLOWED:
            called = str(argument).replace(" ", ".")
            raise FileFormatError(
                f"{self.path}: refused, loading it would call {called:.80}; it must hold one tensor"
            )
        self.stack.append(_Name(argument))

    def name_from_stack(self, _: Any) -> None:
        self.name_global(" ".join(map(str, self.take(2))))

    def load_storage(self, _: Any) -> None:
        kind, storage, key, _place, count = self.stack.pop()
        if kind != "storage" or not isinstance(key, str) or not isinstance(count, int):
            raise ValueError("it names no storage")
        dtype = _DTYPES[storage.name.removeprefix("torch ")]
        self.stack.append(_Storage(key, dtype, count))

    def reduce(self, _: Any) -> None:
        function, arguments = self.take(2)
        if function == _Name(_ORDERED) and arguments == ():
            self.stack.append(None)  # the hooks of a tensor that has none
            return
        if function != _Name(_REBUILD) or not isinstance(arguments[0], _Storage):
            raise ValueError("it calls something on the wrong things")
        storage, offset, shape, strides = arguments[:4]
        if not all(type(n) is int for n in (offset, *shape, *strides)):
            raise ValueError("a shape that is not whole numbers")
        self.stack.append(_Tensor(storage, offset, shape, strides))


_STEPS: dict[str, Callable[[_Interpreter, Any], None]] = {
    "MARK": _Interpreter.mark,
    "TUPLE": _Interpreter.close_tuple,
    "MEMOIZE": _Interpreter.memoize,
    "GLOBAL": _Interpreter.name_global,
    "STACK_GLOBAL": _Interpreter.name_from_stack,
    "BINPERSID": _Interpreter.load_storage,
    "REDUCE": _Interpreter.reduce,
}
