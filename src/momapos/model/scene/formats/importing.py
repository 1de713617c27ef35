"""Write imported rooms as momapos scenes."""

from __future__ import annotations

import json
import os
import re
import shutil
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from momapos.core import MomaposError, SceneError, incomplete, temporary_folder
from momapos.model.scene.bestman import category_of
from momapos.model.scene.model_copies import files_folder
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import VERSION, load_scene
from momapos.model.scene.scene_names import FORMAT
from momapos.model.urdf import Mesh

from .imported_room import DECIMALS, ImportedRoom, Names, RoomObject
from .urdf_writer import obj_text, urdf_text

_MEMBERS = ("category", "hypotheses", "confidence")
"""Extras of an object that its entry contains."""


def write_room(room: ImportedRoom, source: Path, out: Path) -> Scene:
    """Write a room as a momapos scene, with URDF and mesh files in `<stem>_files` next to it.

    Args:
        room: The room.
        source: File that the room was read from, for messages.
        out: The scene file.

    Returns:
        The scene, read back from the written file.

    Raises:
        SceneError: The folder exists or cannot be written to, or the room makes no valid scene;
            then nothing is written.
    """
    target = files_folder(out)
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        with temporary_folder(target.parent, out.stem) as new:
            (new / target.name).mkdir()
            file = new / out.name
            file.write_text(_write_files(room, new / target.name), encoding="utf-8")
            with _naming(source, new):
                load_scene(file)
            with incomplete(new / target.name, target):
                (new / target.name).rename(target)
                try:
                    file.replace(out)
                except OSError:
                    shutil.rmtree(target)
                    raise
    except OSError as error:
        raise SceneError(f"{out}: cannot be written ({error.strerror})") from error
    return load_scene(out)


@contextmanager
def _naming(source: Path, folder: Path) -> Iterator[None]:
    """Replace the names of temporary files in errors by the file they were made from."""
    try:
        yield
    except MomaposError as error:
        text = str(error).replace(f"{folder}{os.sep}", "")
        raise SceneError(f"{source}: makes no valid scene: {text}") from error


def _write_files(room: ImportedRoom, folder: Path) -> str:
    """Write URDF and mesh files, and return the text of the scene file for their folder."""
    for file, mesh in room.meshes.items():
        (folder / file).write_text(obj_text(_rounded(mesh)), encoding="ascii")
    files = Names()
    entries = []
    for item in room.objects:
        plain = re.sub(r"[^A-Za-z0-9._-]", "_", item.name)[:80]
        file = folder / f"{files(plain, 'object')}.urdf"
        file.write_text(urdf_text(item.urdf), encoding="utf-8")
        entries.append(_entry(item, f"{folder.name}/{file.name}"))
    head = {"format": FORMAT, "version": VERSION, "name": room.name, **room.extras}
    objects = ",\n".join(f"  {json.dumps(entry)}" for entry in entries)
    return f'{json.dumps(head)[:-1]},\n "objects": [\n{objects}\n ]}}\n'


def _entry(item: RoomObject, urdf: str) -> dict[str, Any]:
    T = item.T_world_object
    wxyz = Rotation.from_matrix(T[:3, :3]).as_quat(scalar_first=True)
    extras: Mapping[str, Any] = {key: item.extras[key] for key in _MEMBERS if key in item.extras}
    return {
        "name": item.name,
        "category": category_of(item.name, item.name),
        "pose": {"xyz": (T[:3, 3] + 0.0).tolist(), "wxyz": (wxyz + 0.0).tolist()},
        "urdf": urdf,
        "joints": dict(item.joints),
        **extras,
    }


def _rounded(mesh: Mesh) -> Mesh:
    return Mesh(np.round(mesh.vertices, DECIMALS), mesh.faces)
