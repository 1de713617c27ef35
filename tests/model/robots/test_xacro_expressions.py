"""The grammar of xacro's expressions computes what Python computes, and reaches nothing else."""

from __future__ import annotations

import math
import time
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from momapos.model.robots.xacro_program import MATH, PYTHON, checked, evaluate


class Space(dict[str, Any]):
    """A namespace with dotted access, as xacro has them."""

    def __getattr__(self, name: str) -> Any:
        return self[name]


NAMES = {
    **MATH, **PYTHON, "math": Space(MATH), "python": Space(PYTHON), "x": 0.25, "name": "left_arm",
    "d": {"a": [1, 2]}, "config": Space(limits=Space(lower=-1.5), values=[3]), "rows": ["a", "b"],
}  # fmt: skip
PLAIN = {
    **{name: getattr(math, name) for name in MATH}, "math": math, "x": 0.25, "name": "left_arm",
    "d": {"a": [1, 2]}, "rows": ["a", "b"],
}  # fmt: skip


@pytest.mark.parametrize(
    "text",
    [
        "x * 2 + -x ** 2 - 7 // 2 % 3 / 4", "radians(90) + math.sin(pi / 2)", "1 if x > 0.5 else 2",
        "name.split('_')[0] + '_wheel'", "name[-3:]", "d['a'][1]", "d.get('b', 5)", "not x == 1",
        "name == 'left_arm' and x < 1 or x", "1 < x < 2", "'arm' in name", "[1, 2] * 3",
        "' '.join([str(v) for v in [1, 2, 3] if v != 2])", "list(map(float, '1 2 3'.split()))",
        "{k: v + 1 for k, v in [('a', 1), ('b', 2)]}", "f'{name}_{x:.2f}'", "'%s %.3f' % (name, x)",
        "'{} {a}'.format(name, a=x)", "max(len(r) for r in rows)", "sorted(rows, reverse=True)",
        "isinstance(name, str) and isinstance(x, (int, float))", "len(range(3)) + sum([1, 2])",
        "dict(a=1)['a']", "(1, 2) + (3,)", "2 ** 10 << 2", "1e3", "-3 % 4", "round(2.567, 2)",
        "name.upper().startswith('LEFT')", "{1, 2} == {2, 1}", "~5 & 3 | 8 ^ 1", "x is None",
    ],
)  # fmt: skip
def test_an_expression_has_the_value_that_python_gives_it(text: str) -> None:
    assert evaluate(text, NAMES) == eval(text, dict(PLAIN))


@given(st.lists(st.floats(-1e3, 1e3), min_size=1, max_size=5), st.sampled_from("+-*"))
def test_arithmetic_of_random_numbers_is_that_of_python(values: list[float], sign: str) -> None:
    text = sign.join(f"({value!r})" for value in values)
    assert evaluate(text, {}) == eval(text)


def test_entries_of_namespaces_have_dotted_access() -> None:
    assert evaluate("config.limits.lower", NAMES) == -1.5
    assert evaluate("config['values'][0]", NAMES) == 3


@pytest.mark.parametrize(
    "text",
    [
        "(lambda: 1)()", "().__class__", "''.__class__.__mro__", "name.__class__", "__import__",
        "(x := 1)", "[*rows]", "dict(**d)", "name.format_map(d)", "name.encode()", "str.join",
        "open('/etc/passwd')", "eval('1')", "getattr(x, 'real')", "x.real", "sin.run",
        "math.loader", "vars()", "type(x)", "print(1)", "'{0.__class__}'.format(x)",
        "'{0[a]}'.format(d)",
        "len.__self__", "sin + 1", "rows @ rows", "b'a'", "yield_", "PYTHON", "dict.fromkeys(rows)",
        "[c for c in ().__class__.__base__.__subclasses__()]", "(i for i in rows).gi_frame",
        "config.__class__", "map(lambda v: v, rows)", "config.missing", "d.a", "isinstance(x, x)",
    ],
)  # fmt: skip
def test_nothing_but_values_and_known_functions_can_be_reached(text: str) -> None:
    with pytest.raises((ValueError, NameError, AttributeError, TypeError, KeyError, SyntaxError)):
        evaluate(text, NAMES)


@pytest.mark.parametrize(
    "text",
    [
        "9 ** 9 ** 9 ** 9", "1 << 10 ** 12", "'a' * 10 ** 9", "10 ** 9 * [0]", "range(10 ** 12)",
        "'%999999999d' % 1", "'%*d' % (10 ** 9, 1)", "f'{1:>999999999}'",
        "'{:>99999999}'.format(1)",
        "'a'.zfill(10 ** 10)", "'a'.ljust(10 ** 10)", "round(1, -10 ** 9)",
        "('a' * 10 ** 5).replace('a', 'b' * 10 ** 5)", "('b' * 10 ** 5).join(['a'] * 10 ** 4)",
        "[1 for a in range(10000) for b in range(10000)]", "[[0] * 1000] * 1000",
        "[r.extend(r) for i in range(60) for r in [rows2]]", "'{0}{0}{0}{0}{0}{0}{0}{0}{0}{0}{0}'"
        ".format('a' * 10 ** 5)", "(" * 1000 + ")" * 1000, "-" * 5000 + "1", "1+" * 15000 + "1",
    ],
)  # fmt: skip
def test_no_expression_takes_much_time_or_memory(text: str) -> None:
    before = time.process_time()
    with pytest.raises((ValueError, SyntaxError, RecursionError, MemoryError)):
        evaluate(text, {**NAMES, "rows2": ["a"]})
    assert time.process_time() - before < 20  # the bound of steps, not a timing


def test_a_value_that_contains_itself_is_refused() -> None:
    endless: list[Any] = []
    endless.append(endless)
    with pytest.raises(ValueError, match="too large"):
        checked(endless)
