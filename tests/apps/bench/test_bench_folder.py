"""Results folders: what belongs together stays so, and everything else is told in one line."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from tests.apps.bench.fakes import row, task

from momapos.apps.bench import folder as folders
from momapos.apps.bench.bench_records import Settings, SuiteTask
from momapos.apps.bench.folder import held, open_folder, read_folder, rows_file, scene_digest
from momapos.apps.bench.row_store import Store
from momapos.apps.bench.suites import SUITES, SuiteKind
from momapos.apps.cli.main import main
from momapos.core.errors import InputError, MomaposError

SCENE = {
    "format": "momapos-scene", "version": 1, "name": "made",
    "objects": [{"name": "a", "pose": {"xyz": [0, 0, 0]}, "urdf": "a.urdf"}],
}  # fmt: skip

DEFAULT = Settings()


def build(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
    """Two tasks: in a built-in kitchen, and in a scene that the suite makes."""
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
    monkeypatch.setitem(SUITES, "made", SuiteKind("", build, ("fetch",), ("ours",)))
    monkeypatch.setitem(SUITES, "other", SuiteKind("", build, ("fetch",), ("ours",)))


def opened(
    folder: Path, name: str = "made", seed: int = 0, robots: Sequence[str] = (),
    settings: Settings = DEFAULT,
) -> folders.Contents:  # fmt: skip
    return open_folder(folder, name, seed, robots, settings)


def test_a_folder_is_made_once_and_found_as_it_was(tmp_path: Path) -> None:
    first = opened(tmp_path / "deep" / "out")
    assert opened(tmp_path / "deep" / "out") == first == read_folder(tmp_path / "deep" / "out")
    assert set(first.suite.scenes) == {"kitchen_small", "scenes/made.json"}
    assert not list((tmp_path / "deep" / "out").glob(".suite_*"))


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"name": "other"}, "suite is made there, not other"),
        ({"seed": 1}, "seed is 0 there, not 1"),
        ({"robots": ["husky_ur5e"]}, "robots is fetch there, not husky_ur5e"),
        ({"settings": Settings(timeout=3.0)}, "--timeout is 20.0 there, not 3.0"),
        ({"settings": Settings(execute=True)}, "--execute is False there, not True"),
    ],
)
def test_another_run_is_refused(change: dict[str, object], said: str, tmp_path: Path) -> None:
    opened(tmp_path)
    with pytest.raises(InputError, match=said):
        opened(tmp_path, **change)  # type: ignore[arg-type]


def test_a_suite_that_draws_other_tasks_now_is_refused(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened(tmp_path)
    monkeypatch.setitem(SUITES, "made", replace(SUITES["made"], revision=2))
    with pytest.raises(InputError, match="revision is 1 there, not 2"):
        opened(tmp_path)


@pytest.mark.parametrize("package", ["momapos", "numpy", "ompl", "code"])
def test_results_of_another_version_are_refused_and_still_read(
    package: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    opened(tmp_path)
    now = {**folders.versions(), package: "of tomorrow"}
    monkeypatch.setattr(folders, "versions", lambda: now)
    with pytest.raises(InputError, match=f"holds results of {package} .*, and this is of tomorrow"):
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
    ("spoil", "said"),
    [
        (_edit(lambda d: d["suite"]["tasks"].pop()), "its tasks were changed since"),  # type: ignore[index]
        (_edit(lambda d: d["suite"].update(seed=3)), "its tasks were changed since"),  # type: ignore[attr-defined]
        (_edit(lambda d: d.update(version=2)), "not a suite of this version"),
        (_edit(lambda d: d.pop("suite")), "suite"),
        (_edit(lambda d: d["suite"]["tasks"][0].update(verb="eat")), "verb"),  # type: ignore[index]
        (lambda path: (path / "suite.json").write_text("[1, 2"), "damaged JSON"),
        (lambda path: (path / "suite.json").write_text("[1, 2]"), "not a suite of this version"),
        (_append("scenes/made.json"), "scene scenes/made.json was changed since"),
        (_append("scenes/a.urdf"), "scene scenes/made.json was changed since"),
        (_append("scenes/meshes/a.stl"), "scene scenes/made.json was changed since"),
        (lambda path: (path / "scenes/a.urdf").unlink(), "scenes/made.json: cannot be read"),
    ],
)
def test_a_folder_that_was_changed_is_refused(
    spoil: Callable[[Path], None], said: str, tmp_path: Path
) -> None:
    opened(tmp_path)
    spoil(tmp_path)
    with pytest.raises(MomaposError, match=said) as error:
        opened(tmp_path)
    assert "\n" not in str(error.value)


def test_a_suite_that_cannot_be_made_leaves_nothing(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def fail(seed: int, robots: Sequence[str], folder: Path) -> list[SuiteTask]:
        build(seed, robots, folder)
        raise InputError("what it needs is not there")

    monkeypatch.setitem(SUITES, "made", replace(SUITES["made"], build=fail))
    with pytest.raises(InputError, match="not there"):
        opened(tmp_path / "out")
    assert not list((tmp_path / "out").iterdir())


def test_a_scenes_digest_does_not_depend_on_where_it_lies(tmp_path: Path) -> None:
    for name in ("one", "two"):
        build(0, ["fetch"], tmp_path / name)
    one, two = (scene_digest(tmp_path / name / "scenes/made.json") for name in ("one", "two"))
    assert one == two


def test_two_runs_do_not_work_in_one_folder(tmp_path: Path) -> None:
    told = pytest.raises(InputError, match="another 'momapos bench run' works")
    with held(tmp_path), told, held(tmp_path):
        raise AssertionError("both work in it")
    with held(tmp_path):
        assert rows_file(tmp_path).name == f"rows-{socket.gethostname()}.sqlite"


@pytest.mark.parametrize(
    ("words", "said"),
    [
        (["run", "smok", "--out", "x"], "no suite 'smok' in momapos bench; did you mean smoke"),
        (["run", "smoke", "--out", "x", "--methods", "our"], "no method 'our' in --methods"),
        (["run", "made", "--out", "x", "--robots", "fetsh"], "no robot 'fetsh'"),
        (["run", "made", "--out", "x", "--robots", "file"], "no robot 'file' in the library"),
        (["run", "smoke", "--out", "x", "--workers", "0"], "--workers must be at least 1"),
        (["run", "smoke", "--out", "x", "--limit", "-1"], "--limit must be at least 0"),
        (["run", "smoke", "--out", "x", "--timeout", "nan"], "--timeout must be a time above 0"),
        (["run", "smoke", "--out", "x", "--seed", "-1"], "--seed must be between 0"),
        (["run", "smoke", "--out", "file"], "file"),
        (["report", "nowhere"], "no results folder, for it holds no suite.json"),
        (["report", "."], "no results folder"),
        (["report", "empty"], "holds no rows yet"),
        (["report", "full", "--compare", "nowhere"], "nowhere: no results folder"),
        (["report", "full", "--compare", "strange"], "has no task and method in common"),
        (["report", "full", "--html", "file/page.html"], "cannot be written"),
    ],
)
def test_bad_input_is_told_in_one_line(
    words: list[str], said: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    monkeypatch.chdir(tmp_path)
    Path("file").write_text("")
    for name, tasks in (("empty", ()), ("full", ("one",)), ("strange", ("three",))):
        opened(Path(name))
        store = Store(rows_file(Path(name)))
        for one in tasks:
            store.add(row(one, task=one))
        store.close()
    assert main(["bench", *words]) == 2
    shown = capsys.readouterr()
    assert said in shown.err
    assert (shown.err.count("\n"), shown.out) == (1, "")
    assert not Path("x").exists() or not list(Path("x").glob("*.json"))


def test_a_report_says_the_same_as_markdown_page_and_json(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    opened(Path("out"))
    store = Store(rows_file(Path("out")))
    store.add(row("k1", task="one"))
    store.add(row("k2", task="two", outcome="failed", reason="hung: no answer in 3 s"))
    store.close()
    assert main(["bench", "report", "out", "--html", "page.html", "--compare", "out"]) == 0
    text, page = capsys.readouterr().out, Path("page.html").read_text()
    for said in ("1 of 2", "hung: no answer in 3 s", "Compared with the other results"):
        assert said in text
        assert said in page
    assert main(["bench", "report", "out", "--json"]) == 0
    data = json.loads(capsys.readouterr().out)
    assert [one["key"] for one in data["rows"]] == ["k1", "k2"]
    assert data["suite"]["name"] == "made"
