"""Compile kernels to machine code with numba; only this module and `borrowing` import numba.

All functions that an entry calls are compiled into its module without optimization, and the module
is optimized once. numba by itself would optimize each function, then again in each of its callers,
and generate machine code for each.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import Any

import numba
import numpy as np
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering

from . import arrays, lane_types  # noqa: F401, registers types
from .borrowing import BorrowingLowering
from .kernel_source import KernelSource
from .native import Code

_NUMBERS = {int: types.int64, float: types.float64, bool: types.boolean, np.uint64: types.uint64}


def numba_type(hint: Any) -> Any:
    """Return numba's type of an entry's argument."""
    array = arrays.array_of(hint)
    if array is not None:
        dtype = numba.from_dtype(array.dtype)
        return types.Array(dtype, array.ndim, "C", readonly=array.readonly)
    members = arrays.fields(hint)
    if members is None:
        return _NUMBERS[hint]
    inside = [numba_type(member) for member in members]
    if hasattr(hint, "_fields"):
        same = all(kind == inside[0] for kind in inside)
        if same:
            return types.NamedUniTuple(inside[0], len(inside), hint)  # type: ignore[attr-defined]
        return types.NamedTuple(inside, hint)  # type: ignore[attr-defined]
    return types.Tuple(inside)  # type: ignore[attr-defined]


def dispatcher(kernel: KernelSource) -> Any:
    """Build a dispatcher that compiles for any argument types, with numba's own cache.

    numba stamps its cache with the function's file; our stamp also covers the functions it calls.
    """
    made = numba.njit(nogil=True, cache=True, **kernel.options)(kernel.py_func)
    file = getattr(made._cache, "_cache_file", None)
    if file is not None:
        file._source_stamp = kernel.stamp
    return made


def inner(kernel: KernelSource) -> Any:
    """Build a dispatcher for calls from other kernels, without a wrapper for Python."""
    made = _compiled(kernel, _Compiler)
    template_of = made.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        # numba would compile again for each constant argument.
        return template_of([types.unliteral(arg) for arg in args], kws)  # type: ignore[attr-defined]

    made.get_call_template = get_call_template
    return made


def compile_entry(kernel: KernelSource) -> Code:
    """Compile an entry for its annotated types."""
    outer = _compiled(kernel, _EntryCompiler)
    signature = tuple(numba_type(hint) for hint in kernel.types)
    with _optimized_once(kernel.py_func.__qualname__):
        outer.compile(signature)
    (result,) = outer.overloads.values()
    main = result.target_context.get_env_name(result.fndesc)
    others = {e.env_name: e for e in result._find_referenced_environments()}
    others.pop(main, None)
    environments = [(main, _dtypes(result.environment))]
    environments += [(name, _dtypes(env)) for name, env in others.items() if env.consts]
    return Code(
        result.library._get_compiled_object(),
        result.fndesc.llvm_cpython_wrapper_name,
        tuple(environments),
    )


def _dtypes(environment: Any) -> tuple[str, ...]:
    """Return the constants of an environment: the types of returned arrays."""
    if not all(isinstance(const, np.dtype) for const in environment.consts):
        raise TypeError(f"an entry must return numbers or arrays, not {environment}")
    return tuple(const.str for const in environment.consts)


def _compiled(kernel: KernelSource, pipeline: type[CompilerBase]) -> Any:
    """Build a dispatcher that compiles with one of the compilers below."""
    # Entries get their wrapper later: numba shares what it compiles for an entry with its callers.
    options = {**kernel.options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return numba.njit(nogil=True, pipeline_class=pipeline, **options)(kernel.py_func)


class _Compiler(CompilerBase):
    """numba's compiler with `BorrowingLowering`."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (BorrowingLowering if made is NativeLowering else made, what)
            for made, what in passes.passes
        ]
        passes.finalize()
        return [passes]


class _EntryCompiler(_Compiler):
    """The same, with a wrapper for calls from Python."""

    def define_pipelines(self) -> list[Any]:
        self.state.flags.no_cpython_wrapper = False
        return super().define_pipelines()


class _EntryLibrary(JITCodeLibrary):
    """An entry with all functions that it calls, optimized as a whole."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class _CalleeLibrary(JITCodeLibrary):
    """A function linked into an entry, neither optimized nor run by itself."""

    def _optimize_functions(self, ll_module: Any) -> None:
        # Like numba, but with one list of passes for all functions, and without declarations,
        # which are the majority.
        ll_module.data_layout = self._codegen._data_layout
        passes, builder = self._codegen._function_pass_manager()
        for function in ll_module.functions:
            if not function.is_declaration:
                passes.run(function, builder)

    def _optimize_final_module(self) -> None:
        pass

    def _finalize_final_module(self) -> None:
        self._finalize_dynamic_globals()
        self._finalized = True

    def get_pointer_to_function(self, name: str) -> int:  # noqa: ARG002, numba's signature
        self._ensure_finalized()
        return 0


@contextlib.contextmanager
def _optimized_once(entry: str) -> Iterator[None]:
    """Make numba link all other functions into the entry, without wrappers for calls from C."""
    context = cpu_target.target_context
    codegen = context.codegen()

    def library(owner: Any, name: str) -> JITCodeLibrary:
        return (_EntryLibrary if name == entry else _CalleeLibrary)(owner, name)

    def set_env(name: str, environment: Any) -> None:
        if codegen._engine.is_symbol_defined(name):
            type(codegen).set_env(codegen, name, environment)

    def no_wrapper(*_: Any) -> None:
        pass

    codegen._library_class, codegen.set_env = library, set_env
    context.create_cfunc_wrapper = no_wrapper
    try:
        yield
    finally:
        del codegen._library_class, codegen.set_env, context.create_cfunc_wrapper
