"""Commands of momapos, run in this process."""

from __future__ import annotations

import io
import json
from contextlib import redirect_stderr, redirect_stdout
from typing import Any

from momapos.apps.cli.main import main


def output_of(*words: str, status: int = 0) -> str:
    """Return what a command prints if it ends with a status."""
    with redirect_stdout(io.StringIO()) as out:
        assert main(list(words)) == status
    return out.getvalue()


def json_of(*words: str, status: int = 0) -> Any:
    """Return the only JSON value that a command prints."""
    return json.loads(output_of(*words, status=status))


def error_of(*words: str) -> str:
    """Return the only line that a command prints about unusable input."""
    with redirect_stderr(io.StringIO()) as err:
        assert output_of(*words, status=2) == ""
    (line,) = err.getvalue().splitlines()
    return line
