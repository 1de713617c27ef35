"""Laws of settings: a round trip through their text form, and values of every type."""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal

import pytest

from momapos.core.errors import FileFormatError, InputError, UnknownNameError
from momapos.planning.config import PipelineConfig
from momapos.planning.settings import (
    MAX_BYTES,
    apply_settings,
    list_fields,
    parse_setting,
    read_settings,
)


@dataclass(frozen=True)
class Inner:
    """Some fields."""

    size: float = 1.0
    """How large [m]."""
    word: Literal["a", "b"] | None = None
    sizes: tuple[float, ...] = (1.0, 2.0)
    pair: tuple[float, float] = (0.0, 1.0)
    name: str = "x"

    def __post_init__(self) -> None:
        if self.size < 0 and self.name != "negative":
            raise InputError(f"Inner.size must be at least 0, not {self.size:g}")
        if self.word == "a" and self.name == "b":
            raise InputError("word and name contradict each other")


@dataclass(frozen=True)
class Outer:
    """A nested configuration."""

    count: int = 3
    inner: Inner = field(default_factory=Inner)


OUTER = Outer()


def set_all(*texts: str) -> Outer:
    return apply_settings(OUTER, [parse_setting(text, OUTER, "set") for text in texts])


def test_every_field_of_the_pipeline_can_be_set_to_its_own_value() -> None:
    config = PipelineConfig()
    items = list(list_fields(config))
    settings = [parse_setting(f"{item.path}={item.value}", config, "set") for item in items]
    assert len(settings) > 70
    again = {item.path: item.value for item in list_fields(apply_settings(config, settings))}
    assert again == {item.path: item.value for item in items}


def test_fields_are_listed_in_order_with_their_docstrings() -> None:
    items = list(list_fields(OUTER))
    assert [item.path for item in items[:3]] == ["count", "inner.size", "inner.word"]
    assert [item.text for item in items[:3]] == ["", "How large [m].", ""]
    assert items[3].value == "1+2"


def test_values_have_the_type_of_their_field() -> None:
    inner = set_all(
        "inner.size=inf", "inner.word=b", "inner.sizes=0.5", "inner.pair=-1+1e-3", "inner.name=50"
    ).inner
    assert inner == Inner(math.inf, "b", (0.5,), (-1.0, 0.001), "50")
    assert set_all("inner.word=b", "inner.word=none").inner.word is None
    assert set_all("count=4", "count=5").count == 5


def test_fields_that_depend_on_each_other_are_set_together() -> None:
    assert set_all("inner.size=-1", "inner.name=negative").inner.size == -1.0


@pytest.mark.parametrize(
    ("texts", "message"),
    [
        (["inner.size=-1"], "^set inner.size must be at least 0, not -1$"),
        (["inner.size=-1", "count=2"], "^set inner.size must be"),
        (["inner.word=a", "inner.name=b"], "^set inner.word and name contradict each other$"),
        (["inner.name=b", "inner.word=c"], "^set inner.word must be one of a, b or none, not 'c'$"),
        (["inner.pair=1"], "^set inner.pair must be 2 numbers, not '1'$"),
        (["inner.sizes=1+nan"], "^set inner.sizes must be numbers, not '1\\+nan'$"),
        (["count=1e99"], "^set count must be a whole number"),
        (["count.x=1"], "^set count.x: count is a value and has no fields$"),
        (["count=" + "[" * 100_000], "^set count must be a whole number"),
    ],
)
def test_an_unusable_value_names_the_setting(texts: list[str], message: str) -> None:
    with pytest.raises(InputError, match=message):
        set_all(*texts)


@pytest.mark.parametrize("path", ["size", "inner.sise", "outer.inner.size"])
def test_an_unknown_field_suggests_the_nearest_of_all_nested_ones(path: str) -> None:
    with pytest.raises(UnknownNameError, match=r"did you mean inner\.size"):
        parse_setting(f"{path}=1", OUTER, "set")


def test_a_file_sets_fields_by_tables(tmp_path: Path) -> None:
    file = tmp_path / "a.toml"
    file.write_text('count = 7\n[inner]\nsizes = [1, 2.5]\nword = "a"\n')
    config = apply_settings(OUTER, read_settings(file, OUTER))
    assert config == Outer(7, Inner(sizes=(1.0, 2.5), word="a"))
    file.write_bytes(b"#" * (MAX_BYTES + 1))
    with pytest.raises(FileFormatError, match="larger"):
        read_settings(file, OUTER)
