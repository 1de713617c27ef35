"""Write rows as a Parquet file."""

from __future__ import annotations

import io
import json
from collections.abc import Sequence
from pathlib import Path

from momapos.core import InputError, require, write_atomic

from .bench_records import Row, to_plain
from .row_store import COLUMNS, NESTED, TYPES

BOOLEANS = ("verified", "done")


def write_parquet(rows: Sequence[Row], path: Path) -> None:
    """Write rows, with the columns of the results file; write all of it or nothing.

    Raises:
        MissingExtraError: pyarrow is not installed.
        InputError: The file can't be written.
    """
    with require("parquet"):
        import pyarrow
        from pyarrow import parquet
    plain = [to_plain(row) for row in rows]
    # Explicit types, because pyarrow can't infer the type of a column without values.
    kinds = {"INTEGER": pyarrow.int64(), "REAL": pyarrow.float64(), "TEXT": pyarrow.string()}
    types = {name: kinds[TYPES.get(name, "TEXT")] for name in COLUMNS}
    types |= dict.fromkeys(BOOLEANS, pyarrow.bool_())
    nested = [{**one, **{name: json.dumps(one[name]) for name in NESTED}} for one in plain]
    table = pyarrow.Table.from_pylist(nested, schema=pyarrow.schema(types.items()))
    buffer = io.BytesIO()
    parquet.write_table(table, buffer)
    try:
        write_atomic(path, buffer.getvalue())
    except OSError as error:
        raise InputError(f"{path}: cannot be written ({error.strerror})") from error
