"""Laws of tours that choose how far they open parts."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest
from tests.rooms import cabinet_room

from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning import chains
from momapos.planning.chains import plan_chain, without_part
from momapos.planning.config import PipelineConfig
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.placement.config import PlaceConfig
from momapos.planning.plan import plan_placement
from momapos.planning.query import PlacementQuery
from momapos.planning.result import PlacementResult
from momapos.planning.tour import Request, Tour, plan_requests

CONFIG = PipelineConfig(place=PlaceConfig(grid=False), timeout=300.0)
DRAWER = ("cabinet_right", "drawer_middle_slide")
MUG = ', {{"name": "mug", "pose": {{"xyz": [{x}, -0.1, {z}]}}, "box": [0.06, 0.06, 0.1]}}'


def infeasible(answer: PlacementResult) -> PlacementResult:
    plan = replace(answer.plan, status="infeasible", motion=None, base_pose=None)
    return replace(answer, plan=plan)


def refuse_beyond(limit: float, monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the last task fail if the drawer is open wider, as if it were in the way."""

    def stops(query: PlacementQuery, requests: Sequence[Request]) -> Tour:
        tour = plan_requests(query, requests)
        to = tour.steps[0].plan.task.to
        if to is None or to <= limit + 1e-9:
            return tour
        return replace(tour, steps=(*tour.steps[:-1], infeasible(tour.steps[-1])))

    def placement(query: PlacementQuery) -> PlacementResult:
        found, item = plan_placement(query), query.scene.object(DRAWER[0])
        bare = not any(item.model.hulls[link] for link in item.model.moved_by(DRAWER[1]))
        return found if bare or item.values()[DRAWER[1]] <= limit + 1e-9 else infeasible(found)

    monkeypatch.setattr(chains, "plan_requests", stops)
    monkeypatch.setattr(chains, "plan_placement", placement)


def chain(scene: Scene, robot: Robot, requests: Sequence[Request]) -> Tour:
    query = PlacementQuery.of(scene, robot, make_task(scene, *requests[0]), config=CONFIG)
    return plan_chain(query, requests)


def test_a_drawer_opens_to_the_value_nearest_to_the_usual_one_that_the_next_task_allows(
    segway: Robot, monkeypatch: pytest.MonkeyPatch, kitchen: Scene
) -> None:
    usual = make_task(kitchen, "open", *DRAWER).to
    refuse_beyond(0.7 * usual, monkeypatch)
    requests = [Request("open", *DRAWER), Request("pick", "bottle"), Request("close", *DRAWER)]
    tour = chain(kitchen, segway, requests)
    assert tour.status == "solved"
    assert len(tour.steps) == len(requests)
    first = tour.steps[0]
    assert first.plan.task.to == pytest.approx(5 / 8 * usual)
    words = f"opened to {62.5 * usual:.0f} cm, not to {100 * usual:.0f} cm, for pick bottle"
    assert first.notes[-1] == words
    assert tour.steps[-1].plan.motion.object_q[0] == pytest.approx(5 / 8 * usual)


def test_a_value_that_the_user_names_is_kept(
    segway: Robot, monkeypatch: pytest.MonkeyPatch, kitchen: Scene
) -> None:
    refuse_beyond(0.2, monkeypatch)
    tour = chain(kitchen, segway, [Request("open", *DRAWER, 0.3), Request("pick", "bottle")])
    assert tour.status == "infeasible"
    assert tour.steps[0].plan.task.to == 0.3


def test_no_other_value_is_tried_for_what_is_out_of_reach_without_the_part(
    tmp_path: Path, segway: Robot, monkeypatch: pytest.MonkeyPatch
) -> None:
    tours: list[Sequence[Request]] = []

    def counted(query: PlacementQuery, requests: Sequence[Request]) -> Tour:
        tours.append(requests)
        return plan_requests(query, requests)

    monkeypatch.setattr(chains, "plan_requests", counted)
    room = cabinet_room(tmp_path, extra=MUG.format(x=-1.5, z=3.0))
    tour = chain(room, segway, [Request("open", "cabinet"), Request("pick", "mug")])
    assert tour.status == "infeasible"
    assert len(tours) == 1


def test_a_room_without_a_part_keeps_everything_else(tmp_path: Path) -> None:
    room = cabinet_room(tmp_path, extra=MUG.format(x=0.0, z=2.5))
    before = room.object("cabinet")
    (joint,) = before.model.joints
    after = without_part(room, "cabinet", joint).object("cabinet")
    moved = before.model.moved_by(joint)
    assert not any(after.model.hulls[link] for link in moved)
    for link in set(before.model.links) - set(moved):
        assert len(after.model.hulls[link]) == len(before.model.hulls[link])
    assert after.values() == before.values()
