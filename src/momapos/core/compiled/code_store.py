"""Store the machine code of entries: in a pack that comes with a wheel, or in a cache folder.

The key of an entry's code is its stamp (all functions that it calls), the exact versions of numba,
of our compiler and of llvmlite, Python's minor version, and the processor. Checksums detect damage,
not malice: whoever can write the cache folder can run code as its owner, as with Python's caches.
"""

from __future__ import annotations

import contextlib
import json
import logging
import os
import platform
import sys
import threading
from collections.abc import Callable, Iterator, Sequence
from functools import cached_property
from pathlib import Path
from typing import TYPE_CHECKING, Any

import llvmlite
import llvmlite.binding as llvm

from momapos.core import forking as forking  # renews the locks of cached properties
from momapos.core.cache import Cache, content_key, default_cache_dir
from momapos.core.garbage import no_garbage_collection
from momapos.core.stopwatch import processor_time

from .kernel_source import KernelSource
from .native import Code, link, numba_folder

if TYPE_CHECKING:
    import zipfile

log = logging.getLogger(__name__)
PACK = Path(__file__).with_name("kernels.zip")
PACK_CPU = "x86-64-v3"
PACK_FEATURES = ("avx", "avx2", "bmi", "bmi2", "f16c", "fma", "lzcnt", "movbe", "popcnt", "sse4.2")
"""Processor features that the code of a pack needs."""
_NUMBA_SETTINGS = ("NUMBA_CPU_", "NUMBA_OPT", "NUMBA_LOOP_", "NUMBA_SLP_", "NUMBA_BOUNDS")
Progress = Callable[[int, int], None]
_COMPILER = ("compiler.py",)


def compiler_version() -> list[str]:
    """Return what machine code depends on besides its source and the processor."""
    # Read the version file: importing numba is slow, and looking up its metadata takes 40 ms.
    numba = (numba_folder() / "_version.py").read_bytes()
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
        self._linked: dict[tuple[str, str], Callable[..., Any]] = {}

    def native(self, entry: KernelSource) -> Callable[..., Any]:
        """Return an entry's machine code as a function, compiled now if it is not stored."""
        if os.environ.get("NUMBA_DISABLE_JIT", "0") not in ("", "0"):
            return entry.py_func
        key = entry.name, entry.stamp
        with self._lock:
            if key not in self._linked:
                self._linked[key] = link(self.find(entry) or self._compile(entry), entry.name)
            return self._linked[key]

    def prepare(self, entries: Sequence[KernelSource], report: Progress) -> None:
        """Compile entries that are not stored; call `report(done, total)` before each.

        If there are several, a second process compiles them from the last one on.
        """
        missing = [entry for entry in entries if not self._has(entry)]
        with no_garbage_collection(), _second_process(missing[:0:-1], self.cache.folder):
            for done, entry in enumerate(missing):
                report(done, len(missing))
                self.native(entry)
        if missing:
            report(len(missing), len(missing))

    def find(self, entry: KernelSource) -> Code | None:
        """Return the stored code of an entry, or None."""
        if entry.stamp == self._packed.get(entry.name):
            try:
                return decode(self._members.read(entry.name))
            except Exception as error:  # zipfile, zlib and json each raises its own
                log.warning("%s: ignoring %s, which is damaged (%s)", self.pack, entry.name, error)
        try:
            data = self.cache.get(self._key(entry))
        except OSError as error:
            log.warning("cannot read compiled code: %s", error)
            return None
        return None if data is None else decode(data)

    def _has(self, entry: KernelSource) -> bool:
        packed = entry.stamp == self._packed.get(entry.name)
        return packed or self.cache.path(self._key(entry)).is_file()

    def _compile(self, entry: KernelSource) -> Code:
        from .compiler import compile_entry

        log.info("compiling %s", entry.name)
        with processor_time.stopped(), no_garbage_collection():
            code = compile_entry(entry)
        try:
            self.cache.put(self._key(entry), encode(code))
        except OSError as error:
            log.warning("cannot store compiled code: %s", error)
        return code

    def _key(self, entry: KernelSource) -> str:
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
        """Return the stamps of the pack's entries; empty if it does not fit this interpreter."""
        if not self.pack.is_file():
            return {}
        try:
            about = json.loads(self._members.read("pack.json"))
            made_by, stamps = about["made by"], dict(about["stamps"])
        except Exception as error:  # zipfile, zlib and json each raises its own
            log.warning("%s: ignoring a damaged pack (%s)", self.pack, error)
            return {}
        features = llvm.get_host_cpu_features()
        fits = made_by == compiler_version() and all(
            features.get(name, False) for name in PACK_FEATURES
        )
        return stamps if fits else {}


@contextlib.contextmanager
def _second_process(entries: Sequence[KernelSource], folder: Path) -> Iterator[None]:
    """Compile entries into a cache folder in another process, until the block ends."""
    if not entries or not sys.executable or (os.cpu_count() or 1) < 2:
        yield
        return
    from subprocess import DEVNULL, Popen

    names = [entry.name for entry in entries]
    # -P: modules in the current folder, which may hold someone else's files, are not imported.
    words = [sys.executable, "-P", "-m", "momapos.core.compiled", str(folder), *names]
    with Popen(words, stdin=DEVNULL, stdout=DEVNULL, stderr=DEVNULL) as process:
        try:
            yield
        finally:
            process.terminate()


def encode(code: Code) -> bytes:
    """Serialize code."""
    head = {"symbol": code.symbol, "environments": code.environments}
    return json.dumps(head).encode() + b"\n" + code.image


def decode(data: bytes) -> Code:
    """Deserialize the bytes of `encode`."""
    head, _, image = data.partition(b"\n")
    about = json.loads(head)
    environments = tuple((name, tuple(dtypes)) for name, dtypes in about["environments"])
    return Code(image, about["symbol"], environments)


store = Store(default_cache_dir())
"""The store of this process."""


def _before_fork() -> None:
    """Wait until no thread compiles or links, so that a child has whole code and a free LLVM."""
    store._lock.acquire()


def _after_fork() -> None:
    store._lock.release()


os.register_at_fork(before=_before_fork, after_in_parent=_after_fork, after_in_child=_after_fork)
