"""Rate base poses of a lattice: whether an arm state exists, is free, and bears the part's pull."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from momapos.core.compiled import C1, F1, F2, F3, I1, entry, kernel
from momapos.model.collision import FREE, check_one, scratch_of
from momapos.model.kinematics import (
    COARSE,
    MAX_BRANCHES,
    ArmArrays,
    ChainArrays,
    CollisionArrays,
    LoadArrays,
    TaskState,
    begin_pose,
    ik_scratch,
    load_excess,
    load_scratch,
    solve_sample,
    state_loads,
)

NONE, REACHED, CLEAR, BORNE, PULLED = 0, 1, 2, 3, 4
"""Levels of a node: no arm state, one that collides, a free one, one that bears the part's
resistance, and one that also bears what a moving base adds."""


class LatticeJobs(NamedTuple):
    """Base poses, each with a grasp, at one value of the part."""

    bases: F2
    """x [m], y [m], yaw [rad]."""
    tools: F3
    """Tool poses in the world (m, 4, 4)."""
    pull: F2
    """Force on the hand in the world [N]."""
    more_pull: F2
    """The same with what a moving base adds."""
    point: F2
    """Where it acts [m]."""
    node: I1
    """Index of the base pose's node, or of the first one on the lines along which it slides."""
    floor: I1
    """The same among the samples of the floor."""


class Sliding(NamedTuple):
    """How the base of a short arm slides to the arm state."""

    directions: F2
    """Unit directions in the frame of the base; none if it stands."""
    cell: F1
    """Edge of the cells, and of the finer samples of the floor [m]."""
    middle: I1
    """Index of the middle row of cells, and of samples."""
    rows: I1
    """Number of rows of cells, and of samples."""


@kernel
def _seen_from(base, force, point, out):
    """Write a force and where it acts in the frame of the base."""
    c, s = np.cos(base[2]), np.sin(base[2])
    x, y = point[0] - base[0], point[1] - base[1]
    out[0, 0], out[0, 1], out[0, 2] = (
        c * force[0] + s * force[1],
        c * force[1] - s * force[0],
        force[2],
    )
    out[1, 0], out[1, 1], out[1, 2] = c * x + s * y, c * y - s * x, point[2]


@kernel
def _tool_from(base, T, R, p):
    """Write a tool pose in the frame of the base."""
    c, s = np.cos(base[2]), np.sin(base[2])
    for k in range(3):
        R[0, k] = c * T[0, k] + s * T[1, k]
        R[1, k] = c * T[1, k] - s * T[0, k]
        R[2, k] = T[2, k]
    x, y = T[0, 3] - base[0], T[1, 3] - base[1]
    p[0], p[1], p[2] = c * x + s * y, c * y - s * x, T[2, 3]


@kernel
def _row(slide, sliding, k):
    """Return the row of cells or samples in which a slide ends; -1 outside."""
    row = int(np.floor(slide / sliding.cell[k] + 0.5)) + sliding.middle[k]
    return row if 0 <= row < sliding.rows[k] else -1


@kernel
def _borne(q, base, force, point, chain, robot, load, bearing):
    """Return whether motors and base bear a force on the hand."""
    _seen_from(base, force, point, load)
    stability = state_loads(q, chain, robot, load[0], load[1], bearing)
    return load_excess(bearing.efforts, stability, robot)[0] <= 0.0


@entry
def rate_nodes(
    jobs: LatticeJobs,
    value: int,
    holding: bool,
    arm: ArmArrays,
    chain: ChainArrays,
    sliding: Sliding,
    robot: LoadArrays,
    room: CollisionArrays,
    samples: int,
    floor: C1,
    levels: C1,
) -> np.ndarray:
    """Raise the levels of nodes to the best of their arm states.

    Args:
        jobs: Base poses and grasps.
        value: Index of the part's value.
        holding: Whether the hand may touch the part.
        arm: The arm, its slides first.
        chain: The arm without slides.
        sliding: The slides.
        robot, room: Masses and limits; spheres and obstacles.
        samples: Number of samples of the locked joints, or of seeds, that are tried.
        floor: 1 at samples of the floor on which the base is free.
        levels: Output, the level of each node.

    Returns:
        The obstacle that one of the arm states of each job hits, or FREE.
    """
    lead, n = len(sliding.directions), len(arm.limits.lower)
    hits = np.full(len(jobs.bases), FREE, np.int64)
    scratch, placed = ik_scratch(arm), scratch_of(len(chain.slides), room.spheres)
    solutions, bearing = np.empty((MAX_BRANCHES, n)), load_scratch(len(chain.slides), n - lead)
    R, p, load, here = np.empty((3, 3)), np.empty(3), np.empty((2, 3)), np.empty(3)
    state = TaskState(value, holding)
    for m in range(len(jobs.bases)):
        base, point = jobs.bases[m], jobs.point[m]
        _tool_from(base, jobs.tools[m], R, p)
        begin_pose(scratch)
        c, s = np.cos(base[2]), np.sin(base[2])
        for sample in range(samples):
            if lead == 0 and levels[jobs.node[m]] == PULLED:
                break
            for b in range(solve_sample(sample, R, p, arm, COARSE, solutions, scratch)):
                q, node, spot = solutions[b], jobs.node[m], jobs.floor[m]
                here[0], here[1], here[2] = base[0], base[1], base[2]
                inside = True
                for k in range(lead):
                    row, fine = _row(q[k], sliding, 0), _row(q[k], sliding, 1)
                    inside &= row >= 0 and fine >= 0
                    node += row * (sliding.rows[0] if k == 0 else 1)
                    spot += fine * (sliding.rows[1] if k == 0 else 1)
                    x, y = sliding.directions[k, 0] * q[k], sliding.directions[k, 1] * q[k]
                    here[0] += c * x - s * y
                    here[1] += s * x + c * y
                if not inside or levels[node] == PULLED:
                    continue
                levels[node] = max(levels[node], REACHED)
                if floor[spot] == 0:
                    continue
                q_arm, best = q[lead:], CLEAR
                if _borne(q_arm, here, jobs.pull[m], point, chain, robot, load, bearing):
                    best = BORNE
                    if _borne(q_arm, here, jobs.more_pull[m], point, chain, robot, load, bearing):
                        best = PULLED
                if best <= levels[node]:
                    continue
                hit = check_one(q_arm, here, state, chain, room, placed)
                if hit == FREE:
                    levels[node] = best
                else:
                    hits[m] = hit
    return hits
