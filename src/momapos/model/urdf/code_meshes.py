"""Models of rigid meshes that are made in code, checked like those of files."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import InputError, finite_array, shown
from momapos.core.geometry import apply

from .hulls import hull_of
from .meshes import MAX_PARTS
from .urdf_records import Geometry, Link, Mesh, Urdf

if TYPE_CHECKING:
    from jaxtyping import Float, Int

MAX_ELEMENTS = 400_000
"""Maximum number of vertices, and of triangles: saved as text they stay below 50 MB [-]."""
MAX_COORDINATE = 1e3
"""Maximum coordinate, as for the edges of boxes [m]."""


def mesh_model(name: str, parts: Sequence[tuple[object, object]]) -> Urdf:
    """Return the model of a rigid object of one link.

    Args:
        name: The object, for messages.
        parts: Vertices (v, 3) [m] and triangles (f, 3) of each collision element, in the object's
            frame. Vertices that no triangle names are left out.

    Raises:
        InputError: A part has no finite vertices, no triangles, a triangle that names a missing
            vertex, or no extent; or there are too many of them.
    """
    if not 1 <= len(parts) <= MAX_PARTS:
        raise InputError(f"mesh {name!r} has {len(parts)} parts; it must have 1 to {MAX_PARTS}")
    shapes = []
    for number, (vertices, faces) in enumerate(parts):
        where = f"mesh {name!r}" if len(parts) == 1 else f"part {number} of mesh {name!r}"
        mesh = _checked(where, vertices, faces)
        shape = Geometry("mesh", (1.0, 1.0, 1.0), np.eye(4), mesh=mesh)
        hull_of(shape, where)  # refuses meshes without extent
        shapes.append(shape)
    link = Link("body", tuple(shapes), tuple(shapes))
    return Urdf(name, None, "body", {"body": link}, ())


def _checked(where: str, vertices: object, faces: object) -> Mesh:
    points = finite_array(f"vertices of {where}", vertices, (None, 3))
    corners = _faces(where, faces)
    for what, rows in (("vertices", points), ("triangles", corners)):
        if not 1 <= len(rows) <= MAX_ELEMENTS:
            raise InputError(f"{where} has {len(rows)} {what}; it must have 1 to {MAX_ELEMENTS}")
    far = float(np.abs(points).max())
    if far > MAX_COORDINATE:
        raise InputError(
            f"vertices of {where} are up to {far:.4g} m away from its origin; at most "
            f"{MAX_COORDINATE:g} m are supported; units are meters"
        )
    wrong = (corners < 0) | (corners >= len(points))
    if wrong.any():
        raise InputError(
            f"faces of {where}: vertex {corners[wrong][0]} does not exist; there are "
            f"{len(points)} vertices, counted from 0"
        )
    used, index = np.unique(corners, return_inverse=True)
    spread = np.linalg.svd(
        points[used] - points[used].mean(0), compute_uv=False, full_matrices=False
    )
    if len(used) < 3 or spread[1] < 1e-6 * np.sqrt(len(used)):
        raise InputError(f"{where} has no extent: its vertices lie on one line")
    return Mesh(points[used], index.reshape(-1, 3).astype(np.int64))


def _faces(where: str, faces: object) -> Int[np.ndarray, "f 3"]:
    values = finite_array(f"faces of {where}", faces, (None, None))
    if values.shape[1] != 3 and len(values):
        raise InputError(
            f"faces of {where} must be triangles, n x 3 vertex numbers, not n x {values.shape[1]}"
        )
    if (values != np.floor(values)).any() or (np.abs(values) > 2**53).any():
        raise InputError(f"faces of {where} must be whole numbers, not {shown(faces)}")
    return values.astype(np.int64).reshape(-1, 3)


def trimesh_parts(name: str, value: object) -> list[tuple[Any, Any]]:
    """Return the vertices [m] and faces of a trimesh, or of each placed mesh of a trimesh scene.

    Declared units other than meters are converted.

    Args:
        name: The object, for messages.
        value: A `trimesh.Trimesh`, a `trimesh.Scene`, or an object with their attributes.

    Raises:
        InputError: The value is neither, has too many meshes, or has unknown units.
    """
    scale = _meters_per_unit(name, getattr(value, "units", None))
    parts = list(_placed(name, value) if hasattr(value, "geometry") else _single(name, value))
    return [(scale * finite_array(f"vertices of mesh {name!r}", v, (None, 3)), f) for v, f in parts]


def _single(name: str, value: object) -> Iterator[tuple[Any, Any]]:
    if not (hasattr(value, "vertices") and hasattr(value, "faces")):
        raise InputError(
            f"mesh {name!r} must be a trimesh.Trimesh with faces or a trimesh.Scene, not "
            f"{shown(value)}"
        )
    yield value.vertices, value.faces


def _placed(name: str, scene: Any) -> Iterator[tuple[Any, Any]]:
    nodes = list(scene.graph.nodes_geometry)
    if len(nodes) > MAX_PARTS:
        raise InputError(f"mesh {name!r} has {len(nodes)} parts; it must have 1 to {MAX_PARTS}")
    for node in nodes:
        T, key = scene.graph[node]
        mesh = scene.geometry[key]
        if not hasattr(mesh, "faces"):
            raise InputError(f"mesh {name!r}: {key!r:.60} is not a triangle mesh")
        yield _moved(name, T, mesh.vertices), mesh.faces


def _moved(name: str, T: Any, vertices: Any) -> Float[np.ndarray, "v 3"]:
    T = finite_array(f"pose of a part of mesh {name!r}", T, (4, 4))
    return apply(T, finite_array(f"vertices of mesh {name!r}", vertices, (None, 3)))


def _meters_per_unit(name: str, units: object) -> float:
    if units is None:
        return 1.0
    from trimesh.units import unit_conversion

    try:
        return float(unit_conversion(units, "meters"))
    except (KeyError, ValueError, TypeError, AttributeError) as error:
        raise InputError(f"mesh {name!r} has unknown units {shown(units)}") from error
