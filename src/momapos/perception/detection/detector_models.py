"""Download detector weights, check their hash, and cache them."""

from __future__ import annotations

import hashlib
import re
import urllib.request
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from dataclasses import dataclass
from http.client import HTTPException
from pathlib import Path
from typing import IO, Any
from urllib.parse import urlsplit

from momapos.core import InputError, unknown_name, write_atomic

Opener = Callable[[str], AbstractContextManager[IO[bytes]]]
"""Opens a URL for reading; raises OSError on failure."""
MAX_BYTES = 500_000_000
"""Larger downloads are aborted [B]."""
TIMEOUT = 30.0
"""Time limit for a server's answer [s]."""
_CHUNK = 1 << 18
_NAME = re.compile(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,79}")
_HASH = re.compile(r"[0-9a-f]{64}")


@dataclass(frozen=True)
class ModelFile:
    """One file of weights and its source."""

    name: str
    url: str
    sha256: str
    """Hash of the file, 64 lowercase hexadecimal digits."""
    about: str = ""

    def __post_init__(self) -> None:
        if not _NAME.fullmatch(self.name):
            raise InputError(
                f"model name {self.name!r:.80} must be letters, digits, '_', '.' and '-'"
            )
        if not _HASH.fullmatch(self.sha256):
            raise InputError(f"SHA-256 {self.sha256!r:.80} must be 64 lowercase hexadecimal digits")


MODELS: Mapping[str, ModelFile] = {
    item.name: item
    for item in (
        ModelFile(
            "yolox_nano",
            "https://github.com/Megvii-BaseDetection/YOLOX/releases/download/0.1.1rc0/"
            "yolox_nano.onnx",
            "d39bee73564e338080378b0ad567fbb40e818b55bbfaf971de82a0267ed16b8a",
            "YOLOX-Nano (Megvii, Apache-2.0): 80 classes of COCO, 416 px, 4 MB",
        ),
    )
}
"""Models that can be downloaded by name."""


def cached_path(name: str, cache: Path) -> Path:
    """Return the path of cached weights."""
    return cache / "models" / f"{name}.onnx"


def cached_models(cache: Path) -> list[str]:
    """Return the names of cached weights."""
    folder = cached_path("any", cache).parent
    return sorted(path.stem for path in folder.glob("*.onnx")) if folder.is_dir() else []


def find_model(name: str, cache: Path) -> Path:
    """Return the file of a detector, given by its path or by the name of cached weights.

    Raises:
        InputError: There is neither.
    """
    if Path(name).suffix or Path(name).exists() or not _NAME.fullmatch(name):
        return Path(name)
    cached = cached_path(name, cache)
    if cached.is_file():
        return cached
    if name in MODELS:
        raise InputError(
            f"model {name} is not downloaded; run `momapos models get {name}`, or give its file"
        )
    raise unknown_name("model", name, {*MODELS, *cached_models(cache)}, "momapos models list")


def fetch(model: ModelFile, cache: Path, open_url: Opener | None = None) -> Path:
    """Download weights and cache them if their hash is right.

    Args:
        model: The model.
        cache: The cache folder.
        open_url: Opens a URL; if None, over https only.

    Returns:
        The file. It is not downloaded again if it is already there.

    Raises:
        InputError: The download fails, is too large, or has another hash; nothing is stored.
    """
    file = cached_path(model.name, cache)
    if file.is_file() and hashlib.sha256(file.read_bytes()).hexdigest() == model.sha256:
        return file
    data = bytearray()
    try:
        with (open_url or open_https)(model.url) as answer:
            while len(data) <= MAX_BYTES and (chunk := answer.read(_CHUNK)):
                data += chunk
    except (OSError, HTTPException, ValueError) as error:
        raise InputError(
            f"{model.url}: download failed ({error}); download it by other means and give the file"
        ) from error
    if len(data) > MAX_BYTES:
        raise InputError(f"{model.url}: is larger than {MAX_BYTES // 10**6} MB; nothing was stored")
    digest = hashlib.sha256(data).hexdigest()
    if digest != model.sha256:
        raise InputError(
            f"{model.url}: has the SHA-256 {digest}, not {model.sha256}; nothing was stored"
        )
    try:
        write_atomic(file, bytes(data))
    except OSError as error:
        raise InputError(f"{file}: not writable ({error.strerror})") from error
    return file


def open_https(url: str) -> AbstractContextManager[IO[bytes]]:
    """Open an https URL; redirects must be https, too.

    Raises:
        OSError: It is not https, or does not answer.
    """
    _refuse_other(url)
    opener = urllib.request.build_opener(_HttpsOnly)
    answer: AbstractContextManager[IO[bytes]] = opener.open(url, timeout=TIMEOUT)
    return answer


class _HttpsOnly(urllib.request.HTTPRedirectHandler):
    """Follows redirects to https only."""

    def redirect_request(self, req: Any, fp: Any, code: Any, msg: Any, headers: Any, newurl: Any):  # type: ignore[no-untyped-def]
        _refuse_other(newurl)
        return super().redirect_request(req, fp, code, msg, headers, newurl)


def _refuse_other(url: str) -> None:
    if urlsplit(url).scheme != "https":
        raise OSError(f"{url:.200} is not an https URL")
