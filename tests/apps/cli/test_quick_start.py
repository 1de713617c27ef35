"""Help, lists and mistyped names import nothing heavy, so that they are fast."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from momapos.apps.cli.main import main
from momapos.core.cache import default_cache_dir
from momapos.model.robots.robot import load_arms
from momapos.model.robots.robot_names import library_names
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names, builtin_size
from momapos.planning.reachability.arm_axes import no_map

HEAVY = {"numpy", "scipy", "numba", "trimesh", "yourdfpy", "matplotlib", "jaxtyping"}


def imported(code: str, cache: Path) -> tuple[set[str], str]:
    """Run code in a new process; return the heavy packages that it imports, and its output."""
    report = "import sys\n{}\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", report.format(code)], capture_output=True, text=True, check=True,
        env={"PYTHONPATH": ":".join(sys.path), "MOMAPOS_CACHE": str(cache)},
    )  # fmt: skip
    shown, _, modules = done.stdout.rpartition("\n\n")
    return HEAVY & set(modules.split()), shown + done.stderr


def after(words: list[str], status: int, cache: Path) -> set[str]:
    """Return the heavy packages that a command imports."""
    code = f"from momapos.apps.cli.main import main\nassert main({words!r}) == {status}"
    return imported(code, cache)[0]


def test_importing_momapos_imports_nothing_heavy(tmp_path: Path) -> None:
    assert imported("import momapos", tmp_path)[0] == set()


def test_what_reads_and_models_scans_does_not_import_numba(tmp_path: Path) -> None:
    code = "import momapos.perception.recordings.clouds, momapos.perception.pipeline"
    assert "numba" not in imported(code, tmp_path)[0]


@pytest.mark.parametrize(
    "words",
    [
        ["--help"], ["--version"], ["place", "--help"], ["place", "open", "--help"],
        ["rank", "--help"], ["robot", "list"], ["robot", "list", "--json"], ["scene", "list"],
        ["scan", "--help"], ["bench", "run", "--help"], ["--tyro-print-completion", "bash"],
        ["place", "open", "--help-all"], ["solve", "--help-all"],
    ],
)  # fmt: skip
def test_lists_and_help_import_nothing_heavy(words: list[str], tmp_path: Path) -> None:
    assert after(words, 0, tmp_path) == set()


@pytest.mark.parametrize(
    "words",
    [
        ["plcae"],
        ["place", "opne"],
        ["place", "open", "kitchen_smal", "fridge"],
        ["place", "open", "kitchen_small", "fridg"],
        ["place", "open", "kitchen_small", "microwave", "--robot", "fetsh"],
        ["place", "pick", "kitchen_small", "cupp"],
        ["place", "pick", "kitchen_small", "cup", "--set", "plcae.count=3"],
        ["rank", "kitchen_small", "fridg"],
        ["scene", "show", "kitchen_smal"],
        ["scene", "convert", "kitchen_smal", "out.json"],
        ["scene", "scan", "kitchen_smal", "--out", "out"],
        ["robot", "show", "fetsh"],
        ["reach", "eval", "fetsh"],
        ["verify", "no_such_plan.json"],
        ["run", "no_such_plan.json"],
        ["bench", "run", "smok", "--out", "out"],
    ],
)
def test_a_mistyped_name_is_reported_before_anything_heavy_is_imported(
    words: list[str], tmp_path: Path
) -> None:
    assert after(words, 2, tmp_path) == set()


@pytest.mark.parametrize(
    "words",
    [
        ["scene", "show", "kitchen_small"],
        pytest.param(["robot", "show", "segway_ur5e"], marks=pytest.mark.slow),
        pytest.param(["rank", "kitchen_small", "fridge"], marks=pytest.mark.slow),
    ],
)
def test_a_second_start_uses_the_cached_models(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    kernels = default_cache_dir()
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    assert main(words) == 0
    first = capsys.readouterr().out
    for kernel in kernels.glob("kernel-*"):  # this process compiled them, into its own cache
        shutil.copy(kernel, tmp_path)
    code = f"from momapos.apps.cli.main import main\nassert main({words!r}) == 0"
    heavy, shown = imported(code, tmp_path)
    assert shown.strip() == first.strip()
    assert not heavy & {"trimesh", "yourdfpy", "matplotlib", "jaxtyping", "numba"}


def test_a_second_answer_imports_numpy_and_no_other_large_package(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    words = ["place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "fetch"]
    kernels = default_cache_dir()
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    assert main(words) == 0
    for kernel in kernels.glob("kernel-*"):
        shutil.copy(kernel, tmp_path)
    assert after(words, 0, tmp_path) == {"numpy"}


def test_the_planner_imports_numpy_and_no_other_large_package(tmp_path: Path) -> None:
    code = "import momapos.planning.plan, momapos.planning.baselines.by_method"
    assert imported(code, tmp_path)[0] == {"numpy"}


def test_arguments_are_parsed_without_typeguard(tmp_path: Path) -> None:
    words = [
        "place", "open", "kitchen_small", "fridg", "--robot", "fetch", "--to=30deg", "--json",
        "--timeout", "5", "--method", "paper", "--set", "paper.heights=0.5+1",
    ]  # fmt: skip
    code = (
        "import sys\nfrom momapos.apps.cli.main import main\n"
        f"assert main({words!r}) == 2\nassert 'typeguard' not in sys.modules"
    )
    imported(code, tmp_path)


def test_lists_agree_with_the_models(capsys: pytest.CaptureFixture[str]) -> None:
    for name in builtin_names():
        scene = load_scene(name)
        joints = sum(len(item.model.joints) for item in scene.objects)
        assert builtin_size(name) == (len(scene.objects), joints)
    assert main(["robot", "list", "--json"]) == 0
    listed = json.loads(capsys.readouterr().out)["robots"]
    robots = [load_arms(name)[0] for name in library_names()]
    facts = [{"name": r.name, "drive": r.drive, "arms": max(1, len(r.arms))} for r in robots]
    assert [{key: one[key] for key in facts[0]} for one in listed] == facts
    assert [one["map"] == "none" for one in listed] == [bool(no_map(r)) for r in robots]
