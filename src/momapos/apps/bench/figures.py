"""Draw the figures of a report as SVG: success with intervals, driving against time, shares."""

from __future__ import annotations

import math
from collections.abc import Mapping, Sequence

from momapos.core import escape_html

from .bench_records import Row
from .metrics import grouped, share, succeeded

COLORS = (
    "#1f6fb4", "#d1622b", "#3a923a", "#8a5cb4", "#a8842c", "#c03d3e", "#3aa6a6", "#7f7f7f",
    "#d584bd", "#5b5bd6",
)  # fmt: skip
WIDTH = 720


def success_figure(rows: Sequence[Row]) -> str:
    """Draw the success rate of each method with its interval."""
    by_method = grouped(rows, lambda row: row.method)
    left, bar = 190, WIDTH - 190 - 60
    lines = [_open(30 + 26 * len(by_method))]
    for k in range(5):
        x = left + bar * k / 4
        lines.append(_line(x, 8, x, 12 + 26 * len(by_method), "#ddd"))
        lines.append(_text(x, 26 + 26 * len(by_method), f"{25 * k} %", "middle"))
    for k, (method, mine) in enumerate(by_method.items()):
        part = share(sum(map(succeeded, mine)), len(mine))
        y, color = 14 + 26 * k, COLORS[k % len(COLORS)]
        lines.append(_text(left - 8, y + 12, method[:28], "end"))
        width = bar * part.count / max(part.of, 1)
        lines.append(
            f'<rect x="{left}" y="{y}" width="{width:.1f}" height="16" fill="{color}">'
            f"<title>{escape_html(method)}: {part.count} of {part.of}</title></rect>"
        )
        lines.append(_line(left + bar * part.low, y + 8, left + bar * part.high, y + 8, "#111"))
        lines.append(_text(left + bar + 8, y + 12, f"{part.count}/{part.of}"))
    return "".join([*lines, "</svg>"])


def scatter_figure(rows: Sequence[Row], anchors: dict[str, str]) -> str:
    """Draw driving length against time of every solved task; each point links to its row.

    Args:
        rows: All rows.
        anchors: The row's anchor in the page, by key.

    Returns:
        The SVG; empty without any solved task.
    """
    points = [
        (row, row.seconds, row.driving)
        for row in rows
        if row.outcome == "solved" and row.seconds and row.driving is not None
    ]
    if not points:
        return ""
    low = math.floor(math.log10(min(seconds for _, seconds, _ in points)))
    high = max(math.ceil(math.log10(max(seconds for _, seconds, _ in points))), low + 1)
    longest = max(1.0, math.ceil(max(length for _, _, length in points)))
    left, right, top, bottom = 50, WIDTH - 170, 10, 330
    lines = [_open(bottom + 45)]
    for decade in range(low, high + 1):
        x = left + (right - left) * (decade - low) / (high - low)
        lines.append(_line(x, top, x, bottom, "#ddd"))
        lines.append(_text(x, bottom + 16, f"{10.0**decade:g} s", "middle"))
    for k in range(5):
        y = bottom - (bottom - top) * k / 4
        lines.append(_line(left, y, right, y, "#ddd"))
        lines.append(_text(left - 6, y + 4, f"{longest * k / 4:g} m", "end"))
    lines.append(_text((left + right) / 2, bottom + 36, "processor time of an answer", "middle"))
    colors = {m: COLORS[k % len(COLORS)] for k, m in enumerate(grouped(rows, lambda r: r.method))}
    for row, seconds, length in points:
        x = left + (right - left) * (math.log10(seconds) - low) / (high - low)
        y = bottom - (bottom - top) * length / longest
        lines.append(
            f'<a href="#{anchors[row.key]}"><circle cx="{x:.1f}" cy="{y:.1f}" r="3" '
            f'fill="{colors[row.method]}" fill-opacity="0.6"><title>{escape_html(row.method)}, '
            f"{escape_html(row.task)}: {seconds:.3f} s, {length:.2f} m</title></circle></a>"
        )
    for k, (method, color) in enumerate(colors.items()):
        y = top + 12 + 18 * k
        lines.append(f'<circle cx="{right + 18}" cy="{y - 4}" r="4" fill="{color}"/>')
        lines.append(_text(right + 28, y, method[:22]))
    return "".join([*lines, "</svg>"])


def pie_figure(named: Mapping[str, Mapping[str, float]]) -> str:
    """Draw pies side by side, with the same color for a stage in all of them.

    Args:
        named: Shares by stage, of any sum, by the title of each pie.
    """
    stages = list(dict.fromkeys(stage for shares in named.values() for stage in shares))
    colors = {stage: COLORS[k % len(COLORS)] for k, stage in enumerate(stages)}
    each, radius, across = 150, 55, (WIDTH - 170) // 150
    lines = [_open(max(each * -(-len(named) // across), 18 * len(stages) + 20) + 10)]
    for k, (name, shares) in enumerate(named.items()):
        x, y = each * (k % across) + each / 2, each * (k // across) + radius + 10
        total, begin = sum(shares.values()), 0.0
        for stage, share_of in shares.items():
            part = share_of / total if total > 0 else 0.0
            lines.append(
                f'<path d="{_sector(x, y, radius, begin, begin + part)}" fill="{colors[stage]}">'
                f"<title>{escape_html(f'{name}, {stage}')}: {100 * part:.1f} %</title></path>"
            )
            begin += part
        lines.append(_text(x, y + radius + 16, name[:24], "middle"))
    for k, (stage, color) in enumerate(colors.items()):
        y = 20 + 18 * k
        lines.append(f'<circle cx="{WIDTH - 150}" cy="{y - 4}" r="5" fill="{color}"/>')
        lines.append(_text(WIDTH - 138, y, stage[:22]))
    return "".join([*lines, "</svg>"])


def bar_figure(named: Mapping[str, Mapping[str, float]], unit: str) -> str:
    """Draw groups of horizontal bars: a group for each class, with a bar for each name.

    Args:
        named: Values from 0 by class, by the name of each bar.
        unit: Unit of the values.
    """
    classes = list(dict.fromkeys(one for values in named.values() for one in values))
    most = max((value for values in named.values() for value in values.values()), default=0.0)
    left, bar, high = 190, WIDTH - 190 - 230, 18 * len(named) + 14
    lines = [_open(high * len(classes) + 10)]
    for k, one in enumerate(classes):
        lines.append(_text(left - 8, 20 + high * k, one[:28], "end"))
        for i, (name, values) in enumerate(named.items()):
            y, value = 8 + high * k + 18 * i, values.get(one, 0.0)
            width = bar * value / most if most > 0 else 0.0
            lines.append(
                f'<rect x="{left}" y="{y}" width="{width:.1f}" height="14" '
                f'fill="{COLORS[i % len(COLORS)]}"><title>{escape_html(name)}, {escape_html(one)}: '
                f"{value:.2f} {escape_html(unit)}</title></rect>"
            )
            lines.append(_text(left + width + 6, y + 12, f"{value:.2f} {unit}, {name[:26]}"))
    return "".join([*lines, "</svg>"])


def _sector(x: float, y: float, radius: float, begin: float, end: float) -> str:
    """Return the path of a sector between two shares of a turn, clockwise from the top."""
    end = min(end, begin + 0.9999)  # SVG draws no arc whose ends coincide
    points = [
        (x + radius * math.sin(2 * math.pi * turn), y - radius * math.cos(2 * math.pi * turn))
        for turn in (begin, end)
    ]
    (x0, y0), (x1, y1) = points
    large = int(end - begin > 0.5)
    return (
        f"M {x:.2f} {y:.2f} L {x0:.2f} {y0:.2f} A {radius} {radius} 0 {large} 1 {x1:.2f} {y1:.2f} Z"
    )


def _open(height: float) -> str:
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height:.0f}" '
        f'width="{WIDTH}" height="{height:.0f}" font-size="12" font-family="sans-serif">'
    )


def _line(x0: float, y0: float, x1: float, y1: float, color: str) -> str:
    return (
        f'<line x1="{x0:.1f}" y1="{y0:.1f}" x2="{x1:.1f}" y2="{y1:.1f}" stroke="{color}" '
        'stroke-width="1.5"/>'
    )


def _text(x: float, y: float, text: str, anchor: str = "start") -> str:
    return f'<text x="{x:.1f}" y="{y:.1f}" text-anchor="{anchor}">{escape_html(text)}</text>'
