"""Relations from geometry: on, in, inside, near; tolerances, rotated, stacked, hollow objects."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.sparse import csgraph
from scipy.spatial import cKDTree
from tests.planning.importance.small_rooms import (
    SHELF_TOP,
    UP,
    assembly,
    bowl,
    box,
    drawers,
    edges,
    fridge,
    hierarchy,
    link,
    room,
)
from tests.rooms import move_scene

from momapos.core.errors import InputError, MomaposError, SceneError
from momapos.core.geometry.transforms import pose, rotation_about
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.model.scene.scene_object import upright_boxes
from momapos.model.urdf.reader import Link
from momapos.planning.importance.config import GraphConfig
from momapos.planning.importance.scene_graph import build_graph, neighbors, outline_gaps

TABLE = box("table", (1.0, 0.6, 0.7), (0, 0, 0))


def tall(name: str, x: float, y: float, z: float, yaw: float = 0.0):
    return box(name, (0.08, 0.08, 0.2), (x, y, z), yaw)


def test_a_stack_of_three_is_a_chain_of_on_relations() -> None:
    stack = room(TABLE, box("tray", (0.4, 0.3, 0.03), (0, 0, 0.7)), tall("cup", 0, 0, 0.73))
    assert hierarchy(stack) == {("tray", "on", "table"), ("cup", "on", "tray")}


def test_a_stack_of_plates_thinner_than_the_tolerance_is_a_chain_too() -> None:
    plates = [box(f"plate{k}", (0.2, 0.2, 0.01), (0, 0, 0.7 + 0.01 * k)) for k in range(4)]
    assert hierarchy(room(TABLE, *plates)) == {
        ("plate0", "on", "table"), ("plate1", "on", "plate0"), ("plate2", "on", "plate1"),
        ("plate3", "on", "plate2"),
    }  # fmt: skip


@pytest.mark.parametrize(("gap", "rests"), [(-0.019, 1), (0.0, 1), (0.019, 1), (0.021, 0)])
def test_surfaces_touch_within_two_centimeters(gap: float, rests: bool) -> None:
    found = hierarchy(room(TABLE, tall("cup", 0, 0, 0.7 + gap)))
    assert found == ({("cup", "on", "table")} if rests else set())


@pytest.mark.parametrize("yaw", [0.0, 0.4, np.pi / 2, 2.9])
def test_a_rotated_box_carries_only_what_its_rotated_outline_overlaps(yaw: float) -> None:
    turned = box("table", (1.0, 0.2, 0.7), (0, 0, 0), yaw)
    along, across = np.array([np.cos(yaw), np.sin(yaw)]), np.array([-np.sin(yaw), np.cos(yaw)])
    on = tall("cup", *(0.45 * along), 0.7)
    off = tall("mug", *(0.2 * across), 0.7)
    assert hierarchy(room(turned, on, off)) == {("cup", "on", "table")}


def test_a_board_over_two_cabinets_rests_on_both() -> None:
    scene = room(
        box("left", (0.6, 0.6, 0.86), (-0.3, 0, 0)), box("right", (0.6, 0.6, 0.86), (0.3, 0, 0)),
        box("board", (1.2, 0.6, 0.04), (0, 0, 0.86)),
    )  # fmt: skip
    assert hierarchy(scene) == {("board", "on", "left"), ("board", "on", "right")}


@pytest.mark.parametrize("opening", [0.0, 1.57])
def test_an_object_on_the_shelf_of_a_fridge_is_inside_it(opening: float) -> None:
    scene = room(fridge(opening), tall("milk", 0.1, 0, SHELF_TOP))
    assert hierarchy(scene) == {("milk", "inside", "fridge")}


def test_an_object_on_top_of_a_fridge_is_on_it() -> None:
    assert hierarchy(room(fridge(), tall("box", 0, 0, 1.6))) == {("box", "on", "fridge")}


def test_an_object_below_an_open_door_is_not_inside() -> None:
    before = tall("bin", 0.1, -0.6, 0.0)
    assert hierarchy(room(fridge(1.57), before)) == set()


def test_an_object_in_a_drawer_is_in_it_when_open_and_inside_when_closed() -> None:
    fork = box("fork", (0.1, 0.1, 0.05), (0, 0, 0.32))
    assert hierarchy(room(drawers(), fork)) == {("fork", "inside", "drawers")}
    out = replace(fork, T_world_object=pose((0, -0.5, 0)) @ fork.T_world_object)
    assert hierarchy(room(drawers(0.5), out)) == {("fork", "in", "drawers")}


def test_an_apple_in_a_bowl_on_a_table_is_in_the_bowl_only() -> None:
    apple = box("apple", (0.07, 0.07, 0.07), (0.02, 0, 0.71))
    assert hierarchy(room(TABLE, bowl((0, 0, 0.7)), apple)) == {
        ("bowl", "on", "table"), ("apple", "in", "bowl"),
    }  # fmt: skip


def test_a_bowl_with_an_apple_in_a_fridge_is_a_chain() -> None:
    apple = box("apple", (0.07, 0.07, 0.07), (0, 0, SHELF_TOP + 0.01))
    assert hierarchy(room(fridge(), bowl((0, 0, SHELF_TOP)), apple)) == {
        ("bowl", "inside", "fridge"), ("apple", "in", "bowl"),
    }  # fmt: skip


def test_a_stool_under_a_table_is_neither_in_it_nor_on_it() -> None:
    legs = [((0.05, 0.05, 0.7), (x, y, 0.35)) for x in (-0.45, 0.45) for y in (-0.25, 0.25)]
    table = assembly("table", [link("table", ((1.0, 0.6, 0.03), (0, 0, 0.715)), *legs)], [])
    assert edges(room(table, box("stool", (0.3, 0.3, 0.4), (0, 0, 0)))) == {
        ("stool", "near", "table")
    }


def test_a_cup_on_a_counter_below_wall_cabinets_is_on_it_and_not_inside() -> None:
    """The whole row is one model, as in many kitchens."""
    row = link(
        "row", ((2.0, 0.6, 0.9), (0, 0, 0.45)), ((2.0, 0.35, 0.7), (0, 0.12, 1.75)),
        ((2.0, 0.02, 2.1), (0, 0.31, 1.05)),
    )  # fmt: skip
    scene = room(assembly("row", [row], []), tall("cup", 0.3, 0.1, 0.9))
    assert hierarchy(scene) == {("cup", "on", "row")}


@settings(max_examples=25)
@given(
    st.floats(-5, 5), st.floats(-5, 5), st.floats(-np.pi, np.pi), st.floats(0, 1.5)
)  # fmt: skip
def test_moving_and_turning_the_whole_scene_changes_no_relation(
    x: float, y: float, yaw: float, opening: float
) -> None:
    scene = room(
        fridge(opening), tall("milk", 0.1, 0, SHELF_TOP),
        box("table", (1.0, 0.6, 0.7), (1.6, 0.3, 0), 0.3), bowl((1.6, 0.3, 0.7)),
        box("apple", (0.07, 0.07, 0.07), (1.6, 0.3, 0.71), 1.0), tall("cup", 1.3, 0.2, 0.7, 0.5),
    )  # fmt: skip
    assert edges(move_scene(scene, x, y, yaw)) == edges(scene)


def test_only_the_nearest_within_reach_are_near() -> None:
    line = [box(f"b{k}", (0.2, 0.2, 0.2), (x, 0, 0)) for k, x in enumerate((0.0, 0.5, 1.2, 3.0))]
    config = GraphConfig(neighbors=1, near=1.0)
    assert edges(room(*line), config) == {("b0", "near", "b1"), ("b1", "near", "b2")}


@settings(max_examples=25)
@given(st.integers(0, 10_000))
def test_gaps_between_boxes_agree_with_points_sampled_on_their_outlines(seed: int) -> None:
    rng = np.random.default_rng(seed)
    sizes, places = rng.uniform(0.1, 1.5, (2, 3)), rng.uniform(-1.5, 1.5, (2, 2))
    items = [box(f"b{k}", tuple(sizes[k]), (*places[k], 0.0), rng.uniform(-3, 3)) for k in range(2)]
    side = np.linspace(-1, 1, 81)
    outlines = [
        (np.stack(np.meshgrid(side, side), -1).reshape(-1, 2) * size[:2] / 2)
        @ item.T_world_object[:2, :2].T + item.T_world_object[:2, 3]
        for item, size in zip(items, sizes, strict=True)
    ]  # fmt: skip
    sampled = cKDTree(outlines[0]).query(outlines[1])[0].min()
    gap = outline_gaps(upright_boxes(room(*items).objects), 0)[1]
    assert gap <= sampled + 1e-6
    assert gap >= sampled - 0.03


@settings(max_examples=15)
@given(st.floats(-5, 5), st.floats(-5, 5), st.floats(-np.pi, np.pi))
def test_turning_a_row_of_touching_cabinets_changes_no_neighbor(
    x: float, y: float, yaw: float
) -> None:
    row = [box(f"c{k}", (0.6, 0.6, 0.9), (0.6 * k, 0, 0)) for k in range(8)]
    scene = room(
        *row, box("top", (4.8, 0.6, 0.04), (2.1, 0, 0.9)), box("wall", (6, 0.1, 2), (2, 0.35, 0))
    )
    assert edges(move_scene(scene, x, y, yaw)) == edges(scene)


def test_the_neighbors_are_those_of_a_full_search() -> None:
    rng = np.random.default_rng(1)
    items = [
        box(f"b{k}", tuple(size), tuple(rng.uniform(-2, 2, 3)), rng.uniform(-3, 3))
        for k, size in enumerate(rng.uniform(0.1, 0.6, (40, 3)))
    ]
    box_ = upright_boxes(room(*items).objects)
    expected = set()
    for i in range(40):
        rise = np.abs(box_.center[:, 2] - box_.center[i, 2]) - box_.half[:, 2] - box_.half[i, 2]
        gap = np.hypot(outline_gaps(box_, i), np.maximum(rise, 0.0))
        gap[i] = np.inf
        order = [j for j in np.argsort(gap, kind="stable")[:3] if gap[j] <= 1.0]
        expected |= {(min(i, int(j)), max(i, int(j))) for j in order}
    assert {tuple(row) for row in neighbors(box_, count=3, reach=1.0).tolist()} == expected


def test_two_objects_have_at_most_one_relation() -> None:
    for name in ("kitchen_small", "kitchen_island"):
        graph = build_graph(load_scene(name))
        pairs = [tuple(sorted(p)) for p in zip(graph.child, graph.parent, strict=True)]
        assert len(pairs) == len(set(pairs))
        assert (graph.child != graph.parent).all()


def test_built_in_kitchens_have_the_visible_relations(kitchen: Scene) -> None:
    found = hierarchy(kitchen)
    assert found == {
        ("counter", "on", "cabinet_left"), ("counter", "on", "dishwasher"),
        ("counter", "on", "cabinet_right"), ("microwave", "on", "counter"),
        ("cereal_box", "on", "counter"), ("bottle", "on", "counter"), ("cup", "on", "table"),
        ("apple", "on", "table"),
    }  # fmt: skip


def test_real_kitchens_have_the_visible_relations(shared: Path) -> None:
    derived, scenes = shared / "bestman/derived", shared / "bestman/Asset/Scene/Scene"
    assert hierarchy(load_scene(derived / "MoMa_Kitchen.json")) == {
        ("elementD", "on", "elementA"), ("Bowl_Target", "inside", "elementE"),
    }  # fmt: skip
    assert hierarchy(load_scene(scenes / "b512.json")) == {("Mic", "on", "Table")}
    assert hierarchy(load_scene(scenes / "Kitchen.json")) == {("microwave", "on", "elementA")}
    table = {(c, k) for c, k, p in hierarchy(load_scene(derived / "kitchen_v2.json"))}
    fruit = {("Peach", "on"), ("Banana", "on"), ("Lemon", "on"), ("mug", "on"), ("sugar_box", "on")}
    assert table >= fruit


def test_a_long_countertop_rests_on_every_narrow_cabinet_below_it() -> None:
    cabinets = [box(f"c{k}", (0.4, 0.6, 0.86), (0.4 * k, 0, 0)) for k in range(10)]
    found = hierarchy(room(*cabinets, box("top", (4.0, 0.6, 0.04), (1.8, 0, 0.86))))
    assert found == {("top", "on", f"c{k}") for k in range(10)}


def test_an_object_without_geometry_is_a_point() -> None:
    bare = assembly("marker", [Link("marker", (), ())], [])
    graph = build_graph(room(bare, TABLE))
    assert np.isfinite(graph.dist_xy).all()
    assert (graph.upright.half[0] < 1e-3).all()


def test_distances_and_sizes_are_never_zero() -> None:
    same = [box(f"b{k}", (0.1, 0.1, 0.1), (0, 0, 0)) for k in range(3)]
    graph = build_graph(room(*same))
    assert (graph.dist_xy == 0.1).all()
    assert (graph.size > 0).all()


def test_a_scene_without_objects_and_invalid_tolerances_are_refused() -> None:
    with pytest.raises(SceneError, match="no objects"):
        build_graph(Scene("empty", ()))
    for wrong in ({"near": -1.0}, {"neighbors": -1}, {"contact": 0.0}, {"floor": float("nan")}):
        with pytest.raises(InputError):
            GraphConfig(**wrong)


def test_an_unknown_object_is_reported_with_the_nearest_name() -> None:
    with pytest.raises(MomaposError, match="did you mean table"):
        build_graph(room(TABLE)).index("tabel")


def test_an_object_on_its_side_rests_on_the_object_below() -> None:
    lying = tall("bottle", 0, 0, 0.7)
    T = pose(
        (0, 0, 0.74), rotation_about(UP, 0.6) @ rotation_about(np.array([0, 1.0, 0]), np.pi / 2)
    )
    assert hierarchy(room(TABLE, replace(lying, T_world_object=T))) == {("bottle", "on", "table")}


def test_steps_are_the_shortest_path_lengths_over_the_edges() -> None:
    for name in ("kitchen_small", "kitchen_island"):
        graph = build_graph(load_scene(name))
        lengths = csgraph.shortest_path(graph.adjacency, unweighted=True)
        expected = np.where(np.isfinite(lengths), lengths, -1)
        for target in range(len(graph)):
            np.testing.assert_array_equal(graph.steps(target), expected[target])
