"""Texts from files in Markdown."""

from __future__ import annotations


def escaped(text: str) -> str:
    """Escape text, such as names from a file, for Markdown."""
    return "".join(f"\\{c}" if c in "\\`*_{}[]<>()#+-.!|" else c for c in text)
