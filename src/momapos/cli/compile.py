"""Compiling the kernels, once after installation from a clone; a wheel brings them compiled."""

from __future__ import annotations

import importlib
import sys

from momapos.compiled.kernel import ENTRIES
from momapos.compiled.store import store

ANSWER = (
    "momapos.kinematics.base_collision._hit",
    "momapos.kinematics.chain.forward",
    "momapos.kinematics.chain.stand_at_origin",
    "momapos.kinematics.chain.tool_poses",
    "momapos.kinematics.self_collision._contacts",
    "momapos.kinematics.world._fill_buckets",
    "momapos.kinematics.world._first_hits",
    "momapos.manipulation.arm_path._shortest",
    "momapos.manipulation.arm_path._track",
    "momapos.manipulation.hand_room._hand_hits",
    "momapos.manipulation.layers._solve_layers",
    "momapos.manipulation.swept_boxes._surface",
    "momapos.manipulation.swept_boxes._touches",
    "momapos.navigation.clearance._gaps",
    "momapos.navigation.convex_hull._chain",
    "momapos.navigation.grid_distance._clearance",
    "momapos.navigation.grid_distance._path_lengths",
    "momapos.navigation.lattice.astar",
    "momapos.navigation.lattice.connections",
    "momapos.navigation.lattice.shorten",
    "momapos.navigation.lattice.standable",
    "momapos.placement.potential._sees",
    "momapos.reachability.grid.min_line_scores",
    "momapos.verification.convex.overlap",
    "momapos.verification.shapes._place",
    "momapos.verification.sweep._deepest",
)
"""The entries that an answer needs."""
VERIFY = (
    "momapos.verification.convex.overlap",
    "momapos.verification.shapes._place",
    "momapos.verification.sweep._deepest",
)
"""Those that checking a plan needs."""
RANK = (
    "momapos.importance.relations._hierarchy",
    "momapos.importance.relations._nearest",
)
"""Those that the scene graph and the scores by reach need."""
WALKS = ("momapos.importance.embedding._train", "momapos.importance.walks._walk")
"""Those that scores by walks need besides."""


def compile_once(names: tuple[str, ...] = ANSWER) -> None:
    """Compile those entries that are not stored, so that no timeout pays for it.

    Says how far it is on stderr: in place on a terminal, else in one line.
    """
    for name in names:
        importlib.import_module(name.rpartition(".")[0])
    store.prepare([ENTRIES[name] for name in names], _report)


def _report(done: int, count: int) -> None:
    """One line that a terminal shows in place."""
    line = f"momapos: compiling, once after installation: {done} of {count} kernels"
    if sys.stderr.isatty():
        end = "\n" if done == count else ""
        print(f"\r{line}", end=end, file=sys.stderr, flush=True)
    elif done == 0:
        print(line, file=sys.stderr, flush=True)
