"""momapos inside a larger program: forked and spawned children, threads."""

from __future__ import annotations

import multiprocessing
import os
import threading
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cached_property
from typing import Any

import pytest

import momapos
from momapos.core.forking import renew_property_locks
from momapos.model.records import PlacementPlan
from momapos.model.robots.robot import Robot

SECONDS = 60.0
"""Time after which a child counts as stuck [s]; an answer takes less than one."""
TASKS = (("open", "fridge", "door_hinge"), ("pick", "apple", None))


def answer(task: int = 0) -> PlacementPlan:
    """Answer one of the tasks in a kitchen."""
    verb, name, joint = TASKS[task]
    scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("segway_ur5e")
    made = momapos.make_task(scene, verb, name, joint)
    return momapos.plan_base_placement(scene, robot, made).plan


def in_child(work: Callable[[], bool]) -> bool:
    """Return whether work in a forked child is true; a child that takes too long fails."""
    child = os.fork()
    if child == 0:
        threading.Timer(SECONDS, lambda: os._exit(2)).start()
        try:
            os._exit(0 if work() else 1)
        finally:
            os._exit(3)
    return os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


@pytest.fixture(scope="module")
def expected() -> list[PlacementPlan]:
    """Return the answers of this process, which then has threads and compiled code."""
    return [answer(task) for task in range(len(TASKS))]


def test_a_forked_child_gives_the_answer_of_its_parent(expected: list[PlacementPlan]) -> None:
    assert in_child(lambda: answer() == expected[0])


def test_a_child_of_a_forked_child_answers(expected: list[PlacementPlan]) -> None:
    assert in_child(lambda: answer() == expected[0] and in_child(lambda: answer() == expected[0]))


def test_children_forked_while_another_thread_answers_answer(expected: list[PlacementPlan]) -> None:
    done = threading.Event()

    def keep_answering() -> int:
        count = 0
        while not done.is_set():
            assert answer(1) == expected[1]
            count += 1
        return count

    with ThreadPoolExecutor(1) as pool:
        busy = pool.submit(keep_answering)
        answered = [in_child(lambda: answer() == expected[0]) for _ in range(3)]
        done.set()
    assert answered == [True] * 3
    assert busy.result() > 0


def test_a_spawned_child_gives_the_answer_of_its_parent(expected: list[PlacementPlan]) -> None:
    with multiprocessing.get_context("spawn").Pool(1) as pool:
        assert pool.apply_async(answer).get(timeout=SECONDS) == expected[0]


def test_threads_give_the_answers_of_one_thread(expected: list[PlacementPlan]) -> None:
    tasks = [0, 1, 0, 1]
    with ThreadPoolExecutor(len(tasks)) as pool:
        assert list(pool.map(answer, tasks)) == [expected[task] for task in tasks]


def test_a_child_forked_while_a_thread_computes_a_property_can_read_it() -> None:
    prop: Any = next(p for p in vars(Robot).values() if isinstance(p, cached_property))
    if not hasattr(prop, "lock"):
        renew_property_locks()
        assert not hasattr(prop, "lock")  # from Python 3.12 on there are none
        return
    held, done = threading.Event(), threading.Event()

    def hold() -> None:
        with prop.lock:
            held.set()
            done.wait()

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    free = in_child(lambda: bool(prop.lock.acquire(timeout=5)))
    done.set()
    thread.join()
    assert free
