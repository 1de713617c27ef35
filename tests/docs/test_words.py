"""Words of our own that must not come back; the field has better ones."""

from __future__ import annotations

import io
import re
import tokenize
from pathlib import Path

import pytest

REPOSITORY = Path(__file__).parents[2]
INSTEAD = {
    "anew": "again, replanned",
    "beside": "near, next to",
    "dear to": "expensive",
    "hopeless": "dominated",
    "likeliest": "most probable",
    "measured half": "test set",
    "shut in": "blocked in",
    "strangers?": "untrusted",
    "surest": "most confident",
    "things?": "object",
    "tuned half": "development set",
    "twins?": "reference implementation",
    "way of holding": "grasp mode",
    "ways of holding": "grasp modes",
}
"""Private words, and what to write instead."""
PRIVATE = re.compile(rf"\b({'|'.join(INSTEAD)})\b", re.IGNORECASE)
TEXT = (tokenize.STRING, tokenize.COMMENT, getattr(tokenize, "FSTRING_MIDDLE", tokenize.STRING))
PAGES = sorted(
    path
    for pattern in ("*.md", "docs/**/*.md", "integrations/**/*.md", "training/**/*.md")
    for path in REPOSITORY.glob(pattern)
)
MODULES = sorted(
    path
    for folder in ("src", "benchmarks", "examples", "training", "integrations")
    for path in (REPOSITORY / folder).rglob("*.py")
)


def private_words(text: str) -> list[str]:
    return [match[0].lower() for match in PRIVATE.finditer(text)]


def texts_of(module: Path) -> str:
    """Return the strings and comments of a module; names in code may be as they are."""
    with io.StringIO(module.read_text()) as source:
        tokens = tokenize.generate_tokens(source.readline)
        return "\n".join(token.string for token in tokens if token.type in TEXT)


def test_private_words_are_found() -> None:
    assert private_words("Ask anew whether a thing stands beside it") == ["anew", "thing", "beside"]
    assert private_words("Nothing is within the outside of an anewish wall") == []


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(REPOSITORY)))
def test_no_page_uses_a_private_word(page: Path) -> None:
    assert private_words(page.read_text()) == []


def test_no_text_in_the_code_uses_a_private_word() -> None:
    found = {
        str(path.relative_to(REPOSITORY)): words
        for path in MODULES
        if (words := private_words(texts_of(path)))
    }
    assert found == {}
