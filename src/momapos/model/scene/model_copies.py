"""Find and copy the files of models."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable, Iterator, Mapping
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from pathlib import Path

from momapos.core import (
    SceneError,
    incomplete,
    read_bytes_bounded,
    remove_if_incomplete,
    resolved,
    temporary_folder,
)
from momapos.model.urdf import MAX_MESH_BYTES, Articulated, Geometry, mesh_points

from .scene import Scene


def model_files(model: Articulated) -> tuple[Path, ...]:
    """Return the URDF and mesh files of a model; empty for a box."""
    if model.urdf.path is None:
        return ()
    shapes = (s for link in model.urdf.links.values() for s in (*link.collisions, *link.visuals))
    meshes = {shape.mesh: None for shape in shapes if isinstance(shape.mesh, Path)}
    return (model.urdf.path, *meshes)


def package_folder(urdf: Path) -> Path:
    """Return the folder of a URDF's own files: its ROS package, or the URDF's folder.

    The package is the nearest of five folders with a `package.xml`; without one, the parent of a
    folder named `urdf` or `robots`.
    """
    folder = resolved(urdf).parent
    for above in (folder, *folder.parents[:4]):
        if (above / "package.xml").is_file():
            return above
    return folder.parent if folder.name in ("urdf", "robots") else folder


def copy_files(
    models: Iterable[Articulated], target: Path, root: Path | None = None
) -> dict[Path, Path]:
    """Copy the URDF and mesh files of models into a folder, with their relative paths.

    Args:
        models: The models.
        target: The folder.
        root: Folder that must contain the meshes; None for each URDF's `package_folder`.

    Returns:
        The copy of every file.

    Raises:
        SceneError: A mesh is outside the root; an untrusted URDF can name any file.
        UrdfError: A file is not a mesh.
        OSError: The folder cannot be written to.
    """
    files: dict[Path, None] = {}
    for model in models:
        for file in model_files(model):
            if file != model.urdf.path and file not in files:
                assert model.urdf.path is not None
                within = resolved(root or package_folder(model.urdf.path))
                if not resolved(file).is_relative_to(within):
                    raise SceneError(
                        f"{model.urdf.path}: mesh {file} is outside {within} and is not copied"
                    )
                mesh_points(file)
            files[file] = None
    sources = {file: resolved(file) for file in files}
    common = os.path.commonpath([source.parent for source in sources.values()]) if sources else ""
    copies = {file: target / source.relative_to(common) for file, source in sources.items()}
    for file, copy in copies.items():
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(read_bytes_bounded(sources[file], MAX_MESH_BYTES))
    return copies


@contextmanager
def copied(scene: Scene, out: Path, root: Path | None = None) -> Iterator[Scene]:
    """Copy the files of a scene's models into `<stem>_files` next to a new scene file.

    The folder appears complete, and remains only if the block that writes the scene succeeds.

    Args:
        scene: The scene.
        out: The new scene file.
        root: Folder that must contain the meshes, see `copy_files`. The files of a scene file were
            checked against its own root when it was read.

    Yields:
        The scene with its models at their new paths.

    Raises:
        SceneError: The folder exists, or a mesh must not be copied; then nothing is written.
    """
    target = files_folder(out)
    models = list({id(item.model): item.model for item in scene.objects}.values())
    alone = [model.urdf.path for model in models] == [scene.path]  # a URDF, not a scene file
    within = root if root is not None or alone else Path("/")
    with ExitStack() as stack:
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            new = stack.enter_context(temporary_folder(target.parent, out.stem)) / "new"
            new.mkdir()
            copies = copy_files(models, new, within)
            stack.enter_context(incomplete(new, target))
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


def files_folder(out: Path) -> Path:
    """Return the folder for the files of a new scene file; remove it if it is left incomplete.

    Raises:
        SceneError: It exists.
    """
    target = resolved(out).parent / f"{out.stem}_files"
    remove_if_incomplete(target)
    if os.path.lexists(target):
        raise SceneError(f"{target}: exists already; remove it or write to another file")
    return target


def _moved(model: Articulated, places: Mapping[Path, Path]) -> Articulated:
    if model.urdf.path is None:
        return model

    def shape(geometry: Geometry) -> Geometry:
        if not isinstance(geometry.mesh, Path):
            return geometry
        return replace(geometry, mesh=places[geometry.mesh])

    links = {name: link.with_shapes(shape) for name, link in model.urdf.links.items()}
    return replace(model, urdf=replace(model.urdf, path=places[model.urdf.path], links=links))
