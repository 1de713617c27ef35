"""What the site shows beside docs/: the files that its pages link to, and the public names.

A page names a file of the repository by its path, as GitHub and editors follow it. Such a file
becomes a page of its own; a link to a file that there is not stays as it is, and fails the build.
"""

from __future__ import annotations

import json
import re
from pathlib import Path, PurePosixPath
from posixpath import normpath, relpath
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from mkdocs.config.defaults import MkDocsConfig
    from mkdocs.structure.files import Files
    from mkdocs.structure.pages import Page

ROOT = Path(__file__).parent
LINK = re.compile(r"(?<=\]\()(\.\./[^)#\s]*)")
PUBLIC_NAME = re.compile(r"^\| `(\w+)[^|]*\|.*$", re.MULTILINE)
LANGUAGES = {".py": "python", ".toml": "toml", ".urdf": "xml", ".xml": "xml", ".cff": "yaml"}


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """Add a page for every file and folder outside docs/ that a page links to."""
    from mkdocs.structure.files import File

    wanted = {
        path
        for file in files.documentation_pages()
        for link in LINK.findall(file.content_string)
        if (path := _outside(file.src_uri, link)) is not None
    }
    wanted |= {child for path in wanted for child in _children(path)}
    for path in sorted(wanted):
        files.append(File.generated(config, _page_of(path), content=_shown(path)))
    return files


def on_page_markdown(markdown: str, *, page: Page, config: MkDocsConfig, files: Files) -> str:  # noqa: ARG001
    """Lead links that leave docs/ to those pages, and list the public names on theirs."""

    def led(match: re.Match[str]) -> str:
        path = _outside(page.file.src_uri, match[1])
        if path is None:
            return match[1]
        return relpath(_page_of(path), str(PurePosixPath(page.file.src_uri).parent))

    if page.file.src_uri == "reference.md":
        markdown += _public_names()
    return LINK.sub(led, markdown)


def _outside(src_uri: str, link: str) -> str | None:
    """The path in the repository of what a page links to outside docs/, if it is there."""
    path = normpath(f"docs/{PurePosixPath(src_uri).parent}/{link}")
    there = not path.startswith(("docs/", "..")) and (ROOT / path).exists()
    return path if there else None


def _children(path: str) -> list[str]:
    """The files of a folder; none of a file."""
    folder = ROOT / path
    return [str(p.relative_to(ROOT)) for p in folder.glob("*") if p.is_file()]


def _page_of(path: str) -> str:
    return f"files/{path}.md"


def _shown(path: str) -> str:
    """A file as a page: a notebook as its cells, all else as it stands; a folder as a list."""
    file = ROOT / path
    if file.is_dir():
        lines = [f"- [{PurePosixPath(p).name}]({file.name}/{PurePosixPath(p).name}.md)"
                 for p in sorted(_children(path))]  # fmt: skip
        return f"# {path}\n\n" + "\n".join(lines) + "\n"
    if file.suffix == ".ipynb":
        return _notebook(file)
    return f"# {path}\n\n" + _fenced(file.read_text(), LANGUAGES.get(file.suffix, "text"))


def _notebook(file: Path) -> str:
    cells = json.loads(file.read_text())["cells"]
    texts = ("".join(cell["source"]) for cell in cells)
    return "\n\n".join(
        _fenced(text, "python") if cell["cell_type"] == "code" else text
        for cell, text in zip(cells, texts, strict=True)
    )


def _fenced(text: str, language: str) -> str:
    return f"````{language}\n{text.rstrip()}\n````\n"


def _public_names() -> str:
    """The sections of docs/api.md, each name replaced by its docstring."""
    text = (ROOT / "docs" / "api.md").read_text()
    _, *sections = re.split(r"^(?=## )", text, flags=re.MULTILINE)
    listed = ((part.partition("\n")[0], PUBLIC_NAME.findall(part)) for part in sections)
    return "\n\n".join(
        "\n\n".join([title, *(f"::: momapos.{name}" for name in names)]) for title, names in listed
    )
