"""Methods and their variants, in the syntax of the command line."""

from __future__ import annotations

from dataclasses import replace

import pytest

from momapos.apps.bench.methods import METHODS, method_config
from momapos.apps.bench.suites import ABLATIONS, SUITES
from momapos.core.errors import InputError, UnknownNameError
from momapos.planning.config import PipelineConfig


@pytest.mark.parametrize("name", METHODS)
def test_a_method_name_yields_the_default_configuration_with_that_method(name: str) -> None:
    config = method_config(name, 7.0)
    default = PipelineConfig(timeout=7.0)
    assert config == replace(default, place=replace(default.place, method=name))  # type: ignore[arg-type]


def test_a_variant_sets_the_fields_that_it_names() -> None:
    text = "paper:paper.samples=50,importance.k0=1,planner.planner=BITstar,place.grid=false"
    config = method_config(text + ",paper.heights=0.5+1.5,importance.graph.near=2", 1.0)
    assert (config.paper.samples, config.importance.k0) == (50, 1.0)
    assert (config.planner.planner, config.place.grid) == ("BITstar", False)
    assert (config.paper.heights, config.importance.graph.near) == ((0.5, 1.5), 2.0)


def test_all_ablations_have_different_configurations() -> None:
    configs = [repr(method_config(text, 1.0)) for text in ABLATIONS]
    assert len(set(configs)) == len(configs)


@pytest.mark.parametrize("name", SUITES)
def test_every_suite_names_existing_methods(name: str) -> None:
    assert [method_config(text, 1.0).timeout for text in SUITES[name].methods]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("papre", "no method 'papre' in --methods; did you mean paper"),
        ("paper:", "'': write FIELD=VALUE"),
        ("paper:paper.samples", "'paper.samples': write FIELD=VALUE"),
        ("paper:paper.sample=3", "no setting 'paper.sample' in .*did you mean paper.samples"),
        ("paper:paper=3", "paper has several fields; set one of them, such as paper.samples"),
        ("paper:expand_distance.x=3", "expand_distance is a value and has no fields"),
        ("paper:paper.samples=few", "paper.samples must be a whole number, not 'few'"),
        ("paper:paper.samples=1+2", "paper.samples must be a whole number, not '1\\+2'"),
        ("paper:paper.samples=0", "paper.samples must be at least 1"),
        ("paper:importance.scorer=luck", "importance.scorer must be one of reach, .* or none, not"),
        ("paper:timeout=3", "a variant can't set timeout"),
        ("ours:place.method=paper", "a variant can't set place.method"),
    ],
)
def test_a_wrong_method_or_setting_is_refused_with_a_hint(text: str, said: str) -> None:
    with pytest.raises((InputError, UnknownNameError), match=said):
        method_config(text, 1.0)
