"""Read the description of a robot, or of a part of one, in any format: URDF, xacro or MJCF."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from momapos.core import UrdfError, read_text_bounded, resolved
from momapos.model.robots import Expanded, expand_xacro, is_xacro, read_part
from momapos.model.scene.formats import kind_of_file, obj_text, read_robot, urdf_text
from momapos.model.urdf import MAX_MESH_PARENTS, MAX_URDF_BYTES, Link


def is_mjcf(path: Path) -> bool:
    """Return whether a file is MJCF, by its content.

    Raises:
        FileFormatError: The file cannot be read.
    """
    return not is_xacro(path) and kind_of_file(path) == "MJCF"


def read_description(
    path: Path, packages: Mapping[str, Path], args: Mapping[str, str], meshes: str
) -> Expanded:
    """Return a description as a URDF, its meshes named by package or in files to write.

    Args:
        path: A URDF, xacro or MJCF file.
        packages: Package folders by name.
        args: Arguments of a xacro file by name.
        meshes: What the names of mesh files to write begin with.

    Raises:
        RobotError, UrdfError, FileFormatError: The file is invalid, or something is missing.
        MissingExtraError: A reader is not installed.
    """
    if is_xacro(path):
        return expand_xacro(path, packages, args)
    if is_mjcf(path):
        return _of_mjcf(path, meshes)
    text = read_text_bounded(path, MAX_URDF_BYTES, error=UrdfError)
    return read_part(path, text, packages)


def _of_mjcf(path: Path, meshes: str) -> Expanded:
    """Return the robot of an MJCF file; visual shapes are left out."""
    here = resolved(path).parent
    root = [here, *here.parents][: MAX_MESH_PARENTS + 1][-1]
    urdf, files, report = read_robot(path, root)

    def plain(link: Link) -> Link:
        shapes = tuple(
            replace(shape, mesh=Path(f"{meshes}{shape.mesh}")) if shape.mesh else shape
            for shape in link.collisions
        )
        return replace(link, collisions=shapes, visuals=())

    text = urdf_text(replace(urdf, links={name: plain(one) for name, one in urdf.links.items()}))
    used = {file for file in files if f'"{meshes}{file}"' in text}
    written = {f"{meshes}{file}": obj_text(files[file]) for file in used}
    notes = tuple(f"{path.name}: {line}" for line in report.lines())
    return Expanded(text, {}, notes, "", written)
