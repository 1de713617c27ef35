"""Evaluate numbers written as arithmetic, such as "math.pi / 2 * 3" in BestMan scenes.

The text is parsed, never executed: only plain operators on floats, within limits of time and
memory.
"""

from __future__ import annotations

import ast
import math
import operator
import warnings
from collections.abc import Callable

MAX_LENGTH = 200
MAX_DEPTH = 20
MAX_EXPONENT = 16.0
_BINARY: dict[type[ast.operator], Callable[[float, float], float]] = {
    ast.Add: operator.add,
    ast.Sub: operator.sub,
    ast.Mult: operator.mul,
    ast.Div: operator.truediv,
    ast.Pow: math.pow,
}
_CONSTANTS = {"pi": math.pi, "tau": math.tau, "e": math.e}
_MODULES = ("math", "np", "numpy")


def number(value: object) -> float:
    """Return a finite number, given as a number or as arithmetic text.

    Args:
        value: An int, a float, or text of numbers, + - * / **, parentheses, pi, tau, e (also as
            `math.pi`).

    Raises:
        ValueError: The value is invalid, too long, too deep or not finite; the caller adds the
            place to the message.
    """
    if isinstance(value, bool) or not isinstance(value, int | float | str):
        raise ValueError(f"{_short(value)} is not a number")
    try:
        result = _evaluate(_parse(value), 0) if isinstance(value, str) else float(value)
    except (OverflowError, ZeroDivisionError) as error:
        raise ValueError(f"{_short(value)} has no finite value") from error
    if not math.isfinite(result):
        raise ValueError(f"{_short(value)} has no finite value")
    return result


def _parse(text: str) -> ast.expr:
    if len(text) > MAX_LENGTH:
        raise ValueError(f"{_short(text)} is longer than {MAX_LENGTH} characters")
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            return ast.parse(text.strip(), mode="eval").body
    except (SyntaxError, ValueError, MemoryError, RecursionError) as error:
        raise ValueError(f"{_short(text)} is not plain arithmetic") from error


def _evaluate(node: ast.expr, depth: int) -> float:
    if depth > MAX_DEPTH:
        raise ValueError(f"arithmetic is nested deeper than {MAX_DEPTH}")
    match node:
        case ast.Constant(value=int() | float() as value) if not isinstance(value, bool):
            return float(value)
        case ast.Name(id=name) if name in _CONSTANTS:
            return _CONSTANTS[name]
        case ast.Attribute(value=ast.Name(id=module), attr=name) if (
            module in _MODULES and name in _CONSTANTS
        ):
            return _CONSTANTS[name]
        case ast.UnaryOp(op=ast.USub(), operand=operand):
            return -_evaluate(operand, depth + 1)
        case ast.UnaryOp(op=ast.UAdd(), operand=operand):
            return _evaluate(operand, depth + 1)
        case ast.BinOp(op=op) if type(op) in _BINARY:
            left, right = _evaluate(node.left, depth + 1), _evaluate(node.right, depth + 1)
            if isinstance(op, ast.Pow) and abs(right) > MAX_EXPONENT:
                raise ValueError(f"{_short(ast.unparse(node))} has an exponent over 16")
            return _BINARY[type(op)](left, right)
    raise ValueError(
        f"{_short(ast.unparse(node))} is not plain arithmetic (numbers, + - * / **, ( ), pi)"
    )


def _short(value: object) -> str:
    text = repr(value)
    return text if len(text) <= 60 else f"{text[:57]}..."
