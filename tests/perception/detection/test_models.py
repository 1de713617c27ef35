"""Only complete and correct weights are cached; the tests serve files on the loopback address."""

from __future__ import annotations

import hashlib
import threading
import urllib.request
from collections.abc import Iterator
from functools import partial
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from tests.commands import error_of, output_of

from momapos.core.errors import InputError, UnknownNameError
from momapos.perception.detection import detector_models as models
from momapos.perception.detection.detector_models import (
    ModelFile,
    cached_models,
    fetch,
    find_model,
    open_https,
)

CONTENT = b"weights" * 1000
RIGHT = hashlib.sha256(CONTENT).hexdigest()
open_http = partial(urllib.request.urlopen, timeout=5)


class Handler(BaseHTTPRequestHandler):
    def do_GET(self) -> None:
        if self.path != "/weights.onnx":
            self.send_error(404)
            return
        self.send_response(200)
        self.end_headers()
        self.wfile.write(CONTENT)

    def log_message(self, *_: object) -> None:
        pass


@pytest.fixture
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    thread = threading.Thread(target=server.serve_forever, daemon=True)
    thread.start()
    yield f"http://127.0.0.1:{server.server_port}"
    server.shutdown()
    server.server_close()
    thread.join(5)


def files(folder: Path) -> list[Path]:
    return [path for path in folder.rglob("*") if path.is_file()]


def test_correct_weights_are_cached_and_not_downloaded_again(address: str, tmp_path: Path) -> None:
    model = ModelFile("mine", f"{address}/weights.onnx", RIGHT)
    path = fetch(model, tmp_path, open_http)
    assert path.read_bytes() == CONTENT
    assert cached_models(tmp_path) == ["mine"]
    assert find_model("mine", tmp_path) == path

    def refuse(url: str) -> None:
        raise AssertionError(url)

    assert fetch(model, tmp_path, refuse) == path
    path.write_bytes(b"damaged")
    assert fetch(model, tmp_path, open_http).read_bytes() == CONTENT


def test_wrong_missing_and_endless_weights_are_not_stored(
    address: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    with pytest.raises(InputError, match="has the SHA-256"):
        fetch(ModelFile("mine", f"{address}/weights.onnx", "0" * 64), tmp_path, open_http)
    with pytest.raises(InputError, match="download failed"):
        fetch(ModelFile("mine", f"{address}/other.onnx", RIGHT), tmp_path, open_http)
    monkeypatch.setattr(models, "MAX_BYTES", 100)
    with pytest.raises(InputError, match="larger than"):
        fetch(ModelFile("mine", f"{address}/weights.onnx", RIGHT), tmp_path, open_http)
    assert files(tmp_path) == []


def test_only_https_is_opened(address: str, tmp_path: Path) -> None:
    with pytest.raises(OSError, match="not an https"):
        open_https(f"{address}/weights.onnx")
    with pytest.raises(InputError, match="not an https URL"):
        fetch(ModelFile("mine", "file:///etc/hostname", RIGHT), tmp_path)
    handler = models._HttpsOnly()
    request = urllib.request.Request("https://127.0.0.1/a")
    with pytest.raises(OSError, match="not an https"):
        handler.redirect_request(request, None, 302, "Found", {}, f"{address}/weights.onnx")


def test_an_error_about_a_missing_model_says_how_to_get_it(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="momapos models get yolox_nano"):
        find_model("yolox_nano", tmp_path)
    with pytest.raises(UnknownNameError, match="did you mean yolox_nano"):
        find_model("yolox_nan", tmp_path)
    assert find_model("folder/other.onnx", tmp_path) == Path("folder/other.onnx")


@pytest.mark.parametrize(
    ("words", "hint"),
    [
        (["nothing_like_it"], "no model"),
        (["mine", "--url", "https://127.0.0.1/x"], "need each other"),
        (["yolox_nano", "--url", "https://127.0.0.1/x", "--sha256", RIGHT], "is already listed"),
        (["mine", "--url", "https://127.0.0.1/x", "--sha256", "12"], "64 lowercase hexadecimal"),
        (["../mine", "--url", "https://127.0.0.1/x", "--sha256", RIGHT], "model name"),
        (["mine", "--url", "http://127.0.0.1/x", "--sha256", RIGHT], "not an https"),
    ],
)
def test_a_failed_download_is_reported_in_one_line(
    words: list[str], hint: str, tmp_path: Path, monkeypatch
) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    assert hint in error_of("models", "get", *words)
    assert files(tmp_path) == []


def test_the_list_names_available_and_cached_models(tmp_path: Path, monkeypatch) -> None:
    monkeypatch.setenv("MOMAPOS_CACHE", str(tmp_path))
    (tmp_path / "models").mkdir()
    (tmp_path / "models" / "own.onnx").write_bytes(CONTENT)
    shown = output_of("models", "list")
    assert "momapos models get yolox_nano" in shown
    assert str(tmp_path / "models" / "own.onnx") in shown
