"""Tables, and the rows that each of their numbers was counted from."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cell:
    """What a table shows, and the keys of the rows behind it."""

    text: str
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    """A table with one line of headings."""

    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[Cell, ...], ...]
    note: str = ""
