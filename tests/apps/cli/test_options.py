"""Commands have few options; --config and --set reach every other field."""

from __future__ import annotations

import re
from collections.abc import Callable
from pathlib import Path

import pytest
from tests.commands import error_of, output_of

from momapos import ImportanceConfig, PipelineConfig, PlaceConfig
from momapos.apps.cli.main import main
from momapos.core.errors import InputError
from momapos.planning.importance.config import GraphConfig
from momapos.planning.settings import list_fields

PLACE = ("place", "open", "kitchen_small", "fridge/door_hinge")
RANK = ("rank", "kitchen_small", "fridge")


@pytest.fixture
def read_config(
    monkeypatch: pytest.MonkeyPatch, tmp_path: Path
) -> Callable[[str, str], PipelineConfig]:
    """Return the configuration that a file and options result in."""
    seen: list[PipelineConfig] = []

    def answer(*args: object, **_: object) -> int:
        seen.append(args[4].read_config())  # type: ignore[attr-defined]
        return 0

    monkeypatch.setattr("momapos.apps.cli.tour.answer", answer)

    def read(toml: str, options: str) -> PipelineConfig:
        file = tmp_path / "my.toml"
        file.write_text(toml)
        assert main([*PLACE, *options.split(), "--config", str(file)]) == 0
        return seen.pop()

    return read


@pytest.mark.parametrize(
    ("command", "most"), [("place open", 31), ("place pick", 31), ("rank", 15), ("solve", 32)]
)
def test_a_help_text_has_few_options(
    command: str, most: int, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "80")
    names = re.findall(
        r"^\W{0,4}(--[a-z][a-z-]*)", output_of(*command.split(), "--help"), re.MULTILINE
    )
    assert {"--json", "--config", "--set", "--help-all"} <= set(names)
    assert len(set(names)) <= most


@pytest.mark.parametrize("command", ["place open", "place pick kitchen_small cup", "solve"])
def test_help_all_lists_every_field_with_default_and_meaning(command: str) -> None:
    shown = output_of(*command.split(), "--help-all")
    assert re.search(r"^importance\.k0 = 0\.5  \w", shown, re.MULTILINE)
    for item in list_fields(PipelineConfig()):
        assert item.text, item.path
        assert f"{item.path} = {item.value}  {item.text}\n" in shown


def test_help_all_lists_only_what_a_command_uses() -> None:
    lines = output_of("rank", "--help-all").splitlines()[2:]
    assert all(line.startswith("importance.") for line in lines)
    assert "scan.voxel = 0.015  Voxel size" in output_of("scan", "--help-all")


def test_options_take_precedence_over_set_over_file_over_defaults(
    read_config: Callable[[str, str], PipelineConfig],
) -> None:
    toml = "timeout = 30\n[importance]\nalpha = 0.1\nk0 = 0.2\n[importance.graph]\nnear = 2\n"
    config = read_config(toml, "--set importance.alpha=0.3 --set importance.k0=0.4 --alpha 0.5")
    assert config.importance.graph.near == 2.0
    assert config.timeout == 30.0
    assert (config.importance.alpha, config.importance.k0) == (0.5, 0.4)
    assert config.place == PlaceConfig()


def test_an_option_with_the_default_value_still_overrides_the_file(
    read_config: Callable[[str, str], PipelineConfig],
) -> None:
    assert read_config("timeout = 30", "--timeout 120").timeout == 120.0
    config = read_config('[place]\nmethod = "paper"', "--method ours")
    assert config == PipelineConfig()


def test_a_file_may_hold_tables_of_other_commands(
    read_config: Callable[[str, str], PipelineConfig],
) -> None:
    assert read_config("[scan]\nvoxel = 0.02", "") == PipelineConfig()


def test_robustness_is_a_length_and_an_angle(
    read_config: Callable[[str, str], PipelineConfig],
) -> None:
    place = read_config("", "--robust 5cm,3deg").place
    assert (place.robust_radius, place.robust_turn) == pytest.approx((0.05, 3.0))


@pytest.mark.parametrize(
    ("words", "line"),
    [
        ((*PLACE, "--timeout", "nan"), "--timeout must be"),
        ((*PLACE, "--timeout", "0"), "--timeout must be at least 0.001, not 0"),
        ((*PLACE, "--alpha", "2"), "--alpha must be from 0 to 1, not 2"),
        ((*PLACE, "--set", "place.count=0"), "--set place.count must be at least 1, not 0"),
        ((*PLACE, "--set", "place.clearance=inf"), "--set place.clearance must be at least 0"),
        ((*PLACE, "--set", "motion.waypoints=1"), "--set motion.waypoints must be at least 2"),
        ((*PLACE, "--set", "place.count=few"), "place.count must be a whole number, not 'few'"),
        ((*PLACE, "--set", "place.conut=3"), "no setting 'place.conut' in --set; did you mean"),
        ((*PLACE, "--set", "k0=1"), "did you mean importance.k0?"),
        ((*PLACE, "--set", "place=1"), "--set place has several fields"),
        ((*PLACE, "--set", "place.count"), "write FIELD=VALUE"),
        ((*PLACE, "--set", "scan.voxel=0.1"), "this command doesn't use it"),
        ((*RANK, "--set", "place.count=3"), "this command doesn't use it; it uses importance"),
        ((*RANK, "--set", "importance.graph.near=-1"), "--set importance.graph.near"),
        ((*PLACE, "--config", "no_such.toml"), "no_such.toml: no such file"),
        ((*PLACE, "--method", "gess"), "'gess'"),
    ],
)
def test_an_unusable_setting_is_one_line_that_names_it(words: tuple[str, ...], line: str) -> None:
    assert line in error_of(*words)


@pytest.mark.parametrize(
    ("toml", "line"),
    [
        ("[place]\nconut = 3", "no setting 'place.conut' in {}; did you mean place.count"),
        ("[plaec]\ncount = 3", "no setting 'plaec' in {}"),
        ("[place.count]\nx = 1", "{}: place.count must be a whole number, not {{'x': 1}}"),
        ("place = 1", "{}: place must be a table of fields, not 1"),
        ("[[place]]\ncount = 1", "{}: place must be a table of fields, not [{{'count': 1}}]"),
        ("[place]\ncount = 'few'", "{}: place.count must be a whole number, not 'few'"),
        ("[place]\ncount = 0", "{}: place.count must be at least 1, not 0"),
        ("timeout = true", "{}: timeout must be a number, not True"),
        ("timeout = nan", "{}: timeout must be a number, not nan"),
        ("[paper]\nheights = [1, inf]", "{}: paper.heights must be numbers, not [1, inf]"),
        ("[paper\nheights = 1", "{}: not valid TOML"),
        ("x = " + "[" * 5000, "{}: not valid TOML"),
    ],
)
def test_an_unusable_file_is_one_line_that_names_file_and_field(
    toml: str, line: str, tmp_path: Path
) -> None:
    file = tmp_path / "my.toml"
    file.write_text(toml)
    shown = error_of(*PLACE, "--config", str(file))
    assert line.format(file) in shown


def test_solve_takes_the_options_of_a_scan(tmp_path: Path) -> None:
    words = ["solve", str(tmp_path / "none"), "open", "fridge", "--out", str(tmp_path / "out")]
    assert "no such scan" in error_of(*words, "--max-frames", "9", "--timeout", "3")
    assert "no such scan" in error_of(*words, "--set", "scan.voxel=0.02")
    assert "--max-frames must be" in error_of(*words, "--max-frames", "0")
    assert "--set scan.voxel must be" in error_of(*words, "--set", "scan.voxel=2")
    assert "kitchen_smal" in error_of(*words, "--world", "kitchen_smal")
    no_run = [*words, "--world", "kitchen_small", "--no-run"]
    pick = ["solve", words[1], "pick", *words[3:], "--world", "kitchen_small"]
    for some in (no_run, pick):
        assert "--world is the room in which a part is opened or closed" in error_of(*some)


def test_the_scorer_depends_on_the_method_unless_it_is_set() -> None:
    paper = PlaceConfig(method="paper")
    assert PipelineConfig().ranking.scorer == "reach"
    assert PipelineConfig(place=paper).ranking.scorer == "deepwalk"
    chosen = PipelineConfig(place=paper, importance=ImportanceConfig(scorer="size"))
    assert chosen.ranking.scorer == "size"
    assert PipelineConfig(place=PlaceConfig(method="authors")).ranking.scorer == "node2vec"
    assert PipelineConfig(place=paper).ranking.weights == "printed"
    scaled = ImportanceConfig(weights="scaled")
    assert PipelineConfig(place=paper, importance=scaled).ranking.weights == "scaled"
    assert not PipelineConfig().ranking.exceed
    printed = PipelineConfig(place=paper).ranking
    assert (printed.exceed, printed.graph.edges) == (True, "support")
    near = ImportanceConfig(exceed=False, graph=GraphConfig(edges="near"))
    chosen = PipelineConfig(place=paper, importance=near)
    assert (chosen.ranking.exceed, chosen.ranking.graph.edges) == (False, "near")
    with pytest.raises(InputError, match="count"):
        PlaceConfig(count=-1)
