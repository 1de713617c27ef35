"""Parse untrusted YAML: plain values only, without tags, aliases or deep nesting."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

from .errors import FileFormatError

MAX_DEPTH = 50
"""Maximum number of nested lists and mappings [-]."""
_NUMBER = re.compile(r"[-+]?(\.\d+|\d[\d_]*(\.\d*)?)([eE][-+]?\d+)?")
_CONSTANTS = {
    **dict.fromkeys(("", "~", "null", "Null", "NULL"), None),
    **dict.fromkeys(("true", "True", "TRUE", "yes", "Yes", "YES", "on", "On", "ON"), True),
    **dict.fromkeys(("false", "False", "FALSE", "no", "No", "NO", "off", "Off", "OFF"), False),
}
"""Plain words with a meaning in YAML 1.1."""
_INFINITE = re.compile(r"([-+]?)\.(inf|Inf|INF)|\.(nan|NaN|NAN)")


def parse_yaml(text: str, path: Path) -> Any:
    """Return the first document of a YAML text as dicts, lists, texts, numbers, bools and None.

    Args:
        text: The content of a file; later documents are not read.
        path: The file, for messages.

    Raises:
        FileFormatError: The text is not YAML, names a key twice, or has tags, aliases, or more than
            50 levels; one line says what is wrong and in which line.
    """
    import yaml

    loader = getattr(yaml, "CSafeLoader", yaml.SafeLoader)
    try:
        # Build from events: recursive readers of deep documents overflow the stack.
        builder = _Builder(path)
        for event in yaml.parse(text, Loader=loader):
            if isinstance(event, yaml.DocumentEndEvent):
                break
            builder.take(event)
    except yaml.YAMLError as error:
        mark = getattr(error, "problem_mark", None)
        where = "" if mark is None else f"line {mark.line + 1}: "
        problem = getattr(error, "problem", None) or str(error).splitlines()[0]
        raise FileFormatError(f"{path}: {where}invalid YAML ({problem})") from error
    return builder.value


class _Builder:
    """Builds values from the events of a parser."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.value: Any = None
        self.open: list[Any] = []
        """Lists and mappings that are not complete, outermost first."""
        self.keys: list[Any] = []
        """The key of each open mapping that waits for its value."""

    def take(self, event: Any) -> None:
        """Add an event."""
        import yaml

        if isinstance(event, yaml.AliasEvent) or getattr(event, "anchor", None) is not None:
            raise self._error(event, "anchors and aliases are not supported")
        tag = getattr(event, "tag", None)
        if tag is not None and tag != "!":
            raise self._error(event, f"the tag {tag!r:.60} is not supported")
        if isinstance(event, yaml.ScalarEvent):
            quoted = event.style in ("'", '"', "|", ">")
            self._add(event, event.value if quoted else _plain(event.value))
        elif isinstance(event, yaml.SequenceStartEvent):
            self._begin(event, [])
        elif isinstance(event, yaml.MappingStartEvent):
            self._begin(event, {})
        elif isinstance(event, yaml.SequenceEndEvent | yaml.MappingEndEvent):
            self.open.pop()
            self.keys.pop()

    def _error(self, event: Any, text: str) -> FileFormatError:
        return FileFormatError(f"{self.path}: line {event.start_mark.line + 1}: {text}")

    def _begin(self, event: Any, value: list[Any] | dict[str, Any]) -> None:
        if len(self.open) >= MAX_DEPTH:
            raise self._error(event, f"more than {MAX_DEPTH} nested lists and mappings")
        self._add(event, value)
        self.open.append(value)
        self.keys.append(_NO_KEY)

    def _add(self, event: Any, value: Any) -> None:
        if not self.open:
            self.value = value
        elif isinstance(self.open[-1], list):
            self.open[-1].append(value)
        elif self.keys[-1] is _NO_KEY:
            if isinstance(value, list | dict):
                raise self._error(event, "a key must be a word")
            if str(value) in self.open[-1]:
                raise self._error(event, f"the key {value!r:.60} stands twice")
            self.keys[-1] = str(value)
        else:
            self.open[-1][self.keys[-1]] = value
            self.keys[-1] = _NO_KEY


_NO_KEY = object()


def _plain(text: str) -> Any:
    """Return the value of a scalar without quotes."""
    if text in _CONSTANTS:
        return _CONSTANTS[text]
    if _NUMBER.fullmatch(text):
        digits = text.replace("_", "")
        whole = digits.lstrip("+-").isdigit() and len(digits) < 20
        return int(digits) if whole else float(digits)
    infinite = _INFINITE.fullmatch(text)
    if infinite is None:
        return text
    return float(f"{infinite[1] or ''}inf") if infinite[2] else float("nan")
