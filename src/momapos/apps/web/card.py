"""The answer card: status, numbers and reasons of what the page shows, as HTML."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, TypeAlias

from momapos.core import escape_html

from .colors import FEASIBLE, INFEASIBLE, PARTLY, UNKNOWN

Tone: TypeAlias = Literal["", "good", "part", "bad"]
TONES: dict[Tone, str] = {"": UNKNOWN, "good": FEASIBLE, "part": PARTLY, "bad": INFEASIBLE}
"""The color at the edge of a card: that of the footprint."""
WORKING = -1.0
"""Progress of work whose end is not known."""
STYLE = """<style>
.mm-card{margin:.2em .75em .6em;padding:.55em .7em;border-radius:.35em;font-size:.84em;
line-height:1.45;border:1px solid var(--mantine-color-default-border);border-left-width:.4em}
.mm-card h4{margin:0;font-size:1.12em}.mm-card .t{margin-bottom:.35em}
.mm-card .d{color:var(--mantine-color-dimmed)}
.mm-card .f{display:grid;grid-template-columns:auto 1fr;gap:.1em .7em}
.mm-card ul{margin:.3em 0 0;padding-left:1.1em}.mm-card summary{cursor:pointer;margin-top:.35em}
.mm-card .r{display:grid;grid-template-columns:2.6em 1fr;gap:0 .5em}
.mm-card .n{text-align:right;font-variant-numeric:tabular-nums}
.mm-card .b{height:.32em;border-radius:.16em;background:var(--mantine-color-default-border);
margin:.35em 0;overflow:hidden;display:flex;gap:1px}
.mm-card .b i{display:block;background:var(--mantine-color-dimmed)}
.mm-card .b i.w{width:30%;animation:mm-w 1.1s ease-in-out infinite alternate}
@keyframes mm-w{from{margin-left:0}to{margin-left:70%}}
</style>"""


@dataclass(frozen=True)
class Card:
    """What a card says; names in it come from files and are escaped where it is drawn."""

    headline: str
    """The status."""
    tone: Tone = ""
    title: str = ""
    """The task."""
    facts: tuple[tuple[str, str], ...] = ()
    """Names and values."""
    notes: tuple[str, ...] = ()
    """Reasons and remarks, one sentence each."""
    details: tuple[tuple[str, str], ...] = ()
    """Names and values that few want to know."""
    counts: tuple[tuple[int, str], ...] = ()
    """How many candidates were rejected, for which reason."""
    stages: tuple[tuple[str, float], ...] = ()
    """Stages and their times [s]."""
    progress: float | None = None
    """Share of the work that is done [-]; `WORKING` if it is not known; None without work."""

    def __str__(self) -> str:
        """Return the content as lines of text."""
        lines = [self.headline, *([self.title] if self.title else [])]
        lines += [f"{name}: {value}" for name, value in (*self.facts, *self.details)]
        lines += [*self.notes, *(f"{count} {reason}" for count, reason in self.counts)]
        return "\n".join(lines)

    @property
    def html(self) -> str:
        """Return the card as HTML."""
        title = f'<div class="t d">{escape_html(self.title)}</div>' if self.title else ""
        notes = "".join(f"<li>{escape_html(note)}</li>" for note in self.notes)
        return (
            f'{STYLE}<div class="mm-card" style="border-left-color:{TONES[self.tone]}">'
            f"<h4>{escape_html(self.headline)}</h4>{title}{self._bar()}"
            + table(self.facts)
            + (f"<ul>{notes}</ul>" if notes else "")
            + self._counts()
            + "</div>"
        )

    def _bar(self) -> str:
        if self.progress is None:
            return ""
        done = " · ".join(f"{escape_html(name)} {1000 * t:.0f} ms" for name, t in self.stages)
        bar = (
            '<i class="w"></i>'
            if self.progress == WORKING
            else f'<i style="width:{100 * self.progress:.0f}%"></i>'
        )
        return f'<div class="b">{bar}</div><div class="d">{done}</div>'

    def _counts(self) -> str:
        if not self.counts and not self.details:
            return ""
        rows = "".join(
            f'<span class="n">{count}</span><span>{escape_html(reason)}</span>'
            for count, reason in self.counts
        )
        # Why not elsewhere is the reason of a "no", and a detail of a "yes".
        is_open = "" if self.tone == "good" else " open"
        return (
            f'<details{is_open}><summary class="d">Why not elsewhere</summary>{table(self.details)}'
            f'<div class="r">{rows}</div></details>'
        )


def table(rows: tuple[tuple[str, str], ...]) -> str:
    """Return names and values as HTML."""
    cells = "".join(
        f'<span class="d">{escape_html(name)}</span><span>{escape_html(value)}</span>'
        for name, value in rows
    )
    return f'<div class="f">{cells}</div>' if cells else ""


class CardView:
    """Draws the newest card on the page."""

    def __init__(self, gui: Any) -> None:
        """Add an empty card.

        Args:
            gui: Where to draw.
        """
        self._handle = gui.add_html("")
        self.shown = Card("")

    def show(self, card: Card) -> None:
        """Draw a card; an equal one is not sent again."""
        if card != self.shown:
            self.shown = card
            self._handle.content = card.html

    @property
    def text(self) -> str:
        """The content as text."""
        return str(self.shown)
