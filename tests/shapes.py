"""Check the annotated types and array shapes of momapos' functions and records in every test.

`install` adds an import hook that checks each function, method, dataclass and record of the
package: beartype checks the types; jaxtyping checks the shapes and dtypes of arrays, and that axes
of one name have one length within a call. Imports for type checkers only are also executed. The
first calls of a function are checked, see `MAX_CHECKED_CALLS`. Not checked: kernels, which numba
compiles and whose entries check their own arguments; modules with types of a package that is not
installed (torch); and processes that a test starts.
"""

from __future__ import annotations

import ast
import contextlib
import functools
import hashlib
import inspect
import marshal
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
STORE = Path(__file__).parents[1] / ".pytest_cache" / "shapes"
"""Folder of compiled modules."""
_COMPILER = sys.version.encode() + Path(__file__).read_bytes()
MAX_CHECKED_CALLS = 20
"""Calls of a function that a process checks; checking all of them doubles the time of the tests."""


@contextlib.contextmanager
def unchecked() -> Iterator[None]:
    """Disable the check, for calls that break an annotation on purpose.

    Also for tests that no random numbers are drawn: the check draws some, from Python's own
    generator, to choose the list element that it inspects.
    """
    before = jaxtyping.config.jaxtyping_disable
    jaxtyping.config.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        jaxtyping.config.update("jaxtyping_disable", before)


def install() -> None:
    """Check all modules of the package imported from now on.

    Raises:
        RuntimeError: A module was imported before and would remain unchecked.
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
        """Return the module's code with checks, which is stored by its source.

        Compiling all modules takes a process 2.8 s.
        """
        path = self.get_filename(fullname)
        source = self.get_data(path)
        key = hashlib.sha256(b"\n".join((_COMPILER, path.encode(), source))).hexdigest()
        stored = STORE / key
        with contextlib.suppress(OSError):
            needed, code = marshal.loads(stored.read_bytes())
            if all(map(find_spec, needed)):
                return code
        tree = ast.parse(source, path)
        needed = _needed_by_hints(tree)
        whole = all(map(find_spec, needed))
        if whole:
            tree = _Checks().visit(tree)
        code = compile(ast.fix_missing_locations(tree), path, "exec", dont_inherit=True)
        if whole:
            STORE.mkdir(parents=True, exist_ok=True)
            partial = STORE / f"{key}.{os.getpid()}"
            partial.write_bytes(marshal.dumps((needed, code)))
            partial.replace(stored)
        return code

    def exec_module(self, module: ModuleType) -> None:
        setattr(module, _CHECK, check)
        super().exec_module(module)
        names = vars(module)
        for name, hint in names.get("__annotations__", {}).items():
            # Other modules import the alias but not the names in it.
            if hint == "TypeAlias" and isinstance(names[name], str):
                names[name] = eval(names[name], names)


def _needed_by_hints(tree: ast.Module) -> set[str]:
    """Return the packages imported for type checkers only."""
    imports = (node for block in tree.body if _for_hints(block) for node in ast.walk(block))
    return {
        node.module.split(".")[0]
        for node in imports
        if isinstance(node, ast.ImportFrom) and node.module and not node.level
    }


def _for_hints(node: ast.stmt) -> bool:
    return isinstance(node, ast.If) and ast.unparse(node.test) == "TYPE_CHECKING"


class _Checks(ast.NodeTransformer):
    """Add the check to all functions except kernels and nested functions."""

    def visit_If(self, node: ast.If) -> ast.stmt | list[ast.stmt]:
        """Execute the branch for type checkers, then the other one."""
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
    """Return a checked function, or a class whose `__init__` is checked."""
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
    """Return the function with its check, built at the first call, when all names exist."""
    run: Callable[..., Any] | None = None
    left = MAX_CHECKED_CALLS

    @functools.wraps(function)
    def wrapper(*args: Any, **kwargs: Any) -> Any:
        nonlocal run, left
        __tracebackhide__ = True
        if run is None:
            # jaxtyping treats an unknown name as Any; here it raises.
            function.__annotations__ = hints()
            run = _jaxtyped(function)
        if left == 0:
            return function(*args, **kwargs)
        left -= 1
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
