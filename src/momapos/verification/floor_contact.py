"""Contact of the moved part with the floor, the plane z = 0.

How deep the part lies below the floor in the given scene does not count.
"""

from __future__ import annotations

import math
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Task
from momapos.model.scene import SceneObject

from .exact_shapes import Shapes
from .moved_part import MovedPart, moved_part
from .report import DEFAULT

if TYPE_CHECKING:
    from jaxtyping import Float

MAX_DIP = 1e-3
"""A part that extends less below the floor slides along it, as a drawer of a base cabinet [m]."""
TOUCH = 1e-5
"""Depth at which a part that would extend deeper meets the floor [m]."""
_FINE_STEPS = 33
"""Number of states between two states of a sweep, among which the contact is found [-]."""


def depths_below_floor(
    shapes: Shapes, Ts: Float[np.ndarray, "s k 4 4"]
) -> Float[np.ndarray, "s k"]:
    """Return how far each shape extends below z = 0 [m]; 0 if it is above.

    Args:
        shapes: The shapes.
        Ts: Their world poses.
    """
    extent = np.einsum("skj,kj->sk", np.abs(Ts[..., 2, :3]), shapes.half)
    low = Ts[..., 2, 3] - extent < 0.0
    depth = np.zeros(low.shape)
    for index in np.flatnonzero(low.any(0)).tolist():
        rows = np.flatnonzero(low[:, index])
        T = Ts[rows, index, 2]
        bottom = (T[:, :3] @ shapes.outline(index).T).min(1) + T[:, 3] - shapes.ball[index]
        depth[rows, index] = np.maximum(-bottom, 0.0)
    return depth


def dips(part: MovedPart, Ts: Float[np.ndarray, "s k 4 4"]) -> Float[np.ndarray, " s"]:
    """Return how far a part extends below the floor, minus the same in the given scene [m].

    Args:
        part: The part.
        Ts: World poses of its shapes.
    """
    given = depths_below_floor(part.shapes, part.placed(np.array([part.start])))
    depths = depths_below_floor(part.shapes, Ts).max(1, initial=0.0)
    return np.asarray(depths - given.max(initial=0.0))


def floor_contact(part: MovedPart, goal: float, step: float) -> tuple[float, str] | None:
    """Return at which value a part meets the floor, and its shape that does.

    Args:
        part: The part.
        goal: Value at the end of its motion [rad] or [m].
        step: Largest step between the values to check [rad] or [m].

    Returns:
        The value and the name of the shape; None if the part stays above the floor.
    """
    values = np.linspace(part.start, goal, max(2, math.ceil(abs(goal - part.start) / step) + 1))
    depths = dips(part, part.placed(values))
    if not (depths > MAX_DIP).any():
        return None
    state = int(np.argmax(depths > TOUCH))
    fine = np.linspace(values[state - 1], values[state], _FINE_STEPS)
    Ts = part.placed(fine)
    first = int(np.argmax(dips(part, Ts) > TOUCH))
    lowest = int(depths_below_floor(part.shapes, Ts[first : first + 1])[0].argmax())
    return float(fine[first]), part.shapes.names[lowest]


def meets_floor_at(item: SceneObject, joint: str, goal: float) -> float | None:
    """Return the value of a joint at which its part meets the floor; None if it never does.

    Args:
        item: The object, as it is in the scene.
        joint: The joint, which is no mimic joint.
        goal: Value at the end of its motion [rad] or [m].
    """
    contact = floor_contact(
        moved_part(item, Task("open", item.name, joint, goal)), goal, DEFAULT.step
    )
    return None if contact is None else contact[0]
