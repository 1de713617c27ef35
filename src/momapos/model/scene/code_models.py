"""Save models that were made in code, next to a scene file."""

from __future__ import annotations

import hashlib
import re
from dataclasses import replace
from pathlib import Path

import numpy as np

from momapos.core import SceneError, write_atomic
from momapos.model.scene.formats import obj_text, urdf_text
from momapos.model.urdf import Geometry, Link, Mesh, Urdf

_NAME_LENGTH = 60
"""Maximum length of an object's name in a file name [-]."""
_DIGEST_LENGTH = 12
"""Number of digits of the hash of a file's content in its name [-]."""


def box_edges(urdf: Urdf) -> tuple[float, ...] | None:
    """Return the edges of a model that is one box around its origin [m]; None for others."""
    shapes = urdf.links[urdf.root].collisions
    if len(urdf.links) > 1 or len(shapes) != 1 or shapes[0].kind != "box":
        return None
    return shapes[0].size if np.array_equal(shapes[0].T_link_geometry, np.eye(4)) else None


def save_model(name: str, urdf: Urdf, folder: Path) -> Path:
    """Write a model without a file as a URDF with OBJ meshes; return the URDF.

    The names of the files contain a hash of their content, so that saving again changes no file
    that another scene uses.

    Args:
        name: Name of the object.
        urdf: The model.
        folder: Folder of the files, created if necessary.

    Raises:
        SceneError: A file cannot be written.
    """
    plain = re.sub(r"[^A-Za-z0-9._-]", "_", name)[:_NAME_LENGTH]
    files: dict[Mesh, Path] = {}

    def saved(shape: Geometry) -> Geometry:
        if not isinstance(shape.mesh, Mesh):
            return shape
        if shape.mesh not in files:
            files[shape.mesh] = Path(_write(folder, plain, ".obj", obj_text(shape.mesh)).name)
        return replace(shape, mesh=files[shape.mesh])

    links = {
        key: Link(key, tuple(map(saved, link.collisions)), tuple(map(saved, link.visuals)))
        for key, link in urdf.links.items()
    }
    return _write(folder, plain, ".urdf", urdf_text(replace(urdf, links=links)))


def _write(folder: Path, plain: str, suffix: str, text: str) -> Path:
    content = text.encode()
    digest = hashlib.sha256(content).hexdigest()[:_DIGEST_LENGTH]
    file = folder / f"{plain}_{digest}{suffix}"
    try:
        folder.mkdir(parents=True, exist_ok=True)
        write_atomic(file, content)
    except OSError as error:
        raise SceneError(f"{file}: cannot be written ({error.strerror})") from error
    return file
