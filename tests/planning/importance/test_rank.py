"""Importance: scores in (0, 1], 1 for the target, reproducible with a seed, never NaN."""

from __future__ import annotations

import itertools
import os
import subprocess
import sys
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from tests.commands import json_of
from tests.planning.importance.small_rooms import box, room
from tests.rooms import move_scene
from tests.shapes import unchecked

import momapos
from momapos.core.errors import InputError, UnknownNameError
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.model.scene.scene_files import load_scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.importance.config import GraphConfig, ImportanceConfig, ScorerName
from momapos.planning.importance.ranking import Selection, rank
from momapos.planning.importance.scene_graph import KINDS
from momapos.planning.importance.scorers import KNEE, MIN_SCORE, SCORERS, score_of_cosine, words
from momapos.planning.keyword_forms import plan_base_placement

WALKS = ImportanceConfig(
    scorer="deepwalk", weights="scaled", exceed=False, graph=GraphConfig(edges="near")
)
PRINT = (
    "from momapos.model.scene import load_scene; from momapos.planning.importance import rank;"
    "from momapos.planning.importance.config import ImportanceConfig as C;"
    "room = load_scene('kitchen_island');"
    "print(*(rank(room, 'cup', C(scorer=s), seed=3).scores.tobytes().hex()"
    " for s in ('deepwalk', 'reach', 'names')))"
)


def crowd(count: int, seed: int = 0) -> Scene:
    rng = np.random.default_rng(seed)
    side = 0.8 * np.sqrt(count)
    return room(
        *(
            box(f"b{k}", tuple(rng.uniform(0.1, 0.8, 3)), (*rng.uniform(0, side, 2), 0.0))
            for k in range(count)
        )
    )


@pytest.mark.parametrize("scorer", SCORERS)
@pytest.mark.parametrize("kitchen", ["kitchen_small", "kitchen_island"])
def test_scores_are_in_0_to_1_and_the_target_comes_first_with_1(scorer: str, kitchen: str) -> None:
    scene = load_scene(kitchen)
    for item in scene.objects[::4]:
        found = rank(scene, item.name, ImportanceConfig(scorer=scorer))
        assert found.names[0] == item.name
        assert found.scores[0] == 1.0
        assert (found.scores > 0).all()
        assert (found.scores <= 1).all()
        assert (np.diff(found.scores[1:]) <= 0).all()
        assert sorted(found.names) == sorted(o.name for o in scene.objects)


def test_s_grows_as_alpha_falls_and_contains_all_objects_at_zero(kitchen: Scene) -> None:
    found = rank(kitchen, "fridge", WALKS)
    sets = [set(found.selected(alpha)) for alpha in (1.0, 0.7, 0.45, 0.2, 0.0)]
    assert all(a <= b for a, b in itertools.pairwise(sets))
    assert "fridge" in sets[0]
    assert sets[-1] == set(found.names)
    assert found.selected() == found.selected(found.alpha)


def test_with_exceed_a_score_equal_to_alpha_is_not_in_s_but_the_target_always_is(
    kitchen: Scene,
) -> None:
    reaches, exceeds = (rank(kitchen, "fridge", replace(WALKS, exceed=e)) for e in (False, True))
    alpha = float(reaches.scores[3])
    equal = set(np.array(reaches.names)[reaches.scores == alpha])
    assert set(reaches.selected(alpha)) - set(exceeds.selected(alpha)) == equal
    assert exceeds.selected(1.0) == ("fridge",)
    assert set(exceeds.selected(0.0)) == set(exceeds.names)
    selection = Selection(exceeds, 1.0)
    while selection.boxes:
        lower = selection.relax_alpha()
        assert set(lower.names) > set(selection.names)
        selection = lower


def test_with_edges_of_support_the_graph_has_the_paper_s_relations_only(kitchen: Scene) -> None:
    found = rank(kitchen, "fridge", replace(WALKS, graph=GraphConfig(edges="support")))
    assert {KINDS[kind] for kind in found.graph.kind} <= {"on", "in", "inside"}
    assert found.names[0] == "fridge"
    assert (found.scores > 0).all()


def test_every_object_is_in_s_for_some_alpha_above_zero() -> None:
    """Lemma 1 of the paper requires this of a score."""
    found = rank(load_scene("kitchen_island"), "cup", WALKS)
    assert set(found.selected(MIN_SCORE)) == set(found.names)


def test_the_same_seed_gives_the_same_scores_and_another_seed_others(kitchen: Scene) -> None:
    a, b, c = (rank(kitchen, "fridge", WALKS, seed=seed) for seed in (5, 5, 6))
    assert a.names == b.names
    assert np.array_equal(a.scores, b.scores)
    assert not np.array_equal(a.scores, c.scores)


def test_scores_depend_neither_on_the_hash_seed_nor_on_the_processor() -> None:
    def scores(**change: str) -> str:
        done = subprocess.run(
            [sys.executable, "-c", PRINT], capture_output=True, text=True, check=True,
            env={**os.environ, **change},
        )  # fmt: skip
        return done.stdout

    kitchen = load_scene("kitchen_island")
    raw = [
        rank(kitchen, "cup", ImportanceConfig(scorer=name), seed=3).scores.tobytes().hex()
        for name in ("deepwalk", "reach", "names")
    ]
    here = " ".join(raw) + "\n"
    assert scores(PYTHONHASHSEED="1") == here
    assert scores(PYTHONHASHSEED="2", OPENBLAS_CORETYPE="Nehalem") == here


def test_moving_and_turning_the_whole_scene_does_not_change_s(kitchen: Scene) -> None:
    for scorer in SCORERS:
        config = ImportanceConfig(scorer=scorer)
        moved = rank(move_scene(kitchen, 3.0, -2.0, 0.7), "fridge", config)
        assert set(moved.selected()) == set(rank(kitchen, "fridge", config).selected())


def test_noise_between_seeds_is_small_relative_to_the_spread_of_scores(kitchen: Scene) -> None:
    runs = [rank(kitchen, "fridge", WALKS, seed=seed) for seed in range(5)]
    scores = np.array([[run.score(item.name) for item in kitchen.objects] for run in runs])
    assert scores.std(axis=0).mean() < 0.05 < scores.mean(axis=0).std()


def test_a_near_object_is_more_important_than_a_far_one() -> None:
    line = room(*(box(f"b{k}", (0.5, 0.5, 0.8), (0.6 * k, 0, 0)) for k in range(12)))
    config = ImportanceConfig(graph=GraphConfig(neighbors=2, near=0.3))
    for scorer in ("deepwalk", "distance", "size"):
        found = rank(line, "b0", replace(config, scorer=scorer))
        scores = [found.score(f"b{k}") for k in (1, 5, 10)]
        assert scores == sorted(scores, reverse=True)


def test_an_unrelated_object_gets_the_lowest_score() -> None:
    scene = room(*(box(f"b{k}", (0.5, 0.5, 0.5), (5.0 * k, 0, 0)) for k in range(4)))
    found = rank(scene, "b1", WALKS)
    assert found.names[0] == "b1"
    assert found.scores.tolist() == [1.0, MIN_SCORE, MIN_SCORE, MIN_SCORE]
    assert found.relations == ("", "", "", "")
    assert found.steps == (0, -1, -1, -1)
    assert found.selected() == ("b1",)


@pytest.mark.parametrize("scorer", SCORERS)
def test_a_single_object_scores_one(scorer: str) -> None:
    found = rank(room(box("b", (1, 1, 1), (0, 0, 0))), "b", ImportanceConfig(scorer=scorer))
    assert found.names == ("b",)
    assert found.scores.tolist() == [1.0]


@pytest.mark.parametrize("scorer", SCORERS)
def test_a_thousand_objects_at_one_position_have_finite_scores(scorer: str) -> None:
    model = box("b", (0.3, 0.3, 0.3), (0, 0, 0))
    scene = room(*(replace(model, name=f"b{k}") for k in range(1000)))
    found = rank(scene, "b7", ImportanceConfig(scorer=scorer, walks=2, epochs=1))
    assert np.isfinite(found.scores).all()
    assert (found.scores > 0).all()
    assert found.names[0] == "b7"


@settings(max_examples=10)
@given(st.integers(1, 40), st.integers(0, 1000), st.sampled_from([0.0, 0.5, 1.0]))
def test_no_random_scene_gives_a_nan(count: int, seed: int, k0: float) -> None:
    found = rank(crowd(count, seed), "b0", replace(WALKS, k0=k0, walks=2, epochs=1))
    assert np.isfinite(found.scores).all()
    assert found.scores[0] == 1.0


def test_relations_are_from_the_object_to_the_target(kitchen: Scene) -> None:
    found = rank(kitchen, "counter", WALKS)
    relations = dict(zip(found.names, found.relations, strict=True))
    assert relations["microwave"] == "on"
    assert relations["cabinet_left"] == "carries"
    assert relations["oven"] == "near"
    assert relations["counter"] == ""


@pytest.mark.parametrize("name", ["alpha", "k0"])
@pytest.mark.parametrize("value", [-0.1, 1.1, float("nan"), float("inf")])
def test_alpha_and_k0_outside_zero_to_one_are_refused_in_one_line(
    name: str, value: float, kitchen: Scene
) -> None:
    wrong = rf"^ImportanceConfig.{name} must be (from 0 to 1|a number), not .*$"
    with pytest.raises(InputError, match=wrong):
        ImportanceConfig(**{name: value})
    with pytest.raises(InputError):
        rank(kitchen, "fridge", WALKS).selected(2.0)


@pytest.mark.parametrize(
    "wrong", [{"walks": 0}, {"length": 1}, {"window": 0}, {"epochs": 10**9}, {"scorer": "best"}]
)
def test_invalid_counts_and_scorers_are_refused(wrong: dict[str, object]) -> None:
    with pytest.raises(InputError), unchecked():
        ImportanceConfig(**wrong)  # type: ignore[arg-type]


def test_unknown_objects_and_invalid_seeds_are_refused(kitchen: Scene) -> None:
    with pytest.raises(UnknownNameError, match="did you mean fridge"):
        rank(kitchen, "fridg")
    for seed in (-1, 2**32):
        with pytest.raises(InputError, match="seed"):
            rank(kitchen, "fridge", seed=seed)


@given(st.lists(st.floats(-1, 1), min_size=2, max_size=9))
def test_scores_keep_the_order_of_the_cosines(values: list[float]) -> None:
    cosines = np.sort(np.array(values))
    scores = score_of_cosine(cosines)
    assert (np.diff(scores) >= 0).all()
    assert ((scores > 0) & (scores <= 1)).all()
    assert np.array_equal(scores[cosines >= KNEE], cosines[cosines >= KNEE])


def test_words_of_a_name_are_lower_case_without_digits() -> None:
    assert words("elementB2", "range hood") == ("range", "hood", "element", "b")
    assert words("42", "") == ("42",)


def test_the_names_scorer_does_not_depend_on_positions(kitchen: Scene) -> None:
    cup = kitchen.object("cup")
    away = replace(cup, T_world_object=cup.T_world_object + np.diag([1.0, 1.0, 1.0], 1))
    other = replace(kitchen, objects=tuple(away if o is cup else o for o in kitchen.objects))
    config = ImportanceConfig(scorer="names")
    assert rank(other, "fridge", config).score("cup") == rank(kitchen, "fridge", config).score(
        "cup"
    )


def test_an_object_matters_more_the_larger_and_the_nearer_to_the_hand_s_path_it_is() -> None:
    """A box at the path scores 1 regardless of its size."""
    scene = room(
        box("target", (0.5, 0.5, 0.5), (0.0, 3.0, 0.0)),
        box("at", (0.1, 0.1, 0.1), (0.0, 0.0, 0.0)),
        box("near", (0.5, 0.5, 0.5), (1.0, 0.0, 0.0)),
        box("far", (0.5, 0.5, 0.5), (2.0, 0.0, 0.0)),
        box("small", (0.1, 0.1, 0.1), (-1.0, 0.0, 0.0)),
    )
    path = np.array([[0.0, 0.0, 0.05], [0.0, 0.02, 0.05]])
    found = rank(scene, "target", ImportanceConfig(scorer="reach"), path=path)
    assert found.score("at") == 1.0
    assert found.score("near") > found.score("far") > found.score("small")
    middle = np.array([scene.object("target").box_proxy.T_world_object[:3, 3]])
    assert rank(scene, "target").by_name == rank(scene, "target", path=middle).by_name


@pytest.mark.parametrize(
    ("name", "target", "joint"),
    [
        ("kitchen_small", "fridge", None), ("kitchen_small", "fridge", "door_hinge"),
        ("kitchen_small", "cabinet_right", "drawer_top_slide"), ("kitchen_small", "cup", None),
        ("kitchen_island", "dishwasher", None),
    ],
)  # fmt: skip
@pytest.mark.parametrize("scorer", ["reach", "size"])
def test_python_and_the_command_line_give_the_same_scores(
    name: str, target: str, joint: str | None, scorer: ScorerName
) -> None:
    words = ["rank", name, target if joint is None else f"{target}/{joint}", "--json"]
    words += ["--scorer", scorer] if scorer != "reach" else []
    printed = {one["name"]: one["score"] for one in json_of(*words)["objects"]}
    config = ImportanceConfig(scorer=scorer) if scorer != "reach" else None
    assert momapos.rank(load_scene(name), target, config, joint=joint).by_name == printed


def test_the_scores_of_the_planner_are_those_of_its_task(kitchen: Scene, segway: Robot) -> None:
    key = plan_base_placement(
        kitchen, segway, make_task(kitchen, "open", "fridge/door_hinge")
    ).plan.key_objects
    assert dict(key.scores) == rank(kitchen, "fridge", joint="door_hinge").by_name
