"""momapos rank: a table, one JSON object, and one line for unusable input."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from tests.commands import error_of, json_of, output_of

from momapos.apps.cli.main import main


def test_the_table_shows_the_score_and_relation_of_every_object() -> None:
    lines = output_of("rank", "kitchen_small", "counter").splitlines()
    rows = {line.split()[2 if "*" in line else 1]: line for line in lines[3:]}
    assert len(rows) == 17
    assert "1.000  *  counter" in rows["counter"]
    assert rows["counter"].endswith("the target")
    assert rows["microwave"].endswith("on it")
    assert rows["dishwasher"].endswith("carries it")
    assert rows["chair"].endswith("not related")


def test_json_is_one_object_and_nothing_else() -> None:
    words = ["rank", "kitchen_small", "fridge", "--json", "--seed", "4", "--alpha", "0.6"]
    shown = json_of(*words)
    assert (shown["target"], shown["seed"], shown["config"]["alpha"]) == ("fridge", 4, 0.6)
    scores = [item["score"] for item in shown["objects"]]
    assert scores == sorted(scores, reverse=True)
    assert [item["selected"] for item in shown["objects"]] == [score >= 0.6 for score in scores]
    assert {"child": "cup", "parent": "table", "kind": "on"}.items() <= next(
        edge for edge in shown["edges"] if edge["child"] == "cup" and edge["kind"] == "on"
    ).items()


def test_long_work_shows_progress(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    titles = []

    @contextmanager
    def note(title: str) -> Iterator[None]:
        titles.append(title)
        yield

    for module in ("rank", "scene"):
        monkeypatch.setattr(f"momapos.apps.cli.{module}.busy", note)
    path = tmp_path / "graph.png"
    assert main(["rank", "kitchen_small", "cup", "--scorer", "size", "--plot", str(path)]) == 0
    assert titles == ["kitchen_small: scoring 17 objects", "drawing graph.png"]
    assert main(["scene", "show", "kitchen_small", "--plot", str(path)]) == 0
    assert titles[2:] == ["drawing graph.png", "checking kitchen_small"]


def test_the_figure_is_written_to_the_given_file(tmp_path: Path) -> None:
    path = tmp_path / "graph.png"
    assert main(["rank", "kitchen_small", "cup", "--scorer", "size", "--plot", str(path)]) == 0
    assert path.read_bytes()[:4] == b"\x89PNG"


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["fridg"], "did you mean fridge"),
        (["fridge", "--alpha", "1.5"], "alpha must be from 0 to 1"),
        (["fridge", "--set", "importance.k0=-0.1"], "k0 must be from 0 to 1"),
        (["fridge", "--set", "importance.k0=nan"], "k0 must be a number"),
        (["fridge", "--seed", "-1"], "seed must be"),
        (["fridge", "--set", "importance.walks=0"], "walks must be from 1"),
        (["fridge", "--set", "importance.graph.near=-1"], "importance.graph.near"),
    ],
)
def test_unusable_input_is_one_line_and_status_2(words: list[str], hint: str) -> None:
    assert hint in error_of("rank", "kitchen_small", *words)


def test_rank_help_shows_every_option() -> None:
    shown = output_of("rank", "--help")
    assert all(f"--{name}" in shown for name in ("scorer", "alpha", "seed", "plot", "json", "set"))
