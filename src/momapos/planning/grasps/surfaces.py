"""Make tool poses on surfaces: points spread over one, or lanes over a face, to and fro.

A face is the plane with the largest area among the surfaces that look in one direction. Lanes run
along its shorter side, so that a stop serves a piece of the longer one, and end half a tool's width
from the edges.
"""

from __future__ import annotations

from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError, expect, finite_number, unknown_name
from momapos.core.geometry import apply, halton, invert, orthonormal
from momapos.model.records import ToolPath, ToolPose
from momapos.model.robots import Robot
from momapos.model.scene import Scene, SceneObject, link_named

from .handles import opening_direction

if TYPE_CHECKING:
    from jaxtyping import Float

FACES = {
    "top": (2, 1.0), "bottom": (2, -1.0), "x": (0, 1.0), "-x": (0, -1.0), "y": (1, 1.0),
    "-y": (1, -1.0),
}  # fmt: skip
"""Names of faces by the axis of the object to which they are normal, and its side."""
MAX_TILT = np.radians(10.0)
"""Largest angle between a face's triangles and its direction [rad]; rounded edges are left out."""
MAX_TURN = np.radians(45.0)
"""Largest angle between a front and the way in which its middle opens [rad]."""
SAME_PLANE = 0.005
"""Triangles belong to one plane within this [m]."""
SAMPLE = 0.01
"""Distance of the points at which a lane is looked at [m]."""
BREAK = 0.3
"""Longest stretch of a lane without a break [m]; arms reach over two or more."""
GAP = 0.002
"""Distance of the tool from the face [m], less than what checks tolerate as contact."""
MIN_WIDTH = 0.005
"""Least distance of lanes, and of points [m]."""
MIN_AREA = 1e-10
"""Triangles below this area have no direction [m^2]."""
MAX_POINTS = 2_000
"""Largest number of points on a surface, as of poses in a file [-]."""


def wipe_path(
    scene: Scene, robot: Robot, face: str, tool_width: float, *, tool_length: float = 0.0
) -> ToolPath:
    """Return a path of lanes over a face, with the hand toward it and free to turn about that.

    Args:
        scene: The scene.
        robot: The robot, whose hand's tip follows the lanes.
        face: An object or a part of it, and a face: table/top, fridge/door/front. Faces are top,
            bottom, x, -x, y and -y in the object's frame, and front of a part that opens.
        tool_width: Distance of the lanes [m].
        tool_length: How far what the hand holds stands out beyond its tip [m].

    Raises:
        InputError: The face is none, or smaller than the tool.
        UnknownNameError: There is no such object or part.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    expect("robot", robot, Robot, "load_robot reads one")
    expect("face", face, str)
    width = finite_number("tool_width", tool_width, MIN_WIDTH)
    length = finite_number("tool_length", tool_length, 0.0)
    name, _, rest = face.partition("/")
    part, _, side = rest.rpartition("/")
    item = scene.object(name)
    if not name or not side:
        raise InputError(f"{face!r} names no face; write OBJECT/FACE, such as table/top")
    links = surface_links(item, part)
    normal = _direction(item, links, part, side)
    region = _plane(item, links, normal, face)
    R = _axes(item, normal, region)
    lanes = _lanes(region @ R, width, face)
    tip = _tip(robot) + length + GAP
    rotation = _hand_rotation(robot, normal, R[:, 0])
    points = lanes @ R.T + tip * normal
    poses = tuple(
        ToolPose(
            (x, y, z), rotation, f"point {k}", axis=_axis(robot), spin=np.pi, contact=item.name
        )
        for k, (x, y, z) in enumerate(points.tolist(), 1)
    )
    return ToolPath(poses, tuple(range(1, len(poses) - 1)))


def surface_poses(
    scene: Scene,
    robot: Robot,
    surface: str,
    spacing: float,
    *,
    cone: float = 0.0,
    standoff: float = 0.0,
) -> tuple[ToolPose, ...]:
    """Return tool poses spread evenly over a surface, with the hand toward it and free to turn.

    Args:
        scene: The scene.
        robot: The robot, whose hand's tip is at the points.
        surface: An object, or a part of it as OBJECT/PART.
        spacing: Mean distance of neighboring points [m].
        cone: Angle by which the hand may lean [rad].
        standoff: Distance of the hand's tip from the surface [m].

    Raises:
        InputError: A number is out of range, or there are more than `MAX_POINTS` points.
        UnknownNameError: There is no such object or part.
    """
    expect("scene", scene, Scene, "load_scene reads one")
    expect("robot", robot, Robot, "load_robot reads one")
    expect("surface", surface, str)
    spacing = finite_number("spacing", spacing, MIN_WIDTH)
    lean = finite_number("cone", cone, 0.0, np.pi / 2)
    away = _tip(robot) + finite_number("standoff", standoff, 0.0) + GAP
    name, _, part = surface.partition("/")
    item = scene.object(name)
    triangles = _surface(item, surface_links(item, part))
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1) / 2
    count = max(1, round(float(area.sum()) / spacing**2))
    if count > MAX_POINTS:
        least = spacing * np.sqrt(count / MAX_POINTS)
        raise InputError(
            f"{surface} has {count:,} points {100 * spacing:g} cm apart; at most {MAX_POINTS:,} "
            f"are looked at, so a spacing of {100 * least:.1f} cm or more"
        )
    share, u, v = halton(count, 3).T
    passed = np.cumsum(area)
    chosen = np.minimum(np.searchsorted(passed, share * passed[-1], side="right"), len(area) - 1)
    root = np.sqrt(u)
    weights = np.stack([1 - root, root * (1 - v), root * v], axis=1)
    points = np.einsum("nk,nki->ni", weights, triangles[chosen])
    normals = cross[chosen] / (2 * area[chosen, None])
    poses = []
    for k, (point, normal) in enumerate(zip(points, normals, strict=True), 1):
        x, y, z = (point + away * normal).tolist()
        rotation = _hand_rotation(robot, normal, orthonormal(normal))
        poses.append(ToolPose(
            (x, y, z), rotation, f"point {k}", axis=_axis(robot), spin=np.pi, cone=lean,
            contact=item.name,
        ))  # fmt: skip
    return tuple(poses)


def surface_links(item: SceneObject, part: str) -> tuple[str, ...]:
    """Return the links of an object, one by its name, or all that a joint moves."""
    if part in item.model.joints:
        return tuple(item.model.moved_by(part))
    return (link_named(item, part),) if part else item.model.links


def _direction(
    item: SceneObject, links: tuple[str, ...], part: str, side: str
) -> Float[np.ndarray, "3"]:
    """Return the direction in which a face looks, in the world."""
    moves = [j.name for j in item.model.joints.values() if part in (j.name, j.child)]
    if side == "front" and moves:
        # Where a hinge is behind the leaf, its middle does not move straight out of it.
        forward = opening_direction(item, moves[0])[1]
        return _main_normal(_surface(item, links), forward)
    if side not in FACES:
        raise unknown_name("face", side, [*FACES, *(["front"] if moves else [])], item.name)
    axis, sign = FACES[side]
    return np.asarray(sign * item.T_world_object[:3, axis])


def _main_normal(
    triangles: Float[np.ndarray, "t 3 3"], forward: Float[np.ndarray, "3"]
) -> Float[np.ndarray, "3"]:
    """Return the normal with the largest area among those near a direction, else that direction."""
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    length = np.linalg.norm(cross, axis=1, keepdims=True)
    unit = forward / np.linalg.norm(forward)
    near = (cross @ unit) > np.cos(MAX_TURN) * length[:, 0]
    if not near.any():
        return np.asarray(unit)
    normals, which = np.unique(np.round(cross[near] / length[near], 3), axis=0, return_inverse=True)
    best = normals[np.bincount(which.ravel(), length[near, 0]).argmax()]
    return np.asarray(best / np.linalg.norm(best))


def _surface(item: SceneObject, links: tuple[str, ...]) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles with an area of some links, in the world."""
    poses = item.link_poses()
    found = [
        apply(poses[link], item.model.surface(link).reshape(-1, 3)).reshape(-1, 3, 3)
        for link in links
    ]
    every = np.concatenate([np.zeros((0, 3, 3)), *found])
    cross = np.cross(every[:, 1] - every[:, 0], every[:, 2] - every[:, 0])
    return np.asarray(every[np.linalg.norm(cross, axis=1) > MIN_AREA])


def _plane(
    item: SceneObject, links: tuple[str, ...], normal: Float[np.ndarray, "3"], face: str
) -> Float[np.ndarray, "t 3 3"]:
    """Return the triangles of the largest plane that looks in a direction, in the world."""
    triangles = _surface(item, links)
    cross = np.cross(triangles[:, 1] - triangles[:, 0], triangles[:, 2] - triangles[:, 0])
    area = np.linalg.norm(cross, axis=1) / 2
    looks = cross @ normal > 2 * area * np.cos(MAX_TILT)
    triangles, area = triangles[looks], area[looks]
    if not len(triangles):
        raise InputError(f"{face} has no flat surface that looks that way")
    height = triangles.mean(1) @ normal
    near = np.abs(height[:, None] - height) <= SAME_PLANE if len(height) <= 4_000 else None
    if near is None:
        number = np.round(height / SAME_PLANE).astype(int)
        best = np.argmax(np.bincount(number - number.min(), area)) + number.min()
        return triangles[np.abs(number - best) <= 1]
    return np.asarray(triangles[near[int((near @ area).argmax())]])


def _axes(
    item: SceneObject, normal: Float[np.ndarray, "3"], region: Float[np.ndarray, "t 3 3"]
) -> Float[np.ndarray, "3 3"]:
    """Return axes of a face as columns: along the lanes, across them, and out of it."""
    around = item.T_world_object[:3, :3].T
    sides = sorted(around, key=lambda axis: abs(float(axis @ normal)))[:2]
    first = sides[0] - (sides[0] @ normal) * normal
    first /= np.linalg.norm(first)
    other = np.cross(normal, first)
    extent = np.ptp(region.reshape(-1, 3) @ np.stack([first, other], 1), axis=0)
    if extent[0] > extent[1]:
        first, other = other, -first
    return np.stack([first, other, normal], axis=1)


def _lanes(region: Float[np.ndarray, "t 3 3"], width: float, face: str) -> Float[np.ndarray, "n 3"]:
    """Return points along the lanes in the axes of a face, in their order."""
    low, high = region[..., 1].min(), region[..., 1].max()
    if high - low < width - 1e-9:
        raise InputError(
            f"{face} is {100 * (high - low):.1f} cm wide, less than the tool of "
            f"{100 * width:.1f} cm"
        )
    count = int(np.ceil((high - low - width) / width - 1e-9)) + 1
    height = float(np.median(region[..., 2]))
    points: list[Float[np.ndarray, "k 3"]] = []
    for v in np.linspace(low + width / 2, high - width / 2, count).tolist():
        ends = _inside(region[..., :2], v)
        if ends is None or ends[1] - ends[0] < width - 1e-9:
            continue
        begin, end = ends[0] + width / 2, ends[1] - width / 2
        cuts = max(1, int(np.ceil((end - begin) / BREAK - 1e-9)))
        u = np.linspace(begin, end, cuts + 1)
        if len(points) % 2:
            u = u[::-1]
        points.append(np.column_stack([u, np.full(len(u), v), np.full(len(u), height)]))
    lanes = np.concatenate([np.zeros((0, 3)), *points])
    kept = np.append(True, np.linalg.norm(np.diff(lanes, axis=0), axis=1) > 1e-9)
    if len(lanes[kept]) < 2:
        raise InputError(f"{face} is smaller than the tool of {100 * width:.1f} cm")
    return np.asarray(lanes[kept])


def _inside(triangles: Float[np.ndarray, "t 3 2"], v: float) -> tuple[float, float] | None:
    """Return where a line across triangles enters the first and leaves the last; None without."""
    a, b = triangles, np.roll(triangles, -1, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        share = (v - a[..., 1]) / (b[..., 1] - a[..., 1])
    crossed = (share >= 0.0) & (share <= 1.0)
    u = (a[..., 0] + share * (b[..., 0] - a[..., 0]))[crossed]
    return (float(u.min()), float(u.max())) if len(u) else None


def _tip(robot: Robot) -> float:
    """Return how far the hand stands out from the tool's origin along its approach [m]."""
    poses = robot.model.link_poses({})
    back = invert(poses[robot.tool_link])
    points = [
        apply(back @ poses[link], hull.vertices) @ robot.approach_axis
        for link in robot.gripper_links or (robot.tool_link,)
        for hull in robot.model.hulls[link]
    ]
    return float(max((one.max() for one in points), default=0.0))


def _axis(robot: Robot) -> tuple[float, float, float]:
    x, y, z = robot.approach_axis.tolist()
    return x, y, z


def _hand_rotation(
    robot: Robot, normal: Float[np.ndarray, "3"], along: Float[np.ndarray, "3"]
) -> tuple[float, float, float, float]:
    """Return the rotation of a tool that approaches against a normal and closes along a lane."""
    from scipy.spatial.transform import Rotation

    own = np.stack([robot.approach_axis, robot.closing_axis], axis=1)
    own = np.column_stack([own, np.cross(own[:, 0], own[:, 1])])
    there = np.column_stack([-normal, along, np.cross(-normal, along)])
    w, x, y, z = Rotation.from_matrix(there @ own.T).as_quat(scalar_first=True).tolist()
    return w, x, y, z
