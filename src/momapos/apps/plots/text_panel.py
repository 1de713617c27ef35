"""The text column of a figure: task, answer, outcomes of the candidates, legend."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.model.records import PoseStatus
from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from . import palette
from .candidate_markers import KIND_OF, KINDS, Outcomes
from .room_plot import OVERHEAD, OVERHEAD_DASHES

if TYPE_CHECKING:
    from jaxtyping import Float

_LINE_LENGTH = 38
"""Characters of a line [-]."""
_LINE_HEIGHT = 0.11
"""Distance between the lines of a reason [in]."""
MAX_ROWS = 11
"""Outcomes listed; the rarest ones share a row [-]."""


class TextColumn:
    """Writes from top to bottom; coordinates are in inches."""

    def __init__(self, axes: Any, width: float, height: float) -> None:
        self.axes, self.width, self.y = axes, width, height - 0.15
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.axis("off")

    def text(
        self, words: str, *, x: float = 0.0, size: float = 7.5, down: float = 0.0,
        fit: float | None = None, **look: Any,
    ) -> None:  # fmt: skip
        """Write one line, reduced to a width `fit` [in] where it is too long, then move down."""
        look = {"color": palette.INK, "va": "baseline", **look}
        line = self.axes.text(x, self.y, label(words), size=size, **look)
        if fit is not None:
            box = line.get_window_extent(self.axes.figure.canvas.get_renderer())
            line.set_size(size * min(1.0, fit * self.axes.figure.dpi / max(box.width, 1.0)))
        self.y -= down

    def heading(self, words: str) -> None:
        """Start a section."""
        self.y -= 0.04
        self.axes.plot([0, self.width], [self.y + 0.17] * 2, color=palette.FAINT, linewidth=0.8)
        self.text(words, size=7.5, weight="bold", down=0.19)


def draw_panel(
    axes: Any, width: float, height: float, scene: Scene, answer: PlacementResult, seen: Outcomes,
    highest: float,
) -> None:  # fmt: skip
    """Write the task, the answer, the outcomes of the candidates and the legend.

    Args:
        axes: An empty column.
        width, height: Its size [in].
        scene: The room.
        answer: The answer of the pipeline.
        seen: The candidates.
        highest: Highest potential in the figure; 0 for none.
    """
    column = TextColumn(axes, width, height)
    _write_task(column, scene, answer)
    _write_facts(column, answer)
    _write_outcomes(column, seen.counts, floor=1.23 + (0.2 if highest > 0 else 0.0))
    _write_legend(column, answer, highest)


def task_text(answer: PlacementResult) -> tuple[str, str]:
    """Describe the task, such as ('open fridge/door', 'to 90° with fetch')."""
    plan = answer.plan
    task, robot = plan.task, f"with {plan.robot_name}"
    if task.joint is None or task.to is None:
        return f"{task.verb} {task.object}", robot
    value = value_text(answer, task.to)
    return f"{task.verb} {task.object}/{task.joint}", f"to {value} {robot}"


def shown_base(answer: PlacementResult) -> Float[np.ndarray, "3"] | None:
    """Return the base pose to draw: the plan's, or the one that opens the part farthest."""
    pose = answer.plan.base_pose or answer.plan.feasible_from
    return None if pose is None else np.array(pose)


def reached_value(answer: PlacementResult) -> float | None:
    """Return the joint value reached from the base pose that is drawn [rad] or [m]."""
    plan = answer.plan
    return plan.task.to if plan.feasible else plan.feasible_to


def value_text(answer: PlacementResult, value: float) -> str:
    """Format a value of the task's joint, such as 90° or 0.30 m."""
    return f"{value:.2f} m" if answer.slides else f"{np.degrees(value):.0f}°"


def _write_task(column: TextColumn, scene: Scene, answer: PlacementResult) -> None:
    what, how = task_text(answer)
    column.text(what, size=11, weight="bold", fit=column.width, down=0.2)
    column.text(how, size=9, fit=column.width, down=0.18)
    column.text(f"in {scene.name}", size=7.5, color=palette.SOFT_INK, fit=column.width, down=0.27)


def _write_facts(column: TextColumn, answer: PlacementResult) -> None:
    plan, width = answer.plan, column.width
    here = plan.status == "infeasible" and plan.base_pose is not None
    status, color = {
        "solved": ("solved", palette.GOOD),
        "assumed": ("assumed", palette.PART),
        "infeasible": ("not feasible from here" if here else "no feasible base pose", palette.BAD),
        "timeout": ("out of time", palette.BAD),
    }[plan.status]
    marker = "o" if plan.feasible else "X"
    column.axes.plot(0.05, column.y + 0.045, marker, color=color, markersize=6, markeredgewidth=0)
    column.text(status, x=0.16, size=9, weight="bold", color=color, fit=width - 0.16, down=0.21)
    rows = []
    if plan.assumption is not None:
        rows.append(("joint type", str(plan.assumption)))
        if not plan.assumption.is_first:
            rows.append(("most probable", plan.assumption.instead.partition(":")[0]))
    if plan.base_pose is not None:
        x, y, yaw = plan.base_pose
        rows.append(("base pose", f"({x:.2f}, {y:.2f}) m, {np.degrees(yaw):.0f}°"))
    if plan.feasible_to is not None and plan.feasible_from is not None:
        rows.append(("feasible to", value_text(answer, plan.feasible_to)))
        if plan.base_pose is None:
            x, y, yaw = plan.feasible_from
            rows.append(("from", f"({x:.2f}, {y:.2f}) m, {np.degrees(yaw):.0f}°"))
    if plan.navigation_cost is not None:
        rows.append(("driving length", f"{plan.navigation_cost:.2f} m"))
    if "total" in plan.timing:
        rows.append(("time", _seconds(plan.timing["total"])))
    counts = plan.candidates
    rows.append(("candidates sampled", _grouped(counts.sampled)))
    rows.append(("candidates checked", _grouped(counts.checked)))
    for name, value in rows:
        column.text(name, color=palette.SOFT_INK)
        column.text(value, x=width, ha="right", down=0.165)
    column.y -= 0.11


def _seconds(t: float) -> str:
    return f"{1000 * t:.0f} ms" if t < 1 else f"{t:.1f} s"


def _grouped(count: int) -> str:
    return f"{count:,}".replace(",", "\u2009")


def _write_outcomes(
    column: TextColumn, counts: dict[tuple[int, str], int], *, floor: float
) -> None:
    """Write a row with a bar for each outcome, in the order of the checks."""
    column.heading("Outcomes of the candidates")
    rows = _rows(counts)
    if not rows:
        column.text("no candidate was checked", color=palette.SOFT_INK, down=0.2)
        return
    most = max(count for _, _, count in rows)
    words = [wrapped(reason) for _, reason, _ in rows]
    more = _LINE_HEIGHT * sum(len(lines) - 1 for lines in words)
    step = min(0.265, (column.y - floor - more) / len(rows))
    for (kind, _, count), lines in zip(rows, words, strict=True):
        look, y = KINDS[kind], column.y
        bold = "bold" if look.filled else "normal"
        column.axes.plot(
            0.05, y + 0.035, look.marker, color=look.color, markersize=1.3 * look.size,
            markerfacecolor=look.color if look.filled else "none", markeredgewidth=0.9,
        )  # fmt: skip
        number = _grouped(count)
        column.text(number, x=column.width, size=7, ha="right", weight=bold)
        fit = column.width - 0.2 - 0.062 * len(number)
        for line in lines:
            column.text(line, x=0.15, size=7, weight=bold, fit=fit, down=_LINE_HEIGHT)
        column.y += _LINE_HEIGHT
        left, full = 0.15, column.width - 0.15
        bar = column.y - min(0.075, 0.3 * step)
        column.axes.barh(bar, full, left=left, height=0.032, color="#eef0f1")
        column.axes.barh(bar, full * count / most, left=left, height=0.032, color=look.color)
        column.y -= step


def _rows(counts: dict[tuple[int, str], int]) -> list[tuple[int, str, int]]:
    """Return (kind, reason, count) in the order of the checks; the rarest reasons share a row."""
    rows = sorted(((*key, count) for key, count in counts.items()), key=lambda row: -row[2])
    if len(rows) > MAX_ROWS:
        keep = [r for r in rows if KINDS[r[0]].filled or r[0] == KIND_OF[PoseStatus.NOT_TRIED]]
        rare = [r for r in rows if r not in keep]
        keep += rare[: MAX_ROWS - 1 - len(keep)]
        rest = [r for r in rows if r not in keep]
        kinds = {kind for kind, _, _ in rest}
        kind = kinds.pop() if len(kinds) == 1 else KIND_OF[PoseStatus.TASK_INFEASIBLE]
        arm = kind == KIND_OF[PoseStatus.ARM_COLLISION]
        name = "arm hits other objects" if arm else "other reasons"
        rows = [*keep, (kind, name, sum(n for _, _, n in rest))]
    return sorted(rows, key=lambda row: (row[0], -row[2]))


def wrapped(words: str) -> list[str]:
    """Wrap a reason to the column; break names that are longer than a line."""
    return textwrap.wrap(words, _LINE_LENGTH, break_on_hyphens=False) or [""]


def _write_legend(column: TextColumn, answer: PlacementResult, highest: float) -> None:
    from matplotlib.patches import Rectangle

    column.y = 0.82 + (0.2 if highest > 0 else 0.0)
    column.heading("Legend")

    def box(x: float, words: str, **look: Any) -> None:
        column.axes.add_patch(Rectangle((x, column.y - 0.01), 0.17, 0.09, **look))
        column.text(words, x=x + 0.24, size=7)

    right = column.width / 2 + 0.04
    robot = {"facecolor": "white", "edgecolor": palette.INK}
    box(0.0, "start", linewidth=1.0, linestyle=(0, (2.5, 1.5)), **robot)
    if shown_base(answer) is not None:
        words = "base and arm" if answer.plan.motion is not None else "base"
        box(right, words, linewidth=1.5, **robot)
    column.y -= 0.175
    part = {"edgecolor": palette.PART_EDGE, "linewidth": 0.8}
    box(0.0, "part before", facecolor=palette.PART_BEFORE, **part)
    box(right, "part after", facecolor=palette.PART, **part)
    column.y -= 0.175
    box(0.0, "swept area", facecolor=palette.PART, alpha=0.2, linewidth=0)
    column.axes.plot(
        [right, right + 0.085, right + 0.17], [column.y + 0.035] * 3, color=palette.WAYPOINT,
        linewidth=0.8, marker="D", markersize=2.8, markeredgecolor="white", markeredgewidth=0.3,
    )  # fmt: skip
    later = answer.plan.motion is not None and len(answer.plan.motion.holds) > 1
    words = "waypoints (hollow: regrasp)" if later else "waypoints"
    column.text(words, x=right + 0.24, size=7, fit=column.width - right - 0.24)
    column.y -= 0.175
    dashed = {"linestyle": OVERHEAD_DASHES, "edgecolor": palette.FURNITURE_EDGE, "linewidth": 0.7}
    box(0.0, f"above {OVERHEAD:g} m", fill=False, **dashed)
    if answer.plan.task.joint is not None:
        column.axes.plot(
            [right + 0.03, right + 0.14], [column.y + 0.035] * 2, color=palette.HANDLE,
            linewidth=2.0, marker="o", markersize=4.0, markeredgecolor="white", markeredgewidth=0.3,
        )  # fmt: skip
        column.text("handle", x=right + 0.24, size=7)
    column.y -= 0.2
    if highest > 0:
        _write_gradient(column, highest)


def _write_gradient(column: TextColumn, highest: float) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    column.text("potential", x=0.0, size=7)
    left, right = 0.62, column.width - 0.3
    column.text("0", x=left - 0.05, size=7, ha="right")
    column.text(f"{highest:.2f}", x=right + 0.05, size=7)
    colors = LinearSegmentedColormap.from_list("potential", ["#ffffff", *palette.POTENTIAL])
    column.axes.imshow(
        np.linspace(0, 1, 128)[None], cmap=colors, aspect="auto", interpolation="bilinear",
        extent=(left, right, column.y - 0.01, column.y + 0.08),
    )  # fmt: skip
    column.axes.set(xlim=(0, column.width))
