"""Tables whose cells refer to the rows that they count."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Cell:
    """A text, and the keys of the rows that it counts."""

    text: str
    keys: tuple[str, ...] = ()


@dataclass(frozen=True)
class Table:
    title: str
    columns: tuple[str, ...]
    lines: tuple[tuple[Cell, ...], ...]
    note: str = ""
