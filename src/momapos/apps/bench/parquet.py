"""Rows as a Parquet file, for tools that read columns."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

from momapos.core import InputError, require, write_atomic

from .bench_records import Row, to_plain
from .row_store import COLUMNS, NESTED, TYPES

YES_NO = ("verified", "done")


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Write rows, the whole file or nothing; columns are those of the results file.

    Raises:
        MissingExtraError: pyarrow is not installed.
        InputError: The file cannot be written.
    """
    with require("parquet"):
        import pyarrow
        from pyarrow import parquet
    plain = [to_plain(row) for row in rows]
    # Named types, or a column without any value would have none.
    kinds = {"INTEGER": pyarrow.int64(), "REAL": pyarrow.float64(), "TEXT": pyarrow.string()}
    types = {name: kinds[TYPES.get(name, "TEXT")] for name in COLUMNS}
    types |= dict.fromkeys(YES_NO, pyarrow.bool_())
    nested = [{**one, **{name: json.dumps(one[name]) for name in NESTED}} for one in plain]
    table = pyarrow.Table.from_pylist(nested, schema=pyarrow.schema(types.items()))
    buffer = io.BytesIO()
    parquet.write_table(table, buffer)
    try:
        write_atomic(path, buffer.getvalue())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
