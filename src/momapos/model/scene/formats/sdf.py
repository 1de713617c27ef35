"""Read rooms in SDF, Gazebo's format: models with links, joints and shapes.

A file is a world or contains single models. Included models are searched inside the root, as
NAME/model.sdf for `model://NAME`. Frames and poses have the meaning of SDF 1.7 and later; older
files differ only in the axes of joints.
"""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING
from xml.etree.ElementTree import Element

import numpy as np

from momapos.core import FileFormatError, read_xml, resolved

from .confined_files import find_inside
from .imported_room import ImportedRoom, ImportReport, Names
from .sdf_model import Model
from .sdf_values import number, pose_of, text_of

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_BYTES = 20_000_000
MAX_MODELS = 2_000
MAX_DEPTH = 50
"""Maximum nesting of elements [-]."""
_SETTINGS = {
    "physics", "scene", "gui", "gravity", "magnetic_field", "atmosphere", "spherical_coordinates",
    "audio", "wind", "state", "frame",
}  # fmt: skip
"""Elements of a world without content of a room."""


def read_room(path: Path, root: Path) -> ImportedRoom:
    """Read a room in SDF.

    Args:
        path: The file.
        root: Folder that no file may leave, and in which models are searched.

    Raises:
        FileFormatError: The file is invalid; one line says what is wrong and where.
    """
    reader = _Reader(path, resolved(root))
    reader.read(reader.open(path), np.eye(4), None, path.parent)
    objects = tuple(model.object() for model in reader.models if model.solid)
    nothing = len(reader.models) - len(objects)
    reader.report.dropped["objects without collision shapes"] += nothing
    meshes = {file: mesh for model in reader.models for file, mesh in model.meshes.items()}
    return ImportedRoom(path.stem, objects, meshes, reader.report)


class _Reader:
    """Collects the models of a file and of the files it includes."""

    def __init__(self, path: Path, root: Path) -> None:
        self.path, self.root = path, root
        self.report, self.names = ImportReport(), Names()
        self.models: list[Model] = []
        self.open_files: list[Path] = []

    def open(self, path: Path) -> Element:
        """Return the tree of a file."""
        tree = read_xml(path, MAX_BYTES)
        if tree.tag != "sdf":
            raise FileFormatError(f"{path}: the root element is <{tree.tag}>; SDF needs <sdf>")
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
            tree: Tree of the file.
            T: Pose of its content.
            name: Name of the included model, whose pose is then `T`; None for a file of models
                with their own names and poses.
            folder: Folder of the file.
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
        found = element.find("pose")
        if found is not None and (found.get("relative_to") or "world") != "world":
            raise FileFormatError(
                f"{self.path}: the pose of model {name!r:.80} is relative to "
                f"{found.get('relative_to')!r:.80}; only the world is supported"
            )
        return pose_of(found, f"{self.path}: model {name!r:.80}")

    def _include(self, element: Element, T: Float[np.ndarray, "4 4"], folder: Path) -> None:
        uri = text_of(element, "uri")
        file = self._file(uri, folder, whole=True)
        if file in self.open_files or file == resolved(self.path):
            raise FileFormatError(f"{self.path}: {uri!r:.200} includes itself")
        self.open_files.append(file)
        tree = self.open(file)
        inner = next(tree.iter("model"), None)
        if inner is None:
            raise FileFormatError(f"{file}: contains no model")
        name = text_of(element, "name") or inner.get("name") or file.parent.name
        # A pose of the include replaces the model's own.
        own = element if element.find("pose") is not None else inner
        self.read(tree, T @ self._pose(own, name), name, file.parent)
        self.open_files.pop()

    def _file(self, uri: str, folder: Path, *, whole: bool = False) -> Path:
        """Return the file of a URI inside the root; with `whole`, the SDF file of a model."""
        kind, _, rest = uri.rpartition("://")
        if kind not in ("", "model", "file", "package"):
            raise FileFormatError(
                f"{self.path}: {uri!r:.200}: only model:// and paths are supported"
            )
        place = (folder if kind in ("", "file") else self.root) / rest
        places = [place / "model.sdf", place] if whole else [place]
        return find_inside(uri, places, self.root, self.path)
