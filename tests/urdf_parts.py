"""Robots for tests: URDF made of boxes."""

from __future__ import annotations

import re

LIMIT = '<limit lower="{}" upper="{}" effort="1" velocity="1"/>'


def link(name: str, shape: str = "", xyz: str = "0 0 0", rpy: str = "0 0 0") -> str:
    if not shape:
        return f'<link name="{name}"/>'
    return (
        f'<link name="{name}"><collision><origin xyz="{xyz}" rpy="{rpy}"/>'
        f"<geometry>{shape}</geometry></collision></link>"
    )


def joint(
    name: str, kind: str, parent: str, child: str, xyz: str, axis: str = "", limit: str = ""
) -> str:
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}"/>{f"<axis xyz={chr(34)}{axis}{chr(34)}/>" if axis else ""}'
        f"{limit}</joint>"
    )


def box(x: float, y: float, z: float) -> str:
    return f'<box size="{x} {y} {z}"/>'


def mobile_manipulator(
    *, base_z: float = 0.0, tool: bool = True, fingers: bool = True, floating: bool = False
) -> str:
    """Return a wheeled base with a torso lift, a head, six revolute joints and a gripper.

    Args:
        base_z: Height of base_link above the floor [m].
        tool: Whether there is a tool frame between the finger tips.
        fingers: Whether the gripper has fingers.
        floating: Whether virtual joints drive the base, as in simulators.
    """
    parts = [
        link("base_link", box(0.6, 0.4, 0.3), f"0 0 {0.17 - base_z}"),
        link("wheel_left", '<cylinder radius="0.08" length="0.04"/>', rpy="1.5708 0 0"),
        joint("a", "continuous", "base_link", "wheel_left", f"0 0.21 {0.08 - base_z}", "0 1 0"),
        link("torso", box(0.15, 0.2, 0.6), "0 0 0.35"),
        joint(
            "lift", "prismatic", "base_link", "torso", f"-0.15 0 {0.33 - base_z}", "0 0 1",
            LIMIT.format(0, 0.3),
        ),
        link("head_pan", box(0.1, 0.1, 0.1), "0 0 0.1"),
        joint(
            "head_joint", "revolute", "torso", "head_pan", "0 0 0.7", "0 0 1", LIMIT.format(-1, 1)
        ),
    ]  # fmt: skip
    previous, axes = "torso", ["0 0 1", "0 1 0", "0 1 0", "1 0 0", "0 1 0", "1 0 0"]
    for index, axis in enumerate(axes):
        name = f"arm_{index}"
        length = 0.3 if index in (1, 2) else 0.1
        xyz = "0.15 0 0.5" if index == 0 else f"{0.3 if index in (2, 3) else 0.1} 0 0"
        parts += [
            link(name, box(length - 0.04, 0.06, 0.06), f"{length / 2} 0 0"),
            joint(f"j{index}", "revolute", previous, name, xyz, axis, LIMIT.format(-2.5, 2.5)),
        ]
        previous = name
    parts += [
        link("palm", box(0.06, 0.12, 0.05), "0.03 0 0"),
        joint("mount", "fixed", previous, "palm", "0.1 0 0"),
    ]
    if fingers:
        for side, sign in (("left", 1), ("right", -1)):
            parts += [
                link(f"{side}_finger", box(0.06, 0.01, 0.02), f"0.03 {sign * 0.005} 0"),
                joint(
                    f"{side}_finger_joint", "prismatic", "palm", f"{side}_finger", "0.06 0 0",
                    f"0 {sign} 0", LIMIT.format(0, 0.045),
                ),
            ]  # fmt: skip
    if tool:
        parts += [link("tcp"), joint("tcp_joint", "fixed", "palm", "tcp", "0.1 0 0")]
    if floating:
        parts += [
            link("world"), link("w1"), link("w2"),
            joint("drive_x", "prismatic", "world", "w1", "0 0 0", "1 0 0", LIMIT.format(-9, 9)),
            joint("drive_y", "prismatic", "w1", "w2", "0 0 0", "0 1 0", LIMIT.format(-9, 9)),
            joint("drive_yaw", "continuous", "w2", "base_link", "0 0 0", "0 0 1"),
        ]  # fmt: skip
    return f'<robot name="test robot">{"".join(parts)}</robot>'


def dual_armed() -> str:
    """Return the mobile manipulator with a second, equal arm 0.5 m to its side."""
    text = mobile_manipulator()
    begin = text.index('<link name="arm_0">')
    arm = text[begin : text.index("</robot>")]
    other = re.sub(r'(name|link)="(?!torso)', r'\1="b_', arm)
    other = other.replace('xyz="0.15 0 0.5"', 'xyz="0.15 0.5 0.5"', 1)
    return text.replace("</robot>", other + "</robot>")


def telescope(stages: int = 3) -> str:
    """Return the mobile manipulator with a telescope below its first revolute joint."""
    parts = []
    before = "torso"
    for k in range(stages):
        parts.append(link(f"stage_{k}", box(0.1, 0.05, 0.05), "0.05 0 0"))
        xyz = "0.15 0 0.5" if k == 0 else "0.02 0 0"
        limit = LIMIT.format(0, 0.1)
        parts.append(joint(f"t{k}", "prismatic", before, f"stage_{k}", xyz, "1 0 0", limit))
        before = f"stage_{k}"
    text = mobile_manipulator().replace(
        '<joint name="j0" type="revolute"><parent link="torso"/>',
        f'<joint name="j0" type="revolute"><parent link="{before}"/>',
    )
    return text.replace("</robot>", "".join(parts) + "</robot>")


def fixed_arm() -> str:
    """Return the arm of the mobile manipulator, fixed with a small plate."""
    text = mobile_manipulator()
    begin, end = text.index('<link name="arm_0">'), text.index("</robot>")
    arm = text[begin:end].replace('<parent link="torso"/>', '<parent link="plate"/>')
    arm = arm.replace('xyz="0.15 0 0.5"', 'xyz="0 0 0.05"', 1)
    return f'<robot name="arm">{link("plate", box(0.1, 0.1, 0.04))}{arm}</robot>'
