"""Lowering numba's instructions to LLVM's, without counting references of what is only borrowed."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numba.core import ir, types
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import BaseNativeLowering


@register_pass(mutates_CFG=True, analysis_only=False)
class BorrowingLowering(BaseNativeLowering):
    """From numba's instructions to LLVM's."""

    _name = "borrowing_lowering"

    @property
    def lowering_class(self) -> Any:
        return _Lower


class _Lower(Lower):
    """Leaves out the counting of references of what is only borrowed.

    Arguments, which the caller holds, and views and members of them need no count: counting is
    atomic, LLVM removes only a part of it, and there is one for each array of a record. With it
    `_solve_layers` takes half as long again.
    """

    context: Any

    def pre_lower(self) -> None:
        self._counting = self.context
        self._plain = self.context.subtarget(enable_nrt=False)
        self._borrowed = _borrowed(self.blocks, self.fndesc.typemap)
        super().pre_lower()

    def lower_inst(self, inst: Any) -> None:
        name = inst.value if isinstance(inst, ir.Del) else None
        if isinstance(inst, ir.Assign):
            name = inst.target.name
        self.context = self._plain if name in self._borrowed else self._counting
        super().lower_inst(inst)
        self.context = self._counting


def _borrowed(blocks: Mapping[int, Any], kinds: Any) -> set[str]:
    """The variables that hold nothing but arguments, and views and members of these."""
    values: dict[str, list[Any]] = {}
    returned = set()
    for block in blocks.values():
        for inst in block.body:
            if isinstance(inst, ir.Assign):
                values.setdefault(inst.target.name, []).append(inst.value)
            elif isinstance(inst, ir.Return):
                returned.add(inst.value.name)
    names = set(values) - returned
    while True:
        kept = {n for n in names if all(_only_view(v, names, kinds) for v in values[n])}
        if kept == names:
            return names
        names = kept


def _only_view(value: Any, borrowed: set[str], kinds: Any) -> bool:
    """Whether a value is an argument, or can only be a view or member of what is borrowed."""
    if isinstance(value, ir.Var):
        return value.name in borrowed
    if not isinstance(value, ir.Expr):
        return isinstance(value, ir.Arg)
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
