"""Rooms in SDF, Gazebo's format: models with links, joints and shapes.

A world, or single models. Models that it includes are looked for inside the root, as
NAME/model.sdf for `model://NAME`. Frames and poses are those of SDF 1.7 and later; older files
mean them alike but for the axes of joints.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import FileFormatError, read_xml

from .confined_files import find_inside
from .imported_room import Names, Report, Room
from .sdf_model import Model, number, pose_of, text_of

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_BYTES = 20_000_000
MAX_MODELS = 2_000
MAX_DEPTH = 50
"""How deep elements may be nested [-]."""
_SETTINGS = {
    "physics", "scene", "gui", "gravity", "magnetic_field", "atmosphere", "spherical_coordinates",
    "audio", "wind", "state", "frame",
}  # fmt: skip
"""Elements of a world that hold nothing of a room."""


def read_room(path: Path, root: Path) -> Room:
    """Read a room in SDF.

    Args:
        path: The file.
        root: Folder that no file may leave, and that models are looked for in.

    Raises:
        FileFormatError: It cannot be used; one line says what is wrong and where.
    """
    reader = _Reader(path, root.resolve())
    reader.read(reader.open(path), np.eye(4), None, path.parent)
    objects = tuple(model.object() for model in reader.models if model.solid)
    nothing = len(reader.models) - len(objects)
    reader.report.dropped["objects that nothing can touch"] += nothing
    meshes = {file: mesh for model in reader.models for file, mesh in model.meshes.items()}
    return Room(path.stem, objects, meshes, reader.report)


class _Reader:
    """Gathers the models of a file and of those that it includes."""

    def __init__(self, path: Path, root: Path) -> None:
        self.path, self.root = path, root
        self.report, self.names = Report(), Names()
        self.models: list[Model] = []
        self.open_files: list[Path] = []

    def open(self, path: Path) -> Element:
        """The tree of a file."""
        tree = read_xml(path, MAX_BYTES)
        if tree.tag != "sdf":
            raise FileFormatError(f"{path}: the root element is <{tree.tag}>, SDF has <sdf>")
        level: list[Element] = [tree]
        for _ in range(MAX_DEPTH):
            level = [child for element in level for child in element]
        if level:
            raise FileFormatError(f"{path}: elements are nested deeper than {MAX_DEPTH}")
        return tree

    def read(
        self, tree: Element, T: Float[np.ndarray, "4 4"], name: str | None, folder: Path
    ) -> None:
        """Read all models of a file.

        Args:
            tree: Of the file.
            T: Pose of what is in it; where it is given, models have none of their own.
            name: Of the model in it; its own where None.
            folder: Where the file lies.
        """
        version = number(tree.get("version") or "1.7", f"{self.path}: version")
        worlds = tree.findall("world") or [tree]
        for world in worlds:
            for element in world:
                if element.tag == "include":
                    self._include(element, T, folder)
                elif element.tag == "model":
                    self._model(element, T, name, folder, version)
                elif isinstance(element.tag, str) and element.tag not in _SETTINGS:
                    self.report.dropped[f"{element.tag}s"] += 1

    def _model(
        self,
        element: Element,
        T: Float[np.ndarray, "4 4"],
        name: str | None,
        folder: Path,
        version: float,
    ) -> None:
        if len(self.models) >= MAX_MODELS:
            raise FileFormatError(f"{self.path}: more than {MAX_MODELS} models")
        wanted = name or element.get("name") or ""
        T_world_model = T if name is not None else T @ self._pose(element, wanted)
        model = Model(
            self.names(wanted, "model"), T_world_model, version, self.report, self.path,
            lambda uri: self._file(uri, folder), f"m{len(self.models)}_",
        )  # fmt: skip
        model.read(element)
        self.models.append(model)

    def _pose(self, element: Element, name: str) -> Float[np.ndarray, "4 4"]:
        """Pose of a model in the world."""
        found = element.find("pose")
        if found is not None and (found.get("relative_to") or "world") != "world":
            raise FileFormatError(
                f"{self.path}: model {name!r:.80} stands relative to "
                f"{found.get('relative_to')!r:.80}; only the world is supported"
            )
        return pose_of(found, f"{self.path}: model {name!r:.80}")

    def _include(self, element: Element, T: Float[np.ndarray, "4 4"], folder: Path) -> None:
        """Read a model that another file holds."""
        uri = text_of(element, "uri")
        file = self._file(uri, folder, whole=True)
        if file in self.open_files or file == self.path.resolve():
            raise FileFormatError(f"{self.path}: {uri!r:.200} includes itself")
        self.open_files.append(file)
        tree = self.open(file)
        inner = next(tree.iter("model"), None)
        if inner is None:
            raise FileFormatError(f"{file}: holds no model")
        name = text_of(element, "name") or inner.get("name") or file.parent.name
        # A pose of the include stands in the place of the model's own.
        own = element if element.find("pose") is not None else inner
        self.read(tree, T @ self._pose(own, name), name, file.parent)
        self.open_files.pop()

    def _file(self, uri: str, folder: Path, *, whole: bool = False) -> Path:
        """The file that a URI stands for, inside the root; of a model its SDF."""
        kind, _, rest = uri.rpartition("://")
        if kind not in ("", "model", "file", "package"):
            raise FileFormatError(f"{self.path}: {uri!r:.200}: only model:// and paths are read")
        place = (folder if kind in ("", "file") else self.root) / rest
        places = [place / "model.sdf", place] if whole else [place]
        return find_inside(uri, places, self.root, self.path)
