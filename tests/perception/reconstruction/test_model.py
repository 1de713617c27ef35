"""Parts of models open outward, about the true hinge, without self-collision."""

from __future__ import annotations

import tempfile
from itertools import permutations, product
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.perception.reconstruction.fronts import KINDS, face_of, fronts, raised

from momapos.core.errors import InputError
from momapos.core.geometry.polygons import UprightBox
from momapos.core.geometry.transforms import apply, invert, pose, rotation_about
from momapos.model.records.scans import Detection, FaceImage, Part, PartKind
from momapos.model.scene.library.kitchen_writer import Piece, urdf_text
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject
from momapos.model.urdf.articulated import Articulated, opening_of
from momapos.model.urdf.reader import read_urdf
from momapos.perception.reconstruction.model_config import MAX_PASSED, ModelConfig
from momapos.perception.reconstruction.object_model import Neighbors, furniture_model
from momapos.perception.reconstruction.scene_builder import build_scene
from momapos.planning.grasps.handle_shapes import CarriedPart, rigid_links
from momapos.planning.grasps.handles import find_handle, has_handle, opening_direction

UP = np.array([0.0, 0.0, 1.0])
CENTER = np.array([1.0, -2.0, 0.9])
AT_FRONT = ModelConfig(hinge_depth=0.0, tight_hinge_depth=0.0)
"""Hinges at the front edge of their doors, as in the drawn furniture."""


def detection(width: float, depth: float, height: float, yaw: float = 0.3) -> Detection:
    """Return a fridge whose front is the -y side of its box."""
    box = UprightBox(CENTER, np.array([width, depth, height]), yaw)
    return Detection("fridge", "fridge", 0.9, box, np.arange(3))


def modeled(
    found: Detection, parts: list[Part], face: FaceImage | None = None
) -> tuple[Piece, SceneObject]:
    """Return the piece with parts on the -y side, and the object read from its URDF."""
    width, _, height = found.box.size
    face = face or face_of(width, height)
    piece = furniture_model(found, found.box.yaw - np.pi / 2, face, parts)
    return piece, read(piece)


def read(piece: Piece) -> SceneObject:
    """Write the URDF of a piece and read it."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "piece.urdf"
        path.write_text(urdf_text(piece))
        model = Articulated(read_urdf(path))
    T = pose(piece.xyz, rotation_about(UP, piece.yaw))
    return SceneObject(piece.name, piece.category, T, model)


Boxes = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Centers (n, 3), rotations (n, 3, 3) and half sizes (n, 3)."""


def boxes(item: SceneObject, links: list[str], values: dict[str, float]) -> Boxes:
    """Return the collision boxes of links, in the world."""
    poses = item.link_poses(values)
    shapes = [(poses[n], s) for n in links for s in item.model.urdf.links[n].collisions]
    T = np.array([pose_ @ shape.T_link_geometry for pose_, shape in shapes])
    return T[:, :3, 3], T[:, :3, :3], np.array([shape.size for _, shape in shapes]) / 2


def deepest(a: Boxes, b: Boxes) -> float:
    """Return the maximum penetration [m] between the boxes of two sets, by all 15 axes."""
    (c, R, h), (c2, R2, h2) = a, b
    n, m = len(c), len(c2)
    mine = np.broadcast_to(np.swapaxes(R, 1, 2)[:, None], (n, m, 3, 3))
    theirs = np.broadcast_to(np.swapaxes(R2, 1, 2)[None], (n, m, 3, 3))
    cross = np.cross(mine[:, :, :, None], theirs[:, :, None]).reshape(n, m, 9, 3)
    axes = np.concatenate([mine, theirs, cross], axis=2)
    length = np.linalg.norm(axes, axis=-1, keepdims=True)
    reach = (np.abs(np.einsum("nmkj,njl->nmkl", axes, R)) * h[:, None, None]).sum(-1)
    reach = reach + (np.abs(np.einsum("nmkj,mjl->nmkl", axes, R2)) * h2[None, :, None]).sum(-1)
    apart = np.abs(np.einsum("nmkj,nmj->nmk", axes, c2[None] - c[:, None]))
    depth = np.where(length[..., 0] > 1e-6, (reach - apart) / np.maximum(length[..., 0], 1e-6), 1e9)
    return float(depth.min(-1).max())


@given(front=fronts(), seed=st.none() | st.integers(0, 99), yaw=st.floats(-3, 3))
@settings(max_examples=40)
def test_every_part_of_a_random_front_opens_without_self_collision(
    front: tuple[tuple[float, float, float], list[Part]], seed: int | None, yaw: float
) -> None:
    size, parts = front
    face = face_of(size[0], size[2])
    if seed is not None:
        rng = np.random.default_rng(seed)
        face.height_map[...] = rng.uniform(-0.05, 0.05)
        for part in parts:
            raised(face, part.box, rng.uniform(-0.08, 0.08))
    _, item = modeled(detection(*size, yaw), parts, face)
    assert len(item.model.joints) == len(parts)
    for name, joint in item.model.joints.items():
        moving = list(rigid_links(CarriedPart.of(item.model, name)))
        still = [link for link in item.model.links if link not in moving]
        assert deepest(boxes(item, moving, {}), boxes(item, still, {})) < 1e-5, name
        for value in np.linspace(0, joint.upper, 7)[1:]:
            depth = deepest(boxes(item, moving, {name: value}), boxes(item, still, {}))
            assert depth < 1e-3, (name, value)


@given(front=fronts(), yaw=st.floats(-3, 3))
@settings(max_examples=25)
def test_every_part_of_a_random_front_moves_out_of_it(
    front: tuple[tuple[float, float, float], list[Part]], yaw: float
) -> None:
    size, parts = front
    _, item = modeled(detection(*size, yaw), parts)
    normal = np.array([np.sin(yaw), -np.cos(yaw), 0.0])
    for name, joint in item.model.joints.items():
        assert opening_of(item.model, name).sign == 1.0
        assert opening_direction(item, name)[1] @ normal > 0.5
        handle = find_handle(item.model, name, 1.0)
        link = joint.child
        closed, opened = (
            apply(item.link_poses({name: v})[link], handle.center[None])[0] for v in (0.0, 0.2)
        )
        assert (opened - closed) @ normal > 0


@given(front=fronts(), yaw=st.floats(-3, 3))
@settings(max_examples=25)
def test_a_closed_model_fills_its_box_except_for_handles(
    front: tuple[tuple[float, float, float], list[Part]], yaw: float
) -> None:
    size, parts = front
    found = detection(*size, yaw)
    _, item = modeled(found, parts)
    links = [name for name in item.model.links if "handle" not in name]
    T_box_world = invert(pose(CENTER, rotation_about(UP, yaw)))
    points = np.concatenate(
        [
            apply(T_box_world @ item.link_poses()[n], h.vertices)
            for n in links
            for h in item.model.hulls[n]
        ]
    )
    np.testing.assert_allclose(points.min(0), -np.array(size) / 2, atol=1e-3)
    np.testing.assert_allclose(points.max(0), np.array(size) / 2, atol=1e-3)


BAR = {
    "door_left": (0.88, 0.3, 0.92, 0.6),
    "door_right": (0.08, 0.3, 0.12, 0.6),
    "door_down": (0.3, 0.06, 0.7, 0.1),
    "door_up": (0.3, 0.9, 0.7, 0.94),
    "drawer": (0.3, 0.48, 0.7, 0.52),
}
HINGE = {
    "door_left": (-0.3, 0.0, (0.0, 0.0, -1.0)),
    "door_right": (0.3, 0.0, (0.0, 0.0, 1.0)),
    "door_down": (0.0, -0.4, (1.0, 0.0, 0.0)),
    "door_up": (0.0, 0.4, (-1.0, 0.0, 0.0)),
}
"""x, z [m] from the middle of the front, and the axis."""


@pytest.mark.parametrize(("kind", "value"), [*product(KINDS, [0.0, np.pi / 4, np.pi / 2])])
def test_the_handle_rotates_about_the_true_hinge(kind: PartKind, value: float) -> None:
    found = detection(0.6, 0.5, 0.8)
    face = face_of(0.6, 0.8, 0.0)
    raised(face, BAR[kind], 0.05)
    part = Part(kind, (0.0, 0.0, 1.0, 1.0), 0.9, BAR[kind])
    piece = furniture_model(found, 0.3 - np.pi / 2, face, [part], AT_FRONT)
    item = read(piece)
    (name,) = item.model.joints
    assert has_handle(item.model, name)
    left, top, right, bottom = BAR[kind]
    x, z = ((left + right) / 2 - 0.5) * 0.6, (0.5 - (top + bottom) / 2) * 0.8
    start = np.array([x, -0.25 - 0.025, z])  # the handle's middle, in the frame of the piece
    if kind == "drawer":
        value = value / 4
        true = start - [0.0, value, 0.0]
    else:
        x, z, axis = HINGE[kind]
        hinge = np.array([x, -0.25, z])
        true = hinge + rotation_about(np.array(axis), value) @ (start - hinge)
    handle = find_handle(item.model, name, 1.0)
    T_world_link = item.link_poses({name: value})[item.model.joint(name).child]
    T_world_piece = pose(piece.xyz, rotation_about(UP, piece.yaw))
    got = apply(T_world_link, handle.center[None])[0]
    off = float(np.linalg.norm(got - apply(T_world_piece, true[None])[0]))
    assert off < 0.004, (kind, value, off)


@pytest.mark.parametrize("name", ["fridge", "oven", "dishwasher", "cabinet_left"])
def test_the_true_front_of_a_kitchen_piece_gives_the_true_handle_paths(
    name: str, kitchen: Scene
) -> None:
    item = kitchen.object(name)
    joints = {j: r for j, r in item.model.joints.items() if has_handle(item.model, j)}
    _, out = opening_direction(item, next(iter(joints)))
    facing = float(np.round(np.arctan2(out[1], out[0]) / (np.pi / 2)) * np.pi / 2)
    R = rotation_about(UP, facing + np.pi / 2)
    closed = np.concatenate(
        [
            apply(T, h.vertices) @ R
            for n, T in item.link_poses().items()
            if "handle" not in n
            for h in item.model.hulls[n]
        ]
    )
    low, high = closed.min(0), closed.max(0)
    box = UprightBox(R @ ((low + high) / 2), high - low, facing + np.pi / 2)
    face = face_of(high[0] - low[0], high[2] - low[2], 0.0)

    def seen(links: list[str]) -> tuple[tuple[float, float, float, float], float]:
        points = np.concatenate(
            [
                apply(item.link_poses()[n], h.vertices) @ R
                for n in links
                for h in item.model.hulls[n]
            ]
        )
        a, b = (points.min(0) - low) / (high - low), (points.max(0) - low) / (high - low)
        return (a[0], 1 - b[2], b[0], 1 - a[2]), float(low[1] - points[:, 1].min())

    parts, truth = [], {}
    for joint, record in joints.items():
        links = rigid_links(CarriedPart.of(item.model, joint))
        area, height_map = seen([n for n in links if "handle" not in n])
        handle, handle_height_map = seen([n for n in links if "handle" in n])
        raised(face, area, height_map)
        raised(face, handle, handle_height_map)
        kind: PartKind = "drawer"
        if record.kind == "revolute":
            axis = R.T @ (item.link_poses()[record.child][:3, :3] @ record.axis)
            sideways: PartKind = "door_right" if axis[2] > 0 else "door_left"
            kind = sideways if abs(axis[2]) > 0.9 else "door_down"
        parts.append(Part(kind, area, 0.9, handle))
        held = find_handle(item.model, joint, opening_of(item.model, joint).sign)
        values = np.array([0.0, np.pi / 4, np.pi / 2]) * (1 if kind != "drawer" else 0.2)
        truth[handle] = [
            apply(item.link_poses({joint: v})[record.child], held.center[None])[0] for v in values
        ]
    found = Detection(name, name, 0.9, box, np.arange(3))
    again = read(furniture_model(found, facing, face, parts, AT_FRONT))
    assert len(again.model.joints) == len(joints)
    paths = []
    for joint, record in again.model.joints.items():
        held = find_handle(again.model, joint, opening_of(again.model, joint).sign)
        values = np.array([0.0, np.pi / 4, np.pi / 2]) * (1 if record.kind == "revolute" else 0.2)
        paths.append(
            [
                apply(again.link_poses({joint: v})[record.child], held.center[None])[0]
                for v in values
            ]
        )
    off = np.linalg.norm(np.array(paths)[:, None] - np.array(list(truth.values()))[None], axis=-1)
    assert off.max(-1).min(1).max() < 0.005


@pytest.mark.parametrize("neighbors", [(None, 0.0), (0.0, None), (0.02, -0.1), (0.05, 1.0)])
def test_the_depth_of_a_hinge_depends_on_its_neighbor(neighbors: Neighbors) -> None:
    parts = [
        Part("door_left", (0.0, 0.0, 0.5, 1.0), 0.9),
        Part("door_right", (0.5, 0.0, 1.0, 1.0), 0.9),
    ]
    face, config = face_of(0.8, 0.9), ModelConfig()
    raised(face, (0.0, 0.0, 1.0, 1.0), 0.03)
    found = detection(0.8, 0.6, 0.9)
    piece = furniture_model(found, 0.3 - np.pi / 2, face, parts, config, neighbors=neighbors)
    motions = [part.motion for part in piece.parts[1:]]
    depths = [motion.pivot[1] + 0.33 for motion in motions if motion]
    deep, tight = config.hinge_depth, config.tight_hinge_depth
    assert deep > tight > 0.0
    wall = MAX_PASSED * 0.4
    expected = [deep if out is None else tight if out < wall else 0.0 for out in neighbors]
    assert depths == pytest.approx(expected)
    assert [motion.upper for motion in motions if motion] == [np.pi / 2] * 2


@pytest.mark.parametrize("out", [-0.1, 0.0, 0.02, 0.12, 0.3, np.inf])
@pytest.mark.parametrize("kind", ["door_left", "door_right"])
def test_an_opening_door_clears_the_neighboring_object(kind: PartKind, out: float) -> None:
    part, box = Part(kind, (0.0, 0.0, 1.0, 1.0), 0.9), detection(0.5, 0.6, 0.9)
    piece = furniture_model(
        box, 0.3 - np.pi / 2, face_of(0.5, 0.9), [part], neighbors=(out, out)
    )  # fmt: skip
    (door,) = piece.parts[1:]
    assert door.motion
    assert door.motion.upper == np.pi / 2
    pivot = np.array(door.motion.pivot)
    for angle in np.linspace(0.0, np.pi / 2, 46):
        R = rotation_about(np.array(door.motion.axis), angle)
        for leaf in door.boxes:
            corners = np.array(list(product(*zip(leaf.low, leaf.high, strict=True))))
            moved = (corners - pivot) @ R.T + pivot
            # Dense along the edges: a corner outside passes the neighbor's own corner.
            edges = np.concatenate([a + (b - a) * np.linspace(0, 1, 200)[:, None]
                                    for a, b in permutations(moved, 2)])  # fmt: skip
            beside = np.abs(edges[:, 0]) > 0.25 + 1e-9
            assert not (beside & (edges[:, 1] > -0.3 - out + 1e-9)).any()


def test_a_hinge_next_to_another_part_has_the_same_depth_between_objects() -> None:
    parts = [
        Part("drawer", (0.0, 0.0, 0.5, 1.0), 0.9),
        Part("door_left", (0.5, 0.0, 1.0, 1.0), 0.9),
    ]
    found, config = detection(0.8, 0.6, 0.9), ModelConfig()
    piece = furniture_model(found, 0.3 - np.pi / 2, face_of(0.8, 0.9), parts, config)
    (motion,) = (p.motion for p in piece.parts if p.motion and p.motion.kind == "revolute")
    assert motion.pivot[1] == pytest.approx(-0.3 + config.hinge_depth)
    assert motion.upper == np.pi / 2


@pytest.mark.parametrize("proud", [0.0, 0.008])
@pytest.mark.parametrize("kind", ["door_left", "door_right", "door_down", "door_up"])
def test_a_door_with_neighbors_stays_within_its_own_part_as_it_opens(
    kind: PartKind, proud: float
) -> None:
    face, config = face_of(0.9, 0.9, proud), ModelConfig(hinge_depth=0.015)
    raised(face, (1 / 3, 1 / 3, 2 / 3, 2 / 3), 0.0)
    part = Part(kind, (1 / 3, 1 / 3, 2 / 3, 2 / 3), 0.9)
    others = [
        Part("drawer", (0.0, 0.0, 1.0, 1 / 3), 0.8), Part("drawer", (0.0, 2 / 3, 1.0, 1.0), 0.8),
        Part("drawer", (0.0, 1 / 3, 1 / 3, 2 / 3), 0.8),
        Part("drawer", (2 / 3, 1 / 3, 1.0, 2 / 3), 0.8),
    ]  # fmt: skip
    found = detection(0.9, 0.6, 0.9)
    piece = furniture_model(found, 0.3 - np.pi / 2, face, [part, *others], config)
    (motion,) = (p.motion for p in piece.parts if p.motion and p.motion.kind == "revolute")
    assert motion.pivot[1] == pytest.approx(-0.285)
    assert motion.upper == np.pi / 2


@pytest.mark.parametrize("below", [True, False])
def test_a_flap_turns_as_far_behind_its_front_over_another_part(below: bool) -> None:
    flap = Part("door_down", (0.0, 0.0, 1.0, 0.8), 0.9)
    drawer = Part("drawer", (0.0, 0.8, 1.0, 1.0), 0.9)
    found, config = detection(0.6, 0.6, 0.9), ModelConfig()
    parts = [flap, drawer] if below else [flap]
    piece = furniture_model(found, 0.3 - np.pi / 2, face_of(0.6, 0.9), parts, config)
    (motion,) = (p.motion for p in piece.parts if p.motion and p.motion.kind == "revolute")
    assert motion.pivot[1] == pytest.approx(-0.3 + config.hinge_depth)
    assert motion.upper == np.pi / 2


def test_a_scene_stores_the_hypotheses_of_a_part_its_own_joint_first(tmp_path: Path) -> None:
    odds: tuple[tuple[PartKind, float], ...] = (
        ("door_right", 0.6), ("drawer", 0.3), ("door_left", 0.097), ("door_up", 0.003)
    )  # fmt: skip
    part = Part("door_right", (0.0, 0.0, 1.0, 1.0), 0.9, odds=odds)
    found = detection(0.6, 0.5, 0.8)
    piece = furniture_model(found, 0.3 - np.pi / 2, face_of(0.6, 0.8), [part])
    path = build_scene([found], {found.name: piece}, None, tmp_path / "scene.json")
    item = load_scene(path).object(found.name)
    ((joint, ways),) = item.hypotheses.items()
    record = item.model.joint(joint)
    assert [way.kind for way in ways] == ["door_right", "drawer", "door_left"]
    assert sum(way.probability for way in ways) == pytest.approx(1.0, abs=1e-3)
    np.testing.assert_allclose(ways[0].point[:2], record.T_parent_joint[:2, 3], atol=1e-4)
    np.testing.assert_allclose(ways[0].axis, record.axis, atol=1e-6)
    assert ways[0].upper == pytest.approx(record.upper, abs=1e-4)
    assert ways[1].axis == (0.0, -1.0, 0.0)
    assert ways[2].point[0] == pytest.approx(-0.3, abs=0.01)


def test_parts_are_named_top_to_bottom_and_left_to_right() -> None:
    parts = [
        Part("drawer", (0.0, 0.7, 1.0, 1.0), 0.5),
        Part("door_right", (0.5, 0.3, 1.0, 0.7), 0.6),
        Part("door_left", (0.0, 0.3, 0.5, 0.7), 0.7),
        Part("drawer", (0.0, 0.0, 1.0, 0.3), 0.8),
    ]
    piece, _ = modeled(detection(0.8, 0.6, 0.9), parts)
    names = ["body", "drawer_1", "door_1", "door_2", "drawer_2"]
    assert [part.name for part in piece.parts] == names
    only, _ = modeled(detection(0.8, 0.6, 0.9), parts[:1])
    assert [part.name for part in only.parts] == ["body", "drawer"]


def test_the_space_behind_a_door_is_empty() -> None:
    _, item = modeled(detection(0.6, 0.6, 1.8), [Part("door_left", (0.0, 0.0, 1.0, 1.0), 0.9)])
    room = (CENTER[None], rotation_about(UP, 0.3)[None], np.array([[0.27, 0.25, 0.87]]))
    assert deepest(room, boxes(item, ["body"], {})) < 0


def test_areas_that_do_not_open_are_closed_by_panels() -> None:
    _, item = modeled(detection(0.5, 0.35, 0.3), [Part("door_left", (0.0, 0.0, 0.7, 1.0), 0.9)])
    T = pose(CENTER, rotation_about(UP, 0.3))
    button = apply(T, np.array([[0.2, -0.17, 0.0]]))
    room = (button, rotation_about(UP, 0.3)[None], np.full((1, 3), 1e-3))
    assert deepest(room, boxes(item, ["body"], {})) > 0


@pytest.mark.parametrize(
    ("height_map", "front", "thickness"), [(0.045, 0.045, 0.045), (0.0, 0.0, 0.02)]
)
def test_a_protruding_door_is_as_thick_as_its_protrusion(
    height_map: float, front: float, thickness: float
) -> None:
    face = face_of(0.6, 1.8, height_map)
    part = Part("door_right", (0.0, 0.0, 1.0, 1.0), 0.9)
    piece, _ = modeled(detection(0.6, 0.6, 1.8), [part], face)
    (panel,) = piece.parts[1].boxes
    assert -0.3 - panel.low[1] == pytest.approx(front, abs=1e-4)
    assert panel.high[1] - panel.low[1] == pytest.approx(thickness, abs=1e-4)


@pytest.mark.parametrize("quarter", range(4))
def test_any_upright_side_of_the_box_can_be_the_front(quarter: int) -> None:
    found = detection(0.6, 0.5, 0.8, yaw=0.2)
    facing = 0.2 + quarter * np.pi / 2
    width = (0.5, 0.6)[quarter % 2]
    face = face_of(width, 0.8)
    part = Part("drawer", (0.0, 0.0, 1.0, 1.0), 0.9)
    item = read(furniture_model(found, facing + 0.1, face, [part]))
    _, direction = opening_direction(item, "drawer_slide")
    np.testing.assert_allclose(direction, [np.cos(facing), np.sin(facing), 0], atol=1e-6)


def test_a_face_of_another_side_is_refused() -> None:
    found = detection(0.6, 0.5, 0.8)
    with pytest.raises(InputError, match="this side of the box is"):
        furniture_model(found, 0.3, face_of(0.6, 0.8), [])


def test_without_parts_the_model_is_the_box() -> None:
    piece = furniture_model(detection(0.6, 0.5, 0.8), 0.3 - np.pi / 2, face_of(0.6, 0.8), [])
    (body,) = piece.parts
    assert body.boxes[0].high == (0.3, 0.25, 0.4)
    assert (piece.xyz, piece.yaw) == (tuple(CENTER), pytest.approx(0.3))
