"""A latch turns as the scene says, in one direction, before its part moves."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from door_case import make_case

from momapos.model.records.plans import Motion, Task
from momapos.model.scene.scene_files import load_scene
from momapos.verification.moved_part import MovedLatch, MovedPart, split
from momapos.verification.path_checks import known_latch_checks, latch_checks
from momapos.verification.report import DEFAULT

START, GOAL, SLACK = 0.1, 0.8, DEFAULT.goal * 0.7
STARTS = "latch starts at the scene's value"
BACK = "latch turns monotonically (largest step back)"
LIMITS = "latch within its joint limits (excess)"
SHORT = "latch short of its value while the part moves"


@pytest.fixture(scope="module", params=[1.0, -1.0], ids=["forward", "backward"])
def latched(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> MovedPart:
    """Return a door whose latch turns in either direction, within limits of -1 and 1."""
    folder = tmp_path_factory.mktemp("latch")
    make_case().write(folder)
    door, _, _ = split(load_scene(folder / "scene.json"), Task("open", "cupboard", "hinge", 1.0))
    assert door.joint is not None
    turns = replace(door.joint, name="latch", lower=-1.0, upper=1.0)
    latch = MovedLatch(turns, request.param * START, request.param * GOAL, 0)
    return replace(door, latch=latch)


def checked(part: MovedPart, latch: list[float], door: list[float]) -> dict[str, tuple[float, str]]:
    """Return the value of each check and "" or "fails"; the latch as it turns forward."""
    assert part.latch is not None
    values, count = np.sign(part.latch.goal) * np.array(latch), len(latch)
    Ts = np.tile(np.eye(4), (count, 1, 1))
    q = np.zeros((count, 6))
    motion = Motion(q[:1], q, np.array(door), Ts, latch_q=values)
    assert all(check.ok for check in known_latch_checks(part, motion))
    checks = latch_checks(part, motion, DEFAULT)
    return {check.name: (check.value, "" if check.ok else "fails") for check in checks}


def test_a_latch_that_is_turned_before_the_door_moves_is_accepted(latched: MovedPart) -> None:
    found = checked(latched, [START, 0.4, GOAL, GOAL, 0.9], [0.0, 0.0, 0.0, 0.5, 1.0])
    assert found == dict.fromkeys((STARTS, BACK, LIMITS, SHORT), (0.0, ""))


@pytest.mark.parametrize("off", [0.5 * SLACK, 1.5 * SLACK, -1.5 * SLACK])
def test_a_latch_starts_as_it_is_in_the_scene(latched: MovedPart, off: float) -> None:
    found = checked(latched, [START + off, GOAL, GOAL], [0.0, 0.0, 1.0])
    assert found[STARTS] == (pytest.approx(abs(off)), "" if abs(off) < SLACK else "fails")


def test_a_latch_that_turns_back_fails_by_its_largest_step_back(latched: MovedPart) -> None:
    found = checked(latched, [START, 0.6, 0.55, 0.9, 0.81, 0.81], [0.0, 0.0, 0.0, 0.0, 0.0, 1.0])
    assert found[BACK] == (pytest.approx(0.09), "fails")
    assert found[SHORT] == (0.0, "")


def test_a_latch_does_not_turn_beyond_its_limit(latched: MovedPart) -> None:
    found = checked(latched, [START, 1.25, 1.25], [0.0, 0.0, 1.0])
    assert found[LIMITS] == (pytest.approx(0.25), "fails")
    assert found[BACK] == (0.0, "")


def test_a_door_that_moves_too_early_fails_by_what_its_latch_lacks(latched: MovedPart) -> None:
    """What counts is where the latch is when a step of the door begins."""
    door = [0.0, 0.0, 0.3, 1.0]
    found = checked(latched, [START, 0.5, GOAL, GOAL], door)
    assert found[SHORT] == (pytest.approx(GOAL - 0.5), "fails")
    assert checked(latched, [START, GOAL, GOAL, GOAL], door)[SHORT] == (0.0, "")
    near = checked(latched, [START, GOAL - 0.5 * SLACK, GOAL, GOAL], door)
    assert near[SHORT] == (pytest.approx(0.5 * SLACK), "")
