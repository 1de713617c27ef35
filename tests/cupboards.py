"""Furniture of boxes for tests: a carcass that is open to -x, with parts of any kind in front."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np
from tests.meshes import triangles_of, write_obj

from momapos.model.records.plans import JointResistance, Latch
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import save_scene
from momapos.model.scene.scene_object import SceneObject

Box = tuple[tuple[float, float, float], tuple[float, float, float]]
"""Edge lengths and center of a box in its link's frame [m]."""


def link(name: str, *boxes: Box, handle: Box | None = None, handle_name: str = "handle") -> str:
    """Return a link of boxes; the handle's shape has a name of its own."""
    shapes = [*((box, "") for box in boxes), *([(handle, handle_name)] if handle else [])]
    elements = "".join(
        f'<collision name="{text}"><origin xyz="{x} {y} {z}"/>'
        f'<geometry><box size="{a} {b} {c}"/></geometry></collision>'
        for ((a, b, c), (x, y, z)), text in shapes
    )
    return f'<link name="{name}">{elements}</link>'


def joint(
    name: str,
    kind: str,
    ends: tuple[str, str],
    xyz: tuple[float, float, float],
    axis: tuple[float, float, float],
    limits: tuple[float, float],
    mimic: str = "",
) -> str:
    """Return a joint; `mimic` holds the attributes of a <mimic> element."""
    follows = f"<mimic {mimic}/>" if mimic else ""
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{ends[0]}"/><child link="{ends[1]}"/>'
        f'<origin xyz="{xyz[0]} {xyz[1]} {xyz[2]}"/><axis xyz="{axis[0]} {axis[1]} {axis[2]}"/>'
        f'<limit lower="{limits[0]}" upper="{limits[1]}" effort="9" velocity="1"/>{follows}</joint>'
    )


def carcass(width: float = 0.6, height: float = 0.9, depth: float = 0.5) -> str:
    """Return the link `body`: a box without a front, its middle above the origin."""
    x, y, t = depth / 2, width / 2, 0.02
    return link(
        "body",
        ((t, width, height), (x - t / 2, 0.0, height / 2)),
        ((depth, t, height), (0.0, y - t / 2, height / 2)),
        ((depth, t, height), (0.0, t / 2 - y, height / 2)),
        ((depth, width, t), (0.0, 0.0, t / 2)),
        ((depth, width, t), (0.0, 0.0, height - t / 2)),
    )


def furniture_room(folder: Path, parts: Sequence[str], name: str = "cupboard") -> Scene:
    """Write furniture into a folder, and return a room in which it stands at x = 0.8 m."""
    path = folder / f"{name}.urdf"
    path.write_text(f'<robot name="{name}">{"".join(parts)}</robot>')
    item = SceneObject.from_urdf(name, path, (0.8, 0.0, 0.0), category="cabinet")
    return Scene(name, (item,), start=np.array([-1.5, 0.0, 0.0]))


BAR: Box = ((0.02, 0.16, 0.02), (-0.31, 0.0, 0.0))
HINGE = joint("hinge", "revolute", ("body", "door"), (-0.262, -0.295, 0.45), (0, 0, 1), (0, 1.6))
DOOR = link("door", ((0.02, 0.59, 0.88), (0, 0.295, 0)))
SLIDE = joint("slide", "prismatic", ("body", "tray"), (0, 0, 0.6), (-1, 0, 0), (0, 0.4))


def tray(handle: Box | None = BAR) -> str:
    front, bottom = ((0.02, 0.55, 0.2), (-0.262, 0, 0)), ((0.45, 0.5, 0.02), (0, 0, -0.08))
    return link("tray", front, bottom, handle=handle)


def rails(name: str) -> str:
    return link(name, ((0.4, 0.02, 0.02), (0, 0.27, 0)), ((0.4, 0.02, 0.02), (0, -0.27, 0)))


def half_door(name: str, side: int, handle: Box | None = None) -> str:
    return link(name, ((0.02, 0.29, 0.88), (0, side * 0.145, 0)), handle=handle)


def pull_out(*names: str, mimics: tuple[str, ...]) -> list[str]:
    """Return a drawer on rails that each slide by the same distance in the one before."""
    links = ("body", *names)
    joints = [
        joint(
            f"{child}_slide", "prismatic", (parent, child), (0, 0, 0.6 if parent == "body" else 0),
            (-1, 0, 0), (0, 0.14), mimic,
        )
        for parent, child, mimic in zip(links, names, mimics, strict=False)
    ]  # fmt: skip
    return [carcass(), *map(rails, names[:-1]), tray(), *joints]


KNOB_BAR: Box = ((0.02, 0.02, 0.16), (-0.05, -0.26, 0.1))
PAIR = [carcass(), half_door("left", 1), half_door("right", -1, KNOB_BAR)]
RIGHT = joint("right", "revolute", ("body", "right"), (-0.262, 0.298, 0.45), (0, 0, 1), (-1.6, 0))


def left(mimic: str) -> str:
    ends, at = ("body", "left"), (-0.262, -0.298, 0.45)
    return joint("left", "revolute", ends, at, (0, 0, 1), (0, 1.7), f'joint="right" {mimic}')


FOLLOWERS = {
    "rails behind the tray": (
        pull_out("outer", "tray", mimics=('joint="tray_slide"', "")), "outer_slide", "tray_slide",
    ),
    "a tray behind its rails": (
        pull_out("outer", "tray", mimics=("", 'joint="outer_slide"')), "tray_slide", "outer_slide",
    ),
    "a chain of rails": (
        pull_out(
            "outer", "inner", "tray", mimics=('joint="tray_slide"', 'joint="outer_slide"', ""),
        ),
        "inner_slide", "tray_slide",
    ),
    "a door that mirrors the other": ([*PAIR, left('multiplier="-1"'), RIGHT], "left", "right"),
    "a door that lags behind by an offset": (
        [*PAIR, left('multiplier="-0.9" offset="0.1"'), RIGHT], "left", "right",
    ),
    "a lid that turns as its drawer slides": (
        [
            carcass(), tray(), link("lid", ((0.3, 0.5, 0.015), (0.15, 0, 0))), SLIDE,
            joint(
                "lid_hinge", "revolute", ("tray", "lid"), (-0.2, 0, 0.05), (0, 1, 0), (-1.2, 0),
                'joint="slide" multiplier="-2"',
            ),
        ],
        "lid_hinge", "slide",
    ),
}  # fmt: skip

LEAF: Box = ((0.02, 0.29, 0.88), (0, 0.145, 0))
FOLDING_DOOR = [
    carcass(),
    link("first", LEAF),
    link("second", LEAF, handle=((0.02, 0.02, 0.2), (-0.05, 0.22, 0.1))),
    joint("hinge", "revolute", ("body", "first"), (-0.262, -0.295, 0.45), (0, 0, 1), (0, 1.4)),
    joint(
        "fold", "revolute", ("first", "second"), (0, 0.295, 0), (0, 0, -1), (0, 2.8),
        'joint="hinge" multiplier="2"',
    ),
]  # fmt: skip
"""A folding door, whose handle is on the leaf that follows."""
FOLLOWERS["a folding door"] = (FOLDING_DOOR, "fold", "hinge")


def turning(
    kind: str, axis: tuple[float, float, float], limits: tuple[float, float], mimic: str = "",
    *, name: str = "turn", child: str = "grip", x: float = 0.0,
) -> str:  # fmt: skip
    """Return the joint of a latch on the door."""
    return joint(name, kind, ("door", child), (x, 0.52, 0.1), axis, limits, mimic)


SPINDLE: Box = ((0.05, 0.02, 0.02), (-0.035, 0, 0))
GRIP: Box = ((0.02, 0.13, 0.02), (-0.06, -0.055, 0))
TEE_BAR: Box = ((0.02, 0.02, 0.14), (-0.055, 0, 0))
BOLT_ROD: Box = ((0.02, 0.16, 0.02), (-0.02, 0, 0))
BOLT_KNOB: Box = ((0.04, 0.02, 0.02), (-0.045, 0, 0))
INNER: tuple[Box, Box] = (
    ((0.05, 0.02, 0.02), (0.035, 0, 0)), ((0.02, 0.13, 0.02), (0.06, -0.055, 0)),
)  # fmt: skip
LATCHES: Mapping[str, tuple[list[str], float]] = {
    "a lever": (
        [
            carcass(), DOOR, HINGE, link("grip", SPINDLE, GRIP),
            turning("revolute", (1, 0, 0), (-0.8, 0)),
        ],
        -0.7,
    ),
    "a T-handle": (
        [
            carcass(), DOOR, HINGE, link("grip", ((0.04, 0.02, 0.02), (-0.03, 0, 0)), TEE_BAR),
            turning("revolute", (1, 0, 0), (0, 1.57)),
        ],
        1.4,
    ),
    "a sliding bolt": (
        [
            carcass(), DOOR, HINGE, link("grip", BOLT_ROD, BOLT_KNOB),
            turning("prismatic", (0, -1, 0), (0, 0.08)),
        ],
        0.06,
    ),
    "a lever with another inside": (
        [
            carcass(), DOOR, HINGE, link("grip", SPINDLE, GRIP), link("inside", *INNER),
            turning("revolute", (1, 0, 0), (-0.8, 0)),
            turning(
                "revolute", (1, 0, 0), (-0.8, 0), 'joint="turn"', name="other", child="inside",
            ),
        ],
        -0.7,
    ),
    "a knob": (
        [
            carcass(), DOOR, HINGE, link("grip", ((0.06, 0.03, 0.03), (-0.04, 0, 0))),
            turning("revolute", (1, 0, 0), (-1.2, 1.2)),
        ],
        0.9,
    ),
    "a lever on a drawer": (
        [
            carcass(), tray(None), SLIDE, link("grip", SPINDLE, GRIP),
            joint("turn", "revolute", ("tray", "grip"), (-0.272, 0.05, 0), (1, 0, 0), (-0.8, 0)),
        ],
        -0.6,
    ),
}  # fmt: skip
"""Parts with a latch `turn`, and its value from which on the part is free."""


def latched_room(
    folder: Path, kind: str, resistance: Mapping[str, JointResistance] | None = None
) -> Scene:
    """Write a room with a latch, and return it as its file says."""
    parts, to = LATCHES[kind]
    scene = furniture_room(folder, parts)
    held = "slide" if kind.endswith("drawer") else "hinge"
    item = replace(
        scene.objects[0], latch=Latch("turn", to, held), resistance=dict(resistance or {})
    )
    return save_scene(replace(scene, objects=(item,)), folder / "scene.json")


def niche(gap: float) -> list[str]:
    """Return a drawer with a bar in a slot of its front, which is flush with a frame.

    Nothing else can be grasped: the front has no free edge.

    Args:
        gap: Height of the slot [m].
    """
    depth, block = 0.07, (0.2 - gap) / 2
    x = depth / 2 - 0.25
    jambs = (((depth, 0.555, block), (x, 0, side * (gap + block) / 2)) for side in (1, -1))
    back, bottom = ((0.02, 0.555, 0.2), (x + 0.045, 0, 0)), ((0.3, 0.5, 0.02), (0.05, 0, -0.08))
    handle: Box = ((0.016, 0.2, 0.016), (-0.238, 0, 0))
    rails_around = [((0.1, 0.56, 0.02), (-0.2, 0, 0.6 + side * 0.115)) for side in (1, -1)]
    return [
        fixed_to_carcass(*rails_around),
        link("tray", back, bottom, *jambs, handle=handle),
        SLIDE,
    ]


def between_posts(gap: float) -> list[str]:
    """Return a pull-out of 9 cm between two fixed posts that stand out as far as its bar.

    Args:
        gap: Distance between the posts [m].
    """
    posts = [((0.1, 0.3, 0.9), (-0.31, side * (gap / 2 + 0.15), 0.45)) for side in (1, -1)]
    front, bottom = ((0.02, 0.09, 0.8), (-0.262, 0, -0.15)), ((0.4, 0.08, 0.02), (-0.05, 0, -0.5))
    bar: Box = ((0.02, 0.02, 0.2), (-0.32, 0, 0.1))
    return [fixed_to_carcass(*posts), link("tray", front, bottom, handle=bar), SLIDE]


def fixed_to_carcass(*boxes: Box) -> str:
    """Return the carcass with further boxes."""
    extra = link("body", *boxes).removeprefix('<link name="body">')
    return carcass().removesuffix("</link>") + extra


def oven_door(folder: Path, gap: float, low: float = 0.15) -> list[str]:
    """Return a drop-down door that is one mesh with its bow, and writes the mesh.

    Args:
        folder: Where the mesh is written.
        gap: Distance of the bow's bar from the door [m].
        low: Height of the hinge [m].
    """
    x, z, t, half = -0.01, 0.44, 0.016, 0.22
    bow = (
        ((x - gap - t, -half, z - t / 2), (x - gap, half, z + t / 2)),
        ((x - gap, -half, z - t / 2), (x, t - half, z + t / 2)),
        ((x - gap, half - t, z - t / 2), (x, half, z + t / 2)),
    )
    write_obj(folder / "door.obj", triangles_of((((-0.01, -0.29, 0.0), (0.01, 0.29, 0.5)), *bow)))
    mesh = '<collision><geometry><mesh filename="door.obj"/></geometry></collision>'
    ends, at = ("body", "door"), (-0.262, 0.0, low)
    hinge = joint("hinge", "revolute", ends, at, (0, -1, 0), (0, 1.6))
    return [carcass(), f'<link name="door">{mesh}</link>', hinge]


def hollow_door(folder: Path, depth: float = 0.06) -> tuple[tuple[Box, ...], list[str]]:
    """Return the boxes of a drop-down door of one mesh, by lower and upper corner, and its parts.

    Its tub begins below the middle, so that the rim is thin, as that of a dishwasher's door. A bar
    is its handle.

    Args:
        folder: Where the mesh is written.
        depth: How far the tub stands out from the panel, toward the inside [m].
    """
    panel = ((-0.01, -0.28, 0.0), (0.01, 0.28, 0.6))
    tub = ((0.01, -0.25, 0.02), (0.01 + depth, 0.25, 0.25))
    write_obj(folder / "hollow.obj", triangles_of((panel, tub)))
    mesh = '<collision><geometry><mesh filename="hollow.obj"/></geometry></collision>'
    hinge = joint("hinge", "revolute", ("body", "door"), (-0.262, 0.0, 0.15), (0, -1, 0), (0, 1.5))
    bar = link("", handle=((0.016, 0.3, 0.016), (-0.05, 0.0, 0.55))).removeprefix('<link name="">')
    return (panel, tub), [carcass(), f'<link name="door">{mesh}{bar}', hinge]


def wardrobe(*bars: float, height: float = 3.0) -> list[str]:
    """Return a tall door with upright bars at some heights, the first one first in the file [m]."""
    shapes = [("", (0.02, 0.59, height - 0.02), (0.0, 0.295, 0.0))]
    shapes += [
        (f"handle_{k}", (0.02, 0.02, 0.16), (-0.05, 0.53, z - height / 2))
        for k, z in enumerate(bars)
    ]
    door = "".join(
        f'<collision name="{name}"><origin xyz="{x} {y} {z}"/><geometry><box size="{a} {b} {c}"/>'
        "</geometry></collision>"
        for name, (a, b, c), (x, y, z) in shapes
    )
    hinge = joint(
        "hinge", "revolute", ("body", "door"), (-0.262, -0.295, height / 2), (0, 0, 1), (0, 1.6)
    )
    return [carcass(height=height), f'<link name="door">{door}</link>', hinge]
