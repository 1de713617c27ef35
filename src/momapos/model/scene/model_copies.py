"""The files that a model is made of, and copies of them."""

from __future__ import annotations

import os
import shutil
import tempfile
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

from momapos.core import SceneError, read_bytes_bounded
from momapos.model.urdf import MAX_MESH_BYTES, Articulated, Geometry, Link, mesh_points

from .scene import Scene


def model_files(model: Articulated) -> tuple[Path, ...]:
    """The URDF and mesh files that a model was read from; none for a box."""
    if model.urdf.path is None:
        return ()
    shapes = (s for link in model.urdf.links.values() for s in (*link.collisions, *link.visuals))
    meshes = {shape.mesh: None for shape in shapes if shape.mesh is not None}
    return (model.urdf.path, *meshes)


def package_folder(urdf: Path) -> Path:
    """The folder that a URDF's own files lie in: its ROS package, or where it lies itself.

    The package is the nearest of five folders with a `package.xml`; without one, the folder above
    one that is called `urdf` or `robots`.
    """
    folder = urdf.resolve().parent
    for above in (folder, *folder.parents[:4]):
        if (above / "package.xml").is_file():
            return above
    return folder.parent if folder.name in ("urdf", "robots") else folder


def copy_files(
    models: Iterable[Articulated], target: Path, root: Path | None = None
) -> dict[Path, Path]:
    """Copy the URDF and mesh files of models into a folder; they keep places among each other.

    Args:
        models: The models.
        target: The folder.
        root: Folder that the meshes must lie in; for each URDF its `package_folder` where None.

    Returns:
        The copy of every file.

    Raises:
        SceneError: A mesh lies elsewhere: a URDF of a stranger may name any file.
        UrdfError: What it names is no mesh.
        OSError: The folder cannot be written to.
    """
    files: dict[Path, None] = {}
    for model in models:
        for file in model_files(model):
            if file != model.urdf.path and file not in files:
                assert model.urdf.path is not None
                within = (root or package_folder(model.urdf.path)).resolve()
                if not file.resolve().is_relative_to(within):
                    raise SceneError(
                        f"{model.urdf.path}: mesh {file} lies outside {within} and is not copied"
                    )
                mesh_points(file)
            files[file] = None
    sources = {file: file.resolve() for file in files}
    common = os.path.commonpath([source.parent for source in sources.values()]) if sources else ""
    copies = {file: target / source.relative_to(common) for file, source in sources.items()}
    for file, copy in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(read_bytes_bounded(sources[file], MAX_MESH_BYTES))
    return copies


@contextmanager
def copied(scene: Scene, out: Path, root: Path | None = None) -> Iterator[Scene]:
    """Copy the files of a scene's models into `<stem>_files` beside a new scene file.

    The folder appears whole, and stays only if the block that writes the scene file succeeds.

    Args:
        scene: The scene.
        out: The new scene file.
        root: Folder that the meshes must lie in; see `copy_files`. What a scene file names was
            held to that file's own root when it was read.

    Yields:
        The scene with its models at their new places.

    Raises:
        SceneError: The folder exists, or a mesh must not be copied; nothing is written then.
    """
    target = out.resolve().parent / f"{out.stem}_files"
    if os.path.lexists(target):
        raise SceneError(f"{target} exists already; remove it or write to another file")
    models = list({id(item.model): item.model for item in scene.objects}.values())
    alone = [model.urdf.path for model in models] == [scene.path]  # a URDF, not a scene file
    within = root if root is not None or alone else Path("/")
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(prefix=f".{out.stem}_", dir=target.parent) as temporary:
            new = Path(temporary) / "new"
            new.mkdir()
            copies = copy_files(models, new, within)
            if copies:
                new.rename(target)
    except OSError as error:
        raise SceneError(f"{target}: cannot be written ({error.strerror})") from error
    places = {file: target / copy.relative_to(new) for file, copy in copies.items()}
    moved = {id(model): _moved(model, places) for model in models}
    objects = (replace(item, model=moved[id(item.model)]) for item in scene.objects)
    try:
        yield replace(scene, objects=tuple(objects))
    except BaseException:
        shutil.rmtree(target, ignore_errors=True)
        raise


def _moved(model: Articulated, places: Mapping[Path, Path]) -> Articulated:
    """The same model, its files elsewhere."""
    if model.urdf.path is None:
        return model

    def shape(geometry: Geometry) -> Geometry:
        if geometry.mesh is None:
            return geometry
        return replace(geometry, mesh=places[geometry.mesh])

    links = {
        name: Link(name, tuple(map(shape, link.collisions)), tuple(map(shape, link.visuals)))
        for name, link in model.urdf.links.items()
    }
    return Articulated(replace(model.urdf, path=places[model.urdf.path], links=links))
