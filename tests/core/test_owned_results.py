"""A result that belongs to an object lives as long as the object, and is never another one's."""

from __future__ import annotations

import copy
import gc
import pickle
import weakref
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace
from threading import Barrier

import pytest

from momapos.core.owned_results import owner_cache


@dataclass(frozen=True, eq=False)
class Thing:
    """An object that is compared by identity."""

    name: str


@dataclass(frozen=True)
class Part:
    """A part of a thing, compared by value."""

    thing: Thing
    name: str


class Result:
    """A result, which may refer to its owner."""

    def __init__(self, *about: object) -> None:
        self.about = about


@owner_cache()
def about(thing: Thing, word: str = "", *, loud: bool = False) -> Result:
    """Refer to the owner."""
    return Result(thing, word, loud)


@owner_cache(3)
def beside(thing: Thing, _other: Thing | None, number: int = 0) -> Result:
    """Refer to the first of two objects."""
    return Result(thing, number)


@owner_cache(owner=lambda part: part.thing)
def about_part(part: Part) -> Result:
    """Refer to a part, which is compared by value."""
    return Result(part)


def test_equal_arguments_have_one_result() -> None:
    thing, other = Thing("a"), Thing("b")
    assert about(thing, "x") is about(thing, "x")
    assert about(thing, loud=True) is about(thing, loud=True)
    assert beside(thing, other, 1) is beside(thing, other, 1)
    assert about_part(Part(thing, "door")) is about_part(Part(thing, "door"))


def test_other_arguments_have_other_results() -> None:
    thing, other = Thing("a"), Thing("a")
    assert about(thing).about == (thing, "", False)
    found = [
        about(thing), about(thing, "x"), about(thing, loud=True), about(other),
        beside(thing, other), beside(thing, thing), beside(thing, None), beside(thing, other, 1),
        beside(other, thing), about_part(Part(thing, "door")), about_part(Part(thing, "tray")),
        about_part(Part(other, "door")),
    ]  # fmt: skip
    assert len({id(one) for one in found}) == len(found)


def test_results_disappear_with_their_owner_though_they_refer_to_it() -> None:
    thing = Thing("a")
    dead = [weakref.ref(x) for x in (thing, about(thing), about_part(Part(thing, "door")))]
    del thing
    gc.collect()
    assert [ref() for ref in dead] == [None] * 3


def test_results_disappear_with_any_object_that_they_belong_to() -> None:
    thing, other = Thing("a"), Thing("b")
    result = weakref.ref(beside(thing, other))
    other_way = weakref.ref(beside(other, thing))
    del other
    gc.collect()
    assert result() is None
    assert other_way() is None


def test_an_object_has_at_most_as_many_results_as_it_may() -> None:
    thing, others = Thing("a"), [Thing("b") for _ in range(10)]
    alive = [weakref.ref(beside(thing, None, number)) for number in range(10)]
    assert [ref() is not None for ref in alive] == [False] * 7 + [True] * 3
    alive = [weakref.ref(beside(thing, other)) for other in others]
    assert [ref() is not None for ref in alive] == [False] * 7 + [True] * 3


@pytest.mark.parametrize("other", [copy.copy, copy.deepcopy, replace], ids=lambda f: f.__name__)
def test_a_copy_has_results_of_its_own(other: object) -> None:
    thing = Thing("a")
    result = about(thing)
    another = other(thing)  # type: ignore[operator]
    assert about(another).about[0] is another
    assert about(another) is about(another)
    assert about(thing) is result


def test_pickles_contain_no_results() -> None:
    thing = Thing("a")
    about(thing, "a long word in the key and in the result")
    data = pickle.dumps(thing)
    assert b"a long word" not in data
    again = pickle.loads(data)
    assert about(again).about[0] is again


def test_threads_that_ask_at_once_get_one_result() -> None:
    barrier = Barrier(4)

    @owner_cache()
    def slow(_thing: Thing) -> Result:
        barrier.wait(10.0)
        return Result()

    thing = Thing("a")
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: slow(thing), range(4)))
    assert len({id(one) for one in found}) == 1
