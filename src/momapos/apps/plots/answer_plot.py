"""One picture of an answer: the room from above, what was tried, and what came of it."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.core.geometry import apply, contains, place_points
from momapos.model.records import Hold, ReachScorer
from momapos.model.scene import Scene
from momapos.model.urdf import joint_motion
from momapos.planning import PlacementResult

from .candidate_markers import KINDS, Outcomes, outcomes, thin
from .heat import Heat, potential_map
from .image_files import check_picture, save_figure
from .outlines import box_bounds, box_outlines, draw_union
from .palette import HANDLE, INK, PART, PART_BEFORE, PART_EDGE, POTENTIAL, SOFT_INK, WAYPOINT
from .robot_plot import draw_arm, draw_footprint
from .room_plot import name_objects, room, room_bounds
from .text_panel import draw_panel, shown_base

if TYPE_CHECKING:
    from jaxtyping import Float
    from matplotlib.figure import Figure

SIZE, DPI = (8.0, 6.0), 200
"""Size of the picture [in] and its resolution: 1600 x 1200 pixels."""
POINTS = 1500
"""Candidates that are drawn at most [-]."""
SMALL_ROOM = 5.0
"""A room up to this wide is drawn whole [m]."""
_MAP = (0.058, 0.07, 0.625, 0.91)
_COLUMN = (0.715, 0.03, 0.27, 0.95)
_HEAT_LAYER, _OBVIOUS_LAYER, _SWEEP_LAYER, _CANDIDATE_LAYER = 1.0, 1.5, 4.0, 5.0
_PART_LAYER, _WAY_LAYER, _FEASIBLE_LAYER = 7.0, 10.0, 11.0
_HANDLE_LAYER, _WAYPOINT_LAYER = 14.5, 15.0


def draw_answer(
    scene: Scene, answer: PlacementResult, reach: ReachScorer, path: Path, *, cell: float = 0.08
) -> None:
    """Draw an answer into a PNG, SVG or PDF file, the whole file or nothing.

    Args:
        scene: The room that was asked about.
        answer: What the pipeline said.
        reach: The robot's reachability map, for the potential.
        path: The file.
        cell: Cell of the potential map [m].

    Raises:
        InputError: The file cannot be written, or its name says that it is no picture.
    """
    check_picture(path)
    save_figure(_picture(scene, answer, reach, cell), path, dpi=DPI)


def _picture(scene: Scene, answer: PlacementResult, reach: ReachScorer, cell: float) -> Figure:
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=SIZE, dpi=DPI, facecolor="white")
    FigureCanvasAgg(figure)
    axes = figure.add_axes(_MAP)
    seen = outcomes(answer.search)
    heat = potential_map(answer.prepared.geometry, reach, cell=cell)
    view = _view(scene, answer, seen, heat)
    frame(axes, view)
    room(axes, scene, target=answer.plan.task.object, moving=moving_links(scene, answer))
    highest = _draw_heat(axes, heat)
    _draw_part(axes, answer)
    _draw_handle(axes, scene, answer)
    _draw_candidates(axes, scene, seen, view)
    _draw_robot(axes, answer)
    name_objects(axes, scene, target=answer.plan.task.object, keep_clear=_keep_clear(answer))
    column = figure.add_axes(_COLUMN)
    width, height = _COLUMN[2] * SIZE[0], _COLUMN[3] * SIZE[1]
    draw_panel(column, width, height, scene, answer, seen, highest)
    return figure


# ----------------------------------------------------------------------------------------- the view


def _view(
    scene: Scene, answer: PlacementResult, seen: Outcomes, heat: Heat | None
) -> Float[np.ndarray, "2 2"]:
    """What must be seen: lower and upper corner [m]."""
    robot, motion = answer.prepared.robot, answer.prepared.motion
    target = scene.object(answer.plan.task.object)
    points = [target.bounds[:, :2], motion.waypoints[:, :2]]
    points.append(box_bounds(motion.sweep()))
    shown = shown_base(answer)
    bases = np.array([answer.start] + ([] if shown is None else [shown]))
    points += list(place_points(bases, robot.footprint))
    promising = [index for index, kind in enumerate(KINDS) if not kind.obvious]
    points.append(seen.poses[np.isin(seen.kind, promising), :2])
    if heat is not None:
        i, j = np.nonzero(heat.value)
        points.append(heat.low + heat.cell * np.stack([j, i], -1))
    every = np.concatenate(points)
    low, high = every.min(0) - 0.25, every.max(0) + 0.25
    bounds = room_bounds(scene) + np.array([[-0.1], [0.1]])
    if (bounds[1] - bounds[0]).max() <= SMALL_ROOM:
        low, high = np.minimum(low, bounds[0]), np.maximum(high, bounds[1])
    ratio = _MAP[2] * SIZE[0] / (_MAP[3] * SIZE[1])
    return widen(np.stack([low, high]), ratio, bounds)


def widen(
    view: Float[np.ndarray, "2 2"], ratio: float, bounds: Float[np.ndarray, "2 2"]
) -> Float[np.ndarray, "2 2"]:
    """Grow a view to a ratio of width to height, into the room rather than out of it."""
    size = view[1] - view[0]
    grown = np.maximum(size, [size[1] * ratio, size[0] / ratio])
    low = view.mean(0) - grown / 2
    inside = np.clip(low, bounds[0], np.maximum(bounds[0], bounds[1] - grown))
    low = np.clip(inside, view[1] - grown, view[0])  # what must be seen comes first
    low = np.where(grown < bounds[1] - bounds[0], low, view.mean(0) - grown / 2)
    return np.stack([low, low + grown])


def frame(axes: Any, view: Float[np.ndarray, "2 2"]) -> None:
    axes.set(xlim=view[:, 0], ylim=view[:, 1], aspect="equal")
    axes.set_xlabel("x [m]", size=7.5, color=SOFT_INK, labelpad=2)
    axes.set_ylabel("y [m]", size=7.5, color=SOFT_INK, labelpad=2)
    axes.tick_params(labelsize=7, color=SOFT_INK, labelcolor=SOFT_INK, length=2.5, pad=2)
    axes.locator_params(nbins=7, steps=[1, 2, 5, 10])
    for spine in axes.spines.values():
        spine.set(color=SOFT_INK, linewidth=0.6)


def moving_links(scene: Scene, answer: PlacementResult) -> tuple[str, ...]:
    """Links of the target that the task moves."""
    task = answer.plan.task
    model = scene.object(task.object).model
    return model.links if task.joint is None else model.moved_by(task.joint)


def _keep_clear(answer: PlacementResult) -> list[Float[np.ndarray, "2 2"]]:
    """Rectangles around what names must not cover [m]."""
    shapes = [answer.start[None, :2]]
    shown = shown_base(answer)
    if shown is not None:
        robot = answer.prepared.robot
        shapes = list(place_points(np.array([answer.start, shown]), robot.footprint))
    for path in waypoints_by_hold(answer):
        shapes += [path[k : k + 2, :2] for k in range(len(path))]
    shapes += _part(answer, 0) + _part(answer, -1)
    return [np.stack([xy.min(0), xy.max(0)]) for xy in shapes]


# --------------------------------------------------------------------------------------- the layers


def _draw_heat(axes: Any, heat: Heat | None) -> float:
    """Draw the potential as a soft layer on the floor; return its highest value."""
    from matplotlib.colors import LinearSegmentedColormap

    highest = 0.0 if heat is None else float(heat.value.max(initial=0.0))
    if heat is None or highest <= 0:
        return 0.0
    steps = [(c, a) for c, a in zip((POTENTIAL[0], *POTENTIAL), (0.0, 0.8, 0.9, 0.95), strict=True)]
    colors = LinearSegmentedColormap.from_list("potential", steps)
    axes.imshow(
        heat.value,
        cmap=colors,
        vmin=0.0,
        vmax=highest,
        extent=heat.extent,
        origin="lower",
        interpolation="bilinear",
        interpolation_stage="data",
        zorder=_HEAT_LAYER,
        aspect="equal",
    )
    return highest


def _draw_part(axes: Any, answer: PlacementResult) -> None:
    """Draw the part that moves: before, after, and where it passes."""
    sweep = box_outlines(answer.prepared.motion.sweep())
    draw_union(axes, sweep, fill=PART, alpha=0.2, zorder=_SWEEP_LAYER)
    for k, fill in enumerate((PART_BEFORE, PART)):
        polygons = _part(answer, -k)
        draw_union(axes, polygons, fill=fill, edge=PART_EDGE, width=0.6, zorder=_PART_LAYER + k)


def _draw_handle(axes: Any, scene: Scene, answer: PlacementResult) -> None:
    """Draw what is held, where it is before and after; a bar that stands upright is a dot."""
    task, handle = answer.plan.task, answer.prepared.motion.handle
    if task.joint is None or task.to is None or handle is None:
        return
    item = scene.object(task.object)
    joint = item.joint(task.joint)
    values = np.array([item.values()[task.joint], task.to])
    T = item.link_poses()[joint.parent] @ joint.T_parent_joint @ joint_motion(joint, values)
    ends = handle.center + np.outer((-1, 1), handle.half_length * handle.long)
    for points in apply(T, ends):
        axes.plot(
            *points[:, :2].T, color=HANDLE, linewidth=2.4, marker="o", markersize=6.5,
            markeredgecolor="white", markeredgewidth=0.5, zorder=_HANDLE_LAYER,
        )  # fmt: skip


def _part(answer: PlacementResult, k: int) -> list[Float[np.ndarray, "_ 2"]]:
    """Outlines of the part at the k-th value of its joint."""
    return box_outlines(answer.prepared.motion.moving.at(k))


def _draw_candidates(
    axes: Any, scene: Scene, seen: Outcomes, view: Float[np.ndarray, "2 2"]
) -> None:
    """Draw where the base was tried, and what came of it."""
    xy = seen.poses[:, :2]
    shown = ((xy > view[0]) & (xy < view[1])).all(1)
    if scene.floor_polygon is not None:
        shown &= contains(scene.floor_polygon, xy)
    chosen = np.flatnonzero(shown)
    chosen = chosen[thin(xy[chosen], seen.kind[chosen], POINTS)]
    crowd = 1.0 if len(chosen) < 700 else 0.8
    for index, kind in enumerate(KINDS):
        layer = _FEASIBLE_LAYER if kind.filled else _CANDIDATE_LAYER + index / 100
        axes.plot(
            *xy[chosen[seen.kind[chosen] == index]].T, linestyle="none", marker=kind.marker,
            markersize=crowd * kind.size, color=kind.color,
            markerfacecolor=kind.color if kind.filled else "none",
            markeredgecolor="white" if kind.filled else kind.color, markeredgewidth=0.5,
            zorder=_OBVIOUS_LAYER if kind.obvious else layer,
        )  # fmt: skip


def _draw_robot(axes: Any, answer: PlacementResult) -> None:
    """Draw the start, the way, the base and the arm; and the waypoints of the tool."""
    robot, plan = answer.prepared.robot, answer.plan
    draw_footprint(axes, robot, answer.start, dashed=True)
    if plan.base_pose is not None and plan.motion is not None:
        base = np.array(plan.base_pose)
        _draw_way(axes, answer.start, base, plan.navigation_cost)
        draw_footprint(axes, robot, base)
        states = robot.chain.freedom_values(plan.motion.q)
        for hold in plan.motion.holds or (Hold(0, 0),):
            draw_arm(axes, robot, base, states[hold.first], faint=True)
        draw_arm(axes, robot, base, states[-1])
    elif (shown := shown_base(answer)) is not None:
        draw_footprint(axes, robot, shown)
    for later, points in enumerate(waypoints_by_hold(answer)):
        fill, edge = ("white", WAYPOINT) if later else (WAYPOINT, "white")
        axes.plot(
            *points[:, :2].T, color=WAYPOINT, linewidth=0.8, marker="D", markersize=3.4,
            markerfacecolor=fill, markeredgecolor=edge, markeredgewidth=0.4 + 0.3 * later,
            zorder=_WAYPOINT_LAYER,
        )  # fmt: skip


def waypoints_by_hold(answer: PlacementResult) -> list[Float[np.ndarray, "w 3"]]:
    """Where the tool goes, hold by hold: as planned, or as the plainest grasp would have it [m]."""
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


def _draw_way(
    axes: Any, start: Float[np.ndarray, "3"], base: Float[np.ndarray, "3"], length: float | None
) -> None:
    """Draw the way from the start to the base, labeled with its driving length."""
    from matplotlib.patheffects import withStroke

    way = np.stack([start[:2], base[:2]])
    axes.plot(*way.T, color=INK, linewidth=1.0, linestyle=(0, (4, 3)), zorder=_WAY_LAYER)
    if length is None:
        return
    angle = np.degrees(np.arctan2(*(way[1] - way[0])[::-1]))
    label = axes.text(
        *way.mean(0), f"{length:.2f} m", size=7, color=INK, ha="center", va="bottom",
        rotation=(angle + 90) % 180 - 90, rotation_mode="anchor", zorder=16,
        path_effects=[withStroke(linewidth=2, foreground="white")],
    )  # fmt: skip
    box = label.get_window_extent(axes.figure.canvas.get_renderer())
    on_paper = np.ptp(axes.transData.transform(way), axis=0)
    if np.hypot(*on_paper) < 2.2 * max(box.width, box.height):
        label.remove()  # a way as short as this lies under the robot
