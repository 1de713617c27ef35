"""Versions of installed packages."""

from __future__ import annotations

from importlib import metadata

import pytest

from momapos.core.versions import version_of


@pytest.mark.parametrize("package", ["momapos", "numpy", "ompl", "scipy", "toppra"])
def test_the_version_is_that_of_the_packages_metadata(package: str) -> None:
    assert version_of(package) == metadata.version(package)


def test_a_missing_package_raises() -> None:
    with pytest.raises(metadata.PackageNotFoundError):
        version_of("no_such_package")
