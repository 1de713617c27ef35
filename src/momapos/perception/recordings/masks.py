"""Read instances that another program found in the same cloud.

The 20 classes of ScanNet's first benchmark use the numbers of NYU40; the 200 classes use ScanNet's
own. One number has different meanings in the two.

Supported are the ScanNet export of Mask3D, the masks of OpenMask3D, one label per point, and boxes
as JSON. The format is detected from the content.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path
from typing import TYPE_CHECKING, Any, BinaryIO, Literal, NoReturn

import numpy as np

from momapos.core import (
    FileFormatError,
    load_array,
    load_tensors,
    open_regular,
    parse_json,
    read_bytes_bounded,
    resolved,
)
from momapos.core.geometry import UprightBox
from momapos.model.records import Instance

if TYPE_CHECKING:
    from jaxtyping import Bool, Int


ClassSet = Literal["scannet20", "scannet200"]

SCANNET20: Mapping[int, str] = {
    1: "wall", 2: "floor", 3: "cabinet", 4: "bed", 5: "chair", 6: "sofa", 7: "table", 8: "door",
    9: "window", 10: "bookshelf", 11: "picture", 12: "counter", 14: "desk", 16: "curtain",
    24: "refrigerator", 28: "shower curtain", 33: "toilet", 34: "sink", 36: "bathtub",
    39: "other furniture",
}  # fmt: skip

# Parts of rooms, furniture, appliances, and kitchen objects; other classes keep their numbers.
SCANNET200: Mapping[int, str] = {
    1: "wall", 2: "chair", 3: "floor", 4: "table", 5: "door", 6: "couch", 7: "cabinet",
    8: "shelf", 9: "desk", 10: "office chair", 11: "bed", 14: "sink", 15: "picture",
    16: "window", 18: "bookshelf", 21: "curtain", 22: "book", 23: "armchair",
    24: "coffee table", 26: "box", 27: "refrigerator", 28: "lamp", 29: "kitchen cabinet",
    31: "towel", 33: "tv", 34: "nightstand", 35: "counter", 36: "dresser", 38: "stool",
    40: "plant", 41: "ceiling", 44: "end table", 45: "dining table", 51: "tv stand",
    56: "trash can", 57: "closet", 59: "microwave", 62: "stove", 65: "bottle", 66: "bin",
    68: "bench", 70: "washing machine", 73: "basket", 74: "sofa chair", 75: "file cabinet",
    82: "paper towel dispenser", 84: "oven", 87: "rack", 88: "plate", 96: "radiator",
    97: "recycling bin", 98: "container", 99: "wardrobe", 100: "soap dispenser", 102: "bucket",
    104: "stand", 110: "clothes dryer", 116: "seat", 120: "column", 130: "cup",
    132: "storage bin", 134: "coffee maker", 136: "dishwasher", 138: "paper towel roll",
    139: "machine", 141: "windowsill", 145: "bar", 148: "toaster", 159: "kitchen counter",
    161: "doorframe", 165: "mini fridge", 177: "water cooler", 185: "tray", 191: "pillar",
    193: "ledge", 195: "toaster oven", 213: "furniture", 214: "cart", 221: "storage container",
    233: "crate", 276: "closet door", 323: "dish rack", 342: "range hood", 392: "water bottle",
    488: "water pitcher", 562: "bowl", 1156: "bathroom counter", 1164: "bathroom vanity",
    1165: "closet wall", 1169: "trash bin", 1173: "bathroom cabinet", 1176: "coffee kettle",
    1183: "storage organizer", 1184: "folded chair", 1189: "potted plant",
}  # fmt: skip


def class_set(ids: Iterable[int]) -> ClassSet:
    """Guess which classes numbers come from: the 20 if all are among them, else the 200."""
    return "scannet20" if set(ids) <= set(SCANNET20) else "scannet200"


def class_name(number: int, classes: ClassSet) -> str:
    """Name of a class, or "class 123" where it is not known here."""
    table = SCANNET20 if classes == "scannet20" else SCANNET200
    return table.get(number, f"class {number}")


FORMAT, VERSION = "momapos-boxes", 1
MAX_INSTANCES = 10_000
MAX_LIST_BYTES = 5_000_000
MAX_NPY_HEADER = 1_000  # characters; numpy evaluates them
MAX_EDGE, MAX_DISTANCE = 1e3, 1e4  # [m] of a box, from the world's origin
_BOX_KEYS = {"label", "center", "size", "yaw", "score"}
_ACCEPTED = (
    "expected scene.txt of Mask3D, *_masks.pt of OpenMask3D, labels as .npy or .txt, "
    "or boxes as JSON"
)


def read_instances(
    path: Path, cloud_size: int, *, classes: ClassSet | None = None
) -> list[Instance]:
    """Read instances for a cloud.

    Args:
        path: The file.
        cloud_size: Number of points of the cloud, in the order of the masks.
        classes: Meaning of class numbers. If None, it is guessed: the 20 classes if all numbers
            are among them, else the 200.

    Returns:
        The instances in the file's order, with `members`, or with `box` for a JSON of boxes. Masks
        may be empty.

    Raises:
        FileFormatError: It is not readable, belongs to another cloud, or would run code.
        MissingExtraError: It is OpenMask3D's, and torch is not installed.
    """
    path = Path(path)
    with open_regular(path) as file:
        head = file.read(4096)
    if head.startswith(b"PK\x03\x04"):
        return _open_masks(path, cloud_size)
    if head.startswith(b"\x93NUMPY"):
        return _by_label(_npy_labels(path, cloud_size), path)
    if head.startswith(b"\x80"):
        raise FileFormatError(
            f"{path}: refused because it is a bare pickle, which can run code when loaded; save it "
            "with PyTorch 1.6 or later"
        )
    if head.lstrip(b"\xef\xbb\xbf \t\r\n").startswith(b"{"):
        return _boxes(path)
    if b"\0" in head or not head.strip():
        raise FileFormatError(f"{path}: has no instances; {_ACCEPTED}")
    if len(head.strip().splitlines()[0].split()) == 3:
        return _mask3d(path, cloud_size, classes)
    return _by_label(_text_labels(path, cloud_size), path)


def _mask3d(path: Path, cloud_size: int, classes: ClassSet | None) -> list[Instance]:
    rows = [line.split() for line in _text(path, MAX_LIST_BYTES).splitlines() if line.strip()]
    if len(rows) > MAX_INSTANCES:
        raise FileFormatError(f"{path}: has {len(rows)} masks; the limit is {MAX_INSTANCES}")
    parsed = [_mask3d_row(row, number + 1, path) for number, row in enumerate(rows)]
    chosen = classes or class_set(label for _, label, _ in parsed)
    return [
        Instance(class_name(label, chosen), score, np.flatnonzero(_mask_file(mask, cloud_size)))
        for mask, label, score in parsed
    ]


def _mask3d_row(row: list[str], number: int, path: Path) -> tuple[Path, int, float]:
    try:
        name, label, score = row[0], int(row[1]), float(row[2])
        if len(row) != 3 or not math.isfinite(score):
            raise ValueError
    except (ValueError, IndexError):
        raise FileFormatError(
            f"{path}: line {number} must be `pred_mask/name.txt class score`"
        ) from None
    try:
        folder = resolved(path.parent)
        mask = resolved(folder / name)
    except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
        raise FileFormatError(f"{path}: line {number} names {name!r:.80}, not a file") from error
    if not mask.is_relative_to(folder):
        raise FileFormatError(f"{path}: line {number} names {name:.80}, outside its folder")
    return mask, label, min(max(score, 0.0), 1.0)


def _mask_file(path: Path, cloud_size: int) -> Bool[np.ndarray, " n"]:
    """Read one digit per line; much faster than parsing numbers."""
    raw = np.frombuffer(_point_lines(path, 8, cloud_size), np.uint8)
    digit = (raw == ord("0")) | (raw == ord("1"))
    if np.any(digit[1:] & digit[:-1]) or np.any(~digit & (raw > ord(" "))):
        raise FileFormatError(f"{path}: must have one 0 or 1 per line")
    mask = raw[digit] == ord("1")
    return _fitting(mask, cloud_size, path)


def _open_masks(path: Path, cloud_size: int) -> list[Instance]:
    # OpenMask3D saves an array of numpy, others save a tensor.
    array = load_array(path)
    masks = load_tensors(path) if array is None else array
    shape = tuple(getattr(masks, "shape", ()))
    if len(shape) != 2:
        raise FileFormatError(
            f"{path}: must have one tensor or array (vertices, masks), not {shape}"
        )
    _check_size(shape[0], cloud_size, path)
    if shape[1] > MAX_INSTANCES:
        raise FileFormatError(f"{path}: has {shape[1]} masks; the limit is {MAX_INSTANCES}")
    try:
        # One at a time: a tensor whose elements share memory may be far larger than its file.
        members = [np.flatnonzero(np.asarray(masks[:, k] > 0.5)) for k in range(shape[1])]
    except (RuntimeError, TypeError, NotImplementedError) as error:  # sparse, quantized, complex
        raise FileFormatError(f"{path}: must have one dense tensor of numbers") from error
    return [Instance("", 1.0, found) for found in members]


def _npy_labels(path: Path, cloud_size: int) -> Int[np.ndarray, " n"]:
    with open_regular(path) as file:
        shape, dtype = _npy_header(file, path)
        if len(shape) != 1 or not np.issubdtype(dtype, np.integer):
            raise FileFormatError(
                f"{path}: must have one integer per point, not {dtype} of shape {shape}"
            )
        _check_size(shape[0], cloud_size, path)
        labels = np.fromfile(file, dtype, cloud_size)
    if len(labels) < cloud_size:
        raise FileFormatError(f"{path}: ends after {len(labels)} of {cloud_size} labels")
    return labels


def _npy_header(file: BinaryIO, path: Path) -> tuple[tuple[int, ...], np.dtype]:
    """Read the shape and type in the header of a `.npy` file, without allocating memory for it."""
    read = {
        (1, 0): np.lib.format.read_array_header_1_0,
        (2, 0): np.lib.format.read_array_header_2_0,
    }
    try:
        version = np.lib.format.read_magic(file)
        shape, _, dtype = read[version](file, max_header_size=MAX_NPY_HEADER)
    except Exception as error:  # numpy evaluates the header, which may raise anything
        raise FileFormatError(f"{path}: not an array of numbers ({error})") from error
    return shape, dtype


def _text_labels(path: Path, cloud_size: int) -> Int[np.ndarray, " n"]:
    try:
        labels = np.array(_point_lines(path, 12, cloud_size).split(), np.int64)
    except (ValueError, OverflowError) as error:
        raise FileFormatError(f"{path}: must have one integer per line; {_ACCEPTED}") from error
    return _fitting(labels, cloud_size, path)


def _by_label(labels: Int[np.ndarray, " n"], path: Path) -> list[Instance]:
    """Split points by label; labels of zero and below are not instances."""
    order = np.argsort(labels, kind="stable")
    values, starts = np.unique(labels[order], return_index=True)
    if np.count_nonzero(values > 0) > MAX_INSTANCES:
        raise FileFormatError(f"{path}: has {len(values)} labels; the limit is {MAX_INSTANCES}")
    groups = np.split(order, starts[1:])
    return [
        Instance("", 1.0, members)
        for value, members in zip(values, groups, strict=True)
        if value > 0
    ]


def _boxes(path: Path) -> list[Instance]:
    def refuse(constant: str) -> NoReturn:
        raise ValueError(f"it has {constant}")

    try:
        data = parse_json(_text(path, MAX_LIST_BYTES), constant=refuse)
    except (ValueError, RecursionError) as error:
        raise FileFormatError(f"{path}: damaged JSON ({error})") from error
    if data.get("format") != FORMAT or data.get("version") != VERSION:
        raise FileFormatError(
            f'{path}: not a file of boxes; expected "format": "{FORMAT}", "version": {VERSION}'
        )
    entries = data.get("boxes")
    if not isinstance(entries, list) or len(entries) > MAX_INSTANCES:
        raise FileFormatError(f'{path}: "boxes" must be a list of at most {MAX_INSTANCES}')
    return [_box(entry, f"{path}: box {number}") for number, entry in enumerate(entries)]


def _box(entry: Any, where: str) -> Instance:
    if not isinstance(entry, dict) or not set(entry) <= _BOX_KEYS:
        raise FileFormatError(f"{where} may have only {', '.join(sorted(_BOX_KEYS))}")
    label = entry.get("label")
    if not isinstance(label, str) or len(label) > 100:
        raise FileFormatError(f'{where} needs a "label" of at most 100 characters')
    center = _vector(entry, "center", where, lambda v: np.abs(v).max() <= MAX_DISTANCE)
    size = _vector(entry, "size", where, lambda v: v.min() > 0 and v.max() <= MAX_EDGE)
    yaw, score = entry.get("yaw", 0.0), entry.get("score", 1.0)
    if not all(_is_number(value) for value in (yaw, score)) or not 0 <= score <= 1:
        raise FileFormatError(f'{where} needs "yaw" in radians and "score" in [0, 1]')
    return Instance(label, float(score), box=UprightBox(center, size, float(yaw)))


def _vector(entry: dict[str, Any], key: str, where: str, good: Callable[[Any], bool]) -> np.ndarray:
    values = entry.get(key)
    right = isinstance(values, list) and len(values) == 3 and all(map(_is_number, values))
    if not right or not good(np.array(values, float)):
        raise FileFormatError(f'{where} needs "{key}" as three numbers, in meters')
    return np.array(values, float)


def _is_number(value: Any) -> bool:
    return type(value) in (int, float) and abs(value) < 1e9


def _fitting(values: np.ndarray, cloud_size: int, path: Path) -> np.ndarray:
    _check_size(len(values), cloud_size, path)
    return values


def _check_size(count: int, cloud_size: int, path: Path) -> None:
    if count != cloud_size:
        raise FileFormatError(
            f"{path}: is for a cloud of {count} points, but this one has {cloud_size}; "
            "use the cloud that was segmented"
        )


def _point_lines(path: Path, width: int, cloud_size: int) -> bytes:
    """Read a file of one line per point; a far too long file belongs to another cloud."""
    limit = width * cloud_size + 4096
    with open_regular(path) as file:
        data = file.read(limit + 1)
    if len(data) > limit:
        raise FileFormatError(
            f"{path}: is for a larger cloud (more than {limit // width} points); this one has "
            f"{cloud_size}; use the cloud that was segmented"
        )
    return data


def _text(path: Path, limit: int) -> str:
    return read_bytes_bounded(path, limit).decode("utf-8-sig", errors="replace")
