"""Write a report as one self-contained HTML page in which each number links to its rows."""

from __future__ import annotations

from base64 import b64encode
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

from momapos.core import escape_html

from .bench_records import Row
from .cells import Cell, Table
from .figures import bar_figure, pie_figure, scatter_figure, success_figure
from .metrics import outcome_text
from .scan_stages import modeling_times, pies

STYLE = """
body { font: 15px/1.45 sans-serif; margin: 2em auto; max-width: 75em; padding: 0 1em; color: #222 }
table { border-collapse: collapse; margin: .6em 0 }
th, td { border-bottom: 1px solid #ddd; padding: .2em .7em; text-align: left; vertical-align: top }
th { background: #f3f3f3 } td { font-variant-numeric: tabular-nums }
a { color: #1f5f9e; text-decoration: none } a:hover { text-decoration: underline }
img { max-width: 100% }
:target { background: #fff3b0 } .note { color: #666 } .rows { font-size: 13px }
"""
ROW_COLUMNS = (
    "task", "class", "robot", "method", "outcome", "reason", "time", "driving", "full checks",
    "clearance", "base poses", "node",
)  # fmt: skip


def page(
    heading: Sequence[str],
    tables: Sequence[Table],
    rows: Sequence[Row],
    maps: Sequence[AnswerMap] = (),
) -> str:
    """Return the page.

    Args:
        heading: The title and its paragraphs.
        tables: The tables of the report.
        rows: All rows, listed at the end of the page.
        maps: Maps of some answers.
    """
    anchors = {row.key: f"r{number}" for number, row in enumerate(rows)}
    names = {row.key: row.task for row in rows}
    numbers = _Numbers(anchors, names)
    parts = [
        f"<h1>{escape_html(heading[0])}</h1>",
        *(f"<p>{escape_html(line)}</p>" for line in heading[1:]),
    ]
    for k, table in enumerate(tables):
        parts.append(numbers.table(table))
        if k == 0:
            parts += ["<h2>Success</h2>", success_figure(rows)]
            parts += ["<h2>Driving against time</h2>", scatter_figure(rows, anchors)]
            parts += ["<h2>Time by stage, shares</h2>", pie_figure(pies(rows))]
            if times := modeling_times(rows):
                parts += ["<h2>Modeling time by class</h2>", bar_figure(times, "s")]
    if maps:
        parts.append("<h2>Potential and candidates</h2>")
    parts += [_image(one, anchors) for one in maps]
    parts += ["<h2>Rows</h2>", _row_table(rows, anchors)]
    parts += ["<h2>Rows behind each number</h2>", *numbers.lists]
    body = "\n".join(parts)
    return (
        f'<!DOCTYPE html>\n<html lang="en"><head><meta charset="utf-8"><title>'
        f"{escape_html(heading[0])}</title><style>{STYLE}</style></head>\n<body>\n{body}\n</body></html>\n"
    )


@dataclass(frozen=True)
class AnswerMap:
    """A figure of one answer."""

    title: str
    key: str
    """Key of the answer's row."""
    png: bytes


class _Numbers:
    """Links numbers to lists of their rows, with one list per set of rows."""

    def __init__(self, anchors: Mapping[str, str], names: Mapping[str, str]) -> None:
        self.anchors, self.names = anchors, names
        self.lists: list[str] = []
        self.known: dict[tuple[str, ...], str] = {}

    def table(self, table: Table) -> str:
        head = "".join(f"<th>{escape_html(name)}</th>" for name in table.columns)
        lines = [
            "<tr>" + "".join(f"<td>{self.cell(cell, table, line)}</td>" for cell in line) + "</tr>"
            for line in table.lines
        ]
        note = f'<p class="note">{escape_html(table.note)}</p>' if table.note else ""
        content = f"<table><tr>{head}</tr>{''.join(lines)}</table>" if lines else "<p>None.</p>"
        return f"<h2>{escape_html(table.title)}</h2>\n{content}{note}"

    def cell(self, cell: Cell, table: Table, line: tuple[Cell, ...]) -> str:
        text = escape_html(cell.text)
        keys = tuple(key for key in cell.keys if key in self.anchors)
        if not keys or not text:
            return text
        if len(keys) == 1:
            return f'<a href="#{self.anchors[keys[0]]}">{text}</a>'
        if keys not in self.known:
            self.known[keys] = f"n{len(self.known)}"
            links = ", ".join(
                f'<a href="#{self.anchors[key]}">{escape_html(self.names[key])}</a>' for key in keys
            )
            what = escape_html(f"{table.title}, {line[0].text}: {cell.text}")
            self.lists.append(f'<p class="rows" id="{self.known[keys]}"><b>{what}</b>: {links}</p>')
        return f'<a href="#{self.known[keys]}">{text}</a>'


def _image(shown: AnswerMap, anchors: Mapping[str, str]) -> str:
    data, title = b64encode(shown.png).decode(), escape_html(shown.title)
    link = f'<a href="#{anchors[shown.key]}">{title}</a>'
    return f'<p>{link}<br><img src="data:image/png;base64,{data}" alt="{title}"></p>'


def _row_table(rows: Sequence[Row], anchors: Mapping[str, str]) -> str:
    head = "".join(f"<th>{escape_html(name)}</th>" for name in ROW_COLUMNS)
    lines = [f'<table class="rows"><tr>{head}</tr>']
    for row in rows:
        bases = "; ".join(f"({x:.2f}, {y:.2f}, {yaw:.2f})" for x, y, yaw in row.bases)
        texts = (
            row.task, row.group, row.robot, row.method, outcome_text(row), row.reason,
            _number(row.seconds, "s"), _number(row.driving, "m"),
            "" if row.checked is None else str(row.checked), _number(row.clearance, "m"), bases,
            row.host,
        )  # fmt: skip
        cells = "".join(f"<td>{escape_html(text)}</td>" for text in texts)
        lines.append(f'<tr id="{anchors[row.key]}">{cells}</tr>')
    return "\n".join([*lines, "</table>"])


def _number(value: float | None, unit: str) -> str:
    return "" if value is None else f"{value:.3f} {unit}"
