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
class Owner:
    """An object that is compared by identity."""

    name: str


@dataclass(frozen=True)
class Part:
    """A part of an owner, compared by value."""

    owner: Owner
    name: str


class Result:
    """A result, which may refer to its owner."""

    def __init__(self, *about: object) -> None:
        self.about = about


@owner_cache()
def about(owner: Owner, word: str = "", *, loud: bool = False) -> Result:
    """Refer to the owner."""
    return Result(owner, word, loud)


@owner_cache(3)
def with_other(owner: Owner, _other: Owner | None, number: int = 0) -> Result:
    """Refer to the first of two objects."""
    return Result(owner, number)


@owner_cache(owner=lambda part: part.owner)
def about_part(part: Part) -> Result:
    """Refer to a part, which is compared by value."""
    return Result(part)


def test_equal_arguments_have_one_result() -> None:
    owner, other = Owner("a"), Owner("b")
    assert about(owner, "x") is about(owner, "x")
    assert about(owner, loud=True) is about(owner, loud=True)
    assert with_other(owner, other, 1) is with_other(owner, other, 1)
    assert about_part(Part(owner, "door")) is about_part(Part(owner, "door"))


def test_other_arguments_have_other_results() -> None:
    owner, other = Owner("a"), Owner("a")
    assert about(owner).about == (owner, "", False)
    found = [
        about(owner), about(owner, "x"), about(owner, loud=True), about(other),
        with_other(owner, other), with_other(owner, owner), with_other(owner, None),
        with_other(owner, other, 1),
        with_other(other, owner), about_part(Part(owner, "door")), about_part(Part(owner, "tray")),
        about_part(Part(other, "door")),
    ]  # fmt: skip
    assert len({id(one) for one in found}) == len(found)


def test_results_disappear_with_their_owner_though_they_refer_to_it() -> None:
    owner = Owner("a")
    dead = [weakref.ref(x) for x in (owner, about(owner), about_part(Part(owner, "door")))]
    del owner
    gc.collect()
    assert [ref() for ref in dead] == [None] * 3


def test_results_disappear_with_any_object_that_they_belong_to() -> None:
    owner, other = Owner("a"), Owner("b")
    result = weakref.ref(with_other(owner, other))
    other_way = weakref.ref(with_other(other, owner))
    del other
    gc.collect()
    assert result() is None
    assert other_way() is None


def test_an_object_has_at_most_as_many_results_as_it_may() -> None:
    owner, others = Owner("a"), [Owner("b") for _ in range(10)]
    alive = [weakref.ref(with_other(owner, None, number)) for number in range(10)]
    assert [ref() is not None for ref in alive] == [False] * 7 + [True] * 3
    alive = [weakref.ref(with_other(owner, other)) for other in others]
    assert [ref() is not None for ref in alive] == [False] * 7 + [True] * 3


@pytest.mark.parametrize("other", [copy.copy, copy.deepcopy, replace], ids=lambda f: f.__name__)
def test_a_copy_has_results_of_its_own(other: object) -> None:
    owner = Owner("a")
    result = about(owner)
    another = other(owner)  # type: ignore[operator]
    assert about(another).about[0] is another
    assert about(another) is about(another)
    assert about(owner) is result


def test_pickles_contain_no_results() -> None:
    owner = Owner("a")
    about(owner, "a long word in the key and in the result")
    data = pickle.dumps(owner)
    assert b"a long word" not in data
    again = pickle.loads(data)
    assert about(again).about[0] is again


def test_threads_that_ask_at_once_get_one_result() -> None:
    barrier = Barrier(4)

    @owner_cache()
    def slow(_owner: Owner) -> Result:
        barrier.wait(10.0)
        return Result()

    owner = Owner("a")
    with ThreadPoolExecutor(4) as pool:
        found = list(pool.map(lambda _: slow(owner), range(4)))
    assert len({id(one) for one in found}) == 1
