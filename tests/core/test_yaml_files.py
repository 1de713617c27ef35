"""YAML is read as plain values, or refused in one line."""

from __future__ import annotations

from pathlib import Path

import pytest
import yaml

from momapos.core.errors import FileFormatError
from momapos.core.files import parse_yaml

TEXT = """
a: 1
b: [1.5, -2, .5, 1e-3, true, no, ~, word, "7", 'a: b']
c:
  - {x: 1, y: [2, 3]}
  - text with spaces
d:
e: |
  two
  lines
f: 1_000
g: -.inf
"""
BAD = {
    "alias": ("a: &x 1\nb: *x", "line 1: anchors and aliases"),
    "tag": ("\na: !!python/object:os.system x", "line 2: the tag"),
    "twice": ("a: 1\na: 2", "line 2: the key 'a' stands twice"),
    "open": ("{a: [1, 2}", "invalid YAML"),
    "deep": ("[" * 60 + "]" * 60, "more than 50 nested"),
    "very deep": ("[" * 100_000, "invalid YAML|more than 50 nested"),
    "list as key": ("? [1]\n: 2", "a key must be a word"),
    "tab": ("\t- a", "invalid YAML"),
}


def test_plain_values_are_those_of_the_safe_loader() -> None:
    found = parse_yaml(TEXT, Path("a.yaml"))
    expected = yaml.safe_load(TEXT)
    expected["b"][3] = 1e-3  # a number in YAML 1.2 and in ROS
    assert found == expected


def test_only_the_first_document_is_read() -> None:
    assert parse_yaml("a: 1\n---\nb: [", Path("a.yaml")) == {"a": 1}
    assert parse_yaml("", Path("a.yaml")) is None


@pytest.mark.parametrize("case", BAD)
def test_other_yaml_is_refused_in_one_line(case: str) -> None:
    text, message = BAD[case]
    with pytest.raises(FileFormatError, match=message) as raised:
        parse_yaml(text, Path("a.yaml"))
    assert "\n" not in str(raised.value)
