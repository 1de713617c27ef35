"""Describe the part that a joint moves: its handle, and the pull that opens it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import TaskError, UrdfError
from momapos.core.geometry import apply
from momapos.model.scene import (
    ResistanceConfig,
    SceneObject,
    latch_to_turn,
    resistance_along,
)
from momapos.model.urdf import JointOpening, opening_of

from .handle_records import Handle
from .handle_shapes import CarriedPart, is_handle_joint
from .handles import find_handle
from .part_motion import lever_arms, levers_along
from .task_requests import WIDE_OPEN

if TYPE_CHECKING:
    from jaxtyping import Float

_VALUES = 19
"""Joint values at which the resistance is evaluated: every 5 degrees up to 90 [-]."""
_MIN_LEVER = 1e-3
"""Lever arm below which no pull at the handle is stated [m]."""


@dataclass(frozen=True, eq=False)
class PartFacts:
    """What is known about the part that a joint moves."""

    opening: JointOpening
    follows: str
    """The joint that a mimic joint follows; "" for other joints."""
    is_handle: bool
    """Whether the joint moves nothing but the handle of another part."""
    handle: Handle | None
    """Where a hand holds the part; None for a mimic joint, and if there is a problem."""
    handle_world: Float[np.ndarray, "3"] | None
    """Its middle in the world [m]."""
    pull: float | None
    """Largest pull at the handle on the way from closed to open [N]; up to 90 degrees."""
    problem: str = ""
    """Why no handle could be looked for."""


def _latch_link(item: SceneObject, joint: str) -> str | None:
    """Return the link of the latch that a hand must hold to open a part; None if there is none."""
    latch = latch_to_turn(item, joint)
    return None if latch is None else item.joint(latch.joint).child


def part_facts_of(
    item: SceneObject, joint: str, config: ResistanceConfig | None = None
) -> PartFacts:
    """Describe the part that a joint of an object moves.

    Args:
        item: The object.
        joint: One of its movable joints.
        config: Assumed resistances.
    """
    record, opening = item.joint(joint), opening_of(item.model, joint)
    if record.mimic is not None:
        return PartFacts(opening, record.mimic.joint, False, None, None, None)
    alone = is_handle_joint(item.model, record)
    try:
        handle = find_handle(item.posed_model(joint), joint, opening.sign, _latch_link(item, joint))
    except (TaskError, UrdfError) as error:  # no geometry, or a mesh without readable faces
        return PartFacts(opening, "", alone, None, None, None, str(error))
    center = apply(item.link_poses()[handle.carrier], handle.center[None])[0]
    part = CarriedPart(item.posed_model(joint), joint, handle.carrier)
    pull = None
    if lever_arms(part, handle.center[None])[0] > _MIN_LEVER:
        reach = abs(opening.wide - opening.closed)
        reach = reach if record.kind == "prismatic" else min(reach, WIDE_OPEN)
        values = opening.closed + opening.sign * np.linspace(0.0, reach, _VALUES)
        lever = levers_along(part, handle.center[None], values)[:, 0]
        resistance = resistance_along(item, joint, values, lever, config or ResistanceConfig())
        pull = float((resistance.total / lever).max())
    return PartFacts(opening, "", alone, handle, center, pull)
