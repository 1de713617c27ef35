"""Expand one xacro file; the program of the process that `expand_xacro` starts.

It prints JSON: the URDF or the reason why there is none, the tags without a prefix, and the
switches that are off. No file runs code in it: a small grammar evaluates what the library gives
to `eval`, and `FileGate` refuses files outside the robot's folders, and everything but reading.

The expressions are Python's, and xacro gives them to `eval`. Whoever reads a file then runs its
code: a list of forbidden names does not help, since every object leads to all classes of Python.
Here an expression is a tree of the nodes of `_NODES`; it calls the functions of this module and
the methods of `_METHODS`, and no value grows beyond the limits below.
"""

from __future__ import annotations

import ast
import json
import math
import operator
import os
import re
import resource
import stat
import sys
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from itertools import islice
from string import Formatter
from typing import Any

MAX_EXPRESSION, MAX_STEPS = 20_000, 1_000_000
"""Largest number of characters and of evaluated nodes of an expression [-]. Expressions of 60
published robots have up to 200 characters."""
MAX_ITEMS, MAX_TEXT, MAX_BITS = 100_000, 1_000_000, 4096
"""Largest number of items, characters, and bits of integers in a value, all nested ones included
[-]."""
MAX_DIGITS = 999
"""Largest width of a formatted number, and largest number of digits to round to [-]."""

_MATH = (
    "acos", "acosh", "asin", "asinh", "atan", "atan2", "atanh", "cbrt", "ceil", "copysign", "cos",
    "cosh", "degrees", "dist", "erf", "erfc", "exp", "expm1", "fabs", "floor", "fmod", "frexp",
    "fsum", "gamma", "gcd", "hypot", "isclose", "isfinite", "isinf", "isnan", "isqrt", "ldexp",
    "lgamma", "log", "log10", "log1p", "log2", "modf", "nextafter", "pow", "radians", "remainder",
    "sin", "sinh", "sqrt", "tan", "tanh", "trunc", "ulp",
)  # fmt: skip
_METHODS: dict[type, frozenset[str]] = {
    str: frozenset((
        "capitalize", "casefold", "center", "count", "endswith", "find", "format", "index",
        "isalnum", "isalpha", "isdecimal", "isdigit", "islower", "isnumeric", "isspace", "isupper",
        "join", "ljust", "lower", "lstrip", "partition", "removeprefix", "removesuffix", "replace",
        "rfind", "rindex", "rjust", "rpartition", "rsplit", "rstrip", "split", "splitlines",
        "startswith", "strip", "swapcase", "title", "upper", "zfill",
    )),
    list: frozenset((
        "append", "copy", "count", "extend", "index", "insert", "pop", "remove", "reverse", "sort",
    )),
    dict: frozenset(("copy", "get", "items", "keys", "pop", "setdefault", "update", "values")),
    tuple: frozenset(("count", "index")),
    float: frozenset(("is_integer",)),
}  # fmt: skip
_OPERATORS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Add: operator.add, ast.Sub: operator.sub, ast.Div: operator.truediv,
    ast.FloorDiv: operator.floordiv, ast.BitAnd: operator.and_, ast.BitOr: operator.or_,
    ast.BitXor: operator.xor, ast.RShift: operator.rshift,
}  # fmt: skip
_SIGNS: dict[type, Callable[[Any], Any]] = {
    ast.USub: operator.neg, ast.UAdd: operator.pos, ast.Not: operator.not_,
    ast.Invert: operator.invert,
}  # fmt: skip
_COMPARISONS: dict[type, Callable[[Any, Any], Any]] = {
    ast.Eq: operator.eq, ast.NotEq: operator.ne, ast.Lt: operator.lt, ast.LtE: operator.le,
    ast.Gt: operator.gt, ast.GtE: operator.ge, ast.Is: operator.is_, ast.IsNot: operator.is_not,
    ast.In: lambda a, b: a in b, ast.NotIn: lambda a, b: a not in b,
}  # fmt: skip


class ExpressionError(ValueError):
    """An expression is outside the grammar, or a value too large."""


@dataclass(frozen=True)
class Function:
    """A function that expressions can call; they can do nothing else with it."""

    name: str
    run: Callable[..., Any]
    kind: type | None = None
    """The type that it builds, for `isinstance`."""


def evaluate(text: str, names: Mapping[str, Any]) -> Any:
    """Evaluate an expression.

    Args:
        text: The expression.
        names: What its names mean: plain values and `Function`s.

    Raises:
        ExpressionError: It is outside the grammar, or a value exceeds the limits.
        Exception: As Python raises it: an unknown name, an operation that values do not have.
    """
    if len(text) > MAX_EXPRESSION:
        raise ExpressionError(f"more than {MAX_EXPRESSION} characters")
    tree = ast.parse(text.strip(), "<expression>", mode="eval")
    return _Evaluation(names).value(tree.body)


def checked(value: Any) -> Any:
    """Return a value unchanged.

    Raises:
        ExpressionError: It has too many items, characters or bits, nested ones included.
    """
    waiting, items, characters = [value], 0, 0
    while waiting:
        one = waiting.pop()
        items += len(one) if isinstance(one, range) else 1
        if isinstance(one, str):
            characters += len(one)
        elif isinstance(one, dict):
            pairs = islice(dict.items(one), MAX_ITEMS)
            waiting += [part for pair in pairs for part in pair]
        elif isinstance(one, list | tuple | set | frozenset):
            waiting += islice(one, MAX_ITEMS)
        bits = one.bit_length() if isinstance(one, int) else 0
        if items + len(waiting) > MAX_ITEMS or characters > MAX_TEXT or bits > MAX_BITS:
            raise ExpressionError("a value is too large")
    return value


def _refuse_growth(parts: int, size: int, limit: int = MAX_TEXT) -> None:
    """Refuse a result of so many parts of a size before it is built."""
    if parts > 0 and parts * max(size, 1) > limit:
        raise ExpressionError("a value is too large")


def _refuse_wide(text: str) -> None:
    """Refuse formats that set a width by a value, or one of more than three digits."""
    if re.search(r"\d{4}", text) or re.search(r"%[^a-zA-Z%]*\*", text):
        raise ExpressionError(f"the format {text!r:.40} is too wide")


class _Evaluation:
    """The evaluation of one expression."""

    def __init__(self, names: Mapping[str, Any]) -> None:
        self._names, self._steps = names, 0
        self._local: dict[str, Any] = {}
        """Variables of comprehensions."""

    def value(self, node: ast.AST) -> Any:
        """Return the value of a node of the tree."""
        self._steps += 1
        if self._steps > MAX_STEPS:
            raise ExpressionError(f"more than {MAX_STEPS} steps")
        handler = _NODES.get(type(node))
        if handler is None:
            raise ExpressionError(
                f"{_WORDS.get(type(node), type(node).__name__)} is not allowed in a file; "
                "expressions may have numbers, texts, lists, names, operators and known functions"
            )
        return handler(self, node)

    def constant(self, node: ast.Constant) -> Any:
        """Return a number, a text, or None."""
        if isinstance(node.value, bytes) or node.value is ...:
            raise ExpressionError(f"{node.value!r:.40} is not allowed in a file")
        return checked(node.value)

    def name(self, node: ast.Name) -> Any:
        """Return the value of a name."""
        if node.id.startswith("__"):
            raise ExpressionError(f"the name {node.id!r:.40} is not allowed in a file")
        if node.id in self._local:
            return self._local[node.id]
        try:
            return self._names[node.id]
        except KeyError:
            raise NameError(f"name {node.id!r} is not defined") from None

    def sequence(self, node: ast.List | ast.Tuple | ast.Set) -> Any:
        """Return a list, a tuple or a set."""
        parts = [self.value(part) for part in node.elts]
        if isinstance(node, ast.List):
            return checked(parts)
        return checked(tuple(parts) if isinstance(node, ast.Tuple) else set(parts))

    def mapping(self, node: ast.Dict) -> Any:
        """Return a dict."""
        pairs = zip(node.keys, node.values, strict=True)
        return checked({self.value(key): self.value(value) for key, value in pairs if key})

    def text(self, node: ast.JoinedStr) -> str:
        """Return an f-string."""
        parts = [str(self.value(part)) for part in node.values]
        _refuse_growth(len(parts), max(map(len, parts), default=0))
        return str(checked("".join(parts)))

    def formatted(self, node: ast.FormattedValue) -> str:
        """Return a part of an f-string."""
        value = self.value(node.value)
        style = "" if node.format_spec is None else str(self.value(node.format_spec))
        _refuse_wide(style)
        if node.conversion != -1:
            value = str(value) if node.conversion == ord("s") else repr(value)
        return format(value, style)

    def binary(self, node: ast.BinOp) -> Any:
        """Return the result of an operator."""
        left, right = self.value(node.left), self.value(node.right)
        if isinstance(left, Function) or isinstance(right, Function):
            raise ExpressionError("a function is no operand")
        kind = type(node.op)
        if kind is ast.Mult:
            for one, count in ((left, right), (right, left)):
                if isinstance(one, str | list | tuple) and isinstance(count, int):
                    _refuse_growth(count, len(one), MAX_TEXT if isinstance(one, str) else MAX_ITEMS)
            return checked(left * right)
        if kind is ast.Pow:
            if isinstance(left, int) and isinstance(right, int):
                _refuse_growth(right, left.bit_length(), MAX_BITS)
            return checked(left**right)
        if kind is ast.LShift:
            _refuse_growth(right, 1, MAX_BITS)
            return checked(left << right)
        if kind is ast.Mod:
            if isinstance(left, str):
                _refuse_wide(left)
                _refuse_growth(left.count("%"), len(str(right)))
            return checked(left % right)
        if kind not in _OPERATORS:
            raise ExpressionError("@ is not allowed in a file")
        return checked(_OPERATORS[kind](left, right))

    def unary(self, node: ast.UnaryOp) -> Any:
        """Return a negative value, or a negation."""
        return _SIGNS[type(node.op)](self.value(node.operand))

    def logical(self, node: ast.BoolOp) -> Any:
        """Return the first operand that decides; the others are not evaluated."""
        found: Any = None
        for part in node.values:
            found = self.value(part)
            if bool(found) == isinstance(node.op, ast.Or):
                break
        return found

    def comparison(self, node: ast.Compare) -> Any:
        """Return whether all of a chain of comparisons hold."""
        left, found = self.value(node.left), True
        for kind, part in zip(node.ops, node.comparators, strict=True):
            right = self.value(part)
            found = _COMPARISONS[type(kind)](left, right)
            if not found:
                break
            left = right
        return found

    def choice(self, node: ast.IfExp) -> Any:
        """Return one of two values."""
        return self.value(node.body if self.value(node.test) else node.orelse)

    def item(self, node: ast.Subscript) -> Any:
        """Return an item of a list, a text or a dict."""
        whole = self.value(node.value)
        if isinstance(node.slice, ast.Slice):
            ends = (node.slice.lower, node.slice.upper, node.slice.step)
            return whole[slice(*(None if end is None else self.value(end) for end in ends))]
        if not isinstance(whole, str | list | tuple | dict | range):
            raise TypeError(f"{type(whole).__name__!r} object is not subscriptable")
        return whole[self.value(node.slice)]

    def attribute(self, node: ast.Attribute) -> Any:
        """Return an entry of a namespace, or of a dict of a YAML file."""
        return self._entry(self.value(node.value), node.attr)

    def call(self, node: ast.Call) -> Any:
        """Return what a known function or a method of a plain value returns."""
        if any(key.arg is None for key in node.keywords):
            raise ExpressionError("** is not allowed in a file")
        function = self._callee(node.func)
        values = [self.value(one) for one in node.args]
        named = {str(key.arg): self.value(key.value) for key in node.keywords}
        if not isinstance(function, Function):
            raise TypeError(f"{type(function).__name__!r} object is not callable")
        if function.name != "isinstance":
            values = [one.run if isinstance(one, Function) else one for one in values]
            named = {k: one.run if isinstance(one, Function) else one for k, one in named.items()}
        return checked(function.run(*values, **named))

    def _callee(self, node: ast.AST) -> Any:
        """Return the function that a call names, or the method of a plain value."""
        if not isinstance(node, ast.Attribute):
            return self.value(node)
        whole = self.value(node.value)
        for kind, methods in _METHODS.items():
            if isinstance(whole, kind) and node.attr in methods:
                return _method(kind, node.attr, whole)
        return self._entry(whole, node.attr)

    def _entry(self, whole: Any, name: str) -> Any:
        if name.startswith("__"):
            raise ExpressionError(f"the name {name!r:.40} is not allowed in a file")
        # Namespaces and dicts of YAML have dotted access, which plain dicts do not have.
        if isinstance(whole, dict) and hasattr(type(whole), "__getattr__"):
            try:
                return whole[name]
            except KeyError:
                raise NameError(f"name {name!r} is not defined") from None
        raise AttributeError(f"{type(whole).__name__!r} object has no attribute {name!r}")

    def comprehension(self, node: ast.ListComp | ast.SetComp | ast.GeneratorExp) -> Any:
        """Return the values of a comprehension; those of a generator as a list."""
        found = [self.value(node.elt) for _ in self._rounds(node.generators)]
        return checked(set(found) if isinstance(node, ast.SetComp) else found)

    def dict_comprehension(self, node: ast.DictComp) -> Any:
        """Return the dict of a comprehension."""
        rounds = self._rounds(node.generators)
        return checked({self.value(node.key): self.value(node.value) for _ in rounds})

    def _rounds(self, loops: list[ast.comprehension]) -> Iterator[None]:
        """Set the variables of a comprehension to each of their values."""
        if not loops:
            yield
            return
        first, *others = loops
        before = dict(self._local)
        for one in checked(self.value(first.iter)):
            self._assign(first.target, one)
            if all(self.value(test) for test in first.ifs):
                yield from self._rounds(others)
        self._local = before

    def _assign(self, target: ast.AST, value: Any) -> None:
        if isinstance(target, ast.Tuple | ast.List):
            for part, one in zip(target.elts, value, strict=True):
                self._assign(part, one)
        elif isinstance(target, ast.Name):
            self._local[target.id] = value
        else:
            raise ExpressionError("a variable must be a name")


_NODES: dict[type, Callable[[_Evaluation, Any], Any]] = {
    ast.Constant: _Evaluation.constant, ast.Name: _Evaluation.name, ast.List: _Evaluation.sequence,
    ast.Tuple: _Evaluation.sequence, ast.Set: _Evaluation.sequence, ast.Dict: _Evaluation.mapping,
    ast.JoinedStr: _Evaluation.text, ast.FormattedValue: _Evaluation.formatted,
    ast.BinOp: _Evaluation.binary, ast.UnaryOp: _Evaluation.unary, ast.BoolOp: _Evaluation.logical,
    ast.Compare: _Evaluation.comparison, ast.IfExp: _Evaluation.choice,
    ast.Subscript: _Evaluation.item, ast.Attribute: _Evaluation.attribute,
    ast.Call: _Evaluation.call, ast.ListComp: _Evaluation.comprehension,
    ast.SetComp: _Evaluation.comprehension, ast.GeneratorExp: _Evaluation.comprehension,
    ast.DictComp: _Evaluation.dict_comprehension,
}  # fmt: skip
_WORDS = {ast.Lambda: "lambda", ast.NamedExpr: ":=", ast.Starred: "*", ast.Await: "await"}
"""Nodes outside the grammar, as an expression writes them."""


def _method(kind: type, name: str, whole: Any) -> Function:
    """Return a method of a plain value; its type's own, not an entry of the same name."""
    check = _CHECKS.get(name)

    def run(*values: Any, **named: Any) -> Any:
        if check is not None:
            check(whole, *values, **named)
        found = getattr(kind, name)(whole, *values, **named)
        checked(whole)  # it may have grown
        return found

    return Function(name, run)


def _check_join(separator: str, parts: Any = ()) -> None:
    parts = list(parts)
    _refuse_growth(len(parts), len(separator) + max((len(str(one)) for one in parts), default=0))


def _check_format(text: str, *values: Any, **named: Any) -> None:
    for _, name, style, _ in Formatter().parse(text):
        if not re.fullmatch(r"\w*", name or "") or "{" in (style or ""):
            raise ExpressionError(f"the field {name!r:.40} of a format is not allowed in a file")
        _refuse_wide(style or "")
    longest = max((len(str(one)) for one in (*values, *named.values())), default=0)
    _refuse_growth(text.count("{"), longest)


def _check_replace(text: str, old: str, new: str, *_: Any) -> None:
    _refuse_growth(text.count(old), len(new))


def _check_width(_: str, width: int, *__: Any) -> None:
    _refuse_growth(width, 1)


_CHECKS: dict[str, Callable[..., None]] = {
    "join": _check_join, "format": _check_format, "replace": _check_replace,
    "zfill": _check_width, "ljust": _check_width, "rjust": _check_width, "center": _check_width,
}  # fmt: skip
"""Methods whose results can be much larger than their arguments."""


def _round(value: float, digits: int | None = None) -> float:
    if digits is not None and abs(digits) > MAX_DIGITS:
        raise ExpressionError(f"rounding to {digits} digits")
    return round(value, digits)


def _range(*ends: int) -> range:
    found = range(*ends)
    _refuse_growth(len(found), 1, MAX_ITEMS)
    return found


def _is_instance(value: Any, kinds: Any) -> bool:
    several = kinds if isinstance(kinds, tuple) else (kinds,)
    known = [one.kind for one in several if isinstance(one, Function) and one.kind is not None]
    if len(known) < len(several):
        raise TypeError("isinstance() arg 2 must be a type")
    return isinstance(value, tuple(known))


def _listed(function: Callable[..., Any]) -> Callable[..., list[Any]]:
    """Return a function whose result is a list instead of an iterator."""
    return lambda *values: list(function(*values))


_TYPES: tuple[type, ...] = (
    str, int, float, bool, list, dict, tuple, set, frozenset, complex,
)  # fmt: skip
_PYTHON: dict[str, Callable[..., Any]] = {
    "abs": abs, "all": all, "any": any, "divmod": divmod, "enumerate": _listed(enumerate),
    "filter": _listed(filter), "isinstance": _is_instance, "len": len, "map": _listed(map),
    "max": max, "min": min, "ord": ord, "range": _range, "repr": repr,
    "reversed": _listed(reversed), "round": _round, "sorted": sorted, "sum": sum,
    "zip": _listed(zip),
}  # fmt: skip
PYTHON: dict[str, Function] = {
    **{name: Function(name, run) for name, run in _PYTHON.items()},
    **{kind.__name__: Function(kind.__name__, kind, kind) for kind in _TYPES},
}
"""Functions of Python that expressions can call."""
MATH: dict[str, Any] = {
    **{name: Function(name, getattr(math, name)) for name in _MATH if hasattr(math, name)},
    **{name: getattr(math, name) for name in ("pi", "e", "tau", "inf", "nan")},
}
"""Constants and functions of `math` that expressions can use."""


OLD_TAGS = ("if", "unless", "include", "arg", "property", "macro", "insert_block", "call")
"""Tags that xacro expanded without its prefix until ROS Melodic."""
MAX_CALLS, MAX_FILE_BYTES = 100_000, 20_000_000
"""Largest number of elements and macros [-], of which Stretch 4 has 1,530, and size of a file
[bytes]."""
_OPTENV = re.compile(r"\$\(optenv\s+(\w+)\s*([^()]*)\)")
ARGUMENT = "--xacro-arg "
"""Prefix of the switches that are arguments; the others are environment variables."""
_NOWHERE = "/package_not_found/"
"""Folder that stands for those of packages that were not found."""
_OFF = ("", "0", "false", "none")
"""Defaults of switches that leave something out."""
_FORBIDDEN = ("ctypes", "exec", "os", "pty", "shutil", "socket", "subprocess")
"""First words of the events that `FileGate` refuses: calls that do more than compute."""


class Refused(Exception):
    """A file asks for what no file needs."""


class FileGate:
    """Lets the process read files of some folders, and nothing else.

    The grammar of expressions leaves no path to other calls; the gate holds if it has a hole.
    """

    def __init__(self, roots: list[str]) -> None:
        """Name the folders; the gate is open."""
        self.roots = [os.path.realpath(root) for root in roots]
        self._trusted = False

    def close(self) -> None:
        """Close the gate, for good; no module can be loaded from then on."""
        sys.addaudithook(self._check)

    @contextmanager
    def trusted(self) -> Iterator[None]:
        """Allow everything while packages are looked up in the folders that the user has set."""
        before, self._trusted = self._trusted, True
        try:
            yield
        finally:
            self._trusted = before

    def _check(self, event: str, details: tuple[Any, ...]) -> None:
        if self._trusted:
            return
        if event == "open":
            path, _, flags = details
            if isinstance(path, int):
                return
            if flags & (os.O_WRONLY | os.O_RDWR | os.O_CREAT | os.O_TRUNC):
                raise Refused(f"writing {path!r:.200} is not allowed in a file")
            self._check_file(os.fsdecode(path))
        elif event in ("os.listdir", "os.scandir"):
            self._check_inside(os.fsdecode(details[0] or "."))
        elif event.partition(".")[0] in _FORBIDDEN:
            raise Refused(f"{event} is not allowed in a file")

    def _check_file(self, path: str) -> None:
        self._check_inside(path)
        try:
            status = os.stat(path)
        except OSError:
            return  # opening it reports why
        if not stat.S_ISREG(status.st_mode):
            raise Refused(f"{path!r:.200} is not a regular file")
        if status.st_size > MAX_FILE_BYTES:
            raise Refused(f"{path!r:.200} is larger than {MAX_FILE_BYTES / 1e6:g} MB")

    def _check_inside(self, path: str) -> None:
        real = os.path.realpath(path)
        if not any(real == root or real.startswith(root.rstrip("/") + "/") for root in self.roots):
            raise Refused(f"{path!r:.200} is outside {self.roots[0]}, where the file is")


class Files:
    """What all files of a robot say, as xacro reads them."""

    def __init__(self, library: Any, *, old: bool) -> None:
        """Watch what the library reads.

        Args:
            library: The module xacro, which is changed.
            old: Whether tags and macros without a prefix are expanded.
        """
        self._call, self._library = library.handle_macro_call, library
        self._resolve, self._old = library.resolve_macro, old
        self._calls = 0
        self.old_tags: set[str] = set()
        self.switches: dict[str, str] = {}
        """Arguments and environment variables that are off by default, with their defaults."""
        self.missing: list[str] = []
        """Packages that were not found; their files count as empty, their macros as nothing,
        and their properties as 0, so that all are named."""
        library.parse = self.parse
        library.handle_macro_call = self.call

    def parse(self, source: Any, filename: str | None = None) -> Any:
        """Read a file as xacro does, but no document with entities."""
        from defusedxml import minidom

        if source is None and (filename or "").startswith(_NOWHERE):
            source = "<robot/>"
        if source is None:
            try:
                with open(os.path.join(self._library.root_dir, filename or ""), "rb") as file:
                    source = file.read(MAX_FILE_BYTES)
            except OSError as error:  # an optional file; the library reads the cause
                self._library.filestack.pop()
                words = f"{error.strerror}: {error.filename}"
                raise self._library.XacroException(words, exc=error) from error
        document = minidom.parseString(source)
        for element in document.getElementsByTagName("*"):
            if element.tagName in OLD_TAGS:
                self.old_tags.add(element.tagName)
                if self._old:
                    element.tagName = element.nodeName = f"xacro:{element.tagName}"
            self._note_switches(element)
        return document

    def _note_switches(self, element: Any) -> None:
        name, default = element.getAttribute("name"), element.getAttribute("default")
        if element.tagName == "xacro:arg" and default.strip().lower() in _OFF:
            self.switches[f"{ARGUMENT}{name}"] = default
        for value in dict(element.attributes.items()).values():
            for name, default in _OPTENV.findall(value):
                if name not in os.environ and default.strip().lower() in _OFF:
                    self.switches[f"${name}"] = default

    def call(self, node: Any, macros: Any, symbols: Any) -> Any:
        """Expand a macro, whose name may stand without the prefix."""
        self._calls += 1
        if self._calls > MAX_CALLS:
            raise Refused(f"more than {MAX_CALLS} elements and macros")
        if self._old and ":" not in node.tagName:
            try:
                self._resolve(node.tagName, macros, symbols)
            except KeyError:
                return False
            node.tagName = f"xacro:{node.tagName}"
        try:
            return self._call(node, macros, symbols)
        except self._library.XacroException:
            if not self.missing:
                raise
            self._library.replace_node(node, by=None)  # a macro of a missing package
            return True

    def evaluate(self, text: str, names: Any) -> Any:
        """Evaluate an expression; 0 for names that missing packages may define."""
        try:
            return evaluate(text, names)
        except Exception:
            if not self.missing:
                raise
            return 0


def confine(
    library: Any, substitution_args: Any, packages: Any, gate: FileGate, files: Files
) -> None:
    """Evaluate the expressions of a library by our grammar, within its files.

    Args:
        library: The module xacro, which is changed.
        substitution_args: Its module for `$(...)`, which is changed.
        packages: The module that finds packages by name.
        gate: It learns the folders of the packages.
        files: It learns the names of packages that are not found.
    """

    def find(name: str) -> str:
        if not re.fullmatch(r"[\w.-]*\w[\w.-]*", name):
            raise Refused(f"{name!r:.80} is not the name of a package")
        with gate.trusted():
            try:
                folder = os.path.realpath(packages.get_path(name))
            except packages.PackageNotFoundError:
                files.missing.append(name)
                return f"{_NOWHERE}{name}"
        gate.roots.append(folder)
        return folder

    def substitute(text: str, context: Mapping[str, Any]) -> str:
        """Evaluate `$(eval ...)`, whose names are the arguments of the file."""
        convert, given = substitution_args.convert_value, context.get("arg", {})
        functions = {
            "arg": lambda name: convert(substitution_args._eval_arg(name, given), "auto"),
            "dirname": lambda: substitution_args._eval_dirname(context["filename"]),
            "env": substitution_args._eval_env, "optenv": substitution_args._eval_optenv,
            "find": find,
        }  # fmt: skip
        known = {name: convert(value, "auto") for name, value in given.items()}
        known |= {name: PYTHON[name] for name in ("list", "dict", "map", "str", "float", "int")}
        known |= MATH | {name: Function(name, run) for name, run in functions.items()}
        return str(evaluate(text, {**known, "true": True, "false": False}))

    _name_functions(library)
    library.safe_eval = lambda text, names, _=None: files.evaluate(text, names)
    substitution_args._eval, substitution_args._eval_find = substitute, find


def _name_functions(library: Any) -> None:
    """Replace the global names of the library; its messages, which nobody reads, are dropped."""

    def silent(*_: Any, **__: Any) -> str:
        return ""

    def fatal(*words: Any) -> None:
        raise Refused(" ".join(map(str, words)))

    def tokenize(text: str, sep: str = ",; ", skip_empty: bool = True) -> list[str]:
        return [part for part in re.split(f"[{re.escape(sep)}]", text) if part or not skip_empty]

    messages = ("message", "warning", "error", "print_location")
    functions = {
        "load_yaml": lambda name: checked(library.load_yaml(name)),
        "abs_filename": library.abs_filename_spec, "dotify": library.YamlDictWrapper,
        "arg": lambda name: library.substitution_args_context["arg"][name],
        "fatal": fatal, "tokenize": tokenize, **dict.fromkeys(messages, silent),
    }  # fmt: skip
    xacro = {name: Function(name, run) for name, run in functions.items()}
    names = library._global_symbols
    names.clear()
    for space, content in (("math", MATH), ("python", PYTHON), ("xacro", xacro)):
        names[space] = library.NameSpace()
        dict.update(names[space], content)
    plain = (
        "list", "dict", "map", "len", "str", "float", "int", "bool", "min", "max", "round",
        "sorted", "range",
    )  # fmt: skip
    names |= MATH | {name: PYTHON[name] for name in plain}
    names |= {name: xacro[name] for name in ("load_yaml", "abs_filename", "dotify")}
    for name in messages:
        setattr(library, name, silent)


def main() -> None:
    """Expand the file that the arguments name, as JSON; print the result as JSON."""
    asked = json.loads(sys.argv[1])
    # The folder of the file may hold modules, and an empty entry of the path would import them.
    sys.path[:] = [os.path.abspath(folder) for folder in sys.path]
    os.chdir(asked["folder"])  # paths of included files are relative to it
    resource.setrlimit(resource.RLIMIT_CPU, (asked["seconds"],) * 2)
    resource.setrlimit(resource.RLIMIT_AS, (asked["memory"],) * 2)
    import yaml  # noqa: F401  the library loads it later
    from defusedxml import minidom  # noqa: F401
    from xacrodoc import XacroDoc, packages, xacrodoc

    packages.update_package_cache(asked["packages"])
    gate = FileGate([*asked["roots"], *asked["packages"].values()])
    files = Files(xacrodoc.xacro, old=asked["old"])
    confine(xacrodoc.xacro, xacrodoc.substitution_args, packages, gate, files)
    answer: dict[str, Any] = {}
    gate.close()
    try:
        doc = XacroDoc.from_file(
            asked["file"], walk_up=False, subargs=dict(asked["args"]), resolve_packages=False
        )
        left = {one.tagName for one in doc.dom.documentElement.childNodes if one.nodeType == 1}
        answer |= {"urdf": doc.dom.toxml(), "whole": not left & set(OLD_TAGS)}
        if len(answer["urdf"]) > asked["largest"]:
            raise Refused(f"it expands to more than {asked['largest'] / 1e6:g} MB")
    except Exception as error:
        answer = {"error": " ".join(str(error).split()) or type(error).__name__}
    off = {name: value for name, value in files.switches.items() if _is_open(name, asked["args"])}
    facts = {"old_tags": sorted(files.old_tags), "off": off, "missing": files.missing}
    json.dump({**answer, **facts}, sys.stdout)


def _is_open(switch: str, args: dict[str, str]) -> bool:
    """Return whether no argument sets a switch."""
    return switch.removeprefix(ARGUMENT) not in args


if __name__ == "__main__":
    main()
