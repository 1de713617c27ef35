"""Compile kernels to machine code with numba, which nothing else imports.

All functions that an entry calls are compiled into its module without optimization, and the module
is optimized once. numba by itself would optimize each function, then again in each of its callers,
and generate machine code for each.
"""

from __future__ import annotations

import contextlib
import operator
from collections.abc import Callable, Iterator, Mapping
from typing import Any, ClassVar

import numba
import numpy as np
from llvmlite import ir
from numba.core import cgutils, types
from numba.core import ir as numba_ir
from numba.core.codegen import JITCodeLibrary
from numba.core.compiler import CompilerBase, DefaultPassBuilder
from numba.core.compiler_machinery import register_pass
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin
from numba.core.lowering import Lower
from numba.core.registry import cpu_target
from numba.core.typed_passes import BaseNativeLowering, NativeLowering
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import register_model

from . import kernel_source, lanes
from .kernel_source import KernelSource
from .native import Code


@register_pass(mutates_CFG=True, analysis_only=False)
class BorrowingLowering(BaseNativeLowering):
    """The lowering pass."""

    _name = "borrowing_lowering"

    @property
    def lowering_class(self) -> Any:
        return _Lower


class _Lower(Lower):
    """Omits reference counts of borrowed values: arguments, their views and their members.

    The caller holds the arguments. Counting is atomic, LLVM removes only a part of it, and each
    array of a record has a count. With counting, `_solve_layers` takes 1.5 times as long.
    """

    context: Any

    def pre_lower(self) -> None:
        self._counting = self.context
        self._plain = self.context.subtarget(enable_nrt=False)
        self._borrowed = _borrowed(self.blocks, self.fndesc.typemap)
        super().pre_lower()

    def lower_inst(self, inst: Any) -> None:
        name = inst.value if isinstance(inst, numba_ir.Del) else None
        if isinstance(inst, numba_ir.Assign):
            name = inst.target.name
        self.context = self._plain if name in self._borrowed else self._counting
        super().lower_inst(inst)
        self.context = self._counting


def _borrowed(blocks: Mapping[int, Any], kinds: Any) -> set[str]:
    """Return the variables that hold only arguments, and views and members of these."""
    values: dict[str, list[Any]] = {}
    returned = set()
    for block in blocks.values():
        for inst in block.body:
            if isinstance(inst, numba_ir.Assign):
                values.setdefault(inst.target.name, []).append(inst.value)
            elif isinstance(inst, numba_ir.Return):
                returned.add(inst.value.name)
    names = set(values) - returned
    while True:
        remaining = {n for n in names if all(_is_view(v, names, kinds) for v in values[n])}
        if remaining == names:
            return names
        names = remaining


def _is_view(value: Any, borrowed: set[str], kinds: Any) -> bool:
    """Return whether a value is an argument, or a view or member of a borrowed value."""
    if isinstance(value, numba_ir.Var):
        return value.name in borrowed
    if not isinstance(value, numba_ir.Expr):
        return isinstance(value, numba_ir.Arg)
    if value.op == "call":
        record = isinstance(kinds[value.func.name], types.NamedTupleClass)
        return record and all(part.name in borrowed for part in value.args)
    if value.op == "build_tuple":
        return all(part.name in borrowed for part in value.items)
    if value.op in ("getattr", "exhaust_iter"):
        return value.value.name in borrowed
    if value.op == "static_getitem":
        index: Any = kinds[value.index_var.name] if value.index_var else types.intp
    elif value.op == "getitem":
        index = kinds[value.index.name]
    else:
        return False
    parts = index if isinstance(index, types.BaseTuple) else [index]  # type: ignore[attr-defined]
    plain = types.Integer | types.SliceType  # type: ignore[attr-defined]
    return value.value.name in borrowed and all(isinstance(part, plain) for part in parts)


_VECTOR = ir.VectorType(ir.FloatType(), lanes.LANES)
_BYTES_PER_LANE = 4


class _Vector(types.Type):
    """numba's type of eight numbers."""

    def __init__(self) -> None:
        super().__init__("lanes")


_vector = _Vector()
_rows = types.Array(types.float32, 2, "C")


@register_model(_Vector)
class _Model(models.PrimitiveModel):
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


def _types(function: Callable[..., Any], *signatures: Any) -> None:
    """Tell numba the types of a function."""

    @infer_global(function)
    class _Typed(ConcreteTemplate):
        cases: ClassVar = list(signatures)


_two = signature(_vector, _vector, _vector)
for _operator in (operator.add, operator.sub, operator.mul):
    _types(_operator, _two)
_types(lanes.larger, _two)
_types(lanes.magnitude, signature(_vector, _vector))
_types(lanes.root, signature(_vector, _vector))
_types(lanes.less, signature(types.int64, _vector, _vector))
_types(lanes.highest, signature(types.float64, _vector))
_types(lanes.spread, signature(_vector, types.float64))
_types(lanes.load_lanes, signature(_vector, _rows, types.int64))
_types(lanes.store_lanes, signature(types.none, _rows, types.int64, _vector))


@lower_builtin(operator.add, _vector, _vector)
def _add(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return builder.fadd(*args)


@lower_builtin(operator.sub, _vector, _vector)
def _sub(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return builder.fsub(*args)


@lower_builtin(operator.mul, _vector, _vector)
def _mul(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return builder.fmul(*args)


@lower_builtin(lanes.highest, _vector)
def _highest(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    name = f"llvm.vector.reduce.fmax.v{lanes.LANES}f32"
    kind = ir.FunctionType(ir.FloatType(), [_VECTOR])
    function = cgutils.get_or_insert_function(builder.module, kind, name)
    return builder.fpext(builder.call(function, args, fastmath=("nnan",)), ir.DoubleType())


@lower_builtin(lanes.larger, _vector, _vector)
def _larger(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    a, b = args
    return builder.select(builder.fcmp_ordered(">", a, b), a, b)


@lower_builtin(lanes.magnitude, _vector)
def _magnitude(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return _by_lane("fabs", builder, args)


@lower_builtin(lanes.root, _vector)
def _root(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return _by_lane("sqrt", builder, args)


def _by_lane(what: str, builder: Any, args: Any) -> Any:
    """Call LLVM's intrinsic of one vector."""
    name, kind = f"llvm.{what}.v{lanes.LANES}f32", ir.FunctionType(_VECTOR, [_VECTOR])
    return builder.call(cgutils.get_or_insert_function(builder.module, kind, name), args)


@lower_builtin(lanes.less, _vector, _vector)
def _less(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    bits = builder.bitcast(builder.fcmp_ordered("<", *args), ir.IntType(lanes.LANES))
    return builder.zext(bits, ir.IntType(64))


@lower_builtin(lanes.spread, types.float64)
def _spread(_context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    single = builder.fptrunc(args[0], ir.FloatType())
    first = ir.IntType(32)(0)
    one = builder.insert_element(ir.Constant(_VECTOR, ir.Undefined), single, first)
    mask = ir.Constant(ir.VectorType(ir.IntType(32), lanes.LANES), [0] * lanes.LANES)
    return builder.shuffle_vector(one, ir.Constant(_VECTOR, ir.Undefined), mask)


def _row(context: Any, builder: Any, rows: Any, i: Any) -> Any:
    """Return the address of a row."""
    array = context.make_array(_rows)(context, builder, rows)
    start = cgutils.gep(builder, array.data, builder.mul(i, i.type(lanes.LANES)))
    return builder.bitcast(start, _VECTOR.as_pointer())


@lower_builtin(lanes.load_lanes, _rows, types.int64)
def _load(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    return builder.load(_row(context, builder, *args), align=_BYTES_PER_LANE)


@lower_builtin(lanes.store_lanes, _rows, types.int64, _vector)
def _store(context: Any, builder: Any, _signature: Any, args: Any) -> Any:
    rows, i, value = args
    builder.store(value, _row(context, builder, rows, i), align=_BYTES_PER_LANE)
    return context.get_dummy_value()


_NUMBERS = {int: types.int64, float: types.float64, bool: types.boolean, np.uint64: types.uint64}


def numba_type(hint: Any) -> Any:
    """Return numba's type of an entry's argument."""
    array = kernel_source.array_of(hint)
    if array is not None:
        dtype = numba.from_dtype(array.dtype)
        return types.Array(dtype, array.ndim, "C", readonly=array.readonly)
    members = kernel_source.fields(hint)
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
