"""Compile the kernels, once after installation from a clone; wheels contain them compiled."""

from __future__ import annotations

import importlib
import sys
from typing import TYPE_CHECKING

from momapos.core.compiled import ENTRIES, store

if TYPE_CHECKING:
    from momapos.planning.importance import ImportanceConfig

ANSWER = (
    "momapos.core.geometry.polygons._chain",
    "momapos.model.collision.base_collision._hit",
    "momapos.model.kinematics.chain.forward",
    "momapos.model.kinematics.chain.stand_at_origin",
    "momapos.model.kinematics.chain.tool_poses",
    "momapos.model.kinematics.statics.static_loads",
    "momapos.model.collision.self_collision._contacts",
    "momapos.model.collision.collision_world._fill_buckets",
    "momapos.model.collision.collision_world._state_hits",
    "momapos.model.collision.straight_motions._path_hit",
    "momapos.planning.arm_motion.arm_path._track",
    "momapos.planning.arm_motion.hand_clearance._enclosing",
    "momapos.planning.arm_motion.hand_clearance._hand_hits",
    "momapos.planning.arm_motion.ik_layers._solve_layers",
    "momapos.planning.arm_motion.arm_path._shortest_paths",
    "momapos.planning.arm_motion.arm_path._fill_paths",
    "momapos.planning.arm_motion.arm_planner.connect",
    "momapos.planning.arm_motion.arm_planner.level_states",
    "momapos.planning.grasps.handle_shapes._surface",
    "momapos.planning.grasps.handle_shapes._touches",
    "momapos.planning.navigation.reeds_shepp.shortest_lengths",
    "momapos.planning.navigation.convex_polygons._covered_polygons",
    "momapos.planning.navigation.outline_gaps._gaps",
    "momapos.planning.navigation.cost_map._clearance",
    "momapos.planning.navigation.cost_map._path_lengths",
    "momapos.planning.navigation.lattice._expand",
    "momapos.planning.navigation.lattice.car_curves",
    "momapos.planning.navigation.lattice.connections",
    "momapos.planning.navigation.lattice.shorten",
    "momapos.planning.navigation.lattice.standable",
    "momapos.planning.placement.area._within_reach",
    "momapos.planning.placement.grasp_scores._sees",
    "momapos.planning.reachability.grid.min_line_scores",
    "momapos.verification.convex.overlap",
    "momapos.verification.exact_shapes._place",
    "momapos.verification.sweep._deepest",
    "momapos.verification.sweep._first_contact",
)
"""Kernels for planning."""
CHECK = (
    "momapos.model.collision.self_collision._crossings",
    "momapos.model.robots.load_limits._touches",
    "momapos.model.robots.homes._extents",
)
"""Further kernels for checking a robot, which also plans."""
VERIFY = (
    "momapos.core.geometry.polygons._chain",
    "momapos.verification.convex.overlap",
    "momapos.verification.exact_shapes._place",
    "momapos.verification.sweep._deepest",
    "momapos.verification.sweep._first_contact",
)
"""Kernels for verification."""
RANK = (
    "momapos.planning.importance.scene_graph._hierarchy",
    "momapos.planning.importance.scene_graph._nearest",
)
"""Kernels for the scene graph and the reach scores."""
WALKS = (
    "momapos.planning.importance.scorers._train",
    "momapos.planning.importance.scorers._walk",
)
"""Further kernels for the scores of walks."""


def rank_kernels(config: ImportanceConfig) -> tuple[str, ...]:
    """Return the kernels for the scene graph and the scores of a configuration."""
    from momapos.planning.importance import WALKERS

    graph, nearest = RANK
    near = (nearest,) if config.resolved.graph.edges == "near" else ()
    return (graph, *near, *(WALKS if config.scorer in WALKERS else ()))


def compile_once(names: tuple[str, ...] = ANSWER) -> None:
    """Compile the kernels that are not cached, so that this time doesn't count for a timeout.

    Prints progress on stderr: in place on a terminal, else one line.
    """
    for name in names:
        importlib.import_module(name.rpartition(".")[0])
    store.prepare([ENTRIES[name] for name in names], _report)


def _report(done: int, count: int) -> None:
    line = f"momapos: compiling kernels, once after installation: {done} of {count}"
    if sys.stderr.isatty():
        end = "\n" if done == count else ""
        print(f"\r{line}", end=end, file=sys.stderr, flush=True)
    elif done == 0:
        print(line, file=sys.stderr, flush=True)
