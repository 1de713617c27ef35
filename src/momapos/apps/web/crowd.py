"""Objects of a large room, drawn in few nodes; a click is resolved by its ray.

A browser draws node by node, each with a shadow. A thousand nodes of a few triangles take far
longer than a few nodes of thousands of triangles without shadows. In return, objects are not
highlighted under the mouse.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, Any

import numpy as np

from .bodies import Surface, joined

if TYPE_CHECKING:
    from jaxtyping import Float
    from viser import SceneApi

MAX_TRIANGLES = 1000
"""Triangles of a node, unless one object has more; a change sends all of its node again [-]."""


@dataclass(frozen=True, eq=False)
class ColoredSurface:
    """The surface of an object in one color, in the world."""

    object: str
    surface: Surface
    color: tuple[int, int, int]

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lower and upper corner [m]."""
        return np.stack([self.surface.vertices.min(0), self.surface.vertices.max(0)])


class ObjectBatches:
    """Draws objects in few nodes, and sends only the nodes that change."""

    def __init__(
        self, api: SceneApi, name: str, picked: Callable[[str], None] | None = None
    ) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            name: Prefix of the nodes' names.
            picked: Called with the object that a user clicks.
        """
        self._api, self._name, self._picked = api, name, picked
        self._parts: tuple[ColoredSurface, ...] = ()
        self._left_out = ""
        self._drawn: list[tuple[list[ColoredSurface], Any]] = []
        """The surfaces of each node, and the node; None where none of them is drawn."""
        self._listens = False

    @property
    def nodes(self) -> tuple[Any, ...]:
        """The nodes that are drawn."""
        return tuple(node for _, node in self._drawn if node is not None)

    def show(self, parts: Sequence[ColoredSurface], left_out: str = "") -> None:
        """Draw surfaces in place of the last ones.

        Args:
            parts: The surfaces.
            left_out: An object that is drawn elsewhere; "" for none.
        """
        self._parts, self._left_out = tuple(parts), left_out
        batches = batched(parts)
        for _, node in self._drawn[len(batches) :]:
            if node is not None:
                node.remove()
        self._drawn = self._drawn[: len(batches)]
        for k, batch in enumerate(batches):
            wanted = [part for part in batch if part.object != left_out]
            if k == len(self._drawn):
                self._drawn.append((wanted, self._draw(k, wanted)))
            elif self._drawn[k][0] != wanted:
                if self._drawn[k][1] is not None:
                    self._drawn[k][1].remove()
                self._drawn[k] = wanted, self._draw(k, wanted)
        self._listen(bool(parts) and self._picked is not None)

    def _draw(self, k: int, parts: Sequence[ColoredSurface]) -> Any:
        if not parts:
            return None
        surface = joined(part.surface for part in parts)
        return self._api.add_mesh_simple(
            f"{self._name}{k}", *surface.arrays, color=parts[0].color, flat_shading=True,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _listen(self, wanted: bool) -> None:
        if wanted and not self._listens:
            self._api.on_click()(self._clicked)
        elif self._listens and not wanted:
            self._api.remove_click_callback(self._clicked)
        self._listens = wanted

    def _clicked(self, event: Any) -> None:
        name = object_hit(self._parts, np.array(event.ray_origin), np.array(event.ray_direction))
        if self._picked is not None and name not in ("", self._left_out):
            self._picked(name)


def batched(parts: Sequence[ColoredSurface]) -> list[list[ColoredSurface]]:
    """Group surfaces of one color, in their order, as many as one node may hold."""
    batches: list[list[ColoredSurface]] = []
    for color in dict.fromkeys(part.color for part in parts):
        left = 0
        for part in (one for one in parts if one.color == color):
            count = len(part.surface.faces)
            if count > left:
                batches.append([])
                left = MAX_TRIANGLES
            batches[-1].append(part)
            left -= count
    return batches


def object_hit(
    parts: Sequence[ColoredSurface],
    origin: Float[np.ndarray, "3"],
    direction: Float[np.ndarray, "3"],
) -> str:
    """Return the first object that a ray hits; "" where it hits none.

    Args:
        parts: The surfaces.
        origin: Origin of the ray [m].
        direction: Direction of the ray.
    """
    if not parts:
        return ""
    bounds = np.stack([part.bounds for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = np.sort((bounds - origin) / direction, axis=1)  # NaN along a face
    enters, leaves = np.nanmax(crossed[:, 0], axis=1), np.nanmin(crossed[:, 1], axis=1)
    near = np.flatnonzero((enters <= leaves) & (leaves >= 0.0)).tolist()
    distances = [_distance(parts[k].surface, origin, direction) for k in near]
    if not distances or min(distances) == np.inf:
        return ""
    return parts[near[int(np.argmin(distances))]].object


def _distance(
    surface: Surface, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> float:
    """Intersect a ray with the front of a surface: distance in lengths of its direction, or inf.

    By Moeller and Trumbore: Fast, minimum storage ray-triangle intersection, 1997.
    """
    a, b, c = (surface.vertices[surface.faces[:, k]] for k in range(3))
    across = np.cross(direction, c - a)
    volume = np.einsum("fk,fk->f", b - a, across)
    front = volume > 1e-12
    from_a = (origin - a)[front]
    u = np.einsum("fk,fk->f", from_a, across[front]) / volume[front]
    turned = np.cross(from_a, (b - a)[front])
    v = turned @ direction / volume[front]
    t = np.einsum("fk,fk->f", turned, (c - a)[front]) / volume[front]
    hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t >= 0)
    return float(t[hit].min(initial=np.inf))
