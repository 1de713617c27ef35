"""The options of a question are the fields of the pipeline's configuration, from one definition."""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import fields, is_dataclass
from pathlib import Path

import pytest

from momapos import ImportanceConfig, PipelineConfig, PlaceConfig
from momapos.apps.cli.main import main
from momapos.apps.cli.scan import ScanOptions
from momapos.core.errors import InputError


def options(config: object) -> Iterator[str]:
    """Names of the options that a configuration stands for."""
    for item in fields(config):  # type: ignore[arg-type]
        value = getattr(config, item.name)
        if is_dataclass(value):
            yield from options(value)
        else:
            yield f"--{item.name.replace('_', '-')}"


def test_no_two_fields_share_an_option() -> None:
    names = list(options(PipelineConfig()))
    assert len(names) == len(set(names)) > 40


@pytest.mark.parametrize("verb", ["open", "pick"])
def test_every_field_is_an_option_of_place(verb: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["place", verb, "--help"]) == 0
    shown = capsys.readouterr().out
    names = list(options(PipelineConfig()))
    assert [name for name in names if not re.search(rf"{name}[ ,]", shown)] == []


def test_solve_has_the_options_of_a_question_and_those_of_a_scan_by_its_name(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["solve", "--help"]) == 0
    shown = capsys.readouterr().out
    names = list(options(PipelineConfig()))
    names += [f"--scan.{item.name.replace('_', '-')}" for item in fields(ScanOptions)]
    assert [name for name in names if not re.search(rf"{re.escape(name)}[ ,]", shown)] == []


@pytest.mark.parametrize("more", [(), ("--timeout", "3")])
def test_solve_reads_the_options_of_a_scan(
    more: tuple[str, ...], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """With an option of a question and without one, which tyro is told in two ways."""
    words = ["solve", str(tmp_path / "none"), "open", "fridge", "--out", str(tmp_path / "out")]
    assert main([*words, *more, "--scan.voxel", "0.02"]) == 2
    assert "no such scan" in capsys.readouterr().err
    assert main([*words, *more, "--scan.voxel", "2"]) == 2
    assert "voxel" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("--count", "0"), ("--grid-cell", "0"), ("--k0", "2"), ("--timeout", "nan"),
        ("--waypoints", "1"), ("--checks", "0"), ("--clearance", "inf"), ("--substeps", "0"),
    ],
)  # fmt: skip
def test_a_value_without_meaning_is_one_line_that_names_the_option(
    option: str, value: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main(["place", "open", "kitchen_small", "fridge/door_hinge", option, value]) == 2
    said = capsys.readouterr().err
    assert option.strip("-") in said
    assert said.count("\n") == 1


def test_the_scorer_is_the_methods_own_unless_one_is_asked_for() -> None:
    paper = PlaceConfig(method="paper")
    assert PipelineConfig().ranking.scorer == "reach"
    assert PipelineConfig(place=paper).ranking.scorer == "deepwalk"
    asked = PipelineConfig(place=paper, importance=ImportanceConfig(scorer="size"))
    assert asked.ranking.scorer == "size"
    assert PipelineConfig().ranking.weights == "scaled"
    assert PipelineConfig(place=paper).ranking.weights == "printed"
    scaled = ImportanceConfig(weights="scaled")
    assert PipelineConfig(place=paper, importance=scaled).ranking.weights == "scaled"
    with pytest.raises(InputError, match="count"):
        PlaceConfig(count=-1)
