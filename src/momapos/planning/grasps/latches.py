"""Turn the latch of a part before the part moves, with a hand that holds the latch throughout."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from momapos.model.records import Latch
from momapos.model.robots import Grip, Robot
from momapos.model.scene import MotionResistance, SceneObject, resistance_along
from momapos.model.urdf import Articulated

from .config import SUBSTEPS, GraspConfig
from .grasp_families import MIN_LEVER, GraspSelection, select_part_grasps
from .hand_boxes import hand_of
from .handle_records import Handle
from .handle_shapes import CarriedPart
from .part_motion import lever_arms, motion_directions
from .pinch_grasps import pinch_capacity

if TYPE_CHECKING:
    from collections.abc import Collection

    from jaxtyping import Float


@dataclass(frozen=True, eq=False)
class PartValues:
    """Values of a part's joint, and of its latch, at the steps of a manipulation."""

    part: Float[np.ndarray, " v"]
    """[rad] or [m]"""
    latch: Float[np.ndarray, " v"] | None = None
    """[rad] or [m]; None if no latch is turned."""

    def after_turn(self, latch: Float[np.ndarray, " u"]) -> PartValues:
        """Return the values with a latch that is turned first; the part rests meanwhile.

        Args:
            latch: Values of the latch.
        """
        part = np.concatenate([np.full(len(latch) - 1, self.part[0]), self.part])
        return PartValues(part, np.append(latch, np.full(len(self.part) - 1, latch[-1])))

    @property
    def waypoints(self) -> int:
        """Number of waypoints, `SUBSTEPS` steps apart."""
        return (len(self.part) - 1) // SUBSTEPS + 1


def select_latch_grasps(
    robot: Robot,
    target: SceneObject,
    model: Articulated,
    joint: str,
    sign: float,
    resistance: MotionResistance,
    turn: tuple[Latch, Float[np.ndarray, " u"]],
    config: GraspConfig,
    excluded: Collection[Handle] = (),
) -> GraspSelection:
    """Select the grasps by which a hand turns a latch and then moves the part that it held.

    The hand closes on the latch: what only touches one side of it, as a hook does, turns it and
    does not pull.

    Args:
        robot: The robot.
        target: The object.
        model: Its model, see `SceneObject.posed_model`.
        joint: The joint of the part.
        sign: Its opening direction (+1 or -1).
        resistance: Resistance of the part.
        turn: The latch, and its values.
        config: The grasps to try.
        excluded: Handles to skip; not all of the latch's.
    """
    latch, values = turn
    chosen = select_part_grasps(
        robot, model, joint, sign, resistance, closes=False, config=config, excluded=excluded,
        latch=model.joint(latch.joint).child,
    )  # fmt: skip
    if chosen.reason:
        return chosen
    hand, part = hand_of(robot), CarriedPart.of(model, latch.joint)
    if robot.grips is not Grip.FINGERS or not hand.closes:
        return replace(
            chosen, reason=f"{robot.name} has no hand that closes on {part.carrier}, to turn it "
            f"and then pull by it",
        )  # fmt: skip
    R, p = chosen.Ts_part_tool[:, :3, :3], chosen.Ts_part_tool[:, :3, 3]
    point = p + hand.pad_middle * (R @ hand.approach)
    way = motion_directions(part, float(np.sign(values[-1] - values[0])), point)[0]
    lean = np.abs(np.einsum("gi,gi->g", R @ hand.closing, way))
    capacity = pinch_capacity(robot.grip_force, config.friction, lean)
    levers = np.maximum(lever_arms(part, point), MIN_LEVER)
    if model.joint(latch.joint).kind != "prismatic":
        # Both pads turn a knob on whose axis the hand is: each is half the width away from it.
        axis = model.joint(latch.joint).axis
        across = np.linalg.norm(np.cross(R @ hand.closing, axis), axis=1)
        levers = np.hypot(levers, across * chosen.grasps.width / 2)
    usual = float(np.median(levers))
    resists = resistance_along(target, latch.joint, values, usual, config.resistance)
    need = config.grasp_margin * resists.largest / levers
    strong = capacity >= need
    if not strong.any():
        best = int(np.argmax(capacity / need))
        why = resists.source(int(resists.total.argmax()))
        return replace(
            chosen, reason=f"{robot.name} holds {part.carrier} with {capacity[best]:.0f} N at "
            f"most, and {need[best]:.0f} N are needed to turn it"
            f"{why and f' ({why})'}",
        )  # fmt: skip
    return GraspSelection(
        chosen.Ts_part_tool[strong], chosen.grasps.take(strong), "", chosen.better_handle_reason
    )
