"""`momapos robot`: list, show, check and export robots."""

from __future__ import annotations

import json as json_format
import shutil
from importlib import resources
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from jaxtyping import Float

from momapos.errors import RobotError, unknown_name
from momapos.robots.derive import examine, write_robot
from momapos.robots.robot import Robot, library_names, load_robot

if TYPE_CHECKING:
    from matplotlib.axes import Axes

SOLVED = 0


def robot_list(*, json: bool = False) -> int:
    """List the robots that come with momapos.

    Args:
        json: Print one JSON object instead of a table.
    """
    robots = [load_robot(name) for name in library_names()]
    if json:
        facts = [{"name": r.name, "joints": r.chain.size, "drive": r.drive} for r in robots]
        print(json_format.dumps({"robots": facts}, indent=1))
        return SOLVED
    for robot in robots:
        print(f"{robot.name:14} {robot.chain.size} arm joints, {robot.drive} drive")
    print("Use a name as --robot, or a robot file; 'momapos robot check FILE.urdf' makes one.")
    return SOLVED


def robot_show(name: str, /, *, json: bool = False) -> int:
    """Show a robot: its joints, tool, footprint and how its arm is inverted.

    Args:
        name: Name of a robot in the library, or a robot file.
        json: Print one JSON object instead of text.
    """
    facts = describe(load_robot(name))
    print(json_format.dumps(facts, indent=1) if json else as_text(facts))
    return SOLVED


def robot_check(
    file: Path, /, *, out: Path | None = None, plot: Path | None = None, json: bool = False
) -> int:
    """Check a robot file, or derive one from a URDF alone.

    From a URDF, the base, the arm, the tool, a home state and the pairs of links that cannot help
    touching are guessed; every guess is printed, and the robot file is written for you to correct.

    Args:
        file: A robot file (TOML), or a URDF.
        out: The robot file to write; where not given, the URDF's name with .toml.
        plot: Draw the robot at home, with its collision spheres, into this PNG file.
        json: Print one JSON object instead of text.
    """
    guesses: tuple[str, ...] = ()
    if file.suffix.lower() in (".urdf", ".xml"):
        file, derived = write_robot(file, out)
        guesses = derived.assumptions
    elif out is not None:
        raise RobotError(f"--out is for a URDF; {file} is a robot file already")
    robot = load_robot(file)
    doubts = examine(robot)
    if plot is not None:
        draw_robot(robot, plot)
    facts = {
        **describe(robot), "written": bool(guesses), "assumptions": list(guesses),
        "doubts": doubts, "plot": None if plot is None else str(plot),
    }  # fmt: skip
    if json:
        print(json_format.dumps(facts, indent=1))
        return SOLVED
    print(as_text(facts))
    if guesses:
        print(f"\nwritten to {file}; what was assumed, please check:")
        print("\n".join(f"  - {text}" for text in guesses))
    if doubts:
        print("\nthis looks wrong:")
        print("\n".join(f"  - {text}" for text in doubts))
    if plot is not None:
        print(f"\ndrawn in {plot}")
    return SOLVED


def robot_export(name: str, dir: Path, /) -> int:
    """Copy a robot of the library into a folder, to start a robot of your own from.

    Args:
        name: Name of a robot in the library.
        dir: The folder; files in it are not overwritten.
    """
    if name not in library_names():
        raise unknown_name("robot", name, library_names(), "the library")
    source = Path(str(resources.files("momapos.robots") / "library" / name))
    files = [path for path in sorted(source.rglob("*")) if path.is_file()]
    taken = [path for path in files if (dir / path.relative_to(source)).exists()]
    if taken:
        raise RobotError(
            f"{dir / taken[0].relative_to(source)}: exists already; choose a new folder"
        )
    for path in files:
        target = dir / path.relative_to(source)
        try:
            target.parent.mkdir(parents=True, exist_ok=True)
            shutil.copyfile(path, target)
        except OSError as error:
            raise RobotError(f"{target}: cannot be written ({error.strerror})") from error
        print(target)
    return SOLVED


def describe(robot: Robot) -> dict[str, Any]:
    """What `robot show` tells, as plain values [m], [rad]."""
    chain, spheres = robot.chain, robot.spheres

    def finite(value: float) -> float | None:
        return float(value) if np.isfinite(value) else None

    joints = [
        {
            "name": name,
            "kind": "prismatic" if chain.prismatic[i] else "revolute",
            "lower": finite(chain.lower[i]),
            "upper": finite(chain.upper[i]),
            "home": float(robot.home[i]),
        }
        for i, name in enumerate(chain.names)
    ]
    return {
        "name": robot.name,
        "path": str(robot.path),
        "urdf": str(robot.model.urdf.path),
        "base_link": robot.base_link,
        "tool_link": robot.tool_link,
        "gripper_links": list(robot.gripper_links),
        "joints": joints,
        "reach": round(robot.reach, 3),
        "ik": robot.ik.name,
        "spheres": len(spheres.radius),
        "self_collision_pairs": len(spheres.pairs) + int(spheres.base_pairs.any(1).sum()),
        "pairs_never_checked": len(robot.disabled),
        "base_size": np.ptp(robot.footprint, axis=0).round(3).tolist(),
        "drive": robot.drive,
        "max_speed": robot.max_speed,
        "max_yaw_rate": robot.max_yaw_rate,
        "approach_axis": robot.approach_axis.tolist(),
        "closing_axis": robot.closing_axis.tolist(),
        "opening": robot.opening,
    }


def as_text(facts: dict[str, Any]) -> str:
    """The facts about a robot, for people."""
    length, width = facts["base_size"]
    lines = [
        f"{facts['name']} ({facts['path']})",
        f"  base      {facts['base_link']}, {length:.2f} x {width:.2f} m, {facts['drive']} drive, "
        f"{facts['max_speed']:g} m/s, {facts['max_yaw_rate']:g} rad/s",
        f"  tool      {facts['tool_link']}, opens {facts['opening']:.3f} m",
        f"  reach     at most {facts['reach']:.2f} m from the first turning joint",
        f"  inverse   {facts['ik']}",
        f"  collision {facts['spheres']} spheres, {facts['self_collision_pairs']} pairs checked, "
        f"{facts['pairs_never_checked']} never",
        "  joints",
    ]
    for joint in facts["joints"]:
        if joint["lower"] is None:
            span = "without end"
        else:
            span = f"{joint['lower']:.2f} to {joint['upper']:.2f}"
        unit = "m" if joint["kind"] == "prismatic" else "rad"
        lines.append(f"    {joint['name']:26} {span} {unit}, home {joint['home']:.2f}")
    return "\n".join(lines)


# ------------------------------------------------------------------------------------- the picture


def draw_robot(robot: Robot, path: Path) -> None:
    """Draw a robot at home from above and from its right, with its collision spheres."""
    from matplotlib.figure import Figure

    figure = Figure(figsize=(11, 6), layout="constrained")
    above, side = figure.subplots(1, 2)
    corners = np.vstack([robot.footprint, robot.footprint[:1]])
    above.plot(*corners.T, "k--", lw=1, label="footprint")
    side.axhline(0, color="0.5", lw=1)
    for axes, (i, j) in ((above, (0, 1)), (side, (0, 2))):
        _draw_view(robot, axes, i, j)
        axes.set(aspect="equal", xlabel=f"{'xyz'[i]} [m]", ylabel=f"{'xyz'[j]} [m]")
    above.set_title("from above")
    side.set_title("from the right")
    figure.suptitle(f"{robot.name} at home; orange: gripper, arrow: approach")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        figure.savefig(path, dpi=110, format="png")
    except OSError as error:
        raise RobotError(f"{path}: cannot be written ({error.strerror})") from error


def _draw_view(robot: Robot, axes: Axes, i: int, j: int) -> None:
    """Draw the projection onto two coordinates of the base frame."""
    from matplotlib.collections import PatchCollection
    from matplotlib.patches import Circle, Polygon
    from scipy.spatial import ConvexHull

    base = robot.base
    signs = np.stack(np.meshgrid([-1, 1], [-1, 1], [-1, 1]), -1).reshape(-1, 3)
    boxes = []
    for k in range(len(base)):
        points = (base.center[k] + (signs * base.half[k]) @ base.rotation[k].T)[:, [i, j]]
        boxes.append(Polygon(points[ConvexHull(points).vertices]))
    axes.add_collection(PatchCollection(boxes, facecolor="0.8", edgecolor="0.5", alpha=0.7))
    centers, held = sphere_centers(robot, robot.home)
    circles = [Circle((c[i], c[j]), r) for c, r in zip(centers, robot.spheres.radius, strict=True)]
    colours = np.where(held, "tab:orange", "tab:blue")
    axes.add_collection(PatchCollection(circles, facecolor=colours, edgecolor="none", alpha=0.25))
    T = robot.chain.tool_poses(robot.home[None])[0]
    tip = T[:3, 3] + 0.12 * T[:3, :3] @ robot.approach_axis
    axes.annotate("", tip[[i, j]], T[[i, j], 3], arrowprops={"arrowstyle": "->", "color": "k"})
    axes.autoscale_view()


def sphere_centers(
    robot: Robot, q: Float[np.ndarray, " n"]
) -> tuple[Float[np.ndarray, "s 3"], Float[np.ndarray, " s"]]:
    """Centres of the collision spheres in the base frame [m], and which are the gripper's."""
    from momapos.kinematics.chain import chain_arrays
    from momapos.kinematics.collision import place_segments

    chain, spheres = robot.chain, robot.spheres
    R, p = np.empty((chain.size + 1, 3, 3)), np.empty((chain.size + 1, 3))
    place_segments(np.asarray(q, float), np.zeros(3), chain_arrays(chain), R, p)
    count = np.diff(spheres.start)
    segment = np.repeat(spheres.segment, count)
    centers = np.einsum("sij,sj->si", R[segment], spheres.center) + p[segment]
    return centers, np.repeat(spheres.gripper, count)
