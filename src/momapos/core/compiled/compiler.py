"""numba's side: from a kernel to machine code.

Only here numba is imported. All that an entry calls is compiled into its module unoptimized, and
optimized there once, together: numba by itself optimizes every function on its own, then again in
every function that calls it, and makes machine code of each.
"""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from typing import TYPE_CHECKING, Any

import numba
import numpy as np
from numba.core import types
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.registry import cpu_target
from numba.core.typed_passes import NativeLowering

from . import arrays
from .borrowing import BorrowingLowering
from .native import Code

if TYPE_CHECKING:
    from .entries import Kernel

_NUMBERS = {int: types.int64, float: types.float64, bool: types.boolean, np.uint64: types.uint64}


def numba_type(hint: Any) -> Any:
    """numba's type of an entry's argument."""
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


def dispatcher(kernel: Kernel) -> Any:
    """A dispatcher that compiles for any arguments, with numba's own cache.

    numba stamps its cache with the file that holds the function; this stamp holds what the
    function calls as well.
    """
    made = numba.njit(nogil=True, cache=True, **kernel.options)(kernel.py_func)
    file = getattr(made._cache, "_cache_file", None)
    if file is not None:
        file._source_stamp = kernel.stamp
    return made


def inner(kernel: Kernel) -> Any:
    """A dispatcher for other kernels: without the wrapper by which Python calls it."""
    made = _compiled(kernel, _Compiler)
    template_of = made.get_call_template

    def get_call_template(args: Any, kws: Any) -> Any:
        # numba compiles anew for each constant that it is called with.
        return template_of([types.unliteral(arg) for arg in args], kws)  # type: ignore[attr-defined]

    made.get_call_template = get_call_template
    return made


def compile_entry(kernel: Kernel) -> Code:
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
    """The constants of an environment, which are the types of returned arrays."""
    if not all(isinstance(const, np.dtype) for const in environment.consts):
        raise TypeError(f"an entry returns what is neither a number nor an array: {environment}")
    return tuple(const.str for const in environment.consts)


def _compiled(kernel: Kernel, pipeline: type[CompilerBase]) -> Any:
    """A dispatcher that compiles with a compiler below."""
    # Entries get their wrapper later: what numba compiles for one, it keeps for callers alike.
    options = {**kernel.options, "no_cpython_wrapper": True, "no_cfunc_wrapper": True}
    return numba.njit(nogil=True, pipeline_class=pipeline, **options)(kernel.py_func)


class _Compiler(CompilerBase):
    """numba's compiler, which counts references only where there is something to free."""

    def define_pipelines(self) -> list[Any]:
        passes = DefaultPassBuilder.define_nopython_pipeline(self.state)
        passes.passes = [
            (BorrowingLowering if made is NativeLowering else made, what)
            for made, what in passes.passes
        ]
        passes.finalize()
        return [passes]


class _EntryCompiler(_Compiler):
    """The same, with a wrapper by which Python calls it."""

    def define_pipelines(self) -> list[Any]:
        self.state.flags.no_cpython_wrapper = False
        return super().define_pipelines()


class _Whole(JITCodeLibrary):
    """An entry with all that it calls, which is optimized as a whole."""

    def _optimize_functions(self, ll_module: Any) -> None:
        ll_module.data_layout = self._codegen._data_layout


class _Part(JITCodeLibrary):
    """What is linked into an entry: code that is neither optimized nor run by itself."""

    def _optimize_functions(self, ll_module: Any) -> None:
        # As numba does, but with one list of passes instead of one per function, and not for the
        # declarations, which are most of them.
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
    """Have numba make parts of all functions but the entry, and no wrappers by which C calls."""
    context = cpu_target.target_context
    codegen = context.codegen()

    def library(owner: Any, name: str) -> JITCodeLibrary:
        return (_Whole if name == entry else _Part)(owner, name)

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
