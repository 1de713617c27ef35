"""Laws of the shape check of the tests."""

from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[1]
BEFORE = """
import numpy as np
from tests import shapes
from momapos.apps.cli.options import JointsArg
from momapos.core.geometry.transforms import pose
from momapos.core.geometry.polygons import UprightBox
"""


def run(code: str) -> subprocess.CompletedProcess[str]:
    """Run code in a new interpreter that checks the package."""
    return subprocess.run(
        [sys.executable, "-c", BEFORE + code], capture_output=True, text=True, cwd=REPOSITORY,
        env={**os.environ, "MOMAPOS_SHAPES": "1"},
    )  # fmt: skip


@pytest.mark.parametrize(
    ("call", "where"),
    [
        ("pose(np.zeros(1))", "transforms.pose"),
        ("pose(np.zeros(3, int))", "transforms.pose"),
        ("UprightBox(np.zeros(3), np.zeros(2), 0.0)", "UprightBox.__init__"),
    ],
)
def test_a_wrong_shape_or_dtype_is_refused_unless_unchecked(call: str, where: str) -> None:
    refused = run(call)
    assert refused.returncode == 1
    assert "jaxtyping.TypeCheckError" in refused.stderr
    assert where in refused.stderr
    unchecked = run(f"with shapes.unchecked(): {call}")
    assert unchecked.returncode == 0, unchecked.stderr


def test_the_branch_for_the_runtime_is_still_executed() -> None:
    done = run("assert JointsArg != tuple[str, ...], JointsArg")
    assert done.returncode == 0, done.stderr
