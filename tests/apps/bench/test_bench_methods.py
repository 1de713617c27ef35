"""Methods and their variants, as the command line writes them."""

from __future__ import annotations

from dataclasses import replace

import pytest

from momapos.apps.bench.methods import METHODS, method_config
from momapos.apps.bench.suites import ABLATIONS, SUITES
from momapos.core.errors import InputError, UnknownNameError
from momapos.planning.config import PipelineConfig


@pytest.mark.parametrize("name", METHODS)
def test_a_methods_name_stands_for_its_default_configuration(name: str) -> None:
    config = method_config(name, 7.0)
    default = PipelineConfig(timeout=7.0)
    assert config == replace(default, place=replace(default.place, method=name))  # type: ignore[arg-type]


def test_settings_of_a_variant_stand_in_the_configuration() -> None:
    text = "paper:paper.samples=50,importance.k0=1,planner.planner=BITstar,place.grid=false"
    config = method_config(text + ",paper.heights=0.5+1.5,importance.graph.near=2", 1.0)
    assert (config.paper.samples, config.importance.k0) == (50, 1.0)
    assert (config.planner.planner, config.place.grid) == ("BITstar", False)
    assert (config.paper.heights, config.importance.graph.near) == ((0.5, 1.5), 2.0)


def test_every_ablation_is_another_configuration() -> None:
    configs = [repr(method_config(text, 1.0)) for text in ABLATIONS]
    assert len(set(configs)) == len(configs)


@pytest.mark.parametrize("name", SUITES)
def test_every_suite_names_methods_that_there_are(name: str) -> None:
    assert [method_config(text, 1.0).timeout for text in SUITES[name].methods]


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("papre", "no method 'papre' in --methods; did you mean paper"),
        ("paper:", "'' is not FIELD=VALUE"),
        ("paper:paper.samples", "'paper.samples' is not FIELD=VALUE"),
        ("paper:paper.sample=3", "no setting 'sample' in .*did you mean samples"),
        ("paper:paper=3", "paper holds settings of its own"),
        ("paper:expand_distance.x=3", "expand_distance has no parts"),
        ("paper:paper.samples=few", "'few' cannot be used"),
        ("paper:paper.samples=1+2", "'1\\+2' cannot be used"),
        ("paper:paper.samples=0", "samples must be at least 1"),
        ("paper:importance.scorer=luck", "'luck' cannot be used"),
        ("paper:timeout=3", "timeout is no setting of a variant"),
        ("ours:place.method=paper", "place.method is no setting of a variant"),
    ],
)
def test_what_is_no_method_is_told(text: str, said: str) -> None:
    with pytest.raises((InputError, UnknownNameError), match=said):
        method_config(text, 1.0)
