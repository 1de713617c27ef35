"""The path of a first-time visitor: five steps, ticked as they are done."""

from __future__ import annotations

from typing import Any, Literal, TypeAlias, get_args

Step: TypeAlias = Literal["choose", "place", "play", "drag", "why"]
WORDS: dict[Step, tuple[str, str]] = {
    "choose": ("Choose", "Choose a task and an object, or click an object in the room."),
    "place": ("Place", "Press Place: where must the robot stand?"),
    "play": ("Play", "Press Play: how does it move?"),
    "drag": ("Drag", "Drag the base by its arrows: does another place work, too?"),
    "why": ("Why not", "Drag it until the footprint turns red, and read why."),
}
"""The name and the instruction of each step."""


class Guide:
    """Shows the next step, and disappears after the last one."""

    def __init__(self, gui: Any) -> None:
        """Show the first step.

        Args:
            gui: Where to draw.
        """
        self._handle = gui.add_html(guide_html(set()))
        self._done: set[Step] = set()

    def done(self, *steps: Step) -> None:
        """Tick steps."""
        if self._done.issuperset(steps):
            return
        self._done |= set(steps)
        self._handle.content = guide_html(self._done)
        self._handle.visible = len(self._done) < len(WORDS)


def guide_html(done: set[Step]) -> str:
    """Return the steps as HTML, with the instruction of the first one that is not done."""
    steps = get_args(Step)
    current = next((step for step in steps if step not in done), None)
    marks = " ".join(
        f'<span style="white-space:nowrap;opacity:{1.0 if step == current else 0.6};'
        f'font-weight:{700 if step == current else 400}">'
        f"{'✓' if step in done else f'{k}.'} {WORDS[step][0]}</span>"
        for k, step in enumerate(steps, start=1)
    )
    words = "" if current is None else WORDS[current][1]
    return (
        '<div style="margin:.1em .75em .5em;font-size:.84em;line-height:1.5">'
        f'<div style="display:flex;flex-wrap:wrap;gap:0 .9em">{marks}</div>'
        f'<div style="color:var(--mantine-color-dimmed)">{words}</div></div>'
    )
