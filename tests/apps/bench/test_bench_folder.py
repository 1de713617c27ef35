"""Laws of results folders: only matching runs share one, and every error is one line."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from tests.apps.bench.fakes import row, task
from tests.commands import error_of, json_of, output_of

from momapos.apps.bench import folder as folders
from momapos.apps.bench.bench_records import Protocol, Settings, SuiteTask
from momapos.apps.bench.folder import (
    RowStore,
    locked,
    open_folder,
    read_folder,
    rows_file,
    scene_digest,
)
from momapos.apps.bench.suites import SUITES, SuiteKind
from momapos.core.errors import InputError, MomaposError

SCENE = {
    "format": "momapos-scene", "version": 1, "name": "made",
    "objects": [{"name": "a", "pose": {"xyz": [0, 0, 0]}, "urdf": "a.urdf"}],
}  # fmt: skip

DEFAULT = Settings()


def build(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """Build two tasks: one in a built-in kitchen, one in a generated scene."""
    scenes = folder / "scenes"
    (scenes / "meshes").mkdir(parents=True)
    (scenes / "made.json").write_text(json.dumps(SCENE))
    (scenes / "a.urdf").write_text('<robot><mesh scale="1 1 1" filename="meshes/a.stl"/></robot>')
    (scenes / "meshes" / "a.stl").write_text("solid")
    return [
        replace(task("one"), robot=robots[0], seed=seed),
        replace(task("two"), robot=robots[0], seed=seed, scene="scenes/made.json"),
    ]


@pytest.fixture(autouse=True)
def made_suite(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setitem(SUITES, "made", SuiteKind(build, ("fetch",), ("ours",)))
    monkeypatch.setitem(SUITES, "other", SuiteKind(build, ("fetch",), ("ours",)))


def opened(
    folder: Path, name: str = "made", seed: int = 0, robots: Sequence[str] = (),
    settings: Settings = DEFAULT,
) -> folders.Contents:  # fmt: skip
    return open_folder(folder, name, seed, robots, settings)


def test_a_second_run_finds_the_folder_unchanged(tmp_path: Path) -> None:
    first = opened(tmp_path / "deep" / "out")
    assert opened(tmp_path / "deep" / "out") == first == read_folder(tmp_path / "deep" / "out")
    assert set(first.suite.scenes) == {"kitchen_small", "scenes/made.json"}
    assert not list((tmp_path / "deep" / "out").glob(".suite_*"))


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"name": "other"}, "another run with suite made, not other"),
        ({"seed": 1}, "seed 0, not 1"),
        ({"robots": ["husky_ur5e"]}, "robots fetch, not husky_ur5e"),
        ({"settings": Settings(timeout=3.0)}, "timeout 20.0, not 3.0"),
        ({"settings": Settings(execute=True)}, "execute False, not True"),
        (
            {"settings": Settings(protocols=(Protocol("first", "one"), Protocol()))},
            "protocols retry, all, not first, one; retry, all; use another folder",
        ),
    ],
)
def test_a_folder_of_another_run_is_refused(
    change: dict[str, object], message: str, tmp_path: Path
) -> None:
    opened(tmp_path)
    with pytest.raises(InputError, match=message):
        opened(tmp_path, **change)  # type: ignore[arg-type]


def test_a_folder_from_before_there_were_protocols_has_the_default_one(tmp_path: Path) -> None:
    first = opened(tmp_path)
    _edit(lambda data: data["settings"].pop("protocols"))(tmp_path)  # type: ignore[attr-defined]
    assert read_folder(tmp_path) == first


def test_a_folder_of_an_older_suite_revision_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened(tmp_path)
    monkeypatch.setitem(SUITES, "made", replace(SUITES["made"], revision=2))
    with pytest.raises(InputError, match="revision 1, not 2"):
        opened(tmp_path)


@pytest.mark.parametrize("package", ["momapos", "numpy", "ompl", "code"])
def test_results_of_another_version_are_refused_but_can_be_read(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened(tmp_path)
    now = {**folders.versions(), package: "of tomorrow"}
    monkeypatch.setattr(folders, "versions", lambda: now)
    with pytest.raises(
        InputError, match=f"contains results of {package} .*, but this is of tomorrow"
    ):
        opened(tmp_path)
    assert read_folder(tmp_path).suite.name == "made"


def _edit(change: Callable[[dict[str, object]], object]) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        data = json.loads((path / "suite.json").read_text())
        change(data)
        (path / "suite.json").write_text(json.dumps(data))

    return edit


def _append(name: str) -> Callable[[Path], None]:
    def edit(path: Path) -> None:
        (path / name).write_text((path / name).read_text() + " ")

    return edit


@pytest.mark.parametrize(
    ("damage", "message"),
    [
        (_edit(lambda d: d["suite"]["tasks"].pop()), "its tasks were modified"),  # type: ignore[index]
        (_edit(lambda d: d["suite"].update(seed=3)), "its tasks were modified"),  # type: ignore[attr-defined]
        (_edit(lambda d: d.update(version=2)), "unsupported suite file"),
        (_edit(lambda d: d.pop("suite")), "suite"),
        (_edit(lambda d: d["suite"]["tasks"][0].update(verb="eat")), "verb"),  # type: ignore[index]
        (lambda path: (path / "suite.json").write_text("[1, 2"), "damaged JSON"),
        (lambda path: (path / "suite.json").write_text("[1, 2]"), "unsupported suite file"),
        (_append("scenes/made.json"), "scene scenes/made.json was modified"),
        (_append("scenes/a.urdf"), "scene scenes/made.json was modified"),
        (_append("scenes/meshes/a.stl"), "scene scenes/made.json was modified"),
        (lambda path: (path / "scenes/a.urdf").unlink(), "scenes/made.json: cannot be read"),
    ],
)
def test_a_modified_folder_is_refused(
    damage: Callable[[Path], None], message: str, tmp_path: Path
) -> None:
    opened(tmp_path)
    damage(tmp_path)
    with pytest.raises(MomaposError, match=message) as error:
        opened(tmp_path)
    assert "\n" not in str(error.value)


def test_a_suite_that_cannot_be_built_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
        build(seed, robots, folder)
        raise InputError("what it needs is not there")

    monkeypatch.setitem(SUITES, "made", replace(SUITES["made"], build=fail))
    with pytest.raises(InputError, match="not there"):
        opened(tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_the_digest_of_a_scene_does_not_depend_on_its_folder(tmp_path: Path) -> None:
    for name in ("one", "two"):
        build(0, ["fetch"], tmp_path / name)
    one, two = (scene_digest(tmp_path / name / "scenes/made.json") for name in ("one", "two"))
    assert one == two


def test_two_runs_cannot_use_one_folder(tmp_path: Path) -> None:
    refused = pytest.raises(InputError, match="in use by another 'momapos bench run'")
    with locked(tmp_path), refused, locked(tmp_path):
        raise AssertionError("both use it")
    with locked(tmp_path):
        assert rows_file(tmp_path).name == f"rows-{socket.gethostname()}.sqlite"


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (["run", "smok", "--out", "x"], "no suite 'smok' in momapos bench; did you mean smoke"),
        (["run", "smoke", "--out", "x", "--methods", "our"], "no method 'our' in --methods"),
        (["run", "made", "--out", "x", "--robots", "fetsh"], "no robot 'fetsh'"),
        (["run", "made", "--out", "x", "--robots", "file"], "no robot 'file' in the library"),
        (["run", "smoke", "--out", "x", "--workers", "0"], "--workers must be between 1"),
        (["run", "smoke", "--out", "x", "--limit", "-1"], "--limit must be between 0"),
        (["run", "smoke", "--out", "x", "--timeout", "nan"], "--timeout must be a time above 0"),
        (["run", "smoke", "--out", "x", "--seed", "-1"], "--seed must be between 0"),
        (["run", "smoke", "--out", "file"], "file"),
        (["report", "nowhere"], "not a results folder (it has no suite.json)"),
        (["report", "."], "not a results folder"),
        (["report", "empty"], "contains no results yet"),
        (["report", "full", "--compare", "nowhere"], "nowhere: not a results folder"),
        (["report", "full", "--compare", "strange"], "shares no task and method"),
    ],
)
def test_bad_input_is_reported_in_one_line(
    words: list[str], message: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    for name, tasks in (("empty", ()), ("full", ("one",)), ("strange", ("three",))):
        opened(Path(name))
        store = RowStore(rows_file(Path(name)))
        for one in tasks:
            store.add(row(one, task=one))
        store.close()
    assert message in error_of("bench", *words)
    assert not Path("x").exists() or not list(Path("x").glob("*.json"))


def test_markdown_and_json_report_the_same_rows(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    opened(Path("out"))
    store = RowStore(rows_file(Path("out")))
    store.add(row("k1", task="one"))
    store.add(row("k2", task="two", outcome="failed", reason="hung: no answer in 3 s"))
    store.close()
    text = output_of("bench", "report", "out", "--compare", "out")
    for message in ("1 of 2", "hung: no answer in 3 s", "Comparison with the other results"):
        assert message in text
    data = json_of("bench", "report", "out", "--json")
    assert [one["key"] for one in data["rows"]] == ["k1", "k2"]
    assert data["suite"]["name"] == "made"
