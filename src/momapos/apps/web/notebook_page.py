"""Playing a plan in a notebook, or in a browser outside of one."""

from __future__ import annotations

import html
import sys
import tempfile
import webbrowser
from pathlib import Path

from momapos.planning import PlacementResult

from .static import page_of
from .words import answer_card

HEIGHT = 480
"""Height of the page in a notebook [px]."""


def show(answer: PlacementResult) -> None:
    """Play a solved plan.

    Raises:
        InputError: The plan is not solved.
    """
    prepared = answer.prepared
    page = page_of(prepared.scene, prepared.robot, answer.plan, card=answer_card(answer))
    # A notebook has imported IPython already.
    shell = sys.modules.get("IPython")
    if shell is not None and shell.get_ipython() is not None:
        from IPython.display import HTML, display

        display(HTML(frame_of(page)))
        return
    with tempfile.NamedTemporaryFile(
        "w", prefix="momapos-", suffix=".html", delete=False, encoding="utf-8"
    ) as file:
        file.write(page)
    webbrowser.open(Path(file.name).as_uri())


def frame_of(page: str) -> str:
    """Embed a page in a sandboxed frame."""
    # In another element: IPython warns about a bare frame, and wants a URL instead.
    return (
        f'<div><iframe srcdoc="{html.escape(page, quote=True)}" sandbox="allow-scripts" '
        f'style="width:100%;height:{HEIGHT}px;border:0"></iframe></div>'
    )
