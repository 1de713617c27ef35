"""Check, in every test, that what momapos' functions and records take and return is as annotated.

`install` has an importer add a check to each function, method, dataclass and record of the package
as it is imported: beartype compares the types, jaxtyping the shapes and dtypes of arrays, and that
axes of one name are of one length within a call. What the package imports for type checkers only is
imported too. Kernels stay as they are: numba compiles them, and their entries check their own
arguments. So do modules with types of a package that is not installed, which is torch, modules with
types of a neighbor that imports them, and the processes that a test starts.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import inspect
import os
import sys
import typing
from collections.abc import Callable, Iterator, Sequence
from importlib.abc import MetaPathFinder
from importlib.machinery import ModuleSpec, PathFinder, SourceFileLoader
from importlib.util import find_spec
from pathlib import Path
from types import CodeType, ModuleType
from typing import Any

import jaxtyping

PACKAGE = "momapos"
_KERNELS = {"entry", "kernel", "njit"}
_CHECK = "_check_shapes"


@contextlib.contextmanager
def unchecked() -> Iterator[None]:
    """For calls that break an annotation on purpose, to see what the callee itself says.

    Also for those that are seen to draw no random numbers: the check draws them, from Python's own
    generator, to choose the member of a list that it looks at.
    """
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


def install() -> None:
    """Check what is imported of the package from now on.

    Raises:
        RuntimeError: A module of it has been imported already, so that it would go unchecked.
    """
    early = sorted(name for name in sys.modules if name.split(".")[0] == PACKAGE)
    if early:
        raise RuntimeError(f"imported before the check of shapes is installed: {', '.join(early)}")
    sys.meta_path.insert(0, _Finder())


class _Finder(MetaPathFinder):
    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: ModuleType | None = None
    ) -> ModuleSpec | None:
        if fullname.split(".")[0] != PACKAGE:
            return None
        spec = PathFinder.find_spec(fullname, path, target)
        if spec is not None and isinstance(spec.loader, SourceFileLoader):
            spec.loader = _Loader(spec.loader.name, spec.loader.path)
        return spec


class _Loader(SourceFileLoader):
    def get_code(self, fullname: str) -> CodeType:
        """The module with checks, which is not kept among Python's compiled modules."""
        path = self.get_filename(fullname)
        tree = ast.parse(self.get_data(path), path)
        whole = all(find_spec(package) for package in _needed_by_hints(tree))
        if whole and not _in_a_circle(tree, fullname, Path(path).parent):
            tree = _Checks().visit(tree)
        return compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)

    def exec_module(self, module: ModuleType) -> None:
        setattr(module, _CHECK, check)
        super().exec_module(module)
        names = vars(module)
        for name, hint in names.get("__annotations__", {}).items():
            # Other modules name the alias but not what stands in it.
            if hint == "TypeAlias" and isinstance(names[name], str):
                names[name] = eval(names[name], names)


def _needed_by_hints(tree: ast.Module) -> set[str]:
    """Packages that are imported for type checkers only."""
    imports = (node for block in tree.body if _for_hints(block) for node in ast.walk(block))
    return {node.module.split(".")[0] for node in imports if isinstance(node, ast.ImportFrom)}


def _in_a_circle(tree: ast.Module, fullname: str, folder: Path) -> bool:
    """Whether a neighbor that is imported for type checkers only imports this module itself."""
    beside = fullname.rpartition(".")[0] + "."
    for block in tree.body:
        for node in ast.walk(block) if _for_hints(block) else ():
            if isinstance(node, ast.ImportFrom) and (node.module or "").startswith(beside):
                neighbor = folder / f"{(node.module or '').removeprefix(beside)}.py"
                if neighbor.is_file() and f"from {fullname} import" in neighbor.read_text():
                    return True
    return False


def _for_hints(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


class _Checks(ast.NodeTransformer):
    """Adds the check to all but kernels and functions inside functions."""

    def visit_If(self, node: ast.If) -> ast.stmt | list[ast.stmt]:
        """What is for type checkers only runs too, before what is there instead."""
        return [*node.body, *node.orelse] if _for_hints(node) else node

    def visit_FunctionDef(self, node: ast.FunctionDef) -> ast.stmt:
        if not any(_name(decorator) in _KERNELS for decorator in node.decorator_list):
            node.decorator_list.append(_at(node))
        return node

    def visit_ClassDef(self, node: ast.ClassDef) -> ast.stmt:
        self.generic_visit(node)
        node.decorator_list.insert(0, _at(node))
        return node


def _at(node: ast.FunctionDef | ast.ClassDef) -> ast.expr:
    return ast.copy_location(ast.Name(_CHECK, ast.Load()), node)


def _name(decorator: ast.expr) -> str:
    return ast.unparse(decorator.func if isinstance(decorator, ast.Call) else decorator)


def check(made: Any) -> Any:
    """A function that is checked, or a class whose `__init__` or `__new__` is."""
    if not inspect.isclass(made):
        return _checked(made, lambda: typing.get_type_hints(made, include_extras=True))
    if getattr(made, "_is_protocol", False):
        return typing.runtime_checkable(made)
    if "__dataclass_fields__" in vars(made) and "__init__" in vars(made):
        made.__init__ = _checked(made.__init__, lambda: _hints(made))
    return made


def _hints(record: type) -> dict[str, Any]:
    hints = typing.get_type_hints(record, include_extras=True)
    return {name: hints[name] for name in record.__init__.__annotations__ if name in hints}  # type: ignore[misc]


def _checked(function: Callable[..., Any], hints: Callable[[], dict[str, Any]]) -> Any:
    """The function with its check, which is made when it is first called: then all names exist."""
    run: Callable[..., Any] | None = None

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        nonlocal run
        __tracebackhide__ = True
        if run is None:
            # jaxtyping takes a name that it cannot find for Any; here it raises.
            function.__annotations__ = hints()
            run = _jaxtyped(function)
        return run(*args, **kwargs)

    return wrapper


@functools.cache
def _typechecker() -> Callable[..., Any]:
    from beartype import BeartypeConf, beartype

    return beartype(conf=BeartypeConf(is_pep484_tower=True))


def _jaxtyped(function: Callable[..., Any]) -> Callable[..., Any]:
    return jaxtyping.jaxtyped(function, typechecker=_typechecker())


if os.environ.get("MOMAPOS_SHAPES"):
    install()
