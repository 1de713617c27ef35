"""Laws of project files: versions, workflows and the image agree with the code."""

from __future__ import annotations

import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import momapos

REPOSITORY = Path(__file__).parents[2]
WORKFLOWS = sorted((REPOSITORY / ".github" / "workflows").glob("*.yml"))
PROJECT: dict[str, Any] = tomllib.loads((REPOSITORY / "pyproject.toml").read_text())["project"]


def targets() -> set[str]:
    return set(re.findall(r"^([a-z-]+):", (REPOSITORY / "Makefile").read_text(), re.MULTILINE))


def test_all_files_state_one_version() -> None:
    citation = yaml.safe_load((REPOSITORY / "CITATION.cff").read_text())
    ros = REPOSITORY / "integrations" / "ros2"
    versions = [
        re.search(r"<version>(.*)</version>", path.read_text())[1]  # type: ignore[index]
        for path in ros.glob("*/package.xml")
    ]
    versions += re.findall(r'version="(.*)"', (ros / "momapos_ros" / "setup.py").read_text())
    assert len(versions) == 3
    assert {*versions, str(citation["version"]), PROJECT["version"]} == {momapos.__version__}
    assert citation["license"] == PROJECT["license"]


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.stem)
def test_a_workflow_calls_existing_targets(path: Path) -> None:
    jobs = yaml.safe_load(path.read_text())["jobs"]
    commands = [step["run"] for job in jobs.values() for step in job["steps"] if "run" in step]
    called = [m for command in commands for m in re.findall(r"make ([a-z-]+)", command)]
    assert called
    assert set(called) <= targets()


def test_workflows_run_all_supported_python_versions() -> None:
    supported = {
        words.rpartition(" ")[2] for words in PROJECT["classifiers"] if "Python :: 3." in words
    }
    assert f">={min(supported, key=lambda v: int(v[2:]))}" == PROJECT["requires-python"]
    for path in WORKFLOWS:
        jobs = yaml.safe_load(path.read_text())["jobs"].values()
        matrices = [job.get("strategy", {}).get("matrix", {}) for job in jobs]
        tested = {version for matrix in matrices for version in matrix.get("python", [])}
        assert tested == supported, path


def test_the_image_installs_existing_extras() -> None:
    (extras,) = re.findall(r"/source\[(.*)\]", (REPOSITORY / "Dockerfile").read_text())
    assert set(extras.split(",")) <= set(PROJECT["optional-dependencies"])


@pytest.mark.parametrize("name", ["lowest", "locked"])
def test_constraints_hold_an_allowed_version_of_each_dependency(name: str) -> None:
    text = (REPOSITORY / "constraints" / f"{name}.txt").read_text()
    versions = dict(re.findall(r"^([\w.-]+)==([^\s;]+)", text, re.MULTILINE))
    extras = PROJECT["optional-dependencies"]
    named = [*PROJECT["dependencies"], *extras["physics"], *extras["scan"], *extras["view"]]
    for requirement in map(Requirement, named):
        assert versions[canonicalize_name(requirement.name)] in requirement.specifier
