"""Load machine code that numba has compiled, without importing numba.

numba's wrapper needs three extension modules of numba's runtime, which do not import the package.
They are loaded under their own names, so that numba shares them if it is imported later.
"""

from __future__ import annotations

import builtins
import ctypes
import functools
import importlib.util
import pickle
import sys
from collections.abc import Callable
from dataclasses import dataclass
from importlib.machinery import PathFinder
from pathlib import Path
from types import ModuleType
from typing import Any

import llvmlite.binding as llvm


@dataclass(frozen=True)
class Code:
    """The machine code of an entry."""

    image: bytes
    """An object file (ELF)."""
    symbol: str
    """The function that Python calls."""
    environments: tuple[tuple[str, tuple[str, ...]], ...]
    """Symbols of the environments, each with its array types as numpy dtype strings."""


def link(code: Code, name: str) -> Callable[..., Any]:
    """Return machine code as a Python function."""
    dynfunc = _runtime()
    engine = _engine()
    engine.add_object_file(llvm.ObjectFileRef.from_data(code.image))
    engine.finalize_object()
    held: list[Any] = [engine]
    for symbol, dtypes in code.environments:
        environment = dynfunc.Environment({})
        environment.consts.extend(_dtype(text) for text in dtypes)
        address = engine.get_global_value_address(symbol)
        if address:
            (ctypes.c_void_p * 1).from_address(address)[0] = id(environment)
        held.append(environment)
    address = engine.get_function_address(code.symbol)
    return dynfunc.make_function(sys.modules[__name__], name, name, address, held[1], tuple(held))


def _dtype(text: str) -> Any:
    import numpy as np

    return np.dtype(text)


def _engine() -> llvm.ExecutionEngine:
    """Return a new engine; one per entry, so that equal names do not collide."""
    target = llvm.Target.from_triple(llvm.get_process_triple())
    return llvm.create_mcjit_compiler(llvm.parse_assembly(""), target.create_target_machine())


@functools.cache
def _runtime() -> ModuleType:
    """Register numba's helpers with LLVM; return the module that makes functions."""
    llvm.initialize_native_target()
    llvm.initialize_native_asmprinter()
    dynfunc = _extension("numba._dynfunc")
    helpers = _extension("numba._helperlib").c_helpers
    memory = _extension("numba.core.runtime._nrt_python").c_helpers
    symbols = {"_Py_NoneStruct": id(None)}
    for table in (helpers, dynfunc.c_helpers):
        symbols |= {f"numba_{name}": address for name, address in table.items()}
        symbols |= {name: table[name] for name in table if name in _MATH}
    symbols |= {n if n.startswith("_") else f"NRT_{n}": a for n, a in memory.items()}
    for value in vars(builtins).values():
        if isinstance(value, type) and issubclass(value, BaseException):
            symbols[f"PyExc_{value.__name__}"] = id(value)
    if "numba" not in sys.modules:
        symbols["numba_unpickle"] = _unpickle().get_function_address("unpickle")
    for name, address in symbols.items():
        llvm.add_symbol(name, address)
    return dynfunc


_MATH = frozenset({
    "sin", "cos", "tan", "asin", "acos", "atan", "atan2", "sinh", "cosh", "tanh", "asinh", "acosh",
    "atanh", "exp", "exp2", "expm1", "log", "log2", "log10", "log1p", "pow", "powf", "hypot", "erf",
    "erfc", "gamma", "lgamma", "ldexp", "frexp", "floor", "ceil", "trunc", "fmod",
})  # fmt: skip
"""Functions of C's math library that numba's helpers provide under their own names."""


def numba_folder() -> Path:
    """Return the folder of the numba package, without importing it.

    Raises:
        ImportError: numba is not installed.
    """
    package = importlib.util.find_spec("numba")
    if package is None or package.origin is None:
        raise ImportError("numba is not installed")
    return Path(package.origin).parent


def _extension(name: str) -> ModuleType:
    """Load an extension module of numba, without its packages."""
    if name in sys.modules:
        return sys.modules[name]
    folder = numba_folder().joinpath(*name.split(".")[1:-1])
    spec = PathFinder.find_spec(name, [str(folder)])
    if spec is None or spec.loader is None:
        raise ImportError(f"{name} is missing")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    sys.modules[name] = module
    return module


@functools.cache
def _unpickle() -> llvm.ExecutionEngine:
    """Return a replacement for numba's function of this name, which imports numba.

    Kernels call it when they return an array. Neither it nor `_unpickled` is Python code: in such
    code a signal that came during the kernel would raise, and the kernel would crash.
    """
    engine = _engine()
    engine.add_module(llvm.parse_assembly(_UNPICKLE.format(id(_unpickled))))
    engine.finalize_object()
    return engine


_UNPICKLE = """
declare i8* @PyBytes_FromStringAndSize(i8*, i64)
declare i8* @PyObject_CallFunctionObjArgs(i8*, ...)
declare void @Py_DecRef(i8*)
define i8* @unpickle(i8* %data, i32 %size, i8* %hash) {{
  %count = sext i32 %size to i64
  %bytes = call i8* @PyBytes_FromStringAndSize(i8* %data, i64 %count)
  %loads = inttoptr i64 {} to i8*
  %value = call i8* (i8*, ...) @PyObject_CallFunctionObjArgs(i8* %loads, i8* %bytes, i8* null)
  call void @Py_DecRef(i8* %bytes)
  ret i8* %value
}}
"""
_unpickled = functools.cache(pickle.loads)
