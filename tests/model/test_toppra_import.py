"""Laws of the import of toppra: no plots before someone plots."""

from __future__ import annotations

import subprocess
import sys

import pytest

TIMED = """
import sys
import numpy as np
{before}
from momapos.model.trajectory import MotionLimits, time_piece
s = np.linspace(0.0, 1.0, 20)
one = np.ones(1)
assert len(time_piece(s[:, None], s, MotionLimits(one, one, 9 * one), 0.05)) > 10
assert ("matplotlib.pyplot" in sys.modules) == {loaded}
import toppra.parametrizer
assert callable(toppra.parametrizer.plt.figure)
import matplotlib.pyplot
assert toppra.parametrizer.plt.figure is matplotlib.pyplot.figure
assert matplotlib.pyplot.__spec__ is not None
"""


@pytest.mark.parametrize(
    ("before", "loaded"),
    [("", False), ("import matplotlib", False), ("import matplotlib.pyplot", True)],
)
def test_timing_a_motion_imports_no_plots_and_toppra_can_still_plot(
    before: str, loaded: bool
) -> None:
    code = TIMED.format(before=before, loaded=loaded)
    done = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr
