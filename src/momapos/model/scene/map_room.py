"""Make a floor and walls from a map of free and occupied cells.

The floor is the outline of the free region. What is not free inside that outline, and occupied
cells around it, become upright boxes.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import FileFormatError, resolved
from momapos.core.geometry import apply, signed_area
from momapos.model.scene.formats import MapGrid, find_inside, read_map

from .scene import Scene
from .scene_members import MAX_CORNERS
from .scene_object import WALL_HEIGHT, SceneObject

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

WALL_DEPTH = 0.3
"""Occupied cells farther than this from the floor are left out [m]."""
FURNITURE_MARGIN = 0.1
"""Cells at most this far from an object of the scene show the object; maps of rooms are that
accurate [m]."""
MAX_SEEN_BOTTOM = 1.0
"""Elements of objects above this height are not seen by the laser scanners of mobile bases [m]."""
MAX_BOXES = 1_500
"""Maximum number of boxes, of the 2,000 objects of a scene [-]."""
SIMPLIFY = 0.5
"""Largest distance of the floor's edges from the outline between free and other cells [cells]."""
_MAX_SIMPLIFY = 2.0
"""The same for an outline that would have too many corners otherwise [cells]."""
MIN_FLOOR = 0.25
"""Minimum area of a free region [m^2]."""


@dataclass(frozen=True, eq=False)
class MapRoom:
    """The floor and the walls of a map."""

    floor: Float[np.ndarray, "k 2"]
    walls: tuple[SceneObject, ...]
    notes: tuple[str, ...]


def read_map_scene(path: Path, root: Path | None) -> Scene:
    """Read a map as a room without furniture.

    Raises:
        FileFormatError: As for `read_map_room`.
    """
    room = read_map_room(path, resolved(root or path.parent))
    return Scene(path.stem, room.walls, path, floor_polygon=room.floor, warnings=room.notes)


def with_map(scene: Scene, name: str, root: Path) -> Scene:
    """Add the floor and the walls of a map to a scene; the scene's own floor wins.

    Args:
        scene: A scene that was read from a file.
        name: The map's YAML file, relative to that file.
        root: Folder that no path may leave.

    Raises:
        FileFormatError: The map is outside the root or missing, or as for `read_map_room`.
    """
    assert scene.path is not None
    path = find_inside(name, [scene.path.parent / name], root, scene.path)
    room = read_map_room(path, root, start=scene.start, objects=scene.objects)
    floor = room.floor if scene.floor_polygon is None else scene.floor_polygon
    return replace(
        scene,
        objects=(*scene.objects, *room.walls),
        floor_polygon=floor,
        warnings=(*scene.warnings, *room.notes),
    )


def read_map_room(
    path: Path,
    root: Path,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    objects: Sequence[SceneObject] = (),
) -> MapRoom:
    """Read a map as a floor and walls.

    Args:
        path: The map's YAML file.
        root: Folder that must contain the image.
        start: The robot's start, which decides for one of several free regions; the largest one
            without it.
        objects: Furniture. Cells of the map under it are floor.

    Raises:
        FileFormatError: The map is invalid, has no free region, or needs too many boxes.
    """
    grid = read_map(path, root)
    covered = _covered(grid, objects)
    region, notes = _region(grid, grid.free | covered, start, path)
    floor, rough = _outline(grid, region, path)
    inside = _filled(region)
    holes = inside & ~region
    away = _distance(region) * grid.resolution
    walls = grid.occupied & ~inside & ~covered & (away <= WALL_DEPTH)
    names = {item.name for item in objects}
    boxes = [
        _box(grid, rectangle, f"{kind}_{number}", names)
        for kind, needed in (("wall", walls), ("obstacle", holes))
        for number, rectangle in enumerate(_rectangles(needed, ~region & ~covered, path), 1)
    ]
    notes = [*grid.notes, *notes, *rough]
    if covered.any() and (hidden := int((grid.occupied & covered).sum())):
        notes.append(f"{path}: {hidden} occupied cells lie under objects of the scene")
    unknown = int((holes & ~grid.occupied & ~grid.free).sum())
    if unknown:
        notes.append(f"{path}: {unknown} unknown cells inside the floor are obstacles")
    return MapRoom(floor, tuple(boxes), tuple(notes))


def _region(
    grid: MapGrid,
    free: Bool[np.ndarray, "rows columns"],
    start: Float[np.ndarray, "3"] | None,
    path: Path,
) -> tuple[Bool[np.ndarray, "rows columns"], list[str]]:
    """Return the free region of the start, or the largest one."""
    from scipy import ndimage

    label, count = ndimage.label(free)
    sizes = np.bincount(label.ravel(), minlength=count + 1)
    sizes[0] = 0
    chosen, notes = int(np.argmax(sizes)), []
    if start is not None:
        column, row = np.floor(grid.to_cells(start[:2])).astype(int).tolist()
        on_map = 0 <= row < free.shape[0] and 0 <= column < free.shape[1]
        found = int(label[row, column]) if on_map else 0
        chosen = found or chosen
        if not found:
            notes.append(
                f"{path}: the start ({start[0]:.2f}, {start[1]:.2f}) is not on a free cell; the "
                "floor is the largest free region"
            )
    if count == 0 or sizes[chosen] * grid.resolution**2 < MIN_FLOOR:
        raise FileFormatError(
            f"{path}: the map has no free region of at least {MIN_FLOOR:g} m^2; check negate, "
            "mode and thresholds"
        )
    others = int((sizes * grid.resolution**2 >= MIN_FLOOR).sum()) - 1
    if others:
        notes.append(
            f"{path}: {others} other free region{'s are' if others > 1 else ' is'} not connected "
            "to the floor and left out"
        )
    return label == chosen, notes


def _filled(region: Bool[np.ndarray, "rows columns"]) -> Bool[np.ndarray, "rows columns"]:
    from scipy import ndimage

    # Holes that touch the outside at a corner are filled too, so the outline never touches itself.
    return np.asarray(ndimage.binary_fill_holes(region))


def _distance(region: Bool[np.ndarray, "rows columns"]) -> Float[np.ndarray, "rows columns"]:
    """Return the distance of each cell from a region [cells]."""
    from scipy import ndimage

    return np.asarray(ndimage.distance_transform_edt(~region))


# ------------------------------------------------------------------------------------ the furniture


def _covered(grid: MapGrid, objects: Sequence[SceneObject]) -> Bool[np.ndarray, "rows columns"]:
    """Return the cells that show objects of the scene."""
    covered = np.zeros(grid.free.shape, bool)
    for item in objects:
        for link, T in item.link_poses().items():
            for hull in item.model.hulls[link]:
                points = apply(T, hull.vertices)
                if points[:, 2].min() < MAX_SEEN_BOTTOM:
                    _cover(grid, points[:, :2], covered)
    return covered


def _cover(
    grid: MapGrid, points: Float[np.ndarray, "n 2"], covered: Bool[np.ndarray, "rows columns"]
) -> None:
    """Mark the cells whose center is near the convex hull of points."""
    from scipy.spatial import ConvexHull, QhullError

    xy, margin = grid.to_cells(points), FURNITURE_MARGIN / grid.resolution
    rows, columns = covered.shape
    size = np.array([columns, rows])
    low = np.clip(np.floor(xy.min(0) - margin).astype(int), 0, size)
    high = np.clip(np.ceil(xy.max(0) + margin).astype(int), 0, size)
    if (low >= high).any():
        return
    x, y = (np.arange(a, b) + 0.5 for a, b in zip(low, high, strict=True))
    centers = np.stack(np.meshgrid(x, y), -1)
    try:
        sides = ConvexHull(xy).equations
    except QhullError:  # a line; the rectangle around it
        sides = np.zeros((0, 3))
    near = (centers @ sides[:, :2].T + sides[:, 2] <= margin).all(-1)
    covered[low[1] : high[1], low[0] : high[0]] |= near


# -------------------------------------------------------------------------------------- the outline


def _outline(
    grid: MapGrid, region: Bool[np.ndarray, "rows columns"], path: Path
) -> tuple[Float[np.ndarray, "k 2"], list[str]]:
    """Return the outer edge of a region [m], simplified."""
    from contourpy import contour_generator

    # Between the centers of free and other cells: a slanted wall has no steps there.
    padded = np.pad(_filled(region), 1).astype(float)
    lines = contour_generator(z=padded).lines(0.5)
    closed = max(lines, key=lambda line: abs(signed_area(np.asarray(line)[:-1])))
    points = np.asarray(closed)[:-1] - 0.5
    tolerance, notes = SIMPLIFY, list[str]()
    corners = simplified(points, tolerance)
    while len(corners) > MAX_CORNERS and tolerance < _MAX_SIMPLIFY:
        tolerance += SIMPLIFY
        corners = simplified(points, tolerance)
        notes = [
            f"{path}: the floor's outline is simplified to within {tolerance:g} cells, since it "
            f"would have more than {MAX_CORNERS} corners"
        ]
    if len(corners) > MAX_CORNERS:
        raise FileFormatError(
            f"{path}: the outline of the free region has {len(corners)} corners; at most "
            f"{MAX_CORNERS} are supported; crop or clean the map"
        )
    world = grid.to_world(corners)
    return world if signed_area(world) > 0 else world[::-1].copy(), notes


def simplified(points: Float[np.ndarray, "n 2"], tolerance: float) -> Float[np.ndarray, "k 2"]:
    """Return some corners of a closed outline, from whose edges no left-out corner is farther.

    Source: Douglas and Peucker, 1973.
    """
    away = np.linalg.norm(points - points[0], axis=1)
    middle = int(np.argmax(away))
    ring = np.vstack([points, points[:1]])
    keep = np.zeros(len(ring), bool)
    keep[[0, middle, -1]] = True
    parts = [(0, middle), (middle, len(points))]
    while parts:
        first, last = parts.pop()
        if last - first < 2:
            continue
        far = _from_edge(ring[first + 1 : last], ring[first], ring[last])
        worst = int(np.argmax(far))
        if far[worst] > tolerance:
            middle = first + 1 + worst
            keep[middle] = True
            parts += [(first, middle), (middle, last)]
    return ring[:-1][keep[:-1]]


def _from_edge(
    points: Float[np.ndarray, "n 2"], a: Float[np.ndarray, "2"], b: Float[np.ndarray, "2"]
) -> Float[np.ndarray, " n"]:
    along = b - a
    length = float(along @ along)
    share = (
        np.clip((points - a) @ along / length, 0.0, 1.0) if length > 0 else np.zeros(len(points))
    )
    return np.asarray(np.linalg.norm(points - a - share[:, None] * along, axis=1))


# ---------------------------------------------------------------------------------------- the boxes


def _rectangles(
    needed: Bool[np.ndarray, "rows columns"],
    allowed: Bool[np.ndarray, "rows columns"],
    path: Path,
) -> list[tuple[int, int, int, int]]:
    """Cover cells by rectangles that may also contain other cells, each grown from a needed cell.

    Args:
        needed: Cells that must be covered.
        allowed: Cells that may be covered.
        path: The map, for messages.

    Returns:
        First and last row and column of each, the last ones excluded.
    """
    left, found = needed.copy(), list[tuple[int, int, int, int]]()
    # Counts of the rows, columns and cells before each, so that a strip is checked at once.
    bad = np.pad(np.cumsum(np.cumsum(~allowed, 0), 1), ((1, 0), (1, 0)))
    wanted = np.pad(np.cumsum(np.cumsum(needed, 0), 1), ((1, 0), (1, 0)))
    for cell in np.flatnonzero(needed):
        i, j = divmod(int(cell), needed.shape[1])
        if not left[i, j]:
            continue
        if len(found) == MAX_BOXES:
            raise FileFormatError(
                f"{path}: the walls need more than {MAX_BOXES} boxes; crop or clean the map, or "
                "use larger cells"
            )
        one = max(
            (_grown((i, j), order, bad, wanted) for order in ("rows", "columns")),
            key=lambda r: int(left[r[0] : r[1], r[2] : r[3]].sum()),
        )
        left[one[0] : one[1], one[2] : one[3]] = False
        found.append(one)
    return found


def _grown(
    cell: tuple[int, int],
    order: str,
    bad: Int[np.ndarray, "rows_1 columns_1"],
    wanted: Int[np.ndarray, "rows_1 columns_1"],
) -> tuple[int, int, int, int]:
    """Grow a rectangle by strips of allowed cells of which one is needed, along one axis first."""
    r = [cell[0], cell[0] + 1, cell[1], cell[1] + 1]
    size = [bad.shape[0] - 1, bad.shape[1] - 1]

    def count(table: Int[np.ndarray, "rows_1 columns_1"], a: int, b: int, c: int, d: int) -> int:
        return int(table[b, d] - table[a, d] - table[b, c] + table[a, c])

    for axis in (0, 1) if order == "rows" else (1, 0):
        for end, step in ((1, 1), (0, -1)):
            while True:
                strip = list(r)
                edge = r[2 * axis + end]
                strip[2 * axis], strip[2 * axis + 1] = (edge, edge + 1) if end else (edge - 1, edge)
                inside = strip[2 * axis] >= 0 and strip[2 * axis + 1] <= size[axis]
                if not inside or count(bad, *strip) or not count(wanted, *strip):
                    break
                r[2 * axis + end] += step
    return r[0], r[1], r[2], r[3]


def _box(
    grid: MapGrid, rectangle: tuple[int, int, int, int], name: str, taken: set[str]
) -> SceneObject:
    i0, i1, j0, j1 = rectangle
    while name in taken:
        name = f"map_{name}"
    x, y = grid.to_world(np.array([(j0 + j1) / 2, (i0 + i1) / 2])).tolist()
    size = ((j1 - j0) * grid.resolution, (i1 - i0) * grid.resolution, WALL_HEIGHT)
    yaw = float(grid.origin[2])
    category = name.rpartition("_")[0]
    return SceneObject.box(name, size, (x, y, WALL_HEIGHT / 2), yaw=yaw, category=category)
