"""Families of grasps: how a tool acts on a part, and what all stages need to know of that."""

from __future__ import annotations

from enum import StrEnum


class Family(StrEnum):
    """A family of grasps; plans contain the words."""

    PINCH = "pinch"
    """Pads on both sides; friction transmits the pull."""
    HOOK = "hook"
    """A finger behind a bar, a lip or an edge transmits the pull."""
    PUSH = "push"
    """Fingertips against a front."""
    SUCTION = "suction"
    """A suction cup on a front."""
    UNSTATED = ""
    """What a plan says that does not say it, and what holds a rigid object."""

    @classmethod
    def of(cls, word: str) -> Family:
        """Return the family that a word of a plan names; `UNSTATED` for other words."""
        return cls(word) if word in FAMILIES else cls.UNSTATED

    @property
    def closes(self) -> bool:
        """Whether fingers that can close do so on the part, and bear its load by friction."""
        return self not in (Family.PUSH, Family.SUCTION)

    @property
    def sticks(self) -> bool:
        """Whether the tool holds the face that it touches."""
        return self is Family.SUCTION

    @property
    def is_one_sided(self) -> bool:
        """Whether one finger under load is enough."""
        return self is Family.HOOK

    @property
    def leads(self) -> bool:
        """Whether the hand is behind the part: one that stayed where it is would meet the hand."""
        return self in (Family.PUSH, Family.HOOK)

    @property
    def turns(self) -> bool:
        """Whether the hand may turn about what it holds."""
        return self in (Family.PINCH, Family.HOOK)

    @property
    def tools(self) -> tuple[str, ...]:
        """What a tool may hold with to act like this, as robot files state it."""
        if self is Family.PINCH:
            return ("fingers",)
        if self is Family.SUCTION:
            return ("suction",)
        return ("fingers", "hook") if self is Family.HOOK else ("fingers", "hook", "suction")


FAMILIES: tuple[Family, ...] = tuple(one for one in Family if one)
"""The families that a plan may name."""
