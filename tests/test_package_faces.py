"""Laws of imports: packages are imported through their faces, the names of `__init__.pyi`."""

from __future__ import annotations

import ast
import importlib
import re
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest
from tests import sources

import momapos

SOURCE = Path(momapos.__file__).parents[1]
PACKAGES = {
    ".".join(path.parent.relative_to(SOURCE).parts): path.parent
    for path in (SOURCE / "momapos").rglob("__init__.py")
}
MODULES = {
    ".".join(path.relative_to(SOURCE).with_suffix("").parts): path
    for path in (SOURCE / "momapos").rglob("*.py")
    if path.name != "__init__.py"
}
FACE = re.compile(r"^from \.([\w.]+) import (\w+) as \2$", re.MULTILINE)


@cache
def face(package: str) -> dict[str, str]:
    """Return the names of a package's face, and the module of each."""
    stub = PACKAGES[package] / "__init__.pyi"
    text = stub.read_text() if stub.exists() else ""
    return {name: f"{package}.{module}" for module, name in FACE.findall(text)}


def imports(module: str) -> Iterator[tuple[str, str]]:
    """Yield what a module imports of momapos: the module or package, and the name."""
    for node in sources.nodes(MODULES[module]):
        if isinstance(node, ast.ImportFrom):
            package = module.rpartition(".")[0].split(".")
            base = ".".join(package[: len(package) + 1 - node.level]) if node.level else ""
            source = ".".join(filter(None, (base, node.module)))
            if source.split(".")[0] == "momapos":
                yield from ((source, alias.name) for alias in node.names)
        elif isinstance(node, ast.Import):
            for alias in node.names:
                if alias.name.startswith("momapos."):
                    yield alias.name, ""


def past_the_face(module: str) -> list[str]:
    """Return the imports of a module that reach into another package past its face."""
    home, found = module.rpartition(".")[0], []
    for source, name in imports(module):
        package = source if source in PACKAGES else source.rpartition(".")[0]
        inside = home == package or home.startswith(f"{package}.")
        if inside or f"{source}.{name}" in PACKAGES or (source == "momapos" and "_" in name):
            continue
        if source not in PACKAGES or name not in face(package):
            found.append(f"{module}: from {source} import {name}")
    return found


def test_no_module_imports_past_the_face_of_another_package() -> None:
    assert [line for module in MODULES for line in past_the_face(module)] == []


def test_inside_a_package_imports_are_relative() -> None:
    absolute = [
        f"{module}: {node.module}"
        for module, path in MODULES.items()
        for node in sources.nodes(path)
        if isinstance(node, ast.ImportFrom)
        and not node.level
        and node.module in MODULES
        and node.module.rpartition(".")[0] == module.rpartition(".")[0]
    ]
    assert absolute == []


@pytest.mark.parametrize("package", sorted(PACKAGES))
def test_a_face_names_what_its_modules_define(package: str) -> None:
    assert package == "momapos" or f"{package}.__init__" not in MODULES
    loaded = importlib.import_module(package)
    for name, module in face(package).items():
        assert f"{package}.{name}" not in MODULES, f"{name} is a module of {package}, too"
        if importlib.util.find_spec(module) is not None and not needs_an_extra(module):
            assert getattr(loaded, name) is getattr(importlib.import_module(module), name)


def needs_an_extra(module: str) -> bool:
    """Return whether importing a module fails because an optional package is missing."""
    try:
        importlib.import_module(module)
    except ImportError:
        return True
    return False


def test_no_imports_are_circular() -> None:
    graph = {
        module: {
            target
            for source, name in imports(module)
            for target in (
                source if source in MODULES else f"{source}.{name}",
                face(source).get(name, "") if source in PACKAGES else "",
            )
            if target in MODULES
        }
        for module in MODULES
    }
    while ends := {module for module, targets in graph.items() if not targets & graph.keys()}:
        for module in ends:
            del graph[module]
    assert sorted(graph) == [], "each of these is in a cycle, or imports a module that is"


def test_a_class_name_has_one_meaning() -> None:
    places: dict[str, list[str]] = {}
    for module, path in MODULES.items():
        for node in sources.tree(path).body:
            if isinstance(node, ast.ClassDef) and not node.name.startswith("_"):
                places.setdefault(node.name, []).append(module)
    assert {name: where for name, where in places.items() if len(where) > 1} == {}
