"""Write a report as Markdown."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass


@dataclass(frozen=True)
class Table:
    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[str, ...], ...]
    note: str = ""


def markdown(heading: Sequence[str], tables: Sequence[Table]) -> str:
    """Return the report of a results folder; `heading` holds the title and its paragraphs."""
    parts = [f"# {heading[0]}", *heading[1:]]
    for table in tables:
        lines = [
            f"| {' | '.join(map(_escaped, table.columns))} |",
            "|---" * len(table.columns) + "|",
        ]
        lines += [f"| {' | '.join(map(_escaped, line))} |" for line in table.lines]
        parts += [f"## {table.title}", "\n".join(lines) if table.lines else "None."]
        if table.note:
            parts.append(table.note)
    return "\n\n".join(parts)


def _escaped(text: str) -> str:
    return text.replace("|", "\\|")
