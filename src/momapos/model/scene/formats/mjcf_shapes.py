"""Geoms of a compiled MJCF model as shapes of ours."""

from __future__ import annotations

from collections import Counter
from dataclasses import dataclass, field
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core.geometry import pose_wxyz
from momapos.model.urdf import Geometry

from .composed_shapes import LEVEL, capsule, ellipsoid, plane
from .imported_room import Mesh

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass
class GeomShapes:
    """Makes shapes of geoms, and counts what becomes of them."""

    model: Any
    approximated: Counter[str]
    dropped: Counter[str]
    meshes: dict[Path, Mesh] = field(default_factory=dict)
    """The meshes of the shapes that were made, by the names of their files."""

    def solid(self, geom: int) -> bool:
        """Whether anything can touch it."""
        return bool(self.model.geom_contype[geom] or self.model.geom_conaffinity[geom])

    def pose(self, geom: int) -> Float[np.ndarray, "4 4"]:
        """In its body's frame."""
        return pose_wxyz(
            tuple(self.model.geom_pos[geom].tolist()), tuple(self.model.geom_quat[geom].tolist())
        )

    def level(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> bool:
        """Whether it is a plane that one can stand on."""
        upward = (T_world_body @ self.pose(geom))[2, 2]
        return self._kind(geom) == "plane" and bool(upward >= LEVEL)

    def top(self, geom: int, T_world_body: Float[np.ndarray, "4 4"]) -> float:
        """Height of the box around it [m]; of a plane that of its origin."""
        T, box = T_world_body @ self.pose(geom), self.model.geom_aabb[geom]
        if self._kind(geom) == "plane":
            return float(T[2, 3])
        return float(T[2, 3] + T[2, :3] @ box[:3] + np.abs(T[2, :3]) @ box[3:])

    def shapes(
        self, geom: int, T: Float[np.ndarray, "4 4"], name: str, *, solid: bool
    ) -> list[Geometry]:
        """The shapes that stand for a geom; none for planes without edges.

        Args:
            geom: Its number.
            T: Pose of its body in the frame of the shapes.
            name: Of the shapes.
            solid: Whether it counts: what is only drawn is not worth a word.
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
            return capsule(size[0], 2 * size[1], T, name)
        if kind == "mesh":
            file = self._mesh(int(self.model.geom_dataid[geom]))
            return [Geometry("mesh", (1.0, 1.0, 1.0), T, name, file)]
        if kind == "ellipsoid":
            count["ellipsoids as meshes"] += 1
            shape, file, mesh = ellipsoid((size[0], size[1], size[2]), T, name)
            self.meshes[file] = mesh
            return [shape]
        if kind == "plane" and min(size[:2]) > 0:
            count["planes with edges as boxes"] += 1
            return [plane(2 * size[0], 2 * size[1], T, name)]
        if solid:
            self.dropped[
                "planes without edges" if kind == "plane" else f"geoms of type {kind}"
            ] += 1
        return []

    def _kind(self, geom: int) -> str:
        import mujoco

        kind: str = mujoco.mjtGeom(int(self.model.geom_type[geom])).name
        return kind.removeprefix("mjGEOM_").lower()

    def _mesh(self, number: int) -> Path:
        """The file of a mesh, which the room has from now on."""
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
        """Names of files for all meshes: MuJoCo's names may hold anything."""
        names = (self.model.mesh(i).name for i in range(self.model.nmesh))
        plain = ("".join(c if c.isalnum() and c.isascii() else "_" for c in n)[:60] for n in names)
        return [Path(f"mesh{i}_{name}.obj") for i, name in enumerate(plain)]
