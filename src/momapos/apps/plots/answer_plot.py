"""The figure of an answer: the room from above, the candidates, and the plan."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core import label
from momapos.core.geometry import apply, contains, place_points
from momapos.model.records import Hold, ReachScorer
from momapos.model.scene import Scene
from momapos.planning import PlacementResult

from .candidate_markers import KINDS, Outcomes, outcomes, thin
from .heat import PotentialMap, potential_map
from .image_files import check_figure_path, save_figure
from .outlines import box_bounds, box_outlines, draw_union
from .palette import HANDLE, INK, PART, PART_BEFORE, PART_EDGE, POTENTIAL, SOFT_INK, WAYPOINT
from .robot_plot import draw_arm, draw_footprint
from .room_plot import draw_room, name_objects, room_bounds
from .text_panel import draw_panel, shown_base

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.figure import Figure

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
        _draw_drive(axes, answer.start, base, plan.navigation_cost)
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


def _draw_drive(
    axes: Any, start: Float[np.ndarray, "3"], base: Float[np.ndarray, "3"], length: float | None
) -> None:
    """Draw a line from the start to the base, labeled with the driving length."""
    from matplotlib.patheffects import withStroke

    line = np.stack([start[:2], base[:2]])
    axes.plot(*line.T, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), zorder=_PATH_LAYER)
    if length is None:
        return
    angle = np.degrees(np.arctan2(*(line[1] - line[0])[::-1]))
    words = axes.text(
        *line.mean(0), label(f"{length:.2f} m"), size=7, color=INK, ha="center", va="bottom",
        rotation=(angle + 90) % 180 - 90, rotation_mode="anchor", zorder=16,
        path_effects=[withStroke(linewidth=2, foreground="white")],
    )  # fmt: skip
    box = words.get_window_extent(axes.figure.canvas.get_renderer())
    in_pixels = np.ptp(axes.transData.transform(line), axis=0)
    if np.hypot(*in_pixels) < 2.2 * max(box.width, box.height):
        words.remove()  # a line this short lies under the robot
