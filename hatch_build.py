"""Compile the kernels into the wheel, where numba runs on the machine that builds it."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from hatchling.builders.hooks.plugin.interface import BuildHookInterface

_RUN = """
import runpy, sys
sys.path.insert(0, sys.argv.pop(1))
runpy.run_module("momapos.core.compiled.pack", run_name="__main__")
"""


class KernelPack(BuildHookInterface):
    """Puts `kernels.zip` next to `momapos/core/compiled/code_store.py`.

    Without it kernels compile when they are first used.
    """

    def initialize(self, version: str, build_data: dict[str, Any]) -> None:
        """Build the pack in a process of its own, as numba reads the processor's name once."""
        if version == "editable":
            return
        source = Path(self.root) / "src"
        self.folder = tempfile.TemporaryDirectory()
        pack = Path(self.folder.name) / "kernels.zip"
        # By sys.path, not PYTHONPATH: pip's build environment drops from that what an editable
        # install of the same source has put on the path outside.
        command = [sys.executable, "-c", _RUN, str(source), str(pack)]
        done = subprocess.run(command, capture_output=True, text=True)
        if done.returncode == 0:
            build_data["force_include"][str(pack)] = "momapos/core/compiled/kernels.zip"
        else:
            reason = (done.stderr.strip().splitlines() or ["no reason given"])[-1]
            self.app.display_warning(f"the wheel brings no compiled kernels: {reason}")

    def finalize(self, version: str, build_data: dict[str, Any], artifact_path: str) -> None:  # noqa: ARG002
        """Remove the temporary file."""
        if version != "editable":
            self.folder.cleanup()
