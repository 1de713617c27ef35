"""Check the scores of a reach scorer of the caller."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model.records import ReachScorer
from momapos.planning.reachability import ArmLength, ReachMap

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class CheckedReach:
    """A scorer whose arguments are copies, and whose scores are checked."""

    scorer: ReachScorer

    def min_score(
        self, bases: Float[np.ndarray, "n 3"], Ts_world_tool: Float[np.ndarray, "g w 4 4"]
    ) -> Float[np.ndarray, "n g"]:
        """Return the scores of the scorer.

        Raises:
            InputError: They are not one number in [0, 1] for each base pose and grasp.
        """
        scores = np.asarray(self.scorer.min_score(bases.copy(), Ts_world_tool.copy()))
        shape = (len(bases), len(Ts_world_tool))
        if scores.shape != shape or scores.dtype.kind not in "fiub":
            raise InputError(
                f"reach.min_score must return an array of shape {shape}, a score for each base "
                f"pose and grasp, not an array of {scores.dtype} of shape {scores.shape}"
            )
        if not ((scores >= 0.0) & (scores <= 1.0)).all():
            raise InputError("reach.min_score must return scores in [0, 1]")
        return scores.astype(float)


def checked_reach(reach: ReachScorer) -> ReachScorer:
    """Return a scorer with checks, unless it is one of momapos."""
    return reach if isinstance(reach, ReachMap | ArmLength | CheckedReach) else CheckedReach(reach)
