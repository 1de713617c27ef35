"""What stages have found out, drawn over the room: one function a layer.

A layer is a name under which its nodes hang, so that it is switched on and off as one. What it
shows is computed by the modules of `momapos.apps.plots` and of the stages; here it becomes nodes.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps.plots import (
    COLORS,
    DARK,
    GOOD,
    HANDLE,
    INK,
    KINDS,
    PALE,
    POTENTIAL,
    RELATIONS,
    SELECTED,
    SOFT_INK,
    WAYPOINT,
    Heat,
    outcomes,
    room_bounds,
    thin,
    waypoints_by_hold,
)
from momapos.core.geometry import apply, place_points, pose_planar
from momapos.model.records import Tolerance
from momapos.model.scene import Scene
from momapos.model.urdf import Boxes
from momapos.planning import OpeningMap, PlacementResult
from momapos.planning.importance import KINDS as RELATION_KINDS
from momapos.planning.importance import Importance
from momapos.planning.placement import BaseStatus, PlacementGeometry, base_pose_status

from .room_view import rgb

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from viser import SceneApi

FLOOR_IMAGE = 0.004
"""Pictures lie so high above the floor [m]."""
CRISP = 8
"""Browsers blur pictures; with so many pixels along the edge of a cell its border is seen [-]."""
LIT = 0.45
"""What lies on the floor is lit so strongly that it is drawn so much darker, to look as in the
legend [-]."""
POINTS = 1200
"""Candidates that are drawn at most [-]."""
MARK = 0.11
"""Edge of a candidate's mark [m]."""
LOWEST, ABOVE = 0.015, 0.001
"""Height of the mark of the worst candidate, and how much higher each better kind lies [m]."""
CIRCLE = np.stack([f(2 * np.pi / 48 * np.arange(48)) for f in (np.cos, np.sin)], -1)
"""Corners of a circle of radius 1 [-]."""
TURNS = 9
"""So many yaws are drawn of all that a base may have [-]."""
_EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7),
          (6, 7))  # fmt: skip
_CORNERS = np.array(np.meshgrid([-1, 1], [-1, 1], [-1, 1])).reshape(3, -1).T


def floor_image(
    api: SceneApi,
    name: str,
    pixels: UInt8[np.ndarray, "rows columns 4"],
    extent: tuple[float, float, float, float],
    height: float = FLOOR_IMAGE,
) -> Any:
    """Lay a picture on the floor; its first row is the one with the lowest y.

    Args:
        api: Where to draw.
        name: Of the node.
        pixels: Colors with opacity.
        extent: Left, right, bottom, top [m].
        height: Above the floor [m].
    """
    left, right, bottom, top = extent
    crisp = pixels.repeat(CRISP, 0).repeat(CRISP, 1)
    return api.add_image(
        name, crisp, right - left, top - bottom, format="png",
        position=((left + right) / 2, (bottom + top) / 2, height), cast_shadow=False,
        receive_shadow=False,
    )  # fmt: skip


def potential_pixels(heat: Heat) -> UInt8[np.ndarray, "rows columns 4"]:
    """The potential as colors from pale to strong blue; nothing where it is 0."""
    highest = float(heat.value.max(initial=0.0)) or 1.0
    stops = np.array([rgb(color) for color in POTENTIAL], float)
    share = heat.value / highest
    channels = [np.interp(share, np.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)]
    alpha = np.where(heat.value > 0, 215.0, 0.0)
    return np.stack([*channels, alpha], -1).astype(np.uint8)


def free_pixels(share: Float[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns 4"]:
    """The free area: the stronger, the more ways the base may look there."""
    color = np.broadcast_to(np.array(rgb(SELECTED), float), (*share.shape, 3))
    return np.concatenate([color, 150.0 * share[..., None]], -1).astype(np.uint8)


def free_area(
    geometry: PlacementGeometry, bounds: Float[np.ndarray, "2 2"], *, cell: float, yaws: int = 8
) -> tuple[Float[np.ndarray, "rows columns"], tuple[float, float, float, float]]:
    """Share of yaws at which the base stands clear and within the arm's length, over the floor.

    Args:
        geometry: Room and task.
        bounds: Lower and upper corner of what is looked at [m].
        cell: Edge of a cell [m].
        yaws: How many are tried [-].

    Returns:
        The shares, and left, right, bottom, top of the grid [m].
    """
    low = np.floor(bounds[0] / cell) * cell
    columns, rows = np.ceil((bounds[1] - low) / cell).astype(int).tolist()
    x, y = (low[k] + cell * (np.arange((columns, rows)[k]) + 0.5) for k in (0, 1))
    xy = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
    yaw = 2 * np.pi / yaws * np.arange(yaws)
    poses = np.column_stack([np.repeat(xy, yaws, axis=0), np.tile(yaw, len(xy))])
    clear = base_pose_status(geometry, poses)[0] == BaseStatus.CLEAR
    extent = (low[0], low[0] + columns * cell, low[1], low[1] + rows * cell)
    return clear.reshape(rows, columns, yaws).mean(-1), extent


def opening_pixels(opening: OpeningMap) -> UInt8[np.ndarray, "rows columns 4"]:
    """An opening map in the colors of its picture: the darker, the farther."""
    from matplotlib import colormaps

    span = opening.values[-1] - opening.begin
    share = np.nan_to_num((opening.farthest - opening.begin) / (span or 1.0))
    colors = colormaps["viridis"](0.97 - 0.89 * np.clip(share, 0, 1))
    colors[..., 3] = np.where(np.isnan(opening.farthest), 0.0, 0.85)
    return (255 * colors).astype(np.uint8)


def draw_candidates(
    api: SceneApi, name: str, answer: PlacementResult, picked: Callable[[str], None]
) -> tuple[str, ...]:
    """Draw where the base was tried, in the color of what came of it; a click tells why.

    Returns:
        The kinds that are drawn.
    """
    seen = outcomes(answer.search)
    every = [outcome for block in answer.search.outcomes for outcome in block]
    chosen = thin(seen.poses[:, :2], seen.kind, POINTS)
    places = np.concatenate([np.zeros((0, 3)), *answer.search.poses])
    texts = {pose.tobytes(): str(outcome) for pose, outcome in zip(places, every, strict=True)}
    words = [texts[pose.tobytes()] for pose in seen.poses[chosen]]
    height = LOWEST + ABOVE * seen.kind[chosen]  # the best are seen over the others
    positions = np.column_stack([seen.poses[chosen, :2], height])
    own = np.array([rgb(KINDS[k].color) for k in seen.kind[chosen]], float).reshape(-1, 3)
    colors = (LIT * own).astype(np.uint8)
    scales = np.array([MARK * (1.8 if KINDS[k].filled else 1.0) for k in seen.kind[chosen]])
    # An arrowhead that lies on the floor and points where the base looks.
    head = np.array([[0.7, 0, 0], [-0.5, 0.45, 0], [-0.25, 0, 0], [-0.5, -0.45, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    turns = np.zeros((len(chosen), 4))
    turns[:, 0], turns[:, 3] = (f(seen.poses[chosen, 2] / 2) for f in (np.cos, np.sin))
    node = api.add_batched_meshes_simple(
        name, head.astype(np.float32), faces.astype(np.uint32), turns, positions,
        batched_scales=scales, batched_colors=colors, cast_shadow=False,
        receive_shadow=False, lod="off", side="double",
        material="toon3",  # which shines not, and so is not pale
    )  # fmt: skip

    def clicked(event: Any) -> None:
        if event.instance_index is not None:
            picked(words[event.instance_index])

    node.on_click(clicked)
    return tuple(KINDS[k].name for k in sorted(set(seen.kind[chosen].tolist())))


def draw_waypoints(api: SceneApi, name: str, answer: PlacementResult) -> None:
    """Draw where the tool goes, and from where each grasp comes to the handle."""
    for k, points in enumerate(waypoints_by_hold(answer)):
        if len(points) > 1:
            api.add_line_segments(
                f"{name}/way{k}", np.stack([points[:-1], points[1:]], 1), rgb(WAYPOINT),
                thickness=0.008,
            )  # fmt: skip
        api.add_point_cloud(
            f"{name}/points{k}", points, rgb(WAYPOINT), point_size=0.022, point_shape="circle",
            precision="float32",
        )  # fmt: skip
    motion, robot = answer.prepared.motion, answer.prepared.robot
    Ts = motion.Ts_world_tool[:, motion.grasp_step]
    tails = Ts[:, :3, 3] - 0.1 * Ts[:, :3, :3] @ robot.approach_axis
    if len(Ts):
        segments = np.stack([tails, Ts[:, :3, 3]], 1)
        api.add_line_segments(f"{name}/grasps", segments, rgb(HANDLE), thickness=0.003)


def draw_way(api: SceneApi, name: str, answer: PlacementResult) -> None:
    """Draw the start, and the way that the base drives."""
    footprint = answer.prepared.robot.footprint
    corners = np.column_stack([footprint, np.full(len(footprint), 0.008)])
    outline = apply(pose_planar(answer.start), corners)
    api.add_line_segments(
        f"{name}/start", np.stack([outline, np.roll(outline, -1, 0)], 1), rgb(SOFT_INK),
        thickness=0.012,
    )  # fmt: skip
    if answer.plan.base_path is not None:
        draw_path(api, f"{name}/way", answer.plan.base_path)


def draw_tolerance(
    api: SceneApi,
    name: str,
    footprint: Float[np.ndarray, "k 2"],
    base: Float[np.ndarray, "3"],
    found: Tolerance,
) -> None:
    """Draw the disc in which the base may stand, and all that its footprint covers from there.

    Args:
        api: Where to draw.
        name: Of the node.
        footprint: Corners of the base in its frame [m].
        base: x [m], y [m], yaw [rad].
        found: How far beside it the base may stand.
    """
    rings = {"disc": base[:2] + found.radius * CIRCLE, "cover": covered(footprint, base, found)}
    for part, ring in rings.items():
        corners = np.column_stack([ring, np.full(len(ring), 0.009)])
        api.add_line_segments(
            f"{name}/{part}", np.stack([corners, np.roll(corners, -1, 0)], 1), rgb(GOOD),
            thickness=0.012,
        )  # fmt: skip


def covered(
    footprint: Float[np.ndarray, "k 2"], base: Float[np.ndarray, "3"], found: Tolerance
) -> Float[np.ndarray, "m 2"]:
    """Hull of what a footprint covers wherever the base stands within a tolerance [m].

    Args:
        footprint: Corners of the base in its frame [m].
        base: x [m], y [m], yaw [rad].
        found: How far beside it the base may stand.
    """
    from scipy.spatial import ConvexHull

    turns = np.zeros((TURNS, 3))
    turns[:, 2] = np.linspace(-found.turn, found.turn, TURNS)
    corners = place_points(turns, footprint).reshape(-1, 1, 2)
    every = (corners + found.radius * CIRCLE).reshape(-1, 2)
    return place_points(base[None], every[ConvexHull(every).vertices])[0]


def draw_path(api: SceneApi, name: str, path: Float[np.ndarray, "k 3"]) -> None:
    """Draw the way that a base drives: x [m], y [m], yaw [rad]."""
    if len(path) > 1:
        points = np.column_stack([path[:, :2], np.full(len(path), 0.01)])
        segments = np.stack([points[:-1], points[1:]], 1)
        api.add_line_segments(name, segments, rgb(INK), thickness=0.016)


def draw_importance(api: SceneApi, name: str, ranked: Importance) -> None:
    """Draw the upright boxes, the stronger the more they matter, and the relations between them."""
    graph = ranked.graph
    score = np.array([ranked.score(n) for n in graph.names])
    edges = box_edges(graph.upright)
    pale, strong = np.array(rgb("#c3cad0"), float), np.array(rgb(SELECTED), float)
    colors = pale + score[:, None] * (strong - pale)
    api.add_line_segments(
        f"{name}/boxes", edges.reshape(-1, 2, 3),
        np.repeat(colors, 12, 0)[:, None].repeat(2, 1).astype(np.uint8), thickness=0.008,
    )  # fmt: skip
    centers = graph.upright.center
    for index, kind in enumerate(RELATION_KINDS):
        mine = graph.kind == index
        if mine.any():
            lines = np.stack([centers[graph.child[mine]], centers[graph.parent[mine]]], 1)
            look = RELATIONS[kind]
            api.add_line_segments(
                f"{name}/{kind}", lines, rgb(look.color), thickness=0.006 * look.width
            )


def box_edges(boxes: Boxes) -> Float[np.ndarray, "b 12 2 3"]:
    """The edges of boxes [m]."""
    scaled = _CORNERS[None] * boxes.half[:, None]
    corners = np.einsum("bij,bcj->bci", boxes.rotation, scaled) + boxes.center[:, None]
    return corners[:, np.array(_EDGES)]


def reach_pixels(share: Float[np.ndarray, "n n"]) -> UInt8[np.ndarray, "n n 4"]:
    """A slice of the reachability as colors: the darker, the more directions."""
    from matplotlib import colormaps

    colors = colormaps[COLORS](PALE - (PALE - DARK) * share)
    colors[..., 3] = np.where(share > 0, 0.75, 0.0)
    return (255 * colors).astype(np.uint8)


def whole_floor(scene: Scene) -> Float[np.ndarray, "2 2"]:
    """Lower and upper corner of the floor of a room [m]."""
    if scene.floor_polygon is None:
        return room_bounds(scene)
    return np.stack([scene.floor_polygon.min(0), scene.floor_polygon.max(0)])
