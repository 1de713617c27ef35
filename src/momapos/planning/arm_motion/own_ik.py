"""States at the waypoints from inverse kinematics of the user's own."""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.core.compiled import kernel
from momapos.core.geometry import invert, pose_planar
from momapos.model.kinematics import Chain
from momapos.model.records import InverseKinematics

if TYPE_CHECKING:
    from jaxtyping import Float, Int

_MAX_MISS = 1e-3
"""How far a state may miss its tool pose, in every entry of the pose [-] or [m]. The planner's
Newton steps remove smaller errors; a larger one is a solver for another arm or frame."""
_ROUNDING = 1e-6
"""A state may exceed a limit by this [rad] or [m]."""


def own_states(
    solve: InverseKinematics,
    chain: Chain,
    bases: Float[np.ndarray, "j d 3"],
    grasps: Int[np.ndarray, "j k"],
    steps: Int[np.ndarray, " l"],
    Ts_world_tool: Float[np.ndarray, "g s 4 4"],
) -> Float[np.ndarray, "r b n"]:
    """Return the states within limits for each job, step and grasp; NaN where there is none.

    Args:
        solve: The inverse kinematics.
        chain: The arm.
        bases: Base pose of each job, one for all steps or one for each.
        grasps: Grasps of each job, padded with -1.
        steps: Steps of the motion that are solved.
        Ts_world_tool: Tool pose of each grasp at every step.

    Raises:
        InputError: It returns anything but states whose tools are at the poses.
    """
    used = np.broadcast_to((grasps >= 0)[:, None], (len(grasps), len(steps), grasps.shape[1]))
    at = bases[:, np.minimum(steps, bases.shape[1] - 1)]
    tools = Ts_world_tool[grasps[:, None], steps[:, None]]
    Ts = (invert(pose_planar(at))[:, :, None] @ tools)[used]
    found = _checked(solve(Ts.copy()), chain, Ts)
    states = np.full((used.size, max(1, found.shape[1]), chain.size), np.nan)
    states[used.ravel(), : found.shape[1]] = found
    return states


def _checked(
    found: object, chain: Chain, Ts: Float[np.ndarray, "m 4 4"]
) -> Float[np.ndarray, "m b n"]:
    """Return states with those beyond the limits removed, after a check of their tool poses."""
    states = np.array(found, float) if isinstance(found, np.ndarray) else np.empty(0)
    if states.ndim != 3 or (states.shape[0], states.shape[2]) != (len(Ts), chain.size):
        raise InputError(
            f"inverse kinematics must return an array of shape ({len(Ts)}, b, {chain.size}), b "
            f"states for each of {len(Ts)} tool poses, not {getattr(found, 'shape', type(found))}"
        )
    known = ~np.isnan(states).any(2)
    states[~known] = np.nan
    pose, _ = np.nonzero(known)
    miss = np.abs(chain.tool_poses(states[known]) - Ts[pose]).max(initial=0.0)
    if not miss <= _MAX_MISS:
        raise InputError(
            f"inverse kinematics returned a state whose tool misses its pose by {miss:.2g}; at "
            f"most {_MAX_MISS:g} is allowed (m, or entries of the rotation matrix)"
        )
    beyond = (states < chain.lower - _ROUNDING) | (states > chain.upper + _ROUNDING)
    states[beyond.any(2)] = np.nan
    return np.clip(states, chain.lower, chain.upper)


@kernel
def copy_states(states, into):
    """Copy the rows without NaN; return their number."""
    count = 0
    for b in range(len(states)):
        if not np.isnan(states[b, 0]):
            into[count] = states[b]
            count += 1
    return count
