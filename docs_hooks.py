"""Add to the site what docs/ lacks: linked files, public names, settings, file formats, a plan.

A page names a file of the repository by its path, as editors and hosting sites follow it. Such a
file becomes a page of its own, files/PATH.md; a link to what is not there stays as it is, and
fails the build.
"""

from __future__ import annotations

import inspect
import json
import re
import subprocess
import sys
import tempfile
from pathlib import Path
from posixpath import dirname, normpath, relpath
from typing import TYPE_CHECKING

from momapos.apps.schemas import field_list

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent
LINK = re.compile(r"(?<=\]\()([^)#\s:]+)(?=[)#])")
"""The target of a link within the repository, without its anchor."""
NAMES = re.compile(r"^Names: (.+(?:\n.+)*)", re.MULTILINE)
"""The public names of a section of docs/api.md."""
PLAYS = "gallery/plan.html"
"""The plan that plays in the gallery."""
ANSWER = ("place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e")
LANGUAGES = {".py": "python", ".toml": "toml", ".urdf": "xml", ".xml": "xml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for every file and folder outside docs/ that a page links to."""
    from mkdocs.structure.files import File

    texts = [(f"docs/{file.src_uri}", file.content_string) for file in files.documentation_pages()]
    shown: set[str] = set()
    while texts:
        path, text = texts.pop()
        for target in {_target(path, link) for link in LINK.findall(text)} - {None, *shown}:
            if target.startswith("docs"):
                continue
            shown.add(target)
            texts.append((target, _content(target)))
            files.append(File.generated(config, _page_of(target), content=texts[-1][1]))
    files.append(File.generated(config, PLAYS, content=playing_plan()))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Lead links that leave docs/ to those pages; list public names, settings, members of files."""
    uri = page.file.src_uri
    shown = uri.startswith("files/")
    path = uri.removeprefix("files/").removesuffix(".md") if shown else f"docs/{uri}"

    def led(match: re.Match[str]) -> str:
        target = _target(path, match[1])
        stays = target is None or (target.startswith("docs/") and not shown)
        return match[1] if stays else relpath(_page_of(target), dirname(uri))

    if uri == "api.md":
        markdown = NAMES.sub(_described, markdown)
    if uri == "reference.md":
        markdown += public_names()
    if uri == "settings.md":
        markdown += f"\n\n## All settings {{ data-search-exclude }}\n\n{settings()}"
    if uri == "formats.md":
        markdown += f"\n\n{field_list()}"
    if uri == "gallery.md":
        frame = f'<iframe src="{PLAYS}" title="A plan" width="100%" height="480"></iframe>'
        film = '<video src="images/demo.mp4" controls loop muted width="100%"></video>'
        markdown += f"\n\nThe first task in physics:\n\n{film}\n"
        markdown += f"\n\nThe first task, to turn about and to play:\n\n{frame}\n"
    return LINK.sub(led, markdown)


def _target(path: str, link: str) -> str | None:
    """The path in the repository of what a file links to, if it is there."""
    # A folder's links are those of its page.
    folder = path if (ROOT / path).is_dir() else dirname(path)
    target = normpath(f"{folder}/{link}" if folder else link)
    return target if not target.startswith("..") and (ROOT / target).exists() else None


def _page_of(path: str) -> str:
    return path.removeprefix("docs/") if path.startswith("docs/") else f"files/{path}.md"


def _content(path: str) -> str:
    """A file as a page: a notebook as its cells, all else as it stands; a folder as a list."""
    file = ROOT / path
    if file.is_dir():
        names = sorted(p.name for p in file.iterdir() if p.name != "__pycache__")
        return f"# {path}\n\n" + "".join(f"- [{name}]({name})\n" for name in names)
    text = file.read_text()
    if file.suffix == ".md":
        return text
    if file.suffix == ".ipynb":
        return _notebook(text)
    return f"# {path}\n\n" + _fenced(text, LANGUAGES.get(file.suffix, "text"))


def _notebook(text: str) -> str:
    cells = [(cell["cell_type"], "".join(cell["source"])) for cell in json.loads(text)["cells"]]
    return "\n\n".join(
        _fenced(source, "python") if kind == "code" else source for kind, source in cells
    )


def _fenced(text: str, language: str) -> str:
    return f"````{language}\n{text.rstrip()}\n````\n"


def playing_plan() -> bytes:
    """The first task of the gallery as `momapos view --static` writes it."""
    program = [sys.executable, "-c", "from momapos.apps.cli.main import entry; entry()"]
    with tempfile.TemporaryDirectory() as folder:
        plan, page = Path(folder) / "plan.json", Path(folder) / "plan.html"
        subprocess.run([*program, *ANSWER, "--out", str(plan)], check=True, capture_output=True)
        view = [*program, "view", str(plan), "--static", str(page)]
        subprocess.run(view, check=True, capture_output=True)
        return page.read_bytes()


def public_names() -> str:
    """The sections of docs/api.md, each name replaced by its docstring."""
    text = (ROOT / "docs" / "api.md").read_text()
    _, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    listed = ((part.partition("\n")[0], _names(part)) for part in sections)
    return "\n\n".join(
        "\n\n".join([title, *(f"::: momapos.{name}" for name in names)]) for title, names in listed
    )


def _names(section: str) -> list[str]:
    return [name for names in NAMES.findall(section) for name in re.findall(r"`(\w+)`", names)]


def _described(names: re.Match[str]) -> str:
    """A table of names with the first sentences of their docstrings."""
    import momapos

    docs = {name: inspect.getdoc(getattr(momapos, name)) or "" for name in _names(names[0])}
    short = {name: " ".join(doc.partition("\n\n")[0].split()) for name, doc in docs.items()}
    lines = [f"| [`{name}`](reference.md#momapos.{name}) | {doc} |" for name, doc in short.items()]
    return "\n".join(["| name | description |", "|---|---|", *lines])


def settings() -> str:
    """A table of all settings, as --help-all lists them."""
    from momapos.apps.cli.configuration import DEFAULT
    from momapos.planning import list_fields

    lines = [f"| `{item.path}` | `{item.value}` | {item.text} |" for item in list_fields(DEFAULT)]
    return "\n".join(["| setting | default | meaning |", "|---|---|---|", *lines])
