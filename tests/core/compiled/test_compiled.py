"""Kernels are stored as machine code under their inputs, and run without numba."""

from __future__ import annotations

import json
import resource
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

import numpy as np
import pytest

from momapos.apps.cli.compile import compile_once
from momapos.core.compiled import F1, F2, entry, kernel, kernel_source
from momapos.core.compiled import code_store as stores
from momapos.core.compiled.code_store import Store, decode, encode
from momapos.core.compiled.entries import Kernel
from momapos.core.compiled.pack import every_entry
from momapos.core.geometry import polygons

_FACTOR = 2.0


class Line(NamedTuple):
    """A record argument."""

    slope: float
    offsets: F1


@kernel
def _scaled(x):
    return _FACTOR * x


@entry
def _along(line: Line, x: F1, squared: bool):
    out = np.empty((len(x), len(line.offsets)))
    for i in range(len(x)):
        for k in range(len(line.offsets)):
            value = _scaled(x[i]) * line.slope + line.offsets[k]
            out[i, k] = value * value if squared else value
    return out


LINE = Line(3.0, np.array([0.0, 1.0]))
X = np.linspace(-1.0, 1.0, 5)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("kernels")


@pytest.mark.parametrize("squared", [False, True])
def test_machine_code_computes_what_the_python_function_does(folder: Path, squared: bool) -> None:
    native = Store(folder).native(_along)
    np.testing.assert_array_equal(native(LINE, X, squared), _along.py_func(LINE, X, squared))


def test_code_is_compiled_once_and_then_found(folder: Path) -> None:
    Store(folder).native(_along)
    reports: list[tuple[int, int]] = []
    Store(folder).prepare([_along], lambda done, count: reports.append((done, count)))
    assert reports == []
    found = Store(folder).find(_along)
    assert decode(encode(found)) == found


def test_a_second_process_compiles_and_runs_no_code_of_the_current_folder(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    ran = tmp_path / "ran"
    (tmp_path / "zipfile.py").write_text(f"open({str(ran)!r}, 'w')")
    monkeypatch.chdir(tmp_path)
    made, pack, entry = tmp_path / "made", tmp_path / "no pack", polygons._chain
    with stores._second_process([entry], made):
        end = time.monotonic() + 300.0
        while Store(made, pack).find(entry) is None and time.monotonic() < end:
            time.sleep(0.1)
    assert Store(made, pack).find(entry) is not None
    assert not ran.exists()


def test_damaged_code_is_not_found(tmp_path: Path) -> None:
    store = Store(tmp_path)
    store.native(_along)
    (file,) = tmp_path.iterdir()
    file.write_bytes(file.read_bytes()[:-1] + b"?")
    assert store.find(_along) is None


def test_a_pack_of_another_compiler_is_ignored(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    pack = tmp_path / "kernels.zip"
    with zipfile.ZipFile(pack, "w") as file:
        file.writestr(_along.name, b"")
        about = f'{{"made by": ["numba 0"], "stamps": {{"{_along.name}": "{_along.stamp}"}}}}'
        file.writestr("pack.json", about)
    assert Store(tmp_path / "none", pack).find(_along) is None
    monkeypatch.setattr(stores, "compiler_version", lambda: ["numba 0"])
    monkeypatch.setattr(stores.llvm, "get_host_cpu_features", lambda: {"avx2": False})
    assert Store(tmp_path / "none", pack)._packed == {}


def test_a_damaged_pack_is_ignored(tmp_path: Path) -> None:
    pack = tmp_path / "kernels.zip"
    pack.write_bytes(b"not an archive")
    assert Store(tmp_path, pack).find(_along) is None


def _stamp(source: str) -> str:
    """Return the stamp of `outer` in a module of this source."""
    module = {"__name__": "some", "kernel": kernel, "Kernel": Kernel}
    exec(compile(source, "some.py", "exec"), module)
    outer = module["outer"]
    assert isinstance(outer, Kernel)
    return outer.stamp


_SOURCE = """
FACTOR = 2.0
@kernel
def inner(x):
    return x + 1
@kernel
def outer(x):
    return FACTOR * inner(x)
"""


@pytest.mark.parametrize(
    ("old", "new"),
    [("x + 1", "x + 2"), ("2.0", "3.0"), ("FACTOR * inner", "inner"), ("@kernel\ndef inner",
     "@kernel(fastmath=True)\ndef inner")],
)  # fmt: skip
def test_a_change_of_callee_constant_or_option_changes_the_stamp(old: str, new: str) -> None:
    assert _stamp(_SOURCE) != _stamp(_SOURCE.replace(old, new))


def test_the_stamp_covers_comprehensions_but_no_docstring() -> None:
    source = '@kernel\ndef outer(y):\n    """Double."""\n    return [2.0 * x for x in y]\n'
    assert _stamp(source) != _stamp(source.replace("2.0", "3.0"))
    assert _stamp(source) == _stamp(source.replace("Double", "Scale"))


def test_the_location_of_a_kernel_does_not_change_its_stamp() -> None:
    assert _stamp(_SOURCE) == _stamp("# a comment\n\n" + _SOURCE)


@pytest.mark.parametrize(
    "x",
    [X.astype(np.float32), X[::2], X[None], [1.0, 2.0]],
    ids=["dtype", "stride", "ndim", "list"],
)
def test_an_array_of_another_type_is_rejected(x: object) -> None:
    assert kernel_source.checker(F1)(X)
    assert not kernel_source.checker(F1)(x)


def test_a_read_only_array_is_rejected_where_it_may_be_written() -> None:
    read_only = X.copy()
    read_only.flags.writeable = False
    assert not kernel_source.checker(F1)(read_only)
    assert not kernel_source.checker(F2)(X)


def test_arguments_of_other_types_go_through_the_dispatcher(
    folder: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "store", Store(folder))
    strided = np.linspace(-1.0, 1.0, 9)[::2]
    np.testing.assert_array_equal(_along(LINE, strided, False), _along(LINE, X, False))


def test_every_entry_has_types_that_can_be_compiled() -> None:
    from momapos.core.compiled.compiler import numba_type

    entries = every_entry()
    assert len(entries) > 20
    for one in entries:
        assert [numba_type(hint) for hint in one.types]
        assert [kernel_source.checker(hint) for hint in one.types]


_WITHOUT_NUMBA = """
import sys
from momapos.apps.cli.main import main
status = main(sys.argv[1:])
sys.exit(9 if "numba" in sys.modules else status)
"""


def test_planning_and_verification_run_without_numba(tmp_path: Path) -> None:
    compile_once()
    plan = tmp_path / "plan.json"
    place = ["place", "open", "kitchen_small", "fridge/door_hinge", "--robot", "segway_ur5e"]
    for command in ([*place, "--out", str(plan)], ["verify", str(plan)]):
        call = [sys.executable, "-c", _WITHOUT_NUMBA, *command]
        done = subprocess.run(call, capture_output=True, text=True)
        assert done.returncode == 0, done.stderr


@entry
def _careful(x: F1, by: float):
    if len(x) == 0:
        raise ValueError("nothing to divide")
    out = np.empty(len(x))
    for i in range(len(x)):
        out[i] = x[i] / by
    return out


def test_a_kernel_raises_the_same_errors_as_python(folder: Path) -> None:
    native = Store(folder).native(_careful)
    with pytest.raises(ZeroDivisionError):
        native(X, 0.0)
    with pytest.raises(ValueError, match="nothing to divide"):
        native(X[:0], 1.0)
    np.testing.assert_array_equal(native(X, 2.0), X / 2.0)


def test_returned_arrays_are_freed(folder: Path) -> None:
    native, x = Store(folder).native(_careful), np.ones(10_000)
    native(x, 2.0)
    before = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
    for _ in range(20_000):  # 1.6 GB if they leaked
        native(x, 2.0)
    assert resource.getrusage(resource.RUSAGE_SELF).ru_maxrss - before < 40_000  # KiB


def test_concurrent_first_calls_of_an_entry_return_the_same_result(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stores, "store", Store(tmp_path))
    fresh = Kernel(_careful.py_func, False, {})
    fresh.is_entry = True
    with ThreadPoolExecutor(4) as pool:
        answers = list(pool.map(lambda _: fresh(X, 2.0), range(8)))
    np.testing.assert_array_equal(answers, np.tile(X / 2.0, (8, 1)))
    assert len(list(tmp_path.iterdir())) == 1


def test_an_unusable_cache_folder_only_costs_compile_time(tmp_path: Path) -> None:
    blocked = tmp_path / "file"
    blocked.write_bytes(b"")  # neither folders nor files can be made in a file
    native = Store(blocked / "cache").native(_careful)
    np.testing.assert_array_equal(native(X, 2.0), X / 2.0)
    assert blocked.read_bytes() == b""


@pytest.mark.parametrize("damage", ["cut", "foreign key", "empty"])
def test_code_with_a_damaged_file_is_compiled_again(tmp_path: Path, damage: str) -> None:
    store = Store(tmp_path)
    store.native(_careful)
    (file,) = tmp_path.iterdir()
    whole = file.read_bytes()
    if damage == "foreign key":
        other = Store(tmp_path / "other")
        other.native(_along)
        (foreign,) = (tmp_path / "other").iterdir()
        file.write_bytes(foreign.read_bytes())
    else:
        file.write_bytes(whole[: len(whole) // 2] if damage == "cut" else b"")
    assert store.find(_careful) is None
    np.testing.assert_array_equal(Store(tmp_path).native(_careful)(X, 2.0), X / 2.0)
    assert store.find(_careful) is not None


@pytest.mark.parametrize("other", [["numba 0"], ["another Python"]])
def test_code_of_another_compiler_is_not_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, other: list[str]
) -> None:
    Store(tmp_path).native(_careful)
    monkeypatch.setattr(stores, "compiler_version", lambda: other)
    assert Store(tmp_path).find(_careful) is None


def test_code_of_another_processor_is_not_found(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    Store(tmp_path).native(_careful)
    monkeypatch.setattr(stores.llvm, "get_host_cpu_name", lambda: "another")
    assert Store(tmp_path).find(_careful) is None


def test_a_damaged_member_of_a_pack_is_ignored(tmp_path: Path) -> None:
    pack = tmp_path / "kernels.zip"
    about = {"made by": stores.compiler_version(), "stamps": {_careful.name: _careful.stamp}}
    for body in (b"no code", b"{}\n"):
        with zipfile.ZipFile(pack, "w") as file:
            file.writestr(_careful.name, body)
            file.writestr("pack.json", json.dumps(about))
        assert Store(tmp_path / "none", pack).find(_careful) is None


@pytest.mark.parametrize("about", ["{}", "[]", '{"made by": [], "stamps": 3}'])
def test_a_pack_without_valid_metadata_is_ignored(tmp_path: Path, about: str) -> None:
    pack = tmp_path / "kernels.zip"
    with zipfile.ZipFile(pack, "w") as file:
        file.writestr("pack.json", about)
    assert Store(tmp_path / "none", pack).find(_careful) is None
