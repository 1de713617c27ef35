"""The legend of the page: each color once, with its one meaning."""

from __future__ import annotations

from collections.abc import Collection, Sequence

from momapos.apps import plots

from . import colors

VIRIDIS, PLASMA = ("#dde318", "#21918c", "#440f5c"), ("#f0f921", "#cc4778", "#3a049a")


def legend_rows(shown: Collection[str], kinds: Sequence[str]) -> list[tuple[tuple[str, ...], str]]:
    """Return the colors of the layers that are shown, and their meanings.

    Args:
        shown: Keys of the layers.
        kinds: Kinds of outcome of the candidates that are drawn.
    """
    rows: list[tuple[tuple[str, ...], str]] = [
        ((colors.TARGET,), "object of the task"),
        ((colors.PART,), "moving part"),
        ((colors.FEASIBLE,), "feasible base pose, and its tolerance"),
        ((colors.PARTLY,), "base pose feasible in part"),
        ((colors.INFEASIBLE,), "infeasible base pose, and what is in the way"),
        ((colors.UNKNOWN,), "base pose not checked"),
        ((colors.FORCE,), "force of the hand"),
    ]
    of_layers: dict[str, list[tuple[tuple[str, ...], str]]] = {
        "path": [((colors.DRIVE,), "start and path of the base")],
        "waypoints": [((colors.TOOL,), "path of the tool, and grasps")],
        "potential": [(plots.POTENTIAL, "potential, low to high")],
        "free": [((colors.FREE,), "free area, stronger for more yaws")],
        "opening": [(VIRIDIS, "opens a little to fully")],
        "reach": [(PLASMA, "reachable from few to all directions")],
        "importance": [
            (colors.IMPORTANCE, "importance, 0 to 1"),
            *(((look.color,), f"relation: {kind}") for kind, look in plots.RELATIONS.items()),
        ],
        "spheres": [((colors.SPHERES,), "collision spheres")],
        "candidates": [
            ((kind.color,), f"candidate: {kind.name}") for kind in plots.KINDS if kind.name in kinds
        ],
    }
    return rows + [row for key, own in of_layers.items() if key in shown for row in own]


def legend(shown: Collection[str], kinds: Sequence[str]) -> str:
    """Return the legend as HTML; see `legend_rows`."""
    items = "".join(
        f"<div>{_mark(ramp)} {words}</div>" for ramp, words in legend_rows(shown, kinds)
    )
    return f'<div style="font-size:0.8em;line-height:1.5;padding:0 0.8em">{items}</div>'


def _mark(ramp: Sequence[str]) -> str:
    # The border separates dark colors from a dark page, and pale ones from a light page.
    shape = "display:inline-block;height:0.9em;vertical-align:-0.1em;border:1px solid #888"
    fill = (
        f"background:{ramp[0]};width:0.9em"
        if len(ramp) == 1
        else f"background:linear-gradient(90deg,{','.join(ramp)});width:2.2em"
    )
    return f'<span style="{shape};{fill}"></span>'
