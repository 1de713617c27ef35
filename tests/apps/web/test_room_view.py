"""The room is drawn in few nodes, and unchanged objects are not drawn again."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import trimesh
from viser import SceneApi

from momapos.apps.web import colors
from momapos.apps.web.colors import rgb
from momapos.apps.web.room_view import (
    MAX_MERGED,
    ColoredSurface,
    RoomView,
    Surface,
    batched,
    object_hit,
)
from momapos.apps.web.serve import open_server
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import SceneObject

KITCHEN = load_scene("kitchen_small")
DRAWER = ("cabinet_right", "drawer_top_slide")


@pytest.fixture(scope="module")
def api() -> Iterator[SceneApi]:
    server = open_server("127.0.0.1", 0)
    yield server.scene
    server.stop()


@pytest.fixture
def picked() -> list[str]:
    return []


@pytest.fixture
def room(api: SceneApi, picked: list[str]) -> Iterator[RoomView]:
    view = RoomView(api, lambda name, _: picked.append(name))
    yield view
    view.remove()


def crates(count: int) -> tuple[SceneObject, ...]:
    return tuple(
        SceneObject.box(f"crate_{k}", (0.5, 0.4, 0.9), (k % 40, k // 40, 0.45))
        for k in range(count)
    )


HALL = Scene("hall", (*KITCHEN.objects, *crates(1000)))


def batched_objects(room: RoomView) -> set[str]:
    """Return the objects that are drawn in shared nodes."""
    return {
        part.object for parts, node in room._batches._drawn if node is not None for part in parts
    }


def test_a_thousand_objects_are_few_nodes(room: RoomView) -> None:
    room.show(HALL, "fridge")
    assert len(room._batches.nodes) < 30
    assert {name for name, nodes in room._nodes.items() if nodes} == {" floor", "fridge"}
    assert batched_objects(room) == {item.name for item in HALL.objects} - {"fridge"}
    drawn = sum(len(node.faces) for node in room._batches.nodes)
    parts = [part for item in HALL.objects for part in room._batched[item.name]]
    assert drawn == sum(len(part.surface.faces) for part in parts if part.object != "fridge")
    assert all(len(node.faces) <= MAX_MERGED for node in room._batches.nodes)


@pytest.mark.parametrize(("checked", "hulls"), [("box", 12), ("ball", 1280)])
def test_a_complex_object_in_a_large_room_is_drawn_with_few_triangles(
    room: RoomView, tmp_path: Path, checked: str, hulls: int
) -> None:
    shapes = {"box": '<box size="1 1 1"/>', "ball": '<mesh filename="ball.obj"/>'}
    trimesh.creation.icosphere(3, 0.5).export(tmp_path / "ball.obj")
    (tmp_path / "ball.urdf").write_text(
        '<robot name="ball"><link name="base">'
        f"<visual><geometry>{shapes['ball']}</geometry></visual>"
        f"<collision><geometry>{shapes[checked]}</geometry></collision></link></robot>"
    )
    ball = SceneObject.from_urdf("ball", tmp_path / "ball.urdf", (3.0, -4.0, 0.5))
    scene = Scene("hall", (*HALL.objects, ball))

    def triangles() -> int:
        return sum(len(part.surface.faces) for part in room._batched["ball"])

    room.show(scene, "fridge")
    assert triangles() == 12
    corners = room._batched["ball"][0].surface.vertices
    np.testing.assert_allclose(np.stack([corners.min(0), corners.max(0)]), ball.bounds, atol=1e-3)
    room.show(scene, "fridge", collision=True)
    assert triangles() == hulls  # collision shapes are always complete
    room.show(scene, "ball", collision=False)
    assert (
        sum(len(node.faces) for node in room._nodes["ball"]) == 1280
    )  # the active object is complete


def test_a_surface_with_many_triangles_has_its_own_node() -> None:
    def part(name: str, count: int, color: int = 0) -> ColoredSurface:
        return ColoredSurface(
            name, Surface(np.eye(3), np.tile([0, 1, 2], (count, 1))), (color, 0, 0)
        )

    small, large, other = part("small", 10), part("large", MAX_MERGED + 1), part("other", 1, 9)
    assert batched([small, large, small, other]) == [[small], [large], [small], [other]]
    half = part("half", MAX_MERGED // 2)
    assert batched([half, other, half, half]) == [[half, half], [half], [other]]
    assert batched([]) == []


def test_a_new_active_object_in_a_large_room_leaves_most_nodes_unchanged(room: RoomView) -> None:
    room.show(HALL, "crate_7")
    before = room._batches.nodes
    room.show(HALL, "crate_8")
    assert "crate_7" in batched_objects(room)
    assert "crate_8" not in batched_objects(room)
    assert (
        sum(one is not other for one, other in zip(before, room._batches.nodes, strict=True)) == 1
    )
    room.show(KITCHEN, "fridge")
    assert room._batches.nodes == ()
    assert all(room._nodes[item.name] for item in KITCHEN.objects)


def test_a_click_in_a_large_room_picks_the_first_object_on_its_ray(
    room: RoomView, picked: list[str]
) -> None:
    room.show(HALL, "crate_45")
    rng = np.random.default_rng(0)
    for x, y in rng.integers([6, 0], [40, 25], (20, 2)).tolist():
        down = SimpleNamespace(ray_origin=(x, y, 5.0), ray_direction=(0.0, 0.0, -1.0))
        room._batches._clicked(down)
        assert picked.pop() == f"crate_{40 * y + x}"
        along = SimpleNamespace(ray_origin=(x, -50.0, 0.5), ray_direction=(0.0, 1.0, 0.0))
        room._batches._clicked(along)
        assert picked.pop() == f"crate_{x}"
    up = SimpleNamespace(ray_origin=(0.3, -20.0, 0.6), ray_direction=(0.0, 0.0, 1.0))
    room._batches._clicked(up)
    # The active object hides those behind it.
    active = SimpleNamespace(ray_origin=(5.0, 1.0, 5.0), ray_direction=(0.0, 0.0, -1.0))
    room._batches._clicked(active)
    assert picked == []


def test_a_ray_hits_the_nearest_object() -> None:
    rng = np.random.default_rng(1)
    parts = [
        ColoredSurface(item.name, Surface(*_soup(rng)), (0, 0, 0)) for item in crates(30)
    ]  # fmt: skip
    for _ in range(200):
        origin, direction = rng.uniform(-3, 3, 3), rng.normal(size=3)
        best, name = np.inf, ""
        for part in parts:
            for a, b, c in part.surface.vertices[part.surface.faces]:
                m = np.stack([b - a, c - a, -direction], 1)
                if np.linalg.det(m) > 1e-12:  # front side
                    u, v, t = np.linalg.solve(m, origin - a)
                    if min(u, v, t) >= 0 and u + v <= 1 and t < best:
                        best, name = t, part.object
        hit = object_hit(parts, SimpleNamespace(ray_origin=origin, ray_direction=direction))
        assert (hit is None) == (name == "")
        if hit is not None:
            assert hit[0] == name
            np.testing.assert_allclose(hit[1], origin + best * direction)


def _soup(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Return random triangles."""
    return rng.uniform(-1, 1, (12, 3)) + rng.uniform(-3, 3, 3), np.arange(12).reshape(4, 3)


def test_a_new_active_object_redraws_only_itself_and_the_last_one(room: RoomView) -> None:
    room.show(KITCHEN, "fridge")
    before = dict(room._nodes)
    room.show(KITCHEN, "oven")
    again = {name for name, nodes in room._nodes.items() if nodes is not before[name]}
    assert again == {"fridge", "oven"}
    assert {key.partition("|")[0] for key in room._links} <= set(KITCHEN.object("oven").model.links)


def test_a_room_with_another_drawer_state_redraws_only_that_cabinet(room: RoomView) -> None:
    room.show(KITCHEN, "fridge")
    before = dict(room._nodes)
    room.show(KITCHEN.with_joint(*DRAWER, 0.3), "fridge")
    again = {name for name, nodes in room._nodes.items() if nodes is not before[name]}
    assert again == {DRAWER[0], " floor"}  # the outline of the floor may depend on the objects


def test_an_open_door_stays_open_when_its_collision_shapes_are_drawn(room: RoomView) -> None:
    def doors() -> np.ndarray:
        return np.array([[*node.position, *node.wxyz] for node in room._links.values()])

    room.show(KITCHEN, "fridge")
    closed = doors()
    room.move({"door_hinge": 1.0})
    opened = doors()
    assert np.abs(opened - closed).max() > 0.3
    room.show(KITCHEN, "fridge", collision=True)
    room.show(KITCHEN, "fridge", collision=False)
    np.testing.assert_allclose(doors(), opened)
    room.show(KITCHEN, "oven")
    room.show(KITCHEN, "fridge")
    np.testing.assert_allclose(doors(), closed)


@pytest.mark.parametrize("joint", ["door_hinge", "freezer_door_hinge"])
def test_only_the_part_of_the_task_has_the_color_of_the_moving_part(
    room: RoomView, joint: str
) -> None:
    fridge = KITCHEN.object("fridge")
    room.show(KITCHEN, "fridge", joint)
    bodies = {key[:-5]: node for key, node in room._links.items() if key.endswith("|body")}
    colored = {link for link, node in bodies.items() if tuple(node.color) == rgb(colors.PART)}
    assert colored == set(fridge.model.moved_by(joint)) & set(bodies)
    assert colored
    room.show(KITCHEN, "fridge")
    every = {link for name in fridge.model.joints for link in fridge.model.moved_by(name)}
    bodies = {key[:-5]: node for key, node in room._links.items() if key.endswith("|body")}
    colored = {link for link, node in bodies.items() if tuple(node.color) == rgb(colors.PART)}
    assert colored == every & set(bodies)


def test_a_movable_object_can_be_active_after_a_drawer(room: RoomView) -> None:
    room.show(KITCHEN, DRAWER[0])
    room.show(KITCHEN, "cup")
    T = np.eye(4)
    T[:3, 3] = (1.0, 2.0, 3.0)
    room.carry(T)
    room.move({})  # it has no joint
    (node,) = room._nodes["cup"]
    root = KITCHEN.object("cup").link_poses()[KITCHEN.object("cup").model.urdf.root]
    np.testing.assert_allclose(np.array(node.position), T[:3, 3] - root[:3, 3], atol=1e-6)
