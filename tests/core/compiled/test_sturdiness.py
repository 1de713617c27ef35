"""The kernel store with several processes, full disks, interrupts and forks; borrowed arrays."""

from __future__ import annotations

import errno
import gc
import os
import re
import resource
import subprocess
import sys
import threading
from pathlib import Path
from typing import NamedTuple, NoReturn

import numpy as np
import pytest
from numba.core.codegen import JITCodeLibrary
from numba.core.registry import cpu_target

from momapos.core import cache
from momapos.core.compiled import F1, compiler, entry, kernel
from momapos.core.compiled import code_store as stores
from momapos.core.compiled.code_store import Store
from momapos.core.compiled.entries import Kernel

X = np.linspace(-1.0, 1.0, 5)


class Pair(NamedTuple):
    """Two arrays."""

    a: F1
    b: F1


@kernel
def _half(pair, k):
    both = Pair(pair.a[k:], pair.b[k:])
    return 0.5 * (both.a[0] + both.b[0])


@kernel
def _shifted(x):
    out = np.empty(len(x))
    for k in range(len(x)):
        out[k] = x[k] + 1.0
    return out


@kernel
def _shifted_tail(pair, k):
    both = Pair(pair.a[k:], pair.b[k:])
    out = np.empty(len(both.a))
    for i in range(len(both.a)):
        out[i] = both.a[i] + 1.0
    return out


@entry
def _either(pair: Pair, k: int) -> np.ndarray:
    """Return an array of the argument, a new one, or one of a record that holds both."""
    one = _shifted(pair.b)
    if k == 0:
        one = pair.a
    elif k == 1:
        both = Pair(one, pair.a)
        one, other = both.b, both.a
        for i in range(len(one)):
            other[i] = one[i]
        one = other
    return one


@entry
def _mean(pair: Pair):
    out = np.empty(len(pair.a))
    for k in range(len(out)):
        out[k] = _half(pair, k)
    return out


@entry
def _total(pair: Pair) -> float:
    more, total = _shifted(pair.a), 0.0
    for k in range(len(more)):
        total += more[k] + pair.b[k]
    return total


PAIR = Pair(X, X + 2.0)
_FILL = """
import sys, time
from pathlib import Path
import numpy as np
from tests.core.compiled.test_sturdiness import PAIR, _mean
from momapos.core.compiled.code_store import Store

print("ready", flush=True)
sys.stdin.readline()
native = Store(Path(sys.argv[1])).native(_mean)
np.testing.assert_array_equal(native(PAIR), PAIR.a + 1.0)
"""


def test_two_processes_can_fill_one_store_concurrently(tmp_path: Path) -> None:
    call = [sys.executable, "-c", _FILL, str(tmp_path)]
    pipe = subprocess.PIPE
    root = Path(__file__).parents[3]
    paths = [str(root), str(root / "src"), os.environ.get("PYTHONPATH", "")]
    inside = {**os.environ, "PYTHONPATH": os.pathsep.join(filter(None, paths))}
    both = [
        subprocess.Popen(call, stdin=pipe, stdout=pipe, stderr=pipe, text=True, env=inside)
        for _ in range(2)
    ]
    for one in both:
        assert one.stdout.readline() == "ready\n"
    for one in both:
        one.stdin.write("go\n")
        one.stdin.flush()
    for one in both:
        _, errors = one.communicate()
        assert one.returncode == 0, errors
    (file,) = tmp_path.iterdir()
    assert cache.Cache(tmp_path).get(file.name) is not None  # its checksum matches


_INTERRUPTED = """
import signal
import numpy as np
from momapos.core.geometry.polygons import _chain

class Interrupt(BaseException):
    pass

def interrupt(*_):
    raise Interrupt

points, ended = np.repeat(np.arange(200_000.0), 2).reshape(-1, 2), 0
_chain(points)
signal.signal(signal.SIGALRM, interrupt)
while ended < 20:
    try:
        signal.setitimer(signal.ITIMER_REAL, 1e-4)
        while True:
            assert len(_chain(points)) == 2
    except Interrupt:
        ended += 1
"""


def test_a_signal_during_a_kernel_raises_after_it() -> None:
    done = subprocess.run([sys.executable, "-c", _INTERRUPTED], capture_output=True, text=True)
    assert (done.returncode, done.stderr) == (0, "")


@pytest.mark.parametrize("error", [errno.ENOSPC, errno.EROFS, errno.EACCES])
def test_a_read_only_store_only_costs_compile_time(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, error: int
) -> None:
    def refuse(_handle: int) -> NoReturn:
        raise OSError(error, os.strerror(error))

    monkeypatch.setattr(cache.os, "fsync", refuse)
    native = Store(tmp_path).native(_mean)
    np.testing.assert_array_equal(native(PAIR), PAIR.a + 1.0)
    assert list(tmp_path.iterdir()) == []


def test_an_interrupt_while_writing_leaves_no_file(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(_handle: int) -> NoReturn:
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(cache.os, "fsync", interrupt)
        with pytest.raises(KeyboardInterrupt):
            Store(tmp_path).native(_mean)
    assert list(tmp_path.iterdir()) == []
    np.testing.assert_array_equal(Store(tmp_path).native(_mean)(PAIR), PAIR.a + 1.0)


def test_an_interrupt_while_compiling_restores_all_state(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def interrupt(*_: object) -> NoReturn:
        raise KeyboardInterrupt

    codegen = cpu_target.target_context.codegen()
    before = set(vars(codegen))
    with monkeypatch.context() as patch:
        patch.setattr(compiler._CalleeLibrary, "_optimize_functions", interrupt)
        with pytest.raises(KeyboardInterrupt):
            Store(tmp_path).native(_total)
    assert list(tmp_path.iterdir()) == []
    assert set(vars(codegen)) == before
    assert gc.isenabled()
    total = float(Store(tmp_path).native(_total)(PAIR))
    assert total == pytest.approx(_total.py_func(PAIR))


def test_a_forked_child_runs_loaded_code_and_loads_more(tmp_path: Path) -> None:
    mean = Store(tmp_path).native(_mean)
    Store(tmp_path).native(_total)
    child = os.fork()
    if child == 0:
        same = np.array_equal(mean(PAIR), PAIR.a + 1.0)
        total = float(Store(tmp_path).native(_total)(PAIR))
        os._exit(0 if same and abs(total - _total.py_func(PAIR)) < 1e-9 else 1)
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0


def test_a_fork_waits_for_a_thread_that_compiles_and_its_child_can_load_code() -> None:
    held, done = threading.Event(), threading.Event()
    order: list[str] = []

    def hold() -> None:
        with stores.store._lock:
            held.set()
            done.wait()
            order.append("compiled")

    thread = threading.Thread(target=hold)
    thread.start()
    held.wait()
    threading.Timer(0.1, done.set).start()
    child = os.fork()
    if child == 0:
        os._exit(0 if stores.store._lock.acquire(timeout=5) else 1)
    order.append("forked")
    assert os.waitstatus_to_exitcode(os.waitpid(child, 0)[1]) == 0
    thread.join()
    assert order == ["compiled", "forked"]


def test_a_kernel_counts_references_only_of_its_own_arrays() -> None:
    assert _reference_counts(_half, (Pair, int)) == 0
    assert _reference_counts(_shifted, (F1,)) > 0
    assert _reference_counts(_shifted_tail, (Pair, int)) == _reference_counts(_shifted, (F1,))


def _reference_counts(one: Kernel, hints: tuple[object, ...]) -> int:
    """Count a kernel's reference count updates before LLVM's optimization."""
    lowered: list[str] = []
    add = JITCodeLibrary.add_ir_module

    def keep(self: JITCodeLibrary, module: object) -> None:
        lowered.append(str(module))
        add(self, module)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(JITCodeLibrary, "add_ir_module", keep)
        compiler.inner(one).compile(tuple(compiler.numba_type(hint) for hint in hints))
    calls = re.compile(r"call void @\W?NRT_(incref|decref)")
    return sum(len(calls.findall(text)) for text in lowered if one.py_func.__name__ in text)


@pytest.mark.parametrize("k", [0, 1, 2])
def test_a_returned_array_stays_alive_whether_borrowed_or_owned(tmp_path: Path, k: int) -> None:
    native = Store(tmp_path).native(_either)
    for _ in range(50):
        got = native(Pair(X * 1.0, X + 2.0), k)
        more = [np.full(5, np.nan) for _ in range(20)]
        np.testing.assert_array_equal(got, _either.py_func(Pair(X, X + 2.0), k))
        assert len(more) == 20


def test_arrays_that_kernels_return_to_kernels_are_freed(tmp_path: Path) -> None:
    native = Store(tmp_path).native(_total)
    pair = Pair(np.ones(10_000), np.ones(10_000))
    assert native(pair) == 30_000.0
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(20_000):  # 1.6 GB if they leaked
        native(pair)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # KiB
