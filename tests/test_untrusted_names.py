"""Paths and names of untrusted files pass through one helper each, everywhere in the package."""

from __future__ import annotations

import ast
import functools
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st
from tests import sources
from tests.shapes import unchecked

import momapos
from momapos.core.errors import (
    InputError,
    escape_html,
    escape_markdown,
    is_name,
    label,
    one_line,
    printable,
    say,
)
from momapos.core.files import resolved
from momapos.model.records.plans import JointResistance

SOURCE = Path(momapos.__file__).parent
DRAWN = {"text": 2, "annotate": 0, "set_title": 0, "suptitle": 0, "set_xlabel": 0, "set_ylabel": 0,
         "set_label": 0, "set_text": 0, "figtext": 2, "title": 0}  # fmt: skip
"""Calls that draw a text, and the place of the text among the arguments."""
EVIL = ("\x1b[2J", "\x1b]0;pwn\x07", "\u202eabc", "\ud800", "\x9b31m", "a\rb", "\u2066", "\ufeff")


Nodes = tuple[ast.AST, ...]


@functools.cache
def modules() -> tuple[tuple[str, Nodes], ...]:
    """Return the modules of the package, by their paths in it."""
    return tuple(
        (path.relative_to(SOURCE).as_posix(), sources.nodes(path))
        for path in sorted(SOURCE.rglob("*.py"))
    )


def calls(nodes: Nodes) -> Iterator[tuple[str, ast.Call]]:
    """Yield all calls with the last word of what is called."""
    for node in nodes:
        if isinstance(node, ast.Call):
            if isinstance(node.func, ast.Attribute):
                yield f".{node.func.attr}", node
            elif isinstance(node.func, ast.Name):
                yield node.func.id, node


def test_all_paths_are_resolved_by_one_function() -> None:
    """A cycle of links is a RuntimeError up to Python 3.12."""
    own = ("core/files.py", "model/robots/xacro_program.py")  # a program without imports
    found = [
        f"{name}:{call.lineno}"
        for name, nodes in modules()
        for word, call in calls(nodes)
        if word in (".resolve", ".realpath") and name not in own
    ]
    assert found == [], "use momapos.core.resolved"


def test_commands_print_by_one_function() -> None:
    """The others print fixed words, help texts, and progress in one line of the terminal."""
    own = ("apps/cli/main.py", "apps/cli/parse.py", "apps/cli/console.py", "apps/cli/compile.py",
           "core/errors.py")  # fmt: skip
    found = [
        f"{name}:{call.lineno}"
        for name, nodes in modules()
        for word, call in calls(nodes)
        if word == "print" and name not in own
    ]
    assert found == [], "use momapos.core.say"


def test_all_texts_of_figures_pass_through_one_function() -> None:
    found = []
    for name, nodes in modules():
        if not name.startswith("apps/plots/"):
            continue
        for word, call in calls(nodes):
            texts = [key.value for key in call.keywords if key.arg in ("title", "label", "xlabel")]
            if word[0] == "." and word[1:] in DRAWN and not _writes_column(call):
                words = [one for one in call.args if not isinstance(one, ast.Starred)]
                starred = len(words) < len(call.args)
                place = 0 if starred else DRAWN[word[1:]]
                texts += words[place : place + 1]
            found += [f"{name}:{call.lineno}" for text in texts if not _is_safe(text, nodes)]
    assert found == [], "use momapos.core.label"


def _writes_column(call: ast.Call) -> bool:
    """Return whether a call writes into a TextColumn, which passes its texts through `label`."""
    assert isinstance(call.func, ast.Attribute)
    owner = call.func.value
    return isinstance(owner, ast.Name) and owner.id in ("column", "self")


def _is_safe(text: ast.AST, nodes: Nodes) -> bool:
    if isinstance(text, ast.Constant):
        return True
    if isinstance(text, ast.JoinedStr):  # the names of axes
        return all(
            isinstance(part, ast.Constant) or isinstance(part.value, ast.Subscript)
            for part in text.values
            if isinstance(part, ast.Constant | ast.FormattedValue)
        )
    if isinstance(text, ast.Name):
        values = [
            node.value
            for node in nodes
            if isinstance(node, ast.Assign)
            and any(isinstance(one, ast.Name) and one.id == text.id for one in node.targets)
        ]
        return bool(values) and all(_is_label(value) for value in values)
    return _is_label(text)


def _is_label(value: ast.AST) -> bool:
    return isinstance(value, ast.Call) and getattr(value.func, "id", "") == "label"


def test_pages_escape_by_one_function() -> None:
    own = ("core/errors.py", "apps/web/static.py")  # a whole page as an attribute
    found = [
        name
        for name, nodes in modules()
        for node in nodes
        if isinstance(node, ast.Import | ast.ImportFrom)
        and "html" in [getattr(node, "module", None), *(one.name for one in node.names)]
        and name not in own
    ]
    assert found == [], "use momapos.core.escape_html"


def test_no_process_imports_modules_from_the_current_folder() -> None:
    """Whoever runs a command among someone else's files would run a module of theirs."""
    found = [
        path.relative_to(SOURCE).as_posix()
        for path in sorted(SOURCE.rglob("*.py"))
        for node in ast.walk(sources.tree(path))
        if isinstance(node, ast.List | ast.Tuple)
        and node.elts
        and ast.unparse(node.elts[0]) == "sys.executable"
        and ast.unparse(node.elts[1]) != "'-P'"
    ]
    assert found == []


@given(st.text(max_size=50))
def test_a_printable_text_has_no_controls_and_keeps_the_rest(text: str) -> None:
    shown = printable(text)
    assert all(line.isprintable() for line in shown.split("\n"))
    assert len(shown) == len(text)
    assert printable(shown) == shown
    kept = [(a, b) for a, b in zip(text, shown, strict=True) if b != "?" and a != "\t"]
    assert all(a == b for a, b in kept)


@pytest.mark.parametrize("evil", EVIL)
def test_no_output_holds_commands_of_a_terminal(
    evil: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert not is_name(f"a{evil}b")
    say(f"name: a{evil}b")
    for shown in (capsys.readouterr().out, one_line(evil), label(evil), escape_html(evil),
                  escape_markdown(evil)):  # fmt: skip
        assert shown.rstrip("\n").isprintable()


@pytest.mark.parametrize("name", ["$x^2^3$", "a_$b$_c", r"\$x^2^3$", "$$", "$\\frac{$"])
def test_a_label_draws_every_name_as_it_is(name: str) -> None:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure()
    drawn = figure.text(0.1, 0.1, label(name))
    FigureCanvasAgg(figure).draw()
    words, mathematics = drawn._preprocess_math(drawn.get_text())
    assert not mathematics
    assert words == name


def test_a_cycle_of_links_is_reported_in_one_line(tmp_path: Path) -> None:
    loop = tmp_path / "loop"
    loop.symlink_to(loop)
    if sys.version_info < (3, 13):  # later, opening it reports the cycle
        with pytest.raises(InputError, match="cycle"):
            resolved(loop)
    with pytest.raises(InputError, match="not a valid file name"):
        resolved(tmp_path / "a\0b")


def test_a_half_of_a_character_in_a_record_is_refused() -> None:
    with unchecked(), pytest.raises(InputError, match="JointResistance"):
        JointResistance(friction="\ud800")  # type: ignore[arg-type]
