"""The files that a model is made of, and copies of them."""

from __future__ import annotations

import os
import shutil
from collections.abc import Iterable
from pathlib import Path

from momapos.kinematics.articulated import Articulated


def model_files(model: Articulated) -> tuple[Path, ...]:
    """The URDF and mesh files that a model was read from; none for a box."""
    if model.urdf.path is None:
        return ()
    shapes = (s for link in model.urdf.links.values() for s in (*link.collisions, *link.visuals))
    meshes = {shape.mesh: None for shape in shapes if shape.mesh is not None}
    return (model.urdf.path, *meshes)


def copy_files(files: Iterable[Path], target: Path) -> tuple[Path, ...]:
    """Copy files into a folder, where they keep their places among each other.

    Returns:
        The copies, in the order of the files.

    Raises:
        OSError: The folder cannot be written to.
    """
    sources = [file.resolve() for file in files]
    root = os.path.commonpath([file.parent for file in sources])
    copies = tuple(target / file.relative_to(root) for file in sources)
    for source, copy in zip(sources, copies, strict=True):
        copy.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(source, copy)
    return copies
