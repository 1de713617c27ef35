"""The sources of the package as syntax trees, each parsed once for all tests of a process."""

from __future__ import annotations

import ast
from functools import cache
from pathlib import Path

KEPT = ast.Call | ast.Import | ast.ImportFrom | ast.Assign


@cache
def tree(path: Path) -> ast.Module:
    """Return the syntax tree of a module."""
    return ast.parse(path.read_text())


@cache
def nodes(path: Path) -> tuple[ast.AST, ...]:
    """Return the calls, imports and assignments in a module."""
    return tuple(node for node in ast.walk(tree(path)) if isinstance(node, KEPT))
