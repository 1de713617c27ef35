"""The column of words beside the picture: question, answer, what became of the candidates."""

from __future__ import annotations

import textwrap
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.model.records import PoseStatus
from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from .candidate_markers import KIND_OF, KINDS, Outcomes
from .palette import (
    BAD,
    FAINT,
    FURNITURE_EDGE,
    GOOD,
    HANDLE,
    INK,
    PART,
    PART_BEFORE,
    PART_EDGE,
    POTENTIAL,
    SOFT_INK,
    WAYPOINT,
)
from .room_plot import OVERHEAD, OVERHEAD_DASHES

if TYPE_CHECKING:
    from jaxtyping import Float

_LETTERS = 38
"""Letters of a line in the column [-]."""
_LINE = 0.11
"""From one line of a reason to the next [in]."""
ROWS = 11
"""Reasons that are listed; the rarest are added up [-]."""


class Panel:
    """Writes from the top of the column downwards; coordinates are inches."""

    def __init__(self, axes: Any, width: float, height: float) -> None:
        self.axes, self.width, self.y = axes, width, height - 0.15
        axes.set(xlim=(0, width), ylim=(0, height))
        axes.axis("off")

    def text(
        self, words: str, *, x: float = 0.0, size: float = 7.5, down: float = 0.0,
        fit: float | None = None, **look: Any,
    ) -> None:  # fmt: skip
        """Write one line, smaller where it must fit into so many inches, then go down."""
        look = {"color": INK, "va": "baseline", **look}
        line = self.axes.text(x, self.y, words, size=size, **look)
        if fit is not None:
            box = line.get_window_extent(self.axes.figure.canvas.get_renderer())
            line.set_size(size * min(1.0, fit * self.axes.figure.dpi / max(box.width, 1.0)))
        self.y -= down

    def heading(self, words: str) -> None:
        """Start a section."""
        self.y -= 0.04
        self.axes.plot([0, self.width], [self.y + 0.17] * 2, color=FAINT, linewidth=0.8)
        self.text(words, size=7.5, weight="bold", down=0.19)


def draw_panel(
    axes: Any, width: float, height: float, scene: Scene, answer: PlacementResult, seen: Outcomes,
    highest: float,
) -> None:  # fmt: skip
    """Write the question, the answer and the reasons.

    Args:
        axes: An empty column.
        width, height: Its size [in].
        scene: The room.
        answer: What the pipeline said.
        seen: The candidates.
        highest: The highest potential in the picture; 0 for no legend of it.
    """
    panel = Panel(axes, width, height)
    _question(panel, scene, answer)
    _facts(panel, answer)
    _reasons(panel, seen.counts, floor=1.23 + (0.2 if highest > 0 else 0.0))
    _legend(panel, answer, highest)


def question(answer: PlacementResult) -> tuple[str, str]:
    """The task in words, such as ('open fridge/door', 'to 90° with fetch')."""
    plan = answer.plan
    task, robot = plan.task, f"with {plan.robot_name}"
    if task.joint is None or task.to is None:
        return f"{task.verb} {task.object}", robot
    value = value_text(answer, task.to)
    return f"{task.verb} {task.object}/{task.joint}", f"to {value} {robot}"


def shown_base(answer: PlacementResult) -> Float[np.ndarray, "3"] | None:
    """The base pose that is drawn: the plan's, or the one that goes farthest."""
    pose = answer.plan.base_pose or answer.plan.feasible_from
    return None if pose is None else np.array(pose)


def reached_value(answer: PlacementResult) -> float | None:
    """The value that is reached from there [rad] or [m]."""
    plan = answer.plan
    return plan.task.to if plan.status == "solved" else plan.feasible_to


def value_text(answer: PlacementResult, value: float) -> str:
    """A value of the task's joint, such as 90° or 0.30 m."""
    return f"{value:.2f} m" if answer.slides else f"{np.degrees(value):.0f}°"


def _question(panel: Panel, scene: Scene, answer: PlacementResult) -> None:
    what, how = question(answer)
    panel.text(what, size=11, weight="bold", fit=panel.width, down=0.2)
    panel.text(how, size=9, fit=panel.width, down=0.18)
    panel.text(f"in {scene.name}", size=7.5, color=SOFT_INK, fit=panel.width, down=0.27)


def _facts(panel: Panel, answer: PlacementResult) -> None:
    plan = answer.plan
    here = plan.status == "infeasible" and plan.base_pose is not None
    word, color = {
        "solved": ("solved", GOOD),
        "infeasible": (f"infeasible: {'not from here' if here else 'no base pose works'}", BAD),
        "timeout": ("out of time", BAD),
    }[plan.status]
    mark = "o" if plan.status == "solved" else "X"
    panel.axes.plot(0.05, panel.y + 0.045, mark, color=color, markersize=6, markeredgewidth=0)
    panel.text(word, x=0.16, size=9, weight="bold", color=color, fit=panel.width - 0.16, down=0.21)
    rows = []
    if plan.base_pose is not None:
        x, y, yaw = plan.base_pose
        rows.append(("base pose", f"({x:.2f}, {y:.2f}) m, {np.degrees(yaw):.0f}°"))
    if plan.feasible_to is not None and plan.feasible_from is not None:
        rows.append(("works to", value_text(answer, plan.feasible_to)))
        if plan.base_pose is None:
            x, y, yaw = plan.feasible_from
            rows.append(("from", f"({x:.2f}, {y:.2f}) m, {np.degrees(yaw):.0f}°"))
    if plan.navigation_cost is not None:
        rows.append(("driving length", f"{plan.navigation_cost:.2f} m"))
    if "total" in plan.timing:
        rows.append(("time", _seconds(plan.timing["total"])))
    counts = plan.candidates
    rows.append(("candidates sampled", _many(counts.sampled)))
    rows.append(("candidates checked", _many(counts.checked)))
    for name, value in rows:
        panel.text(name, color=SOFT_INK)
        panel.text(value, x=panel.width, ha="right", down=0.165)
    panel.y -= 0.11


def _seconds(t: float) -> str:
    return f"{1000 * t:.0f} ms" if t < 1 else f"{t:.1f} s"


def _many(count: int) -> str:
    return f"{count:,}".replace(",", "\u2009")


def _reasons(panel: Panel, counts: dict[tuple[int, str], int], *, floor: float) -> None:
    """A thin bar for each reason, in the order in which candidates are sifted."""
    panel.heading("What became of the candidates")
    rows = _rows(counts)
    if not rows:
        panel.text("no candidate was looked at", color=SOFT_INK, down=0.2)
        return
    most = max(count for _, _, count in rows)
    words = [wrapped(reason) for _, reason, _ in rows]
    more = _LINE * sum(len(lines) - 1 for lines in words)
    step = min(0.265, (panel.y - floor - more) / len(rows))
    for (kind, _, count), lines in zip(rows, words, strict=True):
        look, y = KINDS[kind], panel.y
        bold = "bold" if look.filled else "normal"
        panel.axes.plot(
            0.05, y + 0.035, look.marker, color=look.color, markersize=1.3 * look.size,
            markerfacecolor=look.color if look.filled else "none", markeredgewidth=0.9,
        )  # fmt: skip
        number = _many(count)
        panel.text(number, x=panel.width, size=7, ha="right", weight=bold)
        room = panel.width - 0.2 - 0.062 * len(number)
        for line in lines:
            panel.text(line, x=0.15, size=7, weight=bold, fit=room, down=_LINE)
        panel.y += _LINE
        left, full = 0.15, panel.width - 0.15
        bar = panel.y - min(0.075, 0.3 * step)
        panel.axes.barh(bar, full, left=left, height=0.032, color="#eef0f1")
        panel.axes.barh(bar, full * count / most, left=left, height=0.032, color=look.color)
        panel.y -= step


def _rows(counts: dict[tuple[int, str], int]) -> list[tuple[int, str, int]]:
    """(kind, reason, count), sifted first to last; the rarest reasons of a long list as one."""
    rows = sorted(((*key, count) for key, count in counts.items()), key=lambda row: -row[2])
    if len(rows) > ROWS:
        keep = [r for r in rows if KINDS[r[0]].filled or r[0] == KIND_OF[PoseStatus.NOT_TRIED]]
        rare = [r for r in rows if r not in keep]
        keep += rare[: ROWS - 1 - len(keep)]
        rest = [r for r in rows if r not in keep]
        kinds = {kind for kind, _, _ in rest}
        kind = kinds.pop() if len(kinds) == 1 else KIND_OF[PoseStatus.TASK_INFEASIBLE]
        arm = kind == KIND_OF[PoseStatus.ARM_COLLISION]
        name = "arm hits other things" if arm else "other reasons"
        rows = [*keep, (kind, name, sum(n for _, _, n in rest))]
    return sorted(rows, key=lambda row: (row[0], -row[2]))


def wrapped(words: str) -> list[str]:
    """A reason in lines that fit the column; names longer than a line are broken."""
    return textwrap.wrap(words, _LETTERS, break_on_hyphens=False) or [""]


def _legend(panel: Panel, answer: PlacementResult, highest: float) -> None:
    """What the shapes in the picture mean, at the foot of the column."""
    from matplotlib.patches import Rectangle

    panel.y = 0.82 + (0.2 if highest > 0 else 0.0)
    panel.heading("In the picture")

    def box(x: float, words: str, **look: Any) -> None:
        panel.axes.add_patch(Rectangle((x, panel.y - 0.01), 0.17, 0.09, **look))
        panel.text(words, x=x + 0.24, size=7)

    right = panel.width / 2 + 0.04
    box(0.0, "start", facecolor="white", edgecolor=INK, linewidth=1.0, linestyle=(0, (2.5, 1.5)))
    if shown_base(answer) is not None:
        words = "base and arm" if answer.plan.motion is not None else "base"
        box(right, words, facecolor="white", edgecolor=INK, linewidth=1.5)
    panel.y -= 0.175
    box(0.0, "part before", facecolor=PART_BEFORE, edgecolor=PART_EDGE, linewidth=0.8)
    box(right, "part after", facecolor=PART, edgecolor=PART_EDGE, linewidth=0.8)
    panel.y -= 0.175
    box(0.0, "its sweep", facecolor=PART, alpha=0.2, linewidth=0)
    panel.axes.plot(
        [right, right + 0.085, right + 0.17], [panel.y + 0.035] * 3, color=WAYPOINT,
        linewidth=0.8, marker="D", markersize=2.8, markeredgecolor="white", markeredgewidth=0.3,
    )  # fmt: skip
    later = answer.plan.motion is not None and len(answer.plan.motion.holds) > 1
    words = "waypoints, hollow: 2nd" if later else "waypoints"
    panel.text(words, x=right + 0.24, size=7, fit=panel.width - right - 0.24)
    panel.y -= 0.175
    dashed = {"linestyle": OVERHEAD_DASHES, "edgecolor": FURNITURE_EDGE, "linewidth": 0.7}
    box(0.0, f"above {OVERHEAD:g} m", fill=False, **dashed)
    if answer.plan.task.joint is not None:
        panel.axes.plot(
            [right + 0.03, right + 0.14], [panel.y + 0.035] * 2, color=HANDLE, linewidth=2.0,
            marker="o", markersize=4.0, markeredgecolor="white", markeredgewidth=0.3,
        )  # fmt: skip
        panel.text("handle", x=right + 0.24, size=7)
    panel.y -= 0.2
    if highest > 0:
        _gradient(panel, highest)


def _gradient(panel: Panel, highest: float) -> None:
    from matplotlib.colors import LinearSegmentedColormap

    panel.text("potential", x=0.0, size=7)
    left, right = 0.62, panel.width - 0.3
    panel.text("0", x=left - 0.05, size=7, ha="right")
    panel.text(f"{highest:.2f}", x=right + 0.05, size=7)
    colors = LinearSegmentedColormap.from_list("potential", ["#ffffff", *POTENTIAL])
    panel.axes.imshow(
        np.linspace(0, 1, 128)[None], cmap=colors, aspect="auto", interpolation="bilinear",
        extent=(left, right, panel.y - 0.01, panel.y + 0.08),
    )  # fmt: skip
    panel.axes.set(xlim=(0, panel.width))
