"""The fast check of a dragged base agrees with `check_base_pose`."""

from __future__ import annotations

import time

import numpy as np
import pytest

from momapos.apps.web.probe import Probe, named_in
from momapos.apps.web.work import Stopped, StopSignal
from momapos.model.records.outcomes import PoseStatus
from momapos.model.robots.robot import Robot
from momapos.model.scene.scene import Scene
from momapos.planning.grasps.task_requests import make_task
from momapos.planning.keyword_forms import check_base_pose
from momapos.planning.reachability.map_store import load_reach


@pytest.fixture(scope="module")
def probe(kitchen: Scene, segway: Robot) -> Probe:
    return Probe(
        kitchen, segway, make_task(kitchen, "open", "fridge", "door_hinge"), load_reach(segway)
    )


def test_a_dragged_base_gets_the_same_outcome_as_check_base_pose(probe: Probe) -> None:
    rng = np.random.default_rng(3)
    seen = set()
    for _ in range(12):
        base = np.array([0.654, -1.650, -2.08]) + rng.normal(0, [0.15, 0.15, 0.4])
        found = probe.at(base, time.perf_counter)
        checked = check_base_pose(
            probe.scene, probe.robot, probe.task, base, probe.reach, how_far=False
        )
        assert found.complete
        assert found.feasible == (checked.motion is not None)
        if found.outcome.status is not PoseStatus.EXACT_CHECK:
            assert found.outcome == checked.outcome
        seen.add(found.feasible)
    assert seen == {True, False}


def test_a_partly_feasible_base_pose_has_the_farthest_value(probe: Probe) -> None:
    rng = np.random.default_rng(1)
    partly = []
    for _ in range(40):
        base = np.array([0.6 + rng.uniform(-0.6, 0.6), -1.3 + rng.uniform(-0.4, 0.2), 1.0])
        found = probe.at(base, time.perf_counter)
        if found.value is not None and not found.feasible:
            partly.append((base, found))
    assert partly
    base, found = partly[0]
    assert found.value in probe.values[:-1]
    assert found.motion.object_q[-1] == pytest.approx(found.value)
    farther = check_base_pose(probe.scene, probe.robot, probe.task, base, probe.reach)
    assert farther.motion is None
    assert farther.farthest >= found.value - 0.02  # whole degrees differ from the waypoints


def test_the_obstacle_in_which_a_base_stands_is_named(probe: Probe) -> None:
    found = probe.at(np.array([1.2, -0.9, 1.5]), time.perf_counter)
    assert not found.feasible
    assert found.in_the_way
    assert found.in_the_way[0].partition("/")[0] in {o.name for o in probe.scene.objects}


def test_a_canceled_check_ends(probe: Probe) -> None:
    stop = StopSignal()
    stop.sent.set()
    with pytest.raises(Stopped):
        probe.at(np.array([0.654, -1.650, -2.08]), stop.clock)


def test_a_check_without_time_is_not_complete(probe: Probe) -> None:
    found = probe.at(np.array([0.654, -1.650, -2.08]), time.perf_counter, within=-1.0)
    assert not found.complete
    assert found.motion is None


def test_labels_in_reasons_are_found_longest_first() -> None:
    labels = ("oven/door", "oven/door_handle", "oven/body")
    assert named_in("arm hits oven/door_handle at waypoint 3", labels) == ("oven/door_handle",)
    assert named_in("no continuous arm path", labels) == ()
