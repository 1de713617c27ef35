"""Drawing the results of the stages over the room: one function for each layer.

The nodes of a layer have one parent node, which shows and hides them together. Their content is
computed by `momapos.apps.plots` and by the stages.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from momapos.apps import plots
from momapos.core.geometry import apply, place_points, pose_planar
from momapos.model.records import Tolerance
from momapos.model.scene import Scene
from momapos.model.urdf import Boxes
from momapos.planning import OpeningMap, PlacementResult
from momapos.planning.importance import KINDS, Importance
from momapos.planning.placement import BaseStatus, PlacementGeometry, base_pose_status

from . import colors
from .colors import rgb

if TYPE_CHECKING:
    from jaxtyping import Float, UInt8
    from viser import SceneApi

PIXELS_PER_CELL = 8
"""Pixels along the edge of a cell: browsers blur images, which would hide the borders [-]."""
FLOOR_SHADE = 0.45
"""Factor for colors of markers on the floor; its strong light would make them paler than in the
legend [-]."""
MAX_CANDIDATES = 1200
"""Maximum number of candidates drawn [-]."""
MARKER_SIZE = 0.11
"""Size of a candidate's marker [m]."""
MARKER_HEIGHT, MARKER_STEP = 0.015, 0.001
"""Height of the markers of the worst kind, and the step to each better kind [m]."""
CIRCLE = np.stack([f(2 * np.pi / 48 * np.arange(48)) for f in (np.cos, np.sin)], -1)
"""Corners of a circle of radius 1 [-]."""
REACH = "plasma"
"""Color map of the reachability; the opening map has another one."""
TOLERANCE_YAWS = 9
"""Yaws for which the footprint within a tolerance is drawn [-]."""
_EDGES = ((0, 1), (0, 2), (0, 4), (1, 3), (1, 5), (2, 3), (2, 6), (3, 7), (4, 5), (4, 6), (5, 7),
          (6, 7))  # fmt: skip


def floor_image(
    api: SceneApi,
    name: str,
    pixels: UInt8[np.ndarray, "rows columns 4"],
    extent: tuple[float, float, float, float],
    height: float,
) -> Any:
    """Draw an image on the floor; its first row has the lowest y.

    Args:
        api: Where to draw.
        name: Name of the node.
        pixels: Colors with opacity.
        extent: Left, right, bottom, top [m].
        height: Height above the floor [m].
    """
    left, right, bottom, top = extent
    enlarged = pixels.repeat(PIXELS_PER_CELL, 0).repeat(PIXELS_PER_CELL, 1)
    return api.add_image(
        name, enlarged, right - left, top - bottom, format="png",
        position=((left + right) / 2, (bottom + top) / 2, height), cast_shadow=False,
        receive_shadow=False,
    )  # fmt: skip


def potential_pixels(potential: plots.PotentialMap) -> UInt8[np.ndarray, "rows columns 4"]:
    """Color the potential from pale to strong blue; transparent where it is 0."""
    highest = float(potential.value.max(initial=0.0)) or 1.0
    stops = np.array([rgb(color) for color in plots.POTENTIAL], float)
    share = potential.value / highest
    channels = [np.interp(share, np.linspace(0, 1, len(stops)), stops[:, k]) for k in range(3)]
    alpha = np.where(potential.value > 0, 215.0, 0.0)
    return np.stack([*channels, alpha], -1).astype(np.uint8)


def free_pixels(share: Float[np.ndarray, "rows columns"]) -> UInt8[np.ndarray, "rows columns 4"]:
    """Color the free area: the opacity is the share of yaws at which the base stands clear."""
    color = np.broadcast_to(np.array(rgb(colors.FREE), float), (*share.shape, 3))
    return np.concatenate([color, 190.0 * share[..., None]], -1).astype(np.uint8)


def free_area(
    geometry: PlacementGeometry, bounds: Float[np.ndarray, "2 2"], *, cell: float, yaws: int = 8
) -> tuple[Float[np.ndarray, "rows columns"], tuple[float, float, float, float]]:
    """Compute the share of yaws at which the base stands clear and within the arm's length.

    Args:
        geometry: Room and task.
        bounds: Lower and upper corner of the area [m].
        cell: Edge of a cell [m].
        yaws: Number of yaws [-].

    Returns:
        The shares in [0, 1], and left, right, bottom, top of the grid [m].
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
    """Color an opening map as in its figure: the darker, the farther."""
    from matplotlib import colormaps

    span = opening.values[-1] - opening.begin
    share = np.nan_to_num((opening.farthest - opening.begin) / (span or 1.0))
    drawn = colormaps["viridis"](0.97 - 0.89 * np.clip(share, 0, 1))
    drawn[..., 3] = np.where(np.isnan(opening.farthest), 0.0, 0.85)
    return (255 * drawn).astype(np.uint8)


def draw_candidates(
    api: SceneApi, name: str, answer: PlacementResult, picked: Callable[[str], None]
) -> tuple[str, ...]:
    """Draw candidates as arrowheads colored by outcome; `picked` gets the outcome of a click.

    Returns:
        The kinds of outcome that are drawn.
    """
    seen = plots.outcomes(answer.search)
    every = [outcome for block in answer.search.outcomes for outcome in block]
    chosen = plots.thin(seen.poses[:, :2], seen.kind, MAX_CANDIDATES)
    kinds = seen.kind[chosen]
    places = np.concatenate([np.zeros((0, 3)), *answer.search.poses])
    texts = {pose.tobytes(): str(outcome) for pose, outcome in zip(places, every, strict=True)}
    words = [texts[pose.tobytes()] for pose in seen.poses[chosen]]
    height = MARKER_HEIGHT + MARKER_STEP * kinds  # better outcomes cover worse ones
    positions = np.column_stack([seen.poses[chosen, :2], height])
    own = np.array([rgb(plots.KINDS[k].color) for k in kinds], float).reshape(-1, 3)
    shades = (FLOOR_SHADE * own).astype(np.uint8)
    scales = np.array([MARKER_SIZE * (1.8 if plots.KINDS[k].filled else 1.0) for k in kinds])
    # An arrowhead on the floor that points where the base faces.
    head = np.array([[0.7, 0, 0], [-0.5, 0.45, 0], [-0.25, 0, 0], [-0.5, -0.45, 0]])
    faces = np.array([[0, 1, 2], [0, 2, 3]])
    turns = np.zeros((len(chosen), 4))
    turns[:, 0], turns[:, 3] = (f(seen.poses[chosen, 2] / 2) for f in (np.cos, np.sin))
    node = api.add_batched_meshes_simple(
        name, head.astype(np.float32), faces.astype(np.uint32), turns, positions,
        batched_scales=scales, batched_colors=shades, cast_shadow=False,
        receive_shadow=False, lod="off", side="double",
        material="toon3",  # without highlights, which would make it paler
    )  # fmt: skip

    def clicked(event: Any) -> None:
        if event.instance_index is not None and event.instance_index < len(words):
            picked(words[event.instance_index])

    node.on_click(clicked)
    return tuple(plots.KINDS[k].name for k in sorted(set(kinds.tolist())))


def draw_waypoints(api: SceneApi, name: str, answer: PlacementResult) -> None:
    """Draw the path of the tool, and the approach direction of each grasp."""
    for k, points in enumerate(plots.waypoints_by_grasp(answer)):
        if len(points) > 1:
            api.add_line_segments(
                f"{name}/path{k}", np.stack([points[:-1], points[1:]], 1), rgb(colors.TOOL),
                thickness=0.008,
            )  # fmt: skip
        api.add_point_cloud(
            f"{name}/points{k}", points, rgb(colors.TOOL), point_size=0.022,
            point_shape="circle", precision="float32",
        )  # fmt: skip
    motion, robot = answer.prepared.motion, answer.prepared.robot
    Ts = motion.Ts_world_tool[:, motion.grasp_step]
    tails = Ts[:, :3, 3] - 0.1 * Ts[:, :3, :3] @ robot.approach_axis
    if len(Ts):
        segments = np.stack([tails, Ts[:, :3, 3]], 1)
        api.add_line_segments(f"{name}/grasps", segments, rgb(colors.TOOL), thickness=0.003)


def draw_start_and_path(api: SceneApi, name: str, answer: PlacementResult) -> None:
    """Draw the footprint at the start, and the path of the base."""
    footprint = answer.prepared.robot.footprint
    corners = np.column_stack([footprint, np.full(len(footprint), 0.008)])
    outline = apply(pose_planar(answer.start), corners)
    api.add_line_segments(
        f"{name}/start", np.stack([outline, np.roll(outline, -1, 0)], 1), rgb(colors.DRIVE),
        thickness=0.012,
    )  # fmt: skip
    if answer.plan.base_path is not None:
        draw_path(api, f"{name}/path", answer.plan.base_path)


def draw_tolerance(
    api: SceneApi,
    name: str,
    footprint: Float[np.ndarray, "k 2"],
    base: Float[np.ndarray, "3"],
    found: Tolerance,
) -> None:
    """Draw the disc in which the base may stand, and the area that its footprint may cover.

    Args:
        api: Where to draw.
        name: Name of the node.
        footprint: Corners of the base in its frame [m].
        base: x [m], y [m], yaw [rad].
        found: The tolerance of the base pose.
    """
    rings = {"disc": base[:2] + found.radius * CIRCLE, "cover": covered(footprint, base, found)}
    for part, ring in rings.items():
        corners = np.column_stack([ring, np.full(len(ring), 0.009)])
        api.add_line_segments(
            f"{name}/{part}", np.stack([corners, np.roll(corners, -1, 0)], 1), rgb(colors.FEASIBLE),
            thickness=0.012,
        )  # fmt: skip


def covered(
    footprint: Float[np.ndarray, "k 2"], base: Float[np.ndarray, "3"], found: Tolerance
) -> Float[np.ndarray, "m 2"]:
    """Return the hull of all points that a footprint may cover within a tolerance [m].

    Args:
        footprint: Corners of the base in its frame [m].
        base: x [m], y [m], yaw [rad].
        found: The tolerance of the base pose.
    """
    from scipy.spatial import ConvexHull

    turns = np.zeros((TOLERANCE_YAWS, 3))
    turns[:, 2] = np.linspace(-found.turn, found.turn, TOLERANCE_YAWS)
    corners = place_points(turns, footprint).reshape(-1, 1, 2)
    every = (corners + found.radius * CIRCLE).reshape(-1, 2)
    return place_points(base[None], every[ConvexHull(every).vertices])[0]


def draw_path(api: SceneApi, name: str, path: Float[np.ndarray, "k 3"]) -> None:
    """Draw the path of the base: x [m], y [m], yaw [rad]."""
    if len(path) > 1:
        points = np.column_stack([path[:, :2], np.full(len(path), 0.01)])
        segments = np.stack([points[:-1], points[1:]], 1)
        api.add_line_segments(name, segments, rgb(colors.DRIVE), thickness=0.016)


def draw_importance(api: SceneApi, name: str, ranked: Importance) -> None:
    """Draw the upright boxes in colors of their importance, and the relations between them."""
    graph = ranked.graph
    score = np.array([ranked.score(n) for n in graph.names])
    edges = box_edges(graph.upright)
    pale, strong = (np.array(rgb(color), float) for color in colors.IMPORTANCE)
    shades = pale + score[:, None] * (strong - pale)
    api.add_line_segments(
        f"{name}/boxes", edges.reshape(-1, 2, 3),
        np.repeat(shades, 12, 0)[:, None].repeat(2, 1).astype(np.uint8), thickness=0.014,
    )  # fmt: skip
    centers = graph.upright.center
    for index, kind in enumerate(KINDS):
        mine = graph.kind == index
        if mine.any():
            lines = np.stack([centers[graph.child[mine]], centers[graph.parent[mine]]], 1)
            look = plots.RELATIONS[kind]
            api.add_line_segments(
                f"{name}/{kind}", lines, rgb(look.color), thickness=0.012 * look.width
            )


def box_edges(boxes: Boxes) -> Float[np.ndarray, "b 12 2 3"]:
    """Return the edges of boxes [m]."""
    return plots.box_corners(boxes)[:, np.array(_EDGES)]


def reach_pixels(share: Float[np.ndarray, "n n"]) -> UInt8[np.ndarray, "n n 4"]:
    """Color a slice of the reachability: the darker, the more directions."""
    from matplotlib import colormaps

    drawn = colormaps[REACH](plots.PALE - (plots.PALE - plots.DARK) * share)
    drawn[..., 3] = np.where(share > 0, 0.75, 0.0)
    return (255 * drawn).astype(np.uint8)


def floor_bounds(scene: Scene) -> Float[np.ndarray, "2 2"]:
    """Return the lower and upper corner of a room's floor [m]."""
    if scene.floor_polygon is None:
        return plots.room_bounds(scene)
    return np.stack([scene.floor_polygon.min(0), scene.floor_polygon.max(0)])
