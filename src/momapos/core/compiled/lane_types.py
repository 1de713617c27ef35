"""Compile `lanes` to vector instructions: numba's values become LLVM's <8 x float>."""

from __future__ import annotations

import operator
from collections.abc import Callable
from typing import Any, ClassVar

from llvmlite import ir
from numba.core import cgutils, types
from numba.core.datamodel import models
from numba.core.imputils import lower_builtin
from numba.core.typing.templates import ConcreteTemplate, infer_global, signature
from numba.extending import register_model

from . import lanes

_VECTOR = ir.VectorType(ir.FloatType(), lanes.LANES)
_BYTES_PER_LANE = 4


class _Vector(types.Type):
    """numba's type of eight numbers."""

    def __init__(self) -> None:
        super().__init__("lanes")


_vector = _Vector()
_rows = types.Array(types.float32, 2, "C")


@register_model(_Vector)
class _Model(models.PrimitiveModel):  # type: ignore[misc]
    def __init__(self, manager: Any, kind: Any) -> None:
        super().__init__(manager, kind, _VECTOR)


def _types(function: Callable[..., Any], *signatures: Any) -> None:
    """Tell numba the types of a function."""

    @infer_global(function)
    class _Typed(ConcreteTemplate):  # type: ignore[misc]
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
