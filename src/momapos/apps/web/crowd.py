"""The things of a large room: many in one node, and what a click means is found by its ray.

A browser draws a room node by node, with a shadow for each; a thousand nodes of a few triangles
take it far longer than a few nodes of thousands without shadows. What it would tell of the node
that the mouse is on it cannot tell then.
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

MOST_TRIANGLES = 1000
"""Of a node, unless a thing has more; where one thing changes, so many are sent again [-]."""


@dataclass(frozen=True, eq=False)
class Part:
    """What is seen of a thing in one color, in the world."""

    thing: str
    surface: Surface
    color: tuple[int, int, int]

    @cached_property
    def bounds(self) -> Float[np.ndarray, "2 3"]:
        """Lower and upper corner [m]."""
        return np.stack([self.surface.vertices.min(0), self.surface.vertices.max(0)])


class Crowd:
    """Draws things in few nodes; of what does not change nothing is sent again."""

    def __init__(
        self, api: SceneApi, name: str, picked: Callable[[str], None] | None = None
    ) -> None:
        """Draw nothing yet.

        Args:
            api: Where to draw.
            name: From which the names of all nodes begin.
            picked: Is told a thing that is clicked.
        """
        self._api, self._name, self._picked = api, name, picked
        self._parts: tuple[Part, ...] = ()
        self._left_out = ""
        self._drawn: list[tuple[list[Part], Any]] = []
        """The parts of each node, and the node; None where none of them is to be seen."""
        self._listens = False

    @property
    def nodes(self) -> tuple[Any, ...]:
        """What is drawn."""
        return tuple(node for _, node in self._drawn if node is not None)

    def show(self, parts: Sequence[Part], left_out: str = "") -> None:
        """Draw parts of things instead of the last.

        Args:
            parts: The parts.
            left_out: A thing that somebody else draws; "" for none.
        """
        self._parts, self._left_out = tuple(parts), left_out
        batches = batched(parts)
        for _, node in self._drawn[len(batches) :]:
            if node is not None:
                node.remove()
        self._drawn = self._drawn[: len(batches)]
        for k, batch in enumerate(batches):
            wanted = [part for part in batch if part.thing != left_out]
            if k == len(self._drawn):
                self._drawn.append((wanted, self._draw(k, wanted)))
            elif self._drawn[k][0] != wanted:
                if self._drawn[k][1] is not None:
                    self._drawn[k][1].remove()
                self._drawn[k] = wanted, self._draw(k, wanted)
        self._listen(bool(parts) and self._picked is not None)

    def _draw(self, k: int, parts: Sequence[Part]) -> Any:
        if not parts:
            return None
        surface = joined(part.surface for part in parts)
        return self._api.add_mesh_simple(
            f"{self._name}{k}", surface.vertices.astype(np.float32),
            surface.faces.astype(np.uint32), color=parts[0].color, flat_shading=True,
            cast_shadow=False, receive_shadow=False,
        )  # fmt: skip

    def _listen(self, wanted: bool) -> None:
        if wanted and not self._listens:
            self._api.on_click()(self._clicked)
        elif self._listens and not wanted:
            self._api.remove_click_callback(self._clicked)
        self._listens = wanted

    def _clicked(self, event: Any) -> None:
        ray = np.array(event.ray_origin), np.array(event.ray_direction)
        thing = thing_hit(self._parts, *ray)
        if self._picked is not None and thing not in ("", self._left_out):
            self._picked(thing)


def batched(parts: Sequence[Part]) -> list[list[Part]]:
    """Parts of one color together, in their order, as many as may be drawn as one."""
    batches: list[list[Part]] = []
    for color in dict.fromkeys(part.color for part in parts):
        left = 0
        for part in (one for one in parts if one.color == color):
            count = len(part.surface.faces)
            if count > left:
                batches.append([])
                left = MOST_TRIANGLES
            batches[-1].append(part)
            left -= count
    return batches


def thing_hit(
    parts: Sequence[Part], origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> str:
    """The first thing that a ray meets; "" where it meets none.

    Args:
        parts: What there is.
        origin: Where the ray begins [m].
        direction: Where it goes.
    """
    if not parts:
        return ""
    bounds = np.stack([part.bounds for part in parts])
    with np.errstate(divide="ignore", invalid="ignore"):
        crossed = np.sort((bounds - origin) / direction, axis=1)  # not a number: along a face
    enters, leaves = np.nanmax(crossed[:, 0], axis=1), np.nanmin(crossed[:, 1], axis=1)
    near = np.flatnonzero((enters <= leaves) & (leaves >= 0.0)).tolist()
    distances = [_distance(parts[k].surface, origin, direction) for k in near]
    if not distances or min(distances) == np.inf:
        return ""
    return parts[near[int(np.argmin(distances))]].thing


def _distance(
    surface: Surface, origin: Float[np.ndarray, "3"], direction: Float[np.ndarray, "3"]
) -> float:
    """How far a ray goes to the front of a surface, in lengths of its direction; else infinity.

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
