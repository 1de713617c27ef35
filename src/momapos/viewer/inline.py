"""Pictures as notebooks take them: the content of a PNG."""

from __future__ import annotations

import tempfile
from collections.abc import Callable
from pathlib import Path

from momapos.placement_result import PlacementResult
from momapos.reachability.store import load_reach
from momapos.scene.scene import Scene
from momapos.viewer.plot import draw_answer
from momapos.viewer.scene_outlines import draw_scene


def scene_png(scene: Scene) -> bytes:
    """A scene from above."""
    return _content(lambda path: draw_scene(scene, path))


def answer_png(answer: PlacementResult) -> bytes:
    """An answer; what was modeled as a box is drawn as one."""
    prepared = answer.prepared
    return _content(
        lambda path: draw_answer(prepared.scene, answer, load_reach(prepared.robot), path)
    )


def _content(draw: Callable[[Path], None]) -> bytes:
    with tempfile.TemporaryDirectory(prefix="momapos-") as folder:
        path = Path(folder) / "picture.png"
        draw(path)
        return path.read_bytes()
