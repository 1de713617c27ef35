"""Convert geoms of a compiled MJCF model to our shapes."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core.geometry import pose_wxyz
from momapos.model.urdf import Geometry, Mesh, capsule_shapes

from .composed_shapes import MIN_FLOOR_NORMAL_Z, ellipsoid, plane

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass
class GeomShapes:
    """Converts geoms to shapes, and counts approximations."""

    model: Any
    approximated: Counter[str]
    dropped: Counter[str]
    meshes: dict[Path, Mesh] = field(default_factory=dict)
    """Meshes of the converted shapes, by file name."""

    def solid(self, geom: int) -> bool:
        """Return whether a geom has collisions."""
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def pose(self, geom: int) -> Float[np.ndarray, "4 4"]:
        """Return the pose of a geom in its body's frame."""
        return pose_wxyz(
            tuple(self.model.geom_pos[geom].tolist()), tuple(self.model.geom_quat[geom].tolist())
        )

    def level(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> bool:
        """Return whether a geom is a floor plane."""
        upward = (T_world_body @ self.pose(geom))[2, 2]
        return self._kind(geom) == "plane" and bool(upward >= MIN_FLOOR_NORMAL_Z)

    def top(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> float:
        """Return the height of a geom's bounding box [m]; for a plane, of its origin."""
        T, box = T_world_body @ self.pose(geom), self.model.geom_aabb[geom]
        if self._kind(geom) == "plane":
            return float(T[2, 3])
        return float(T[2, 3] + T[2, :3] @ box[:3] + np.abs(T[2, :3]) @ box[3:])

    def shapes(
        self, geom: int, T: Float[np.ndarray, "4 4"], name: str, *, solid: bool
    ) -> list[Geometry]:
        """Return the shapes of a geom; empty for unbounded planes.

        Args:
            geom: Index of the geom.
            T: Pose of its body in the frame of the shapes.
            name: Name of the shapes.
            solid: Whether the report counts it, as it does not for visual geoms.
        """
        T, size = T @ self.pose(geom), self.model.geom_size[geom].tolist()
        kind = self._kind(geom)
        count = self.approximated if solid else Counter[str]()
        if kind == "box":
            return [Geometry("box", (2 * size[0], 2 * size[1], 2 * size[2]), T, name)]
        if kind == "sphere":
            return [Geometry("sphere", (size[0],), T, name)]
        if kind == "cylinder":
            return [Geometry("cylinder", (size[0], 2 * size[1]), T, name)]
        if kind == "capsule":
            return capsule_shapes(size[0], 2 * size[1], T, name)
        if kind == "mesh":
            file = self._mesh(int(self.model.geom_dataid[geom]))
            return [Geometry("mesh", (1.0, 1.0, 1.0), T, name, file)]
        if kind == "ellipsoid":
            count["ellipsoids as meshes"] += 1
            shape, file, mesh = ellipsoid((size[0], size[1], size[2]), T, name)
            self.meshes[file] = mesh
            return [shape]
        if kind == "plane" and min(size[:2]) > 0:
            count["bounded planes as boxes"] += 1
            return [plane(2 * size[0], 2 * size[1], T, name)]
        if solid:
            self.dropped["unbounded planes" if kind == "plane" else f"geoms of type {kind}"] += 1
        return []

    def _kind(self, geom: int) -> str:
        import mujoco

        kind: str = mujoco.mjtGeom(int(self.model.geom_type[geom])).name
        return kind.removeprefix("mjGEOM_").lower()

    def _mesh(self, number: int) -> Path:
        """Return the file of a mesh, and add the mesh."""
        file = self._files[number]
        if file not in self.meshes:
            m = self.model
            first, count = m.mesh_vertadr[number], m.mesh_vertnum[number]
            points = m.mesh_vert[first : first + count].astype(float)
            first, count = m.mesh_faceadr[number], m.mesh_facenum[number]
            faces = m.mesh_face[first : first + count].astype(np.int64)
            self.meshes[file] = Mesh(points, faces)
        return file

    @cached_property
    def _files(self) -> list[Path]:
        """File names of all meshes, because MuJoCo's names can contain any characters."""
        names = (self.model.mesh(i).name for i in range(self.model.nmesh))
        plain = ("".join(c if c.isalnum() and c.isascii() else "_" for c in n)[:60] for n in names)
        return [Path(f"mesh{i}_{name}.obj") for i, name in enumerate(plain)]
