"""Search the shortest path over the waypoints, and check for collision only what it needs.

Most configurations end up on no path. The search takes unchecked configurations for free and checks
those of its path. If one collides, it checks all others and searches again, which is faster than to
search after every collision.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from momapos.core.compiled import B1, F1, F2, I1, I2, entry, kernel
from momapos.model.collision import FREE, CollisionWorld, check_one, collision_arrays, scratch_of
from momapos.model.kinematics import ChainArrays, CollisionArrays, TaskState, chain_arrays
from momapos.planning.grasps import TaskMotion

from .arm_models import ArmModel, robot_of, split_states, standing_arm
from .hand_clearance import arm_spheres
from .ik_layers import MAX_STEP, Layers, full_turns, joint_scale, joint_step

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

MAX_TURN = float(np.radians(25.0))
"""Largest turn of the hand about a bar between waypoints [rad]."""


class _Nodes(NamedTuple):
    """The configurations of a job, waypoint by waypoint."""

    states: F2
    """Joint values, and the turn of the hand as one more joint."""
    q: F2
    """Values of all degrees of freedom, slides of the base first."""
    bases: F2
    arm_q: F2
    """The base pose at each, and the state of the arm on it."""
    first: I1
    """First index of each waypoint's nodes, and their number."""
    lane: I2
    row: I1
    """See `TaskMotion.lanes`."""
    checked: B1
    """Which nodes were checked for collision; updated."""
    banned: B1
    """Which nodes are excluded; updated."""


class _Steps(NamedTuple):
    """How to measure steps between states, see `joint_step`."""

    full_turn: B1
    scale: F1


class _Moments(NamedTuple):
    """The state of the task at each waypoint."""

    value: I1
    holding: B1


@dataclass(frozen=True, eq=False)
class PathGraph:
    """The configurations of one job: a grasp mode at a base pose."""

    nodes: _Nodes
    grasps: Int[np.ndarray, " m"]
    """The grasp of each node."""
    steps: _Steps
    moments: _Moments
    chain: ChainArrays
    room: CollisionArrays

    @classmethod
    def of(
        cls,
        robot: ArmModel,
        world: CollisionWorld,
        motion: TaskMotion,
        base: Float[np.ndarray, "*d 3"],
        layers: Layers,
        job: int,
    ) -> PathGraph:
        """Return the graph of a job with configurations at all waypoints.

        Args:
            robot, world, motion: Arm, obstacles and task motion.
            base: Base pose x [m], y [m], yaw [rad], or one at every step of the motion.
            layers: The configurations of all jobs.
            job: The index of this one.
        """
        layer_of, (lanes, row) = motion.layer_of, motion.lanes
        counts = layers.counts[job, layer_of]
        first = np.append(0, np.cumsum(counts))
        begin = layers.first[job, layer_of] - first[:-1]
        which = np.arange(first[-1]) + np.repeat(begin, counts)
        q, grasps, checked = (x[which] for x in (layers.q, layers.grasps, layers.checked))
        chain, step = robot.chain, motion.waypoint_steps
        at = base if base.ndim == 1 else base[np.repeat(step, counts)]
        bases, arm_q = map(np.ascontiguousarray, split_states(robot, at, q))
        return cls(
            _Nodes(
                np.column_stack([q, motion.turning.angles[grasps]]), q, bases, arm_q, first,
                np.ascontiguousarray(lanes[:, grasps]), row, checked, np.zeros(len(q), bool),
            ),
            grasps,
            _Steps(
                np.append(full_turns(chain), False),
                np.append(joint_scale(chain), MAX_STEP / MAX_TURN),
            ),
            _Moments(motion.value[step], motion.holding[step]),
            chain_arrays(standing_arm(robot).chain),
            collision_arrays(arm_spheres(robot_of(robot)), world),
        )  # fmt: skip

    @property
    def banned(self) -> Bool[np.ndarray, " m"]:
        """Nodes that are on no path; may be extended."""
        return self.nodes.banned

    def shortest_free_path(self) -> tuple[int, Int[np.ndarray, " w"]]:
        """Return the number of waypoints reached and, if that is all, the node at each."""
        chosen = np.full(len(self.moments.value), -1)
        args = self.nodes, self.steps, self.moments, self.chain, self.room, chosen
        return int(_shortest_free_path(*args)), chosen


@kernel
def _extend(nodes, steps, begin, cost, parent):
    """Search the path with the smallest sum of steps to each node of the layers from one on.

    A step connects states of the same lane, by the lanes in the layer's row. Return the number of
    layers reached.
    """
    start, banned, lane, row = nodes.first, nodes.banned, nodes.lane, nodes.row
    for i in range(start[begin], len(cost)):
        cost[i], parent[i] = np.inf, -1
        if i < start[1] and not banned[i]:
            cost[i] = 0.0
    for w in range(max(begin, 1), len(start) - 1):
        any_reached = False
        for i in range(start[w], start[w + 1]):
            if banned[i]:
                continue
            for j in range(start[w - 1], start[w]):
                if cost[j] >= cost[i] or lane[row[w], i] != lane[row[w], j]:
                    continue
                d = joint_step(
                    nodes.states[j], nodes.states[i], steps.full_turn, steps.scale, MAX_STEP
                )
                if d < MAX_STEP and cost[j] + d < cost[i]:
                    cost[i], parent[i] = cost[j] + d, j
                    any_reached = True
        if not any_reached:
            return w
    return len(start) - 1


@kernel
def _trace(start, cost, parent, chosen):
    """Fill in the nodes of the cheapest path to the last layer."""
    layers = len(start) - 1
    best = start[layers - 1]
    for i in range(start[layers - 1], start[layers]):
        if cost[i] < cost[best]:
            best = i
    for w in range(layers - 1, -1, -1):
        chosen[w] = best
        best = parent[best]


@kernel
def _collides(i, w, nodes, moments, chain, room, scratch):
    """Check a node of a layer, if it was not checked before; ban it if it collides."""
    if nodes.checked[i]:
        return False
    nodes.checked[i] = True
    state = TaskState(moments.value[w], moments.holding[w])
    if check_one(nodes.arm_q[i], nodes.bases[i], state, chain, room, scratch) == FREE:
        return False
    nodes.banned[i] = True
    return True


@entry
def _shortest_free_path(
    nodes: _Nodes,
    steps: _Steps,
    moments: _Moments,
    chain: ChainArrays,
    room: CollisionArrays,
    chosen: I1,
) -> int:
    """Fill in the nodes of the path; return the number of layers reached."""
    start, layers = nodes.first, len(nodes.first) - 1
    cost, parent = np.empty(len(nodes.q)), np.empty(len(nodes.q), np.int64)
    reached = _extend(nodes, steps, 0, cost, parent)
    if reached < layers:
        return reached
    _trace(start, cost, parent, chosen)
    scratch, begin = scratch_of(len(chain.slides), room.spheres), layers
    for w in range(layers):
        if _collides(chosen[w], w, nodes, moments, chain, room, scratch):
            begin = min(begin, w)
    if begin == layers:
        return layers
    for w in range(layers):
        for i in range(start[w], start[w + 1]):
            if _collides(i, w, nodes, moments, chain, room, scratch):
                begin = min(begin, w)
    reached = _extend(nodes, steps, begin, cost, parent)
    if reached == layers:
        _trace(start, cost, parent, chosen)
    return reached
