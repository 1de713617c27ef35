"""Mimic joints of the part in physics: equality constraints with their leader."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

from .simulated_room import is_part

if TYPE_CHECKING:
    import numpy as np
    from jaxtyping import Float


def set_followers(model: Any, q: Float[np.ndarray, " q"]) -> None:
    """Set the mimic joints of the part to where its joint takes them."""
    for follower, leader, ratio in couplings(model):
        x, y = model.joint(leader).qposadr[0], model.joint(follower).qposadr[0]
        q[y] = model.qpos0[y] + ratio * (q[x] - model.qpos0[x])


def couplings(model: Any) -> list[tuple[str, str, float]]:
    """Return the mimic joints of the part, with their leader and ratio."""
    return [
        (
            model.joint(model.eq_obj1id[i]).name,
            model.joint(model.eq_obj2id[i]).name,
            float(model.eq_data[i, 1]),
        )
        for i in range(model.neq)
        if is_part(model.equality(i).name)
    ]
