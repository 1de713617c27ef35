"""Convert scenes between formats, for `momapos scene convert`."""

from __future__ import annotations

import os
import tempfile
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.apps.export import write_scene
from momapos.core import InputError, SceneError, resolved, temporary_folder
from momapos.model.robots import expand_xacro, is_xacro
from momapos.model.scene import Scene, copied, load_scene, model_files, save_scene
from momapos.model.scene.formats import (
    ImportReport,
    kind_of_file,
    read_room,
    write_mjcf,
    write_room,
)

FORMATS = {".json": "momapos", ".xml": "MJCF", ".scene": "MoveIt"}
"""Output formats, by file ending."""


def convert(
    path: Path, out: Path, *, copy: bool, root: Path | None, without: Sequence[str]
) -> tuple[Scene, ImportReport | None]:
    """Convert a scene; the arguments are those of the command.

    Returns:
        The scene in the new file, with the warnings of its reader, and a report on the import of
        another program's file.

    Raises:
        MomaposError: The scene can't be converted; then nothing is written.
    """
    if is_xacro(path):
        return _convert_xacro(path, out, root=root, without=without)
    kind, suffix = kind_of_file(path), out.suffix.lower()
    if suffix not in FORMATS:
        written = ", ".join(f"{ending} ({name})" for ending, name in FORMATS.items())
        raise InputError(f"{out}: unknown format; scenes are written as {written}")
    if without and kind is None:
        raise InputError("--without needs a file of another program, such as MJCF")
    if kind is not None and suffix == ".json":
        room = read_room(kind, path, root).without(without)
        return write_room(room, path, out), room.final_report()
    if kind is not None:
        with tempfile.TemporaryDirectory() as folder:
            room = read_room(kind, path, root).without(without)
            return _write_foreign(
                write_room(room, path, Path(folder) / "room.json"), out
            ), room.final_report()
    scene = load_scene(path, root=root)
    if suffix != ".json":
        return _write_foreign(scene, out), None
    if copy:
        with copied(scene, out, root) as moved:
            save_scene(moved, out)
    else:
        _refuse_outside(scene, out)
        save_scene(scene, out)
    again = load_scene(out)
    return replace(again, warnings=(*scene.warnings, *again.warnings)), None


def _convert_xacro(
    path: Path, out: Path, *, root: Path | None, without: Sequence[str]
) -> tuple[Scene, ImportReport | None]:
    """Convert an expanded xacro file; copies its files, since the expansion is temporary."""
    expanded = expand_xacro(path, {}, {})
    try:
        with temporary_folder(path.parent, path.stem) as folder:
            urdf = folder / path.with_suffix("").with_suffix(".urdf").name
            urdf.write_text(expanded.urdf)
            scene, report = convert(urdf, out, copy=True, root=root, without=without)
    except OSError as error:
        raise InputError(f"{path.parent}: cannot be written ({error.strerror})") from error
    return replace(scene, warnings=(*expanded.notes, *scene.warnings)), report


def _write_foreign(scene: Scene, out: Path) -> Scene:
    """Write a scene for another program."""
    if out.suffix.lower() == ".scene":
        write_scene(scene, np.eye(4), out)
    else:
        write_mjcf(scene, out)
    return scene


def _refuse_outside(scene: Scene, out: Path) -> None:
    """Refuse an output whose folder does not contain the models; suggest a folder that does."""
    files = [resolved(file) for item in scene.objects for file in model_files(item.model)]
    folder = resolved(out).parent
    if all(file.is_relative_to(folder) for file in files):
        return
    place = Path(os.path.commonpath([file.parent for file in files])) / out.name
    raise SceneError(
        f"{out}: the scene's URDF files are not below {folder}; "
        f"write it to {place}, or add --copy to copy them"
    )
