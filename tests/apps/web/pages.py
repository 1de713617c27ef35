"""Pages for tests, on a free port of this machine."""

from __future__ import annotations

from contextlib import AbstractContextManager
from pathlib import Path

from momapos.apps.web.opened import Opened
from momapos.apps.web.page import Page
from momapos.apps.web.serve import served
from momapos.core.cache import USER_CACHE


def serve(
    folder: Path, *others: str, scene: str = "kitchen_small", opened: Opened | None = None
) -> AbstractContextManager[tuple[Page, str]]:
    """Serve a page with one scene and others to choose from; files are saved in a folder."""
    return served(
        host="127.0.0.1", port=0, scenes=(scene, *others), robots=("segway_ur5e",), scene=scene,
        robot="segway_ur5e", cache=USER_CACHE, folder=folder, opened=opened,
    )  # fmt: skip
