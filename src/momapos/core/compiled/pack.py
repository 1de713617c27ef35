"""Compile every entry for a common processor: `python -m momapos.core.compiled.pack FILE`.

The build of the wheel runs it in a separate process, since numba reads the processor's name once.
"""

from __future__ import annotations

import importlib
import json
import os
import sys
import zipfile
from pathlib import Path

from . import code_store as stores
from .entries import ENTRIES, Kernel


def every_entry() -> list[Kernel]:
    """Import all modules that define entries; return the entries sorted by name."""
    package = Path(__file__).parents[2]
    for path in sorted(package.rglob("*.py")):
        if "\n@entry" in path.read_text(encoding="utf-8"):
            parts = path.relative_to(package).with_suffix("").parts
            importlib.import_module(".".join(["momapos", *parts]))
    return [ENTRIES[name] for name in sorted(ENTRIES)]


def write_pack(path: Path) -> None:
    """Compile all entries into one file."""
    from .compiler import compile_entry

    stamps = {}
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as pack:
        for entry in every_entry():
            pack.writestr(entry.name, stores.encode(compile_entry(entry)))
            stamps[entry.name] = entry.stamp
        about = {"made by": stores.compiler_version(), "stamps": stamps}
        pack.writestr("pack.json", json.dumps(about))


if __name__ == "__main__":
    os.environ["NUMBA_CPU_NAME"] = stores.PACK_CPU
    os.environ["NUMBA_CPU_FEATURES"] = ",".join(f"+{name}" for name in stores.PACK_FEATURES)
    write_pack(Path(sys.argv[1]))
