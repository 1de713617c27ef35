"""The tasks of a tour, one after the other."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import TYPE_CHECKING

import numpy as np

from momapos.core import InputError
from momapos.model.records import PlacementPlan
from momapos.model.robots import Robot
from momapos.model.scene import Scene

from .playback import Moment, Setting, Story

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class TourStory:
    """Plans as moments, each in its own room."""

    stories: tuple[Story, ...]
    scenes: tuple[Scene, ...]
    """The room as each begins."""

    @classmethod
    def of(cls, plans: Sequence[PlacementPlan], scenes: Sequence[Scene], robot: Robot) -> TourStory:
        """The story of solved plans.

        Args:
            plans: In order.
            scenes: The room of each.
            robot: Of all of them.

        Raises:
            InputError: A plan is of another robot, or there is no motion to show.
        """
        for number, plan in enumerate(plans, start=1):
            if (plan.robot_urdf, plan.joints) != (plans[0].robot_urdf, plans[0].joints):
                raise InputError(f"plan {number} of the tour is of another robot than the first")
        stories = [Story.of(p, robot, scene) for p, scene in zip(plans, scenes, strict=True)]
        return cls(tuple(stories), tuple(scenes))

    @cached_property
    def _ends(self) -> Float[np.ndarray, " k"]:
        """When each task is done [s]."""
        return np.cumsum([story.duration for story in self.stories])

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self._ends[-1])

    def at(self, seconds: float) -> Moment:
        """What is where at a time [s]; the first and the last moment hold before and after."""
        last = len(self.stories) - 1
        k = min(int(np.searchsorted(self._ends, seconds, side="right")), last)
        story, began = self.stories[k], float(self._ends[k]) - self.stories[k].duration
        moment, task = story.at(seconds - began), story.task
        words = f"task {k + 1} of {last + 1}, {task.verb} {task.object}: {moment.words}"
        return replace(moment, words=words, setting=Setting(self.scenes[k], task.object))
