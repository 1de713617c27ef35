"""Scenes in the BestMan format: a JSON list of models with poses.

`{model_path, object_position, object_orientation (roll, pitch, yaw), scale, obj_name, fixed_base}`;
numbers can be arithmetic text, which is parsed and never executed. Model paths are relative to the
folder that contains `Asset`. The format has no floor and no start.
"""

from __future__ import annotations

import ast
import csv
import math
import operator
import re
import warnings
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.core import FileFormatError, SceneError, is_name, resolved
from momapos.core.geometry import apply, pose_rpy
from momapos.model.urdf import Articulated, box_urdf

from .scene_object import SceneObject

if TYPE_CHECKING:
    from jaxtyping import Float


MAX_LENGTH = 200
MAX_DEPTH = 20
MAX_EXPONENT = 16.0
_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
_CONSTANTS = {"pi": math.pi, "tau": math.tau, "e": math.e}
_MODULES = ("math", "np", "numpy")


def number(value: object) -> float:
    """Return a finite number, given as a number or as arithmetic text.

    Args:
        value: An int, a float, or text of numbers, + - * / **, parentheses, pi, tau, e (also as
            `math.pi`).

    Raises:
        ValueError: The value is invalid, too long, too deep or not finite; the caller adds the
            place to the message.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{_short(value)} is not a number")
    try:
        result = _evaluate(_parse(value), 0) if isinstance(value, str) else float(value)
    except (OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"{_short(value)} has no finite value") from error
    if not math.isfinite(result):
        raise ValueError(f"{_short(value)} has no finite value")
    return result


def _parse(text: str) -> ast.expr:
    if len(text) > MAX_LENGTH:
        raise ValueError(f"{_short(text)} is longer than {MAX_LENGTH} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"{_short(text)} is not plain arithmetic") from error


def _evaluate(node: ast.expr, depth: int) -> float:
    if depth > MAX_DEPTH:
        raise ValueError(f"arithmetic is nested deeper than {MAX_DEPTH}")
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id=name) if name in _CONSTANTS:
            return _CONSTANTS[name]
        case ast.Attribute(value=ast.Name(id=module), attr=name) if (
            module in _MODULES and name in _CONSTANTS
        ):
            return _CONSTANTS[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand, depth + 1)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _evaluate(operand, depth + 1)
        case ast.BinOp(op=op) if type(op) in _BINARY:
            left, right = _evaluate(node.left, depth + 1), _evaluate(node.right, depth + 1)
            if isinstance(op, ast.Pow) and abs(right) > MAX_EXPONENT:
                raise ValueError(f"{_short(ast.unparse(node))} has an exponent over 16")
            return _BINARY[type(op)](left, right)
    raise ValueError(
        f"{_short(ast.unparse(node))} is not plain arithmetic (numbers, + - * / **, ( ), pi)"
    )


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."


ReadModel = Callable[[Path, float], Articulated]
"""Reads a URDF file at a scale; equal arguments return the same model."""
Size = tuple[float, float, float]
Corners: TypeAlias = "tuple[Float[np.ndarray, '3'], Float[np.ndarray, '3']]"

SIZES = "derived/urdf_models_sizes.csv"
"""Sizes of household models, relative to the root; optional."""
DEFAULT_EDGE = 0.08
"""Edge of the cube that replaces a model of unknown size [m]."""
MAX_SIZES_BYTES = 10_000_000
_KEYS = ("obj_name", "model_path", "object_position", "object_orientation")
_CATEGORIES = (
    ("minifridge", "fridge"), ("fridge", "fridge"), ("refrigerator", "fridge"),
    ("microwave", "microwave"), ("mic", "microwave"), ("dishwasher", "dishwasher"),
    ("oven", "oven"), ("drawer", "drawer"), ("cabinet", "cabinet"), ("sink", "sink"),
    ("basin", "sink"), ("faucet", "faucet"), ("table", "table"), ("chair", "chair"),
    ("counter", "counter"), ("kitchen part", "cabinet"), ("element", "counter"),
)  # fmt: skip
_FILLER = {
    "food", "plastic", "utensil", "furniture", "model", "mobility", "urdf", "models", "target",
    "large", "extra", "medium", "small", "mini", "round", "square", "circle", "rectangle", "flat",
    "black", "white", "blue", "green", "grey", "orange", "pink", "red", "yellow", "two",
    "color", "high", "nocolor", "clear",
}  # fmt: skip


def is_bestman(data: object) -> bool:
    """Return whether parsed JSON looks like a BestMan scene."""
    return isinstance(data, list)


def find_root(path: Path) -> Path:
    """Find the folder that model paths are relative to: the nearest parent with `Asset`.

    Raises:
        FileFormatError: No parent folder has it.
    """
    for folder in resolved(path).parents:
        if (folder / "Asset").is_dir():
            return folder
    raise FileFormatError(
        f"{path}: a BestMan scene must be below the folder that contains 'Asset'; else set root"
    )


def read_entries(data: Sequence[Any], path: Path) -> list[Entry]:
    """Check the entries of a BestMan scene.

    Raises:
        FileFormatError, SceneError: An entry is invalid; one line says where.
    """
    if not data:
        raise FileFormatError(f"{path}: the list of objects is empty")
    return [Entry(item, f"{path}: object {i}") for i, item in enumerate(data)]


def read_objects(
    entries: Sequence[Entry], root: Path, read: ReadModel
) -> tuple[tuple[SceneObject, ...], tuple[str, ...]]:
    """Read the objects of a BestMan scene.

    A model with a missing file becomes a box where the model would come to rest.

    Args:
        entries: Entries of the file.
        root: Folder that model paths are relative to, and must not leave.
        read: Reads a URDF.

    Returns:
        The objects in the file's order, and the assumptions.

    Raises:
        SceneError, UrdfError: An object is invalid; one line says why.
    """
    files = [_file_of(entry, root) for entry in entries]
    objects = {
        i: SceneObject(entry.name, entry.category, entry.T, read(file, entry.scale))
        for i, (entry, file) in enumerate(zip(entries, files, strict=True))
        if file is not None
    }
    warnings = []
    if len(objects) < len(entries):
        sizes, solid = _read_sizes(root), _hull_bounds(objects.values())
        for i, entry in enumerate(entries):
            if i not in objects:
                objects[i], warning = _stand_in(entry, sizes, solid)
                warnings.append(warning)
    return tuple(objects[i] for i in range(len(entries))), tuple(warnings)


class Entry:
    """A checked entry of the list."""

    def __init__(self, item: Any, where: str) -> None:
        if not isinstance(item, dict):
            raise FileFormatError(f"{where} is not a JSON object, as in a BestMan scene")
        lacking = [key for key in _KEYS if key not in item]
        if lacking:
            raise FileFormatError(f"{where} has no {lacking[0]!r}, so it is not a BestMan object")
        self.where = where
        self.name, self.model_path = (self._text(item, key) for key in _KEYS[:2])
        self.where = f"{where} ({self.name!r})"
        xyz, rpy = (self._triple(item, key) for key in _KEYS[2:])
        if max(map(abs, xyz)) > 1e4:
            raise SceneError(f"{self.where}: object_position is more than 10 km away")
        self.T = pose_rpy(xyz, rpy)
        self.scale = self._number(item.get("scale", 1.0), "scale")
        if not 1e-3 <= self.scale <= 1e3:
            raise SceneError(f"{self.where}: scale must be 0.001 to 1000, not {self.scale:g}")
        self.fixed = bool(item.get("fixed_base", False))
        self.category = category_of(self.name, self.model_path)

    def _text(self, item: Mapping[str, Any], key: str) -> str:
        value = item[key]
        if not is_name(value):
            raise SceneError(f"{self.where}: {key} must be printable, 1 to 1000 characters long")
        return value

    def _triple(self, item: Mapping[str, Any], key: str) -> Size:
        value = item[key]
        if not isinstance(value, list) or len(value) != 3:
            raise SceneError(f"{self.where}: {key} must be a list of 3 numbers")
        x, y, z = (self._number(v, key) for v in value)
        return x, y, z

    def _number(self, value: object, key: str) -> float:
        try:
            return number(value)
        except ValueError as error:
            raise SceneError(f"{self.where}: {key}: {error}") from error


def _file_of(entry: Entry, root: Path) -> Path | None:
    """Return the model's file; None if it is missing."""
    try:
        file = resolved(root / entry.model_path)
        inside, exists = file.is_relative_to(resolved(root)), file.is_file()
    except (FileFormatError, OSError) as error:  # too long, cyclic links, a NUL
        path = f"{entry.model_path!r:.80}"
        raise SceneError(f"{entry.where}: model_path {path} is not a valid path") from error
    if not inside:
        raise SceneError(f"{entry.where}: model_path {entry.model_path!r} leaves {root}")
    return file if exists else None


def category_of(name: str, model_path: str) -> str:
    """Return the category of an object, for example "fridge" for Fridge/10144/mobility.urdf.

    Args:
        name: Name of the object; it takes precedence if it contains a known category.
        model_path: Path of its URDF; only the last folders count.
    """
    parts = Path(model_path).with_suffix("").parts[-3:]
    own, path = _words(name), " ".join(_words(part) for part in reversed(parts))
    for text in (own, path):
        for word, known in _CATEGORIES:
            if re.search(rf"\b{word}", text) and not (word == "element" and text is own):
                return known
    for part in (*reversed(parts), name):
        words = [w for w in _words(part).split() if not w.isdigit()]
        telling = [w for w in words if w not in _FILLER]
        if telling:
            return " ".join(telling)
        if "orange" in words:
            return "orange"
    return "object"


def _words(text: str) -> str:
    """Return the lower-case words of a name in any common spelling."""
    return " ".join(re.findall(r"[a-z]+|\d+", re.sub(r"([a-z])([A-Z])", r"\1 \2", text).lower()))


def _read_sizes(root: Path) -> dict[str, Size]:
    """Read the sizes of household models by folder name [m]; skip invalid rows."""
    file = root / SIZES
    if not file.is_file() or file.stat().st_size > MAX_SIZES_BYTES:
        return {}
    sizes: dict[str, Size] = {}
    with file.open(newline="", encoding="utf-8", errors="replace") as lines:
        for row in csv.DictReader(lines):
            try:
                x, y, z = (float(row[f"size_{axis}"]) for axis in "xyz")
            except (KeyError, TypeError, ValueError):
                continue
            if all(math.isfinite(v) and 0 < v < 100 for v in (x, y, z)):
                sizes[row.get("subfolder_name") or ""] = (x, y, z)
    return sizes


def _stand_in(
    entry: Entry, sizes: Mapping[str, Size], solid: Sequence[Corners]
) -> tuple[SceneObject, str]:
    """Return the box that replaces a missing model, and a warning about it."""
    known = sizes.get(Path(entry.model_path).parent.name)
    size = np.multiply(known or (DEFAULT_EDGE,) * 3, entry.scale)
    edges = (float(size[0]), float(size[1]), float(size[2]))
    box = Articulated(box_urdf(entry.name, edges))
    item = SceneObject(entry.name, entry.category, entry.T, box)
    if not entry.fixed:
        item = _set_down(item, size, solid)
    origin = f"with the size from {SIZES}" if known else "of unknown size"
    shape = " x ".join(f"{100 * v:.1f}" for v in edges)
    return item, (
        f"object {entry.name!r}: {entry.model_path} does not exist; replaced by a box {origin}, "
        f"{shape} cm"
    )


def _set_down(
    item: SceneObject, size: Float[np.ndarray, "3"], solid: Sequence[Corners]
) -> SceneObject:
    """Rest a movable box on what is below its center, or on the floor.

    BestMan drops such objects from their position, which is the center of the household models. A
    position up to half the height inside a support is lifted out of it.
    """
    T = item.T_world_object.copy()
    half = float(np.abs(T[2, :3]) @ size / 2)
    tops = [
        high[2]
        for low, high in solid
        if (low[:2] <= T[:2, 3]).all() and (T[:2, 3] <= high[:2]).all()
    ]
    T[2, 3] = max([top for top in tops if top <= T[2, 3] + half], default=0.0) + half
    return replace(item, T_world_object=T)


def _hull_bounds(items: Iterable[SceneObject]) -> list[Corners]:
    bounds = []
    for item in items:
        for link, T in item.link_poses().items():
            for hull in item.model.hulls[link]:
                points = apply(T, hull.vertices)
                bounds.append((points.min(0), points.max(0)))
    return bounds
