"""Lower numba's instructions to LLVM's without reference counts for borrowed values."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

from numba.core import ir, types
from numba.core.compiler_machinery import register_pass
from numba.core.lowering import Lower
from numba.core.typed_passes import BaseNativeLowering


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
        name = inst.value if isinstance(inst, ir.Del) else None
        if isinstance(inst, ir.Assign):
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
            if isinstance(inst, ir.Assign):
                values.setdefault(inst.target.name, []).append(inst.value)
            elif isinstance(inst, ir.Return):
                returned.add(inst.value.name)
    names = set(values) - returned
    while True:
        remaining = {n for n in names if all(_is_view(v, names, kinds) for v in values[n])}
        if remaining == names:
            return names
        names = remaining


def _is_view(value: Any, borrowed: set[str], kinds: Any) -> bool:
    """Return whether a value is an argument, or a view or member of a borrowed value."""
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
