"""No field of a plan is left out by the benchmark that mutates them."""

from __future__ import annotations

import importlib
from pathlib import Path

import pytest

BENCHMARKS = Path(__file__).parents[2] / "benchmarks"


def test_each_field_of_a_plan_is_physical_or_descriptive(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.syspath_prepend(str(BENCHMARKS))
    fields = importlib.import_module("mutated_fields")
    named = {*fields.PHYSICAL, *fields.DESCRIPTIVE}
    assert len(named) == len(fields.PHYSICAL) + len(fields.DESCRIPTIVE)
    assert fields.fields_of("plan") | fields.fields_of("plan2") == named
