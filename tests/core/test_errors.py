"""Errors: a missing extra is named so that it can be installed."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import get_args

import pytest

import momapos
from momapos.core.errors import Extra, MissingExtraError, require

ROOT = Path(__file__).parents[2]


def test_every_extra_that_is_named_is_one_of_the_package() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    assert set(get_args(Extra)) <= set(project["optional-dependencies"])
    source = Path(momapos.__file__).parent
    texts = [file.read_text() for file in sorted(source.rglob("*.py"))]
    asked = {name for text in texts for name in re.findall(r'require\("(\w+)"\)', text)}
    assert asked == set(get_args(Extra))
    spelled = {name for text in texts for name in re.findall(r"momapos\[(\w+)\]", text)}
    assert spelled <= set(get_args(Extra))


def test_a_missing_package_is_named_with_its_extra() -> None:
    with pytest.raises(MissingExtraError) as raised, require("physics"):
        import no_such_package.part  # type: ignore[import-not-found] # noqa: F401
    assert str(raised.value) == "no_such_package is not installed; pip install 'momapos[physics]'"


def test_other_errors_pass_through() -> None:
    with pytest.raises(ZeroDivisionError), require("scan"):
        raise ZeroDivisionError
