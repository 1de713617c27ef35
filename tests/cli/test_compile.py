"""Compiling once after installation."""

from __future__ import annotations

from pathlib import Path

import pytest

from momapos.cli import compile as compiling
from momapos.cli.compile import ANSWER, compile_once
from momapos.compiled.kernel import ENTRIES
from momapos.compiled.store import Store


def test_what_an_answer_needs_is_compiled_once_with_one_line(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    store = Store(tmp_path, tmp_path / "no pack")
    monkeypatch.setattr(compiling, "store", store)
    short = ("momapos.kinematics.chain.stand_at_origin", "momapos.verification.shapes._place")
    for name in short:  # as in a new process
        monkeypatch.setattr(ENTRIES[name], "_native", None)
    monkeypatch.setattr("momapos.compiled.store.store", store)
    compile_once(short)
    assert capsys.readouterr().err.splitlines() == [
        "momapos: compiling, once after installation: 0 of 2 kernels"
    ]
    compile_once(short)
    assert capsys.readouterr().err == ""
    assert all(store.find(ENTRIES[name]) is not None for name in short)


def test_every_kernel_of_an_answer_is_an_entry() -> None:
    compile_once()
    assert set(ANSWER) <= set(ENTRIES)
