"""A cabinet with a door and a drawer, as a URDF and as an imported object."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest
from numpy.testing import assert_allclose

from momapos.core.errors import MomaposError
from momapos.core.geometry.transforms import apply
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_object import SceneObject

CABINET = """<robot name="cabinet">
  <link name="body"><collision><geometry><box size="0.4 0.6 0.8"/></geometry></collision></link>
  <link name="door"><collision><origin xyz="0 0.3 0"/><geometry><box size="0.02 0.6 0.3"/></geometry></collision></link>
  <link name="drawer"><collision><geometry><box size="0.02 0.6 0.3"/></geometry></collision>
    <collision><origin xyz="0.03 0 0" rpy="{bar} 0 0"/><geometry><cylinder radius="0.01" length="0.2"/></geometry></collision></link>
  <joint name="hinge" type="revolute"><parent link="body"/><child link="door"/>
    <origin xyz="0.21 -0.3 0.2" rpy="0 0 {turn}"/><axis xyz="{axis}"/><limit lower="{lower}" upper="{upper}"/></joint>
  <joint name="slide" type="prismatic"><parent link="body"/><child link="drawer"/>
    <origin xyz="0.21 0 -0.2"/><axis xyz="1 0 0"/><limit lower="0" upper="0.4"/></joint>
</robot>"""  # noqa: E501
"""URDF of `expected`; the fields differ between formats."""


def expected(folder: Path, xyz: tuple[float, float, float], yaw: float = 0.0, *, bar: float,
             turn: float, axis: str, lower: float, upper: float) -> SceneObject:  # fmt: skip
    """Return the cabinet of the URDF.

    Args:
        folder: Folder of the URDF.
        xyz: Position [m].
        yaw: Rotation about z [rad].
        bar: Roll of the drawer's bar [rad].
        turn: Yaw of the hinge's frame [rad].
        axis: Axis of the hinge.
        lower, upper: Limits of the hinge [rad].
    """
    text = CABINET.format(bar=bar, turn=turn, axis=axis, lower=lower, upper=upper)
    (folder / "cabinet.urdf").write_text(text)
    return SceneObject.from_urdf("cabinet", folder / "cabinet.urdf", xyz, yaw=yaw)


def assert_moves_alike(
    found: SceneObject, truth: SceneObject, values: tuple[tuple[float, float], ...]
) -> None:
    """Check that every part is at its pose in the URDF, for each value of hinge and slide."""
    for name, joint in truth.model.joints.items():
        ours = found.model.joints[name]
        assert (ours.kind, ours.lower) == (joint.kind, pytest.approx(joint.lower))
        assert ours.upper == pytest.approx(joint.upper)
    for hinge, slide in values:
        change = {"hinge": hinge, "slide": slide}
        ours_at, theirs_at = found.link_poses(change), truth.link_poses(change)
        for link in ("body", "door", "drawer"):
            for a, b in zip(found.model.hulls[link], truth.model.hulls[link], strict=True):
                one, two = apply(ours_at[link], a.vertices), apply(theirs_at[link], b.vertices)
                assert_allclose(one.min(0), two.min(0), atol=2e-4)  # of a prism of 24 sides
                assert_allclose(one.max(0), two.max(0), atol=2e-4)
    assert found.model.urdf.links["door"].collisions[0].name == "door_handle"


def assert_refused(
    folder: Path, read: Callable[[Path, str], Scene], text: str, message: str
) -> None:
    """Check that a reader refuses a file in one line and writes nothing."""
    inside = folder / "inside"
    inside.mkdir()
    with pytest.raises(MomaposError, match=message) as caught:
        read(inside, text)
    assert "\n" not in str(caught.value)
    assert not list(inside.glob("*out*"))
