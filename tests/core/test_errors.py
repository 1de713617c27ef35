"""Errors name missing extras and invalid configuration fields."""

from __future__ import annotations

import re
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import get_args

import pytest

import momapos
from momapos.core.arguments import refuse_below
from momapos.core.errors import (
    REQUIREMENTS,
    Extra,
    InputError,
    MissingExtraError,
    install_hint,
    require,
)

ROOT = Path(__file__).parents[2]


def test_the_code_requires_only_extras_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = {name: tuple(project["optional-dependencies"][name]) for name in get_args(Extra)}
    assert extras == REQUIREMENTS
    source = Path(momapos.__file__).parent
    texts = [file.read_text() for file in sorted(source.rglob("*.py"))]
    required = {name for text in texts for name in re.findall(r'require\("(\w+)"\)', text)}
    assert required == set(get_args(Extra))
    assert not any("momapos[" in text for text in texts)


def test_install_hints_name_packages_with_their_upper_bounds() -> None:
    assert install_hint("scan") == "pip install onnxruntime pillow rosbags"
    assert install_hint("torch") == "pip install 'torch>=2.10,<2.14'"


def test_an_error_for_a_missing_package_tells_how_to_install_it() -> None:
    with pytest.raises(MissingExtraError) as raised, require("physics"):
        import no_such_package.part  # type: ignore[import-not-found] # noqa: F401
    assert str(raised.value) == "no_such_package is not installed; pip install mujoco pillow"


def test_other_errors_pass_through() -> None:
    with pytest.raises(ZeroDivisionError), require("scan"):
        raise ZeroDivisionError


@dataclass(frozen=True)
class SomeConfig:
    count: float = 1.0

    def __post_init__(self) -> None:
        refuse_below(self, 1, "count")


@pytest.mark.parametrize("count", [0.5, float("nan"), float("inf")])
def test_a_field_below_its_bound_or_not_finite_is_named_with_its_class(count: float) -> None:
    with pytest.raises(InputError, match=r"^SomeConfig\.count must be .*, not " + str(count)):
        SomeConfig(count)


def test_an_error_for_a_field_below_its_bound_names_the_bound() -> None:
    with pytest.raises(InputError, match=r"^SomeConfig\.count must be at least 1, not 0$"):
        SomeConfig(0.0)
