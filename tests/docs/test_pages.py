"""Laws of the documentation: the commands of its pages work, and the site lists all pages."""

from __future__ import annotations

import re
import shlex
import shutil
from dataclasses import dataclass
from pathlib import Path
from types import SimpleNamespace
from typing import Any, cast

import docs_hooks
import pytest

import momapos
from momapos.apps.cli.configuration import DEFAULT
from momapos.apps.cli.main import main
from momapos.planning.settings import list_fields

REPOSITORY = Path(__file__).parents[2]
DOCS = REPOSITORY / "docs"
PAGES = (DOCS / "index.md", *sorted((DOCS / "howto").glob("*.md")))
FENCE = re.compile(
    r"^(?P<indent> *)```(?P<kind>sh|python|json)\n(?P<text>.*?)^(?P=indent)```$",
    re.MULTILINE | re.DOTALL,
)
NOTE = re.compile(r"<!-- (.*?) -->\s*\Z")
QUICK = {"own_room.md", "planners.md"}
"""Pages with quick commands that no other test runs; `make test-slow` runs the others."""


@dataclass(frozen=True)
class Block:
    """A fenced block of shell commands, Python or JSON."""

    kind: str
    text: str
    status: int
    """Exit status of its last command."""


def blocks(page: Path) -> list[Block]:
    text, found = page.read_text(), []
    for match in FENCE.finditer(text):
        note = NOTE.search(text[: match.start()])
        status = re.fullmatch(r"exit status (\d)", note[1]) if note else None
        lines = [line.removeprefix(match["indent"]) for line in match["text"].splitlines()]
        found.append(Block(match["kind"], "\n".join(lines), int(status[1]) if status else 0))
    return found


def slow_unless_quick(page: Path) -> pytest.param:  # type: ignore[valid-type]
    return pytest.param(page, id=page.stem, marks=() if page.name in QUICK else pytest.mark.slow)


@pytest.mark.parametrize("page", [slow_unless_quick(page) for page in PAGES])
def test_the_commands_of_a_page_work(
    page: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    shutil.copy(REPOSITORY / "examples" / "cupboard.urdf", tmp_path)  # own_room.md says so
    for block in blocks(page):
        if block.kind == "json":
            (tmp_path / "room.json").write_text(block.text)
        elif block.kind == "python":
            exec(compile(block.text, str(page), "exec"), {"__name__": page.stem})
        else:
            *before, last = [shlex.split(line) for line in block.text.splitlines()]
            assert all(main(words[1:]) == 0 for words in before)
            assert {words[0] for words in [*before, last]} == {"momapos"}
            assert main(last[1:]) == block.status, last


def test_every_how_to_has_commands() -> None:
    assert len(PAGES) >= 9
    assert [page.name for page in PAGES if not blocks(page)] == ["notebooks.md"]


def test_the_navigation_lists_every_page() -> None:
    listed = re.findall(r": (\S+\.md)$", (REPOSITORY / "mkdocs.yml").read_text(), re.MULTILINE)
    assert sorted(listed) == sorted(str(path.relative_to(DOCS)) for path in DOCS.rglob("*.md"))


def test_the_results_name_existing_benchmarks() -> None:
    scripts = re.findall(
        r"python (benchmarks/\w+\.py)", (DOCS / "results" / "index.md").read_text()
    )
    assert len(scripts) > 10
    assert [script for script in scripts if not (REPOSITORY / script).exists()] == []


def test_the_files_that_the_page_of_the_paper_links_define_the_functions_it_names() -> None:
    links = re.findall(r"\[`(?:\w+\.)?(\w+)`\]\((\S+\.py)\)", (DOCS / "paper.md").read_text())
    assert len(links) > 10
    wrong = [
        (name, file)
        for name, file in links
        if not re.search(rf"^ *(?:def|class) {name}\b", (DOCS / file).read_text(), re.MULTILINE)
    ]
    assert not wrong


def test_the_site_documents_every_public_name() -> None:
    shown = re.findall(r"^::: momapos\.(\w+)$", docs_hooks.public_names(), re.MULTILINE)
    assert sorted(shown) == sorted(momapos.__all__)
    page: Any = SimpleNamespace(file=SimpleNamespace(src_uri="api.md"))
    text, nothing = (DOCS / "api.md").read_text(), cast(Any, None)
    site = docs_hooks.on_page_markdown(text, page=page, config=nothing, files=nothing)
    rows = re.findall(r"^\| \[`(\w+)`\]\(\S+\) \| [A-Z].* \|$", site, re.MULTILINE)
    assert sorted(rows) == sorted(momapos.__all__)


def test_the_site_describes_every_setting() -> None:
    rows = re.findall(
        r"^\| `([\w.]+)` \| `[^`]+` \| [^|]+ \|$", docs_hooks.settings(), re.MULTILINE
    )
    assert rows == [item.path for item in list_fields(DEFAULT)]


@pytest.mark.parametrize(
    ("uri", "link", "target"),
    [
        ("api.md", "../examples", "files/examples.md"),
        ("howto/x.md", "../../CONTRIBUTING.md", "../files/CONTRIBUTING.md.md"),
        ("howto/x.md", "../tours.md", "../tours.md"),
        ("files/CONTRIBUTING.md.md", "docs/api.md", "../api.md"),
        ("files/examples.md", "07_rank.py", "examples/07_rank.py.md"),
        ("x.md", "../no_such_file.py", "../no_such_file.py"),
        ("x.md", "../../outside", "../../outside"),
        ("x.md", "https://example.org/a", "https://example.org/a"),
    ],
)
def test_a_link_leads_to_the_page_of_its_file(uri: str, link: str, target: str) -> None:
    page: Any = SimpleNamespace(file=SimpleNamespace(src_uri=uri))
    nothing: Any = None
    markdown = docs_hooks.on_page_markdown(f"[a]({link})", page=page, config=nothing, files=nothing)
    assert markdown == f"[a]({target})"
