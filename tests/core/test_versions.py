"""Versions that answers and runs are recorded with."""

from __future__ import annotations

from importlib import metadata

import pytest

from momapos.core.versions import version_of


@pytest.mark.parametrize("package", ["momapos", "numpy", "ompl", "scipy", "toppra"])
def test_the_version_is_the_one_in_the_packages_metadata(package: str) -> None:
    assert version_of(package) == metadata.version(package)


def test_a_package_that_is_missing_is_told() -> None:
    with pytest.raises(metadata.PackageNotFoundError):
        version_of("no_such_package")
