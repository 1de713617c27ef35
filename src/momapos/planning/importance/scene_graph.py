"""The scene graph: objects as nodes, and the relations on, in, inside and near as edges."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import SceneError, owner_cache, unknown_name
from momapos.model.scene import Scene, upright_boxes
from momapos.model.urdf import Boxes

from .config import GraphConfig
from .object_bodies import stack_bodies
from .relations import KINDS, NEAR, hierarchy, neighbors, outline_gaps

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from scipy import sparse

MIN_SIZE = 1e-3
"""Lower bound of an object's size [m], for flat objects."""
_SEEN_FROM_PARENT = {"on": "carries", "in": "contains", "inside": "contains", "near": "near"}


@dataclass(frozen=True, eq=False)
class SceneGraph:
    """Objects and their relations, computed on first use."""

    scene: Scene
    config: GraphConfig

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the objects, in the order of the scene."""
        return tuple(item.name for item in self.scene.objects)

    @cached_property
    def categories(self) -> tuple[str, ...]:
        """Categories of the objects."""
        return tuple(item.category for item in self.scene.objects)

    @cached_property
    def upright(self) -> Boxes:
        """The upright box around each object, turned with the object's frame."""
        return upright_boxes(self.scene.objects)

    @cached_property
    def size(self) -> Float[np.ndarray, " n"]:
        """Cube root of the volume of each object's upright box [m]."""
        return np.maximum(np.cbrt(np.prod(2 * self.upright.half, axis=1)), MIN_SIZE)

    @cached_property
    def edges(self) -> Int[np.ndarray, "e 3"]:
        """Child, parent, index into KINDS; of two neighbors, the first in the scene is the child.

        An edge that follows from two others is omitted: a cup on a tray on a table is not on the
        table. Objects with another relation are not near as well. With `dense` edges, every two
        objects that nothing carries are.
        """
        config, n = self.config, len(self)
        bodies = stack_bodies(self.scene, self.upright)
        above = _shortest(hierarchy(bodies, contact=config.contact), n)
        if config.edges == "support":
            return above
        if config.edges == "dense":
            lowest = np.setdiff1d(np.arange(n), above[:, 0])
            near = np.stack([lowest[one] for one in np.triu_indices(len(lowest), 1)], -1)
        else:
            near = neighbors(self.upright, count=config.neighbors, reach=config.near)
        known = np.sort(above[:, :2], axis=1) @ [n, 1]
        near = near[~np.isin(near @ [n, 1], known)]
        return np.concatenate([above, np.column_stack([near, np.full(len(near), NEAR)])])

    @property
    def child(self) -> Int[np.ndarray, " e"]:
        """The object that is on, in, inside or near the parent, for each edge."""
        return self.edges[:, 0]

    @property
    def parent(self) -> Int[np.ndarray, " e"]:
        """The object that the child is on, in, inside or near, for each edge."""
        return self.edges[:, 1]

    @property
    def kind(self) -> Int[np.ndarray, " e"]:
        """Index into KINDS: on, in, inside, near."""
        return self.edges[:, 2]

    @cached_property
    def dist_xy(self) -> Float[np.ndarray, " e"]:
        """Horizontal distance between the two centers of each edge, at least `config.floor` [m]."""
        center = self.upright.center[:, :2]
        apart = np.linalg.norm(center[self.child] - center[self.parent], axis=1)
        return np.maximum(apart, self.config.floor)

    def __len__(self) -> int:
        return len(self.scene.objects)

    def index(self, name: str) -> int:
        """Return the index of an object in `names`.

        Raises:
            UnknownNameError: There is no such object; the message suggests the nearest name.
        """
        if name not in self.names:
            raise unknown_name("object", name, self.names, "the scene")
        return self.names.index(name)

    @cached_property
    def adjacency(self) -> sparse.csr_array:
        """The undirected graph: entry (i, j) is 1 + the index of the edge between i and j."""
        from scipy import sparse

        order = np.arange(1, len(self.child) + 1)
        rows, columns = np.r_[self.child, self.parent], np.r_[self.parent, self.child]
        shape = (len(self), len(self))
        matrix = sparse.coo_array((np.r_[order, order], (rows, columns)), shape=shape).tocsr()
        matrix.sort_indices()
        return matrix

    def steps(self, target: int) -> Int[np.ndarray, " n"]:
        """Count the edges on the shortest path from each object to the target, -1 without one."""
        ends = np.stack([np.r_[self.child, self.parent], np.r_[self.parent, self.child]])
        steps = np.full(len(self), -1)
        new = np.array([target])
        for count in range(len(self)):
            steps[new] = count
            near = np.unique(ends[1, np.isin(ends[0], new)])
            new = near[steps[near] < 0]
            if not len(new):
                break
        return steps

    def relations(self, target: int) -> tuple[str, ...]:
        """Return each object's relation to the target; "" for none."""
        words = [""] * len(self)
        for child, parent, kind in zip(self.child, self.parent, self.kind, strict=True):
            if parent == target:
                words[child] = KINDS[kind]
            elif child == target:
                words[parent] = _SEEN_FROM_PARENT[KINDS[kind]]
        return tuple(words)

    def gaps(self, target: int) -> Float[np.ndarray, " n"]:
        """Return the horizontal gap between each object's box and the target's [m]."""
        return outline_gaps(self.upright, target)


@owner_cache(4)
def build_graph(scene: Scene, config: GraphConfig | None = None) -> SceneGraph:
    """Build the scene graph from the geometry of the objects at their joint values.

    Raises:
        SceneError: The scene has no objects.
    """
    if not scene.objects:
        raise SceneError(f"scene {scene.name} has no objects to rank")
    return SceneGraph(scene, config or GraphConfig())


def _shortest(edges: Int[np.ndarray, "e 3"], n: int) -> Int[np.ndarray, "f 3"]:
    """Drop each edge whose ends are also connected by two other edges."""
    from scipy import sparse

    child, parent = edges[:, 0], edges[:, 1]
    matrix = sparse.csr_array((np.ones(len(edges), np.int32), (child, parent)), shape=(n, n))
    detour = (matrix @ matrix).multiply(matrix).tocoo()
    longer = np.isin(edges[:, :2] @ [n, 1], detour.row.astype(np.int64) * n + detour.col)
    return edges[~longer]
