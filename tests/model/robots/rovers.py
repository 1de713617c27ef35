"""Arms on bases with wheels, as URDFs without a word about the drive in a name."""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path

from tests.urdf_parts import LIMIT, box, fixed_arm, joint, link

from momapos.model.robots.amended_urdf import Amendments
from momapos.model.robots.base_guess import DriveGuess, drive_of
from momapos.model.robots.derive import write_robot
from momapos.model.robots.robot import Robot, load_robot
from momapos.model.robots.running_gear import drawn_meshes, find_running_gear
from momapos.model.urdf.articulated import Articulated

DISC = '<cylinder radius="0.1" length="0.05"/>'
CORNERS = [(0.2, 0.2), (0.2, -0.2), (-0.2, 0.2), (-0.2, -0.2)]
FRONT, REAR = CORNERS[:2], CORNERS[2:]


@dataclass(frozen=True)
class Axle:
    """A wheel at a place, with the direction of its axle, and its steering."""

    xy: tuple[float, float]
    yaw: float = math.pi / 2
    """Direction of the axle; pi / 2 rolls along x [rad]."""
    steering: float | None = None
    """Largest steering angle [rad]; infinite for a joint without limits; None without steering."""
    trail: float = 0.0
    """Distance of the wheel behind its steering axis [m]."""
    name: str = "w"
    rollers: int = 0
    mesh: str = ""


def wheel(index: int, axle: Axle, root: str) -> str:
    """Return a wheel whose axis is z of its frame, drawn as a disc 10 cm above the floor."""
    name, (x, y) = f"{axle.name}{index}", axle.xy
    shape = link(name, DISC)
    if axle.mesh:
        visual = f'<visual><geometry><mesh filename="{axle.mesh}"/></geometry></visual>'
        shape = shape.replace("</link>", f"{visual}</link>")
    parts, parent, xyz = [shape], root, f"{x} {y} 0.1"
    if axle.steering is not None:
        kind = "continuous" if math.isinf(axle.steering) else "revolute"
        limit = "" if kind == "continuous" else LIMIT.format(-axle.steering, axle.steering)
        parts += [
            link(f"k{index}"),
            joint(f"t{index}", kind, root, f"k{index}", xyz, "0 0 1", limit),
        ]
        parent, xyz = f"k{index}", f"{-axle.trail} 0 0"
    # Roll by 90 degrees about x puts z of the wheel along y; the yaw turns it from there.
    turned = joint(f"{name}_spin", "continuous", parent, name, xyz, "0 0 1")
    turned = turned.replace("/><axis", f' rpy="{math.pi / 2} 0 {axle.yaw - math.pi / 2}"/><axis')
    parts.append(turned)
    for k in range(axle.rollers):
        angle = 2 * math.pi * k / axle.rollers
        place = f"{0.09 * math.cos(angle)} {0.09 * math.sin(angle)} 0"
        parts += [
            link(f"{name}_r{k}"),
            joint(f"{name}_p{k}", "continuous", name, f"{name}_r{k}", place, "1 0 1"),
        ]
    return "".join(parts)


def rover(axles: list[Axle], root: str = "chassis", more: str = "") -> str:
    """Return an arm on a base with wheels, without a word about the drive in a name."""
    text = fixed_arm().replace(
        '<link name="plate">', f'{link(root, box(0.6, 0.5, 0.3), "0 0 0.25")}<link name="plate">', 1
    )
    wheels = "".join(wheel(index, axle, root) for index, axle in enumerate(axles))
    mount = joint("bolts", "fixed", root, "plate", "0 0 0.42")
    return text.replace("</robot>", f"{mount}{wheels}{more}</robot>")


def guess_of(folder: Path, text: str) -> DriveGuess | None:
    path = folder / "rover.urdf"
    path.write_text(text)
    model = Articulated(Amendments().read(path)[0])
    return drive_of(find_running_gear(model, model.urdf.root, drawn_meshes(None, path)))


def derived(folder: Path, text: str) -> tuple[Robot, str]:
    path = folder / "rover.urdf"
    path.write_text(text)
    made, words = write_robot(path)
    return load_robot(made), "\n".join(words.assumptions)


def ring(count: int, **more: object) -> list[Axle]:
    """Return wheels around the middle, with axles that point away from it."""
    turns = [2 * math.pi * k / count + 0.3 for k in range(count)]
    return [Axle((0.25 * math.cos(a), 0.25 * math.sin(a)), a, **more) for a in turns]  # type: ignore[arg-type]


def at(places: list[tuple[float, float]], **more: object) -> list[Axle]:
    return [Axle(xy, **more) for xy in places]  # type: ignore[arg-type]
