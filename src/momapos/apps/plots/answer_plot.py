"""The figure of an answer: the room from above, the candidates, the potential, and the plan."""

from __future__ import annotations

import textwrap
from collections import Counter
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label, length_text
from momapos.core.geometry import apply, contains, place_points
from momapos.model.records import Hold, PoseStatus, ReachScorer
from momapos.model.scene import Scene
from momapos.planning import PlacementResult
from momapos.planning.placement import (
    BaseStatus,
    PlacementGeometry,
    Search,
    attraction,
    base_pose_status,
    reachable_rectangle,
    within_reach,
)

from . import palette
from .image_files import check_figure_path, save_figure
from .palette import HANDLE, INK, PART, PART_BEFORE, PART_EDGE, POTENTIAL, SOFT_INK, WAYPOINT
from .room_plot import (
    OVERHEAD,
    OVERHEAD_DASHES,
    box_bounds,
    box_outlines,
    draw_arm,
    draw_footprint,
    draw_room,
    draw_union,
    name_objects,
    room_bounds,
)

if TYPE_CHECKING:
    from jaxtyping import Float, Int
    from matplotlib.figure import Figure


@dataclass(frozen=True)
class MarkerKind:
    """Outcomes that share a marker."""

    name: str
    statuses: tuple[PoseStatus, ...]
    color: str
    marker: str
    filled: bool = False
    size: float = 2.6
    """Size of the marker [pt]."""
    obvious: bool = False
    """Whether the room alone explains it; such candidates are drawn under the furniture."""


_S = PoseStatus
KINDS = (
    MarkerKind("beyond the arm's reach", (_S.BEYOND_ARM,), "#c9ced3", ".", size=2.2, obvious=True),
    MarkerKind(
        "base",
        (
            _S.BASE_BLOCKED, _S.BASE_PATH_BLOCKED, _S.BASE_COLLISION, _S.OFF_FLOOR, _S.NO_ROUTE,
            _S.NO_PASSAGE, _S.NO_ROUTE_AT_HOME, _S.AREA_IN_THE_WAY, _S.NO_ROUTE_CARRYING,
        ),
        "#a3aab1", "x", size=2.2, obvious=True,
    ),
    MarkerKind(
        "out of reach",
        (
            _S.OUT_OF_REACH, _S.TOO_FEW_JOINTS, _S.OUT_OF_REACH_ANYWHERE,
            _S.WAYPOINT_OUT_OF_REACH, _S.NO_GRASP_IN_REACH,
        ),
        "#4f6d8f", "o",
    ),
    MarkerKind("not checked", (_S.NOT_TRIED, _S.PATH_FOUND), "#6f7a83", ".", size=2.8),
    MarkerKind(
        "other",
        (
            _S.FILTERED, _S.NOT_KEPT_IN, _S.NOT_KEPT_OUT, _S.NOT_FACING, _S.TOO_LONG_A_DRIVE,
            _S.TASK_INFEASIBLE, _S.LITTLE_ROOM, _S.NOT_FOR_ALL,
        ),
        "#555555", "*", size=3.4,
    ),
    MarkerKind("arm hits", (_S.ARM_COLLISION, _S.HOME_COLLISION), "#b52ad6", "^", size=3.2),
    MarkerKind("no continuous path", (_S.NO_CONTINUOUS_PATH,), "#7a4a1e", "s"),
    MarkerKind("too much load", (_S.OVERLOAD, _S.TIPS_OVER), "#ff9d6e", "v", size=3.2),
    MarkerKind("no approach", (_S.NO_APPROACH, _S.NO_WAY_HOME), "#7d7a1f", "D"),
    MarkerKind("exact check", (_S.EXACT_CHECK,), "#330000", "P", size=3.6),
    MarkerKind("feasible", (_S.FEASIBLE,), "#009e73", "o", filled=True, size=5.0),
)  # fmt: skip
"""Kinds in the order of the checks that fail, which is also the drawing order."""
KIND_OF = {status: index for index, kind in enumerate(KINDS) for status in kind.statuses}
"""Index of the kind that a status belongs to."""
_NOWHERE = (PoseStatus.OUT_OF_REACH_ANYWHERE, PoseStatus.TASK_INFEASIBLE)


@dataclass(frozen=True, eq=False)
class Outcomes:
    """All candidates of a search."""

    poses: Float[np.ndarray, "n 3"]
    kind: Int[np.ndarray, " n"]
    """Index into `KINDS`."""
    counts: dict[tuple[int, str], int]
    """Number of candidates by kind and summary."""


def outcomes(search: Search) -> Outcomes:
    """Group the candidates of a search by kind."""
    poses = np.concatenate([np.zeros((0, 3)), *search.poses])
    seen = [outcome for block in search.outcomes for outcome in block]
    counts = Counter((KIND_OF[outcome.status], outcome.summary) for outcome in seen)
    kind = np.array([KIND_OF[outcome.status] for outcome in seen], int)
    # If no pose can be sampled, the search reports it as one candidate without a pose.
    placed = np.array([outcome.status not in _NOWHERE for outcome in seen], bool)
    return Outcomes(poses[placed], kind[placed], dict(counts))


def thin(
    points: Float[np.ndarray, "n 2"], rank: Int[np.ndarray, " n"], most: int
) -> Int[np.ndarray, " k"]:
    """Return the indices of all points, or of the highest-ranked point in each cell of a grid.

    Args:
        points: Positions [m].
        rank: Priority of each point.
        most: Maximum number of points; the cells grow until it is met.
    """
    cell = 0.0
    chosen = np.arange(len(points))
    while len(chosen) > most:
        cell += 0.05
        cells = np.floor(points / cell).astype(np.int64)
        off_center = np.abs(points / cell - cells - 0.5).max(1).round(2)
        order = np.lexsort((off_center, -rank, cells[:, 1], cells[:, 0]))
        step = np.diff(cells[order], axis=0, prepend=cells[order[:1]] - 1)
        chosen = order[(step != 0).any(1)]
    return np.sort(chosen)


YAWS = 8
"""Yaws sampled at each position [-]."""


@dataclass(frozen=True, eq=False)
class PotentialMap:
    """The potential on a grid over the floor."""

    value: Float[np.ndarray, "rows columns"]
    """Potential in [0, 1]; 0 where the base cannot stand or the arm cannot reach."""
    low: Float[np.ndarray, "2"]
    """Lower corner of cell (0, 0) [m]."""
    cell: float
    """Edge of a cell [m]."""

    @property
    def extent(self) -> tuple[float, float, float, float]:
        """Left, right, bottom, top [m]."""
        rows, columns = self.value.shape
        right, top = self.low + self.cell * np.array([columns, rows])
        return (float(self.low[0]), float(right), float(self.low[1]), float(top))


def potential_map(
    geometry: PlacementGeometry, reach: ReachScorer, *, cell: float
) -> PotentialMap | None:
    """Compute the mean of reachability, for the worst waypoint, and attraction on a grid.

    Args:
        geometry: Room and task.
        reach: The robot's reachability map.
        cell: Edge of a cell [m].

    Returns:
        The map, or None if no position is within the arm's length of all waypoints.
    """
    corners = reachable_rectangle(geometry)
    if corners is None:
        return None
    low = np.floor(corners[0] / cell) * cell
    columns, rows = np.ceil((corners[1] - low) / cell).astype(int)
    x = low[0] + (np.arange(columns) + 0.5) * cell
    y = low[1] + (np.arange(rows) + 0.5) * cell
    xy = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    yaw = 2 * np.pi / YAWS * np.arange(YAWS)
    poses = np.column_stack([np.repeat(xy, YAWS, axis=0), np.tile(yaw, len(xy))])
    # Reachability first, as it is cheaper to compute.
    score = np.zeros(len(poses))
    near = np.flatnonzero(within_reach(geometry, poses))
    score[near] = reach.min_score(poses[near], geometry.Ts_world_tool).max(1, initial=0.0)
    near = near[score[near] > 0]
    score[near[base_pose_status(geometry, poses[near])[0] != BaseStatus.CLEAR]] = 0.0
    best = score.reshape(-1, YAWS).max(1)
    seen = np.flatnonzero(best > 0)
    value = np.zeros(len(xy))
    field = attraction(geometry, xy[seen], np.array([geometry.shoulder[2]]))
    value[seen] = (best[seen] + field) / 2
    return PotentialMap(value.reshape(rows, columns), low, cell)


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
    return length_text(value) if answer.slides else f"{np.degrees(value):.0f}°"


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
    return f"{count:,}"


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


SIZE, DPI = (8.0, 6.0), 200
"""Size of the figure [in] and its resolution: 1600 x 1200 pixels."""
MAX_CANDIDATES = 1500
"""Maximum number of candidates drawn [-]."""
SMALL_ROOM = 5.0
"""Rooms up to this size are drawn completely [m]."""
MAP, COLUMN = (0.058, 0.07, 0.625, 0.91), (0.715, 0.03, 0.27, 0.95)
"""Places of the map and the text column: left, bottom, width, height, as shares of the figure."""
_POTENTIAL_LAYER, _OBVIOUS_LAYER, _SWEEP_LAYER, _CANDIDATE_LAYER = 1.0, 1.5, 4.0, 5.0
_PART_LAYER, _PATH_LAYER, _FEASIBLE_LAYER = 7.0, 10.0, 11.0
_HANDLE_LAYER, _WAYPOINT_LAYER = 14.5, 15.0


def draw_answer(
    scene: Scene, answer: PlacementResult, reach: ReachScorer, path: Path, *, cell: float = 0.08
) -> None:
    """Draw an answer into a PNG, SVG or PDF file, which is written completely or not at all.

    Args:
        scene: The room.
        answer: The answer of the pipeline.
        reach: The robot's reachability map, for the potential.
        path: The file.
        cell: Cell of the potential map [m].

    Raises:
        InputError: The file cannot be written, or its format is not supported.
    """
    check_figure_path(path)
    save_figure(_answer_figure(scene, answer, reach, cell), path, dpi=DPI)


def new_figure(size: tuple[float, float] = SIZE) -> Figure:
    """Return an empty figure of a size [in] that is drawn without a window."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=size, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    return figure


def _answer_figure(
    scene: Scene, answer: PlacementResult, reach: ReachScorer, cell: float
) -> Figure:
    figure = new_figure()
    axes = figure.add_axes(MAP)
    seen = outcomes(answer.search)
    potential = potential_map(answer.prepared.geometry, reach, cell=cell)
    view = _view(scene, answer, seen, potential)
    set_view(axes, view)
    draw_room(axes, scene, target=answer.plan.task.object, moving=moving_links(scene, answer))
    highest = _draw_potential(axes, potential)
    _draw_part(axes, answer)
    _draw_handle(axes, scene, answer)
    _draw_candidates(axes, scene, seen, view)
    _draw_robot(axes, answer)
    name_objects(axes, scene, target=answer.plan.task.object, keep_clear=_keep_clear(answer))
    column = figure.add_axes(COLUMN)
    width, height = COLUMN[2] * SIZE[0], COLUMN[3] * SIZE[1]
    draw_panel(column, width, height, scene, answer, seen, highest)
    return figure


# ----------------------------------------------------------------------------------------- the view


def _view(
    scene: Scene, answer: PlacementResult, seen: Outcomes, potential: PotentialMap | None
) -> Float[np.ndarray, "2 2"]:
    robot, motion = answer.prepared.robot, answer.prepared.motion
    target = scene.object(answer.plan.task.object)
    points = [target.bounds[:, :2], motion.waypoints[:, :2]]
    points.append(box_bounds(motion.sweep()))
    shown = shown_base(answer)
    bases = np.array([answer.start] + ([] if shown is None else [shown]))
    points += list(place_points(bases, robot.footprint))
    promising = [index for index, kind in enumerate(KINDS) if not kind.obvious]
    points.append(seen.poses[np.isin(seen.kind, promising), :2])
    if potential is not None:
        i, j = np.nonzero(potential.value)
        points.append(potential.low + potential.cell * np.stack([j, i], -1))
    every = np.concatenate(points)
    low, high = every.min(0) - 0.25, every.max(0) + 0.25
    bounds = room_bounds(scene) + np.array([[-0.1], [0.1]])
    if (bounds[1] - bounds[0]).max() <= SMALL_ROOM:
        low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
    ratio = MAP[2] * SIZE[0] / (MAP[3] * SIZE[1])
    return widen(np.stack([low, high]), ratio, bounds)


def widen(
    view: Float[np.ndarray, "2 2"], ratio: float, bounds: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "2 2"]:
    """Enlarge a view to a ratio of width to height, into the room rather than out of it."""
    size = view[1] - view[0]
    grown = np.maximum(size, [size[1] * ratio, size[0] / ratio])
    low = view.mean(0) - grown / 2
    inside = np.clip(low, bounds[0], np.maximum(bounds[0], bounds[1] - grown))
    low = np.clip(inside, view[1] - grown, view[0])  # always contains the given view
    low = np.where(grown < bounds[1] - bounds[0], low, view.mean(0) - grown / 2)
    return np.stack([low, low + grown])


def set_view(axes: Any, view: Float[np.ndarray, "2 2"]) -> None:
    """Set the limits [m], labels and ticks of the map."""
    axes.set(xlim=view[:, 0], ylim=view[:, 1], aspect="equal")
    axes.set_xlabel("x [m]", size=7.5, color=SOFT_INK, labelpad=2)
    axes.set_ylabel("y [m]", size=7.5, color=SOFT_INK, labelpad=2)
    axes.tick_params(labelsize=7, color=SOFT_INK, labelcolor=SOFT_INK, length=2.5, pad=2)
    axes.locator_params(nbins=7, steps=[1, 2, 5, 10])
    for spine in axes.spines.values():
        spine.set(color=SOFT_INK, linewidth=0.6)


def moving_links(scene: Scene, answer: PlacementResult) -> tuple[str, ...]:
    """Return the links of the target that the task moves."""
    task = answer.plan.task
    model = scene.object(task.object).model
    return model.links if task.joint is None else model.moved_by(task.joint)


def _keep_clear(answer: PlacementResult) -> list[Float[np.ndarray, "2 2"]]:
    shapes = [answer.start[None, :2]]
    shown = shown_base(answer)
    if shown is not None:
        robot = answer.prepared.robot
        shapes = list(place_points(np.array([answer.start, shown]), robot.footprint))
    for path in waypoints_by_grasp(answer):
        shapes += [path[k : k + 2, :2] for k in range(len(path))]
    shapes += _part(answer, 0) + _part(answer, -1)
    return [np.stack([xy.min(0), xy.max(0)]) for xy in shapes]


# --------------------------------------------------------------------------------------- the layers


def _draw_potential(axes: Any, potential: PotentialMap | None) -> float:
    """Draw the potential on the floor; return its highest value."""
    from matplotlib.colors import LinearSegmentedColormap

    highest = 0.0 if potential is None else float(potential.value.max(initial=0.0))
    if potential is None or highest <= 0:
        return 0.0
    steps = [*zip((POTENTIAL[0], *POTENTIAL), (0.0, 0.8, 0.9, 0.95), strict=True)]
    colors = LinearSegmentedColormap.from_list("potential", steps)
    axes.imshow(
        potential.value, cmap=colors, vmin=0.0, vmax=highest, extent=potential.extent,
        origin="lower", interpolation="bilinear", interpolation_stage="data",
        zorder=_POTENTIAL_LAYER, aspect="equal",
    )  # fmt: skip
    return highest


def _draw_part(axes: Any, answer: PlacementResult) -> None:
    """Draw the moving part before and after the task, and the area that it sweeps."""
    sweep = box_outlines(answer.prepared.motion.sweep())
    draw_union(axes, sweep, fill=PART, alpha=0.2, zorder=_SWEEP_LAYER)
    for k, fill in enumerate((PART_BEFORE, PART)):
        polygons = _part(answer, -k)
        draw_union(axes, polygons, fill=fill, edge=PART_EDGE, width=0.6, zorder=_PART_LAYER + k)


def _draw_handle(axes: Any, scene: Scene, answer: PlacementResult) -> None:
    """Draw the handle before and after the task; an upright bar is a dot."""
    task, handle = answer.plan.task, answer.prepared.motion.handle
    if task.joint is None or task.to is None or handle is None:
        return
    item = scene.object(task.object)
    values = np.array([item.values()[task.joint], task.to])
    T = item.moving_poses(task.joint, values)[handle.carrier]
    ends = handle.center + np.outer((-1, 1), handle.half_length * handle.long)
    for points in apply(T, ends):
        axes.plot(
            *points[:, :2].T, color=HANDLE, linewidth=2.4, marker="o", markersize=6.5,
            markeredgecolor="white", markeredgewidth=0.5, zorder=_HANDLE_LAYER,
        )  # fmt: skip


def _part(answer: PlacementResult, k: int) -> list[Float[np.ndarray, "_ 2"]]:
    """Return the outlines of the part at the k-th value of its joint."""
    return box_outlines(answer.prepared.motion.moving.at(k))


def _draw_candidates(
    axes: Any, scene: Scene, seen: Outcomes, view: Float[np.ndarray, "2 2"]
) -> None:
    xy = seen.poses[:, :2]
    shown = ((xy > view[0]) & (xy < view[1])).all(1)
    if scene.floor_polygon is not None:
        shown &= contains(scene.floor_polygon, xy)
    chosen = np.flatnonzero(shown)
    chosen = chosen[thin(xy[chosen], seen.kind[chosen], MAX_CANDIDATES)]
    scale = 1.0 if len(chosen) < 700 else 0.8
    for index, kind in enumerate(KINDS):
        layer = _FEASIBLE_LAYER if kind.filled else _CANDIDATE_LAYER + index / 100
        axes.plot(
            *xy[chosen[seen.kind[chosen] == index]].T, linestyle="none", marker=kind.marker,
            markersize=scale * kind.size, color=kind.color,
            markerfacecolor=kind.color if kind.filled else "none",
            markeredgecolor="white" if kind.filled else kind.color, markeredgewidth=0.5,
            zorder=_OBVIOUS_LAYER if kind.obvious else layer,
        )  # fmt: skip


def _draw_robot(axes: Any, answer: PlacementResult) -> None:
    robot, plan = answer.prepared.robot, answer.plan
    draw_footprint(axes, robot, answer.start, dashed=True)
    if plan.base_pose is not None and plan.motion is not None:
        base = np.array(plan.base_pose)
        path = np.stack([answer.start, base]) if plan.base_path is None else plan.base_path
        _draw_drive(axes, path, plan.navigation_cost)
        draw_footprint(axes, robot, base)
        states = robot.chain.freedom_values(plan.motion.q)
        bases = plan.motion.base_poses(plan.base_pose)
        for hold in plan.motion.holds or (Hold(0, 0),):
            draw_arm(axes, robot, bases[hold.first], states[hold.first], faint=True)
        if plan.moves_base:
            draw_footprint(axes, robot, bases[-1])
            axes.plot(*bases[:, :2].T, color=INK, linewidth=1.0, zorder=_WAYPOINT_LAYER)
        draw_arm(axes, robot, bases[-1], states[-1])
    elif (shown := shown_base(answer)) is not None:
        draw_footprint(axes, robot, shown)
    for later, points in enumerate(waypoints_by_grasp(answer)):
        fill, edge = ("white", WAYPOINT) if later else (WAYPOINT, "white")
        axes.plot(
            *points[:, :2].T, color=WAYPOINT, linewidth=0.8, marker="D", markersize=3.4,
            markerfacecolor=fill, markeredgecolor=edge, markeredgewidth=0.4 + 0.3 * later,
            zorder=_WAYPOINT_LAYER,
        )  # fmt: skip


def waypoints_by_grasp(answer: PlacementResult) -> list[Float[np.ndarray, "w 3"]]:
    """Return the tool positions by grasp: of the plan, or of the first grasp without a plan [m]."""
    motion, planned = answer.prepared.motion, answer.plan.motion
    if planned is None:
        return [motion.waypoints]
    if not planned.holds:
        return [planned.Ts_world_tool[motion.waypoint_steps[1:] - motion.grasp_step, :3, 3]]
    stride = int(np.diff(motion.waypoint_steps)[-1])
    return [
        planned.Ts_world_tool[np.append(np.arange(h.first, h.last, stride), h.last), :3, 3]
        for h in planned.holds
    ]


def _draw_drive(axes: Any, path: Float[np.ndarray, "k 3"], length: float | None) -> None:
    """Draw the path from the start to the base, labeled with the driving length at its middle."""
    from matplotlib.patheffects import withStroke

    line = path[:, :2]
    axes.plot(*line.T, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), zorder=_PATH_LAYER)
    if length is None or len(line) < 2:
        return
    driven = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(line, axis=0), axis=1)))
    ends = driven[-1] * np.array([0.45, 0.5, 0.55])
    before, middle, after = np.column_stack([np.interp(ends, driven, side) for side in line.T])
    angle = np.degrees(np.arctan2(*(after - before)[::-1]))
    words = axes.text(
        *middle, label(f"{length:.2f} m"), size=7, color=INK, ha="center", va="bottom",
        rotation=(angle + 90) % 180 - 90, rotation_mode="anchor", zorder=16,
        path_effects=[withStroke(linewidth=2, foreground="white")],
    )  # fmt: skip
    box = words.get_window_extent(axes.figure.canvas.get_renderer())
    in_pixels = np.ptp(axes.transData.transform(line), axis=0)
    if np.hypot(*in_pixels) < 2.2 * max(box.width, box.height):
        words.remove()  # a line this short lies under the robot
