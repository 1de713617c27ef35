"""Where the machine code of entries is kept: a pack that comes with a wheel, then a cache folder.

Code is found by what it is made from: the entry's stamp (all functions that it calls), the exact
versions of numba, of our compiler and of llvmlite, Python's minor version, and the processor.
Checksums find damage, not malice: who can write the cache folder can run code as its owner, as with
Python's own caches.
"""

from __future__ import annotations

import contextlib
import gc
import json
import logging
import os
import platform
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from importlib.util import find_spec
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite
import llvmlite.binding as llvm

from momapos.core.cache import Cache, content_key, default_cache_dir

from .native import Code, link

if TYPE_CHECKING:
    import zipfile

    from .entries import Kernel

log = logging.getLogger(__name__)
PACK = Path(__file__).with_name("kernels.zip")
PACK_CPU = "x86-64-v3"
PACK_FEATURES = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2")
"""What the processor must have for the code of a pack."""
_NUMBA_SETTINGS = ("NUMBA_CPU_", "NUMBA_OPT", "NUMBA_LOOP_", "NUMBA_SLP_", "NUMBA_BOUNDS")
Report = Callable[[int, int], None]
_COMPILER = ("borrowing.py", "compiler.py")


def compiler_version() -> list[str]:
    """What machine code depends on besides its source and the processor."""
    package = find_spec("numba")
    if package is None or package.origin is None:
        raise ImportError("numba is not installed")
    # numba's version, read and not imported: importing is what must not happen here, and the
    # package's metadata takes 40 ms to look up.
    numba = Path(package.origin).with_name("_version.py").read_bytes()
    python = f"{sys.implementation.name} {sys.version_info[0]}.{sys.version_info[1]}"
    ours = [Path(__file__).with_name(name).read_bytes() for name in _COMPILER]
    versions = [f"numba {content_key(numba, *ours)}", f"llvmlite {llvmlite.__version__}"]
    return [*versions, python, sys.platform, platform.machine()]


class Store:
    """Machine code by entry."""

    def __init__(self, folder: Path, pack: Path = PACK) -> None:
        self.cache = Cache(folder)
        self.pack = pack
        self._lock = threading.RLock()

    def native(self, entry: Kernel) -> Callable[..., Any]:
        """What Python calls, compiled now if it has not been."""
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            return entry.py_func
        with self._lock:
            code = self.find(entry)
            if code is None:
                code = self._compile(entry)
            return link(code, entry.name)

    def prepare(self, entries: Sequence[Kernel], report: Report) -> None:
        """Compile those entries that are not stored, calling `report(done, of)` before each."""
        missing = [entry for entry in entries if not self._has(entry)]
        with _no_collector():
            for done, entry in enumerate(missing):
                report(done, len(missing))
                entry.load()
        if missing:
            report(len(missing), len(missing))

    def find(self, entry: Kernel) -> Code | None:
        """The code of an entry, if it is stored."""
        if entry.stamp == self._packed.get(entry.name):
            try:
                return decode(self._members.read(entry.name))
            except Exception as error:  # zipfile, zlib and json each raise their own
                log.warning("%s: %s is damaged, ignored (%s)", self.pack, entry.name, error)
        try:
            data = self.cache.get(self._key(entry))
        except OSError as error:
            log.warning("compiled code cannot be read: %s", error)
            return None
        return None if data is None else decode(data)

    def _has(self, entry: Kernel) -> bool:
        packed = entry.stamp == self._packed.get(entry.name)
        return packed or self.cache.path(self._key(entry)).is_file()

    def _compile(self, entry: Kernel) -> Code:
        from .compiler import compile_entry

        log.info("compiling %s", entry.name)
        with _no_collector():
            code = compile_entry(entry)
        try:
            self.cache.put(self._key(entry), encode(code))
        except OSError as error:
            log.warning("compiled code cannot be kept: %s", error)
        return code

    def _key(self, entry: Kernel) -> str:
        return f"kernel-{content_key(entry.name, entry.stamp, self._host)}"

    @cached_property
    def _host(self) -> list[str]:
        settings = sorted(
            f"{k}={v}" for k, v in os.environ.items() if k.startswith(_NUMBA_SETTINGS)
        )
        features = llvm.get_host_cpu_features().flatten()
        return [*compiler_version(), llvm.get_host_cpu_name(), features, *settings]

    @cached_property
    def _members(self) -> zipfile.ZipFile:
        import zipfile

        return zipfile.ZipFile(self.pack)

    @cached_property
    def _packed(self) -> dict[str, str]:
        """Stamps of the entries in the pack; none where it is not for this interpreter."""
        if not self.pack.is_file():
            return {}
        try:
            about = json.loads(self._members.read("pack.json"))
            made_by, stamps = about["made by"], dict(about["stamps"])
        except Exception as error:  # zipfile, zlib and json each raise their own
            log.warning("%s: damaged, ignored (%s)", self.pack, error)
            return {}
        features = llvm.get_host_cpu_features()
        fits = made_by == compiler_version() and all(
            features.get(name, False) for name in PACK_FEATURES
        )
        return stamps if fits else {}


@contextlib.contextmanager
def _no_collector() -> Iterator[None]:
    """Keep Python from looking for dead cycles among numba's many objects.

    It takes a tenth of the time of compiling; without it an answer's kernels take 600 MB.
    """
    enabled = gc.isenabled()
    gc.disable()
    try:
        yield
    finally:
        if enabled:
            gc.enable()


def encode(code: Code) -> bytes:
    """Code as bytes."""
    head = {"symbol": code.symbol, "environments": code.environments}
    return json.dumps(head).encode() + b"\n" + code.image


def decode(data: bytes) -> Code:
    """Code from bytes that `encode` has made."""
    head, _, image = data.partition(b"\n")
    about = json.loads(head)
    environments = tuple((name, tuple(dtypes)) for name, dtypes in about["environments"])
    return Code(image, about["symbol"], environments)


store = Store(default_cache_dir())
"""The one store of this process: code belongs to the process, as imported modules do."""


def _after_fork() -> None:
    """Renew the lock in a child: a thread that held it stayed in the parent."""
    store._lock = threading.RLock()


os.register_at_fork(after_in_child=_after_fork)
