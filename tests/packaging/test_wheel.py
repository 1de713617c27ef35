"""Laws of the wheel: it contains all data and works without a checkout or a cache."""

from __future__ import annotations

import json
import os
import subprocess
import sys
import venv
import zipfile
from dataclasses import dataclass
from pathlib import Path

import pytest
from tests import optional

REPOSITORY = Path(__file__).parents[2]
PACKAGE = REPOSITORY / "src" / "momapos"
COMMAND = ("place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e")
"""The command of `make demo`."""
EVERYTHING = """
import json, sys
from pathlib import Path
import momapos
from momapos.planning.reachability.construct import default_config
from momapos.planning.reachability.map_store import map_key, shipped
from momapos.model.robots.robot_names import library_names
from momapos.model.robots.robot import load_arms
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names

arms = [arm for name in library_names() for arm in load_arms(name)]
robots = {f"{arm.name} {arm.arm}".strip(): arm for arm in arms if arm.chain.size >= 6}
maps = {n: shipped(r, map_key(r, default_config(r))) is not None for n, r in robots.items()}
boxes = {n: sum(len(item.bounds) for item in load_scene(n).objects) for n in builtin_names()}
print(json.dumps({"file": momapos.__file__, "maps": maps, "kitchens": boxes}))
"""
FRONTS = """
import numpy as np
from momapos.perception.reconstruction.front_network import FrontNetwork
from momapos.model.records import FaceImage

image, relief = np.full((96, 96, 3), 205, np.uint8), np.full((96, 96), np.nan, np.float32)
print(type(FrontNetwork()(FaceImage(image, relief, 0.6, 0.6), "cabinet")).__name__)
"""

MAX_WHEEL_BYTES = 20_000_000
KERNELS = """
import json, sys
from momapos.core.compiled.pack import every_entry
from momapos.core.compiled.code_store import store

entries = every_entry()
outdated = [e.name for e in entries if store._packed.get(e.name) != e.stamp]
damaged = [e.name for e in entries if not callable(store.native(e))]
print(json.dumps([len(entries), outdated + damaged, "numba" in sys.modules]))
"""

pytestmark = optional.needs("a wheel", "MOMAPOS_WHEEL" in os.environ)


@dataclass(frozen=True)
class Installed:
    """An environment with the wheel and its dependencies, and an empty working folder."""

    wheel: Path
    environment: Path
    folder: Path

    def run(self, *command: str) -> str:
        """Run a program of the environment, without this process's environment variables."""
        plain = {
            "PATH": f"{self.environment / 'bin'}:/usr/bin:/bin",
            "HOME": str(self.folder / "home"),
        }
        kept = {k: v for k, v in os.environ.items() if k.startswith(("PIP_", "SSL_", "LANG"))}
        kept |= {k: v for k, v in os.environ.items() if k.lower().endswith("_proxy")}
        done = subprocess.run(
            [str(self.environment / "bin" / command[0]), *command[1:]],
            capture_output=True, text=True, cwd=self.folder, env=kept | plain,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
        return done.stdout


@pytest.fixture(scope="module")
def installed(tmp_path_factory: pytest.TempPathFactory) -> Installed:
    """Build the wheel as a release is built, from the source archive, and install it."""
    root = tmp_path_factory.mktemp("wheel")
    assert not root.is_relative_to(REPOSITORY)
    dist, environment, folder = root / "dist", root / "env", root / "work"
    (folder / "home").mkdir(parents=True)
    build = [sys.executable, "-m", "build", "--outdir", str(dist), str(REPOSITORY)]
    done = subprocess.run(build, capture_output=True, text=True)
    assert done.returncode == 0, done.stdout + done.stderr
    (wheel,) = dist.glob("*.whl")
    venv.create(environment, with_pip=True)
    installation = Installed(wheel, environment, folder)
    installation.run("python", "-m", "pip", "install", "--quiet", str(wheel))
    return installation


def test_every_file_of_the_package_is_in_the_wheel(installed: Installed) -> None:
    wanted = {
        str(path.relative_to(PACKAGE.parent))
        for path in PACKAGE.rglob("*")
        if path.is_file() and "__pycache__" not in path.parts
    }
    assert {".toml", ".urdf", ".srdf", ".reach", ".json", ".onnx"} <= {
        Path(w).suffix for w in wanted
    }
    assert wanted <= set(zipfile.ZipFile(installed.wheel).namelist())


def test_every_kernel_is_shipped_compiled_and_links_without_numba(installed: Installed) -> None:
    assert "momapos/core/compiled/kernels.zip" in zipfile.ZipFile(installed.wheel).namelist()
    count, missing, imports_numba = json.loads(installed.run("python", "-c", KERNELS))
    assert count > 20
    assert missing == []
    assert not imports_numba


def test_the_wheel_contains_robots_maps_and_kitchens(installed: Installed) -> None:
    found = json.loads(installed.run("python", "-c", EVERYTHING))
    assert Path(found["file"]).is_relative_to(installed.environment)
    assert all(found["maps"].values())
    assert {"fetch", "tiago", "tiago_dual left", "tiago_dual right"} <= set(found["maps"])
    assert installed.wheel.stat().st_size < MAX_WHEEL_BYTES
    assert all(found["kitchens"].values())
    assert set(found["kitchens"]) == {"kitchen_small", "kitchen_island"}


def test_the_demo_command_writes_a_valid_plan(installed: Installed) -> None:
    text = installed.run("momapos", *COMMAND, "--out", "plan.json", "--plot", "plan.png")
    assert ": solved\n" in text
    assert installed.run("momapos", "verify", "plan.json").rstrip().endswith("VALID")
    assert (installed.folder / "plan.png").read_bytes().startswith(b"\x89PNG")
    assert " ".join(COMMAND) in (REPOSITORY / "Makefile").read_text()
    # Kernels compiled at run time are cached: there are none.
    cache = installed.folder / "home" / ".cache" / "momapos"
    assert list(cache.glob("kernel-*")) == []


def test_the_wheel_contains_the_weights_of_the_front_network(installed: Installed) -> None:
    installed.run("python", "-m", "pip", "install", "--quiet", f"{installed.wheel}[scan]")
    assert installed.run("python", "-c", FRONTS) == "Front\n"
