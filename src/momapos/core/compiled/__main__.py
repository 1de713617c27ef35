"""Compile entries into a cache folder: `python -m momapos.core.compiled FOLDER NAME...`."""

from __future__ import annotations

import importlib
import sys
from pathlib import Path

from .code_store import Store
from .entries import ENTRIES

store = Store(Path(sys.argv[1]))
for name in sys.argv[2:]:
    importlib.import_module(name.rpartition(".")[0])
    store.prepare([ENTRIES[name]], lambda *_: None)
