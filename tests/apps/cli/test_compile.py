"""Compiling once after installation."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest
from tests.model.robots.rovers import Axle, rover

from momapos.apps.cli import compile as compiling
from momapos.apps.cli.compile import ANSWER, CHECK, RANK, VERIFY, WALKS, compile_once
from momapos.apps.cli.main import main
from momapos.core.compiled.code_store import Store
from momapos.core.compiled.entries import ENTRIES
from momapos.core.compiled.pack import every_entry

ON_FIRST_USE = {
    "momapos.planning.reachability": "a map is built once per robot, and shows its progress",
    "momapos.model.collision.arm_collision": "exact reach, compact tours and drawings",
    "momapos.model.collision.base_collision._hit_moving": "other kernels call it; Python in tests",
    "momapos.model.kinematics.base_fit": "only for arms of fewer than six joints",
    "momapos.model.kinematics.ik._solve_all": "inverse kinematics on its own",
    "momapos.perception": "a scan is checked while it is read, and shows its progress",
    "momapos.planning.navigation.dynamic_window": "a run drives after it has planned",
}
"""Kernels that compile when they are first needed, by module or name, with the reason."""


def test_kernels_are_compiled_once_with_one_line_of_output(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path, tmp_path / "no pack")
    monkeypatch.setattr(compiling, "store", store)
    short = (
        "momapos.model.kinematics.chain.stand_at_origin",
        "momapos.verification.exact_shapes._place",
    )
    for name in short:  # as in a new process
        importlib.import_module(name.rpartition(".")[0])
        monkeypatch.setattr(ENTRIES[name], "_native", None)
    monkeypatch.setattr("momapos.core.compiled.code_store.store", store)
    compile_once(short)
    assert capsys.readouterr().err.splitlines() == [
        "momapos: compiling kernels, once after installation: 0 of 2"
    ]
    compile_once(short)
    assert capsys.readouterr().err == ""
    assert all(store.find(ENTRIES[name]) is not None for name in short)


def test_every_kernel_for_planning_is_an_entry() -> None:
    compile_once()
    assert set(ANSWER) <= set(ENTRIES)


def test_every_kernel_is_announced_or_has_a_reason_to_compile_on_first_use() -> None:
    announced = {*ANSWER, *CHECK, *VERIFY, *RANK, *WALKS}
    names = {name for entry in every_entry() if (name := entry.name).startswith("momapos.")}
    assert announced <= names
    unused = [k for k in ON_FIRST_USE if not any(f"{name}.".startswith(f"{k}.") for name in names)]
    assert not unused
    assert not announced & set(ON_FIRST_USE)
    silent = [
        name
        for name in names - announced
        if not any(f"{name}.".startswith(f"{key}.") for key in ON_FIRST_USE)
    ]
    assert not silent, "add them to a list of compile.py, or say why not"


def test_checking_a_car_like_robot_compiles_only_the_announced_kernels(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    axles = [
        Axle((0.2, 0.2), steering=0.5),
        Axle((0.2, -0.2), steering=0.5),
        Axle((-0.2, 0.2)),
        Axle((-0.2, -0.2)),
    ]
    urdf = tmp_path / "car.urdf"
    urdf.write_text(rover(axles).replace('effort="1"', 'effort="300"'))
    for kernel in ENTRIES.values():
        monkeypatch.setattr(kernel, "_native", None)
    assert main(["robot", "check", str(urdf)]) == 0
    used = {name for name, kernel in ENTRIES.items() if kernel._native is not None}
    assert "momapos.planning.navigation.lattice.car_curves" in used
    assert used <= {*ANSWER, *CHECK}


@pytest.mark.parametrize("command", ["rank", "walks", "near", "verify"])
def test_verifying_and_ranking_compile_only_the_announced_kernels(
    command: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    plan, walks = tmp_path / "plan.json", ["rank", "kitchen_small", "fridge", "--scorer"]
    words, announced = {
        "rank": (["rank", "kitchen_small", "fridge"], RANK),
        "walks": ([*walks, "node2vec"], RANK[:1] + WALKS),
        "near": ([*walks, "deepwalk", "--set", "importance.graph.edges=near"], RANK + WALKS),
        "verify": (["verify", str(plan)], VERIFY),
    }[command]
    if command == "verify":
        question = ["place", "open", "kitchen_small", "fridge/door_hinge", "--out", str(plan)]
        assert main(question) == 0
    for kernel in ENTRIES.values():  # as in a new process
        monkeypatch.setattr(kernel, "_native", None)
    assert main(words) == 0
    used = {name for name, kernel in ENTRIES.items() if kernel._native is not None}
    assert used == set(announced)
