"""The file cache."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import numpy as np
import pytest

from momapos.core.cache import Cache, content_key, default_cache_dir, write_atomic


def test_the_cache_returns_what_was_put(tmp_path: Path) -> None:
    cache = Cache(tmp_path / "deep" / "folder")
    assert cache.get("a") is None
    for data in (b"", b"one", b"two" * 1000):
        cache.put("a", data)
        assert cache.get("a") == data


def test_any_damage_is_detected(tmp_path: Path) -> None:
    cache = Cache(tmp_path)
    path = cache.put("a", b"content")
    whole = path.read_bytes()
    for i in range(len(whole)):
        path.write_bytes(whole[:i] + bytes([whole[i] ^ 1]) + whole[i + 1 :])
        assert cache.get("a") is None
        path.write_bytes(whole[:i])
        assert cache.get("a") is None
    path.write_bytes(whole + b" ")
    assert cache.get("a") is None
    path.write_bytes(whole)
    path.rename(tmp_path / "b")
    assert cache.get("b") is None


@pytest.mark.parametrize("key", ["", "../a", "a/b", ".a", "a\n", "a" * 300])
def test_keys_cannot_leave_the_folder(tmp_path: Path, key: str) -> None:
    with pytest.raises(ValueError, match="cache key"):
        Cache(tmp_path).put(key, b"")


def test_different_contents_have_different_keys() -> None:
    parts = [
        ("ab", "c"),
        ("a", "bc"),
        (b"ab", "c"),
        (1, 2.0),
        (1.0, 2),
        (np.zeros(3),),
        (np.zeros((3, 1)),),
        (np.zeros(3, np.float32),),
        (None,),
        (),
    ]
    assert len({content_key(*p) for p in parts}) == len(parts)
    assert content_key("a", np.arange(3)) == content_key("a", np.arange(6)[:3])
    transposed = np.arange(6).reshape(2, 3).T
    assert content_key(transposed) == content_key(transposed.copy())


def test_readers_see_either_the_old_or_the_new_content(tmp_path: Path) -> None:
    cache, contents = Cache(tmp_path), [bytes([i]) * 50_000 for i in range(8)]
    cache.put("a", contents[0])

    def work(i: int) -> bool:
        cache.put("a", contents[i % 8])
        return cache.get("a") in contents

    with ThreadPoolExecutor(4) as pool:
        assert all(pool.map(work, range(80)))
    assert [path.name for path in tmp_path.iterdir()] == ["a"]


def test_a_failed_write_leaves_no_file(tmp_path: Path) -> None:
    (tmp_path / "folder").mkdir()
    with pytest.raises(OSError, match="folder"):
        write_atomic(tmp_path / "folder", b"data")
    assert [path.name for path in tmp_path.iterdir()] == ["folder"]


def test_the_environment_sets_the_folder(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    assert default_cache_dir() == tmp_path
    monkeypatch.delenv("MOMAPOS_CACHE")
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path))
    assert default_cache_dir() == tmp_path / "momapos"
