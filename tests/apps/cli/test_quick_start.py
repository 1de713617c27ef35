"""A quick start: what is asked often, or asked wrongly, imports nothing heavy."""

from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path

import pytest

from momapos.apps.cli.main import main
from momapos.model.robots.robot import load_arms
from momapos.model.robots.robot_names import library_names
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_names import builtin_names, builtin_size
from momapos.planning.reachability.arm_axes import no_map

HEAVY = {"numpy", "scipy", "numba", "trimesh", "yourdfpy", "matplotlib", "jaxtyping"}


def imported(code: str, cache: Path) -> tuple[set[str], str]:
    """The heavy packages that a fresh Python has imported after some code, and what it printed."""
    tell = "import sys\n{}\nprint('\\n' + ' '.join(sys.modules))"
    done = subprocess.run(
        [sys.executable, "-c", tell.format(code)], capture_output=True, text=True, check=True,
        env={"PYTHONPATH": ":".join(sys.path), "MOMAPOS_CACHE": str(cache)},
    )  # fmt: skip
    shown, _, modules = done.stdout.rpartition("\n\n")
    return HEAVY & set(modules.split()), shown + done.stderr


def after(words: list[str], status: int, cache: Path) -> set[str]:
    """The heavy packages that a command imports."""
    code = f"from momapos.apps.cli.main import main\nassert main({words!r}) == {status}"
    return imported(code, cache)[0]


def test_importing_momapos_imports_nothing_heavy(tmp_path: Path) -> None:
    assert imported("import momapos", tmp_path)[0] == set()


@pytest.mark.parametrize(
    "words",
    [
        ["--help"], ["--version"], ["place", "--help"], ["place", "open", "--help"],
        ["rank", "--help"], ["robot", "list"], ["robot", "list", "--json"], ["scene", "list"],
        ["scan", "--help"], ["bench", "run", "--help"], ["--tyro-print-completion", "bash"],
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
def test_a_mistyped_name_is_told_before_anything_heavy_is_imported(
    words: list[str], tmp_path: Path
) -> None:
    assert after(words, 2, tmp_path) == set()


@pytest.mark.parametrize(
    "words",
    [
        ["robot", "show", "segway_ur5e"],
        ["scene", "show", "kitchen_small"],
        ["rank", "kitchen_small", "fridge"],
    ],
)
def test_a_second_start_neither_parses_nor_covers_anything_again(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:  # fmt: skip
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    assert main(words) == 0
    first = capsys.readouterr().out
    code = f"from momapos.apps.cli.main import main\nassert main({words!r}) == 0"
    imported(code, tmp_path)  # compiles, where kernels are not in this new cache
    heavy, shown = imported(code, tmp_path)
    assert shown.strip() == first.strip()
    assert not heavy & {"trimesh", "yourdfpy", "matplotlib", "jaxtyping", "numba"}


def test_a_question_without_options_of_the_method_is_read_without_typeguard(tmp_path: Path) -> None:
    place = ["place", "open", "kitchen_small", "fridg", "--robot", "fetch", "--to=30deg", "--json"]
    code = (
        "import sys\nfrom momapos.apps.cli.main import main\n"
        "assert main({!r}) == 2\nassert ('typeguard' in sys.modules) is {}"
    )
    imported(code.format(place, False), tmp_path)
    imported(code.format([*place, "--timeout", "5"], True), tmp_path)


@pytest.mark.parametrize(
    "words",
    [
        ["place", "open", "kitchen_small", "microwave"],
        ["place", "pick", "kitchen_small", "cup", "--robot=fetch", "--seed", "3", "--json"],
        ["rank", "kitchen_small", "fridge", "--seed", "3", "--joint", "fridge/door_hinge=10deg"],
    ],
)
def test_a_configuration_that_is_not_read_is_the_default_one(
    words: list[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """Options of the method make tyro read all of them; these give each its default."""
    asked = []

    def ask(*args: object, **named: object) -> int:
        asked.append((args, named))
        return 0

    monkeypatch.setattr("momapos.apps.cli.place._answer", ask)
    monkeypatch.setattr(
        "momapos.planning.importance.ranking.rank", lambda *args, **_: ask(args[2]) or exit(0)
    )
    for more in ([], ["--alpha", "0.45"]):
        assert main([*words, *more]) == 0
    assert asked[0] == asked[1]


def test_lists_tell_what_the_models_hold(capsys: pytest.CaptureFixture[str]) -> None:
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
