"""The motions of a tour's tasks, one after the other."""

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

from .playback import ActiveRoom, Moment, Story

if TYPE_CHECKING:
    from jaxtyping import Float


@dataclass(frozen=True)
class TourStory:
    """The motions of several plans, each in its own room."""

    stories: tuple[Story, ...]
    scenes: tuple[Scene, ...]
    """The room before each task."""

    @classmethod
    def of(cls, plans: Sequence[PlacementPlan], scenes: Sequence[Scene], robot: Robot) -> TourStory:
        """Build the motion of solved plans.

        Args:
            plans: The plans, in order.
            scenes: The room of each plan.
            robot: The robot of all plans.

        Raises:
            InputError: A plan is for another robot, or there is no motion to show.
        """
        for number, plan in enumerate(plans, start=1):
            if (plan.robot_urdf, plan.joints) != (plans[0].robot_urdf, plans[0].joints):
                raise InputError(f"plan {number} of the tour is for another robot than the first")
        stories = [Story.of(p, robot, scene) for p, scene in zip(plans, scenes, strict=True)]
        return cls(tuple(stories), tuple(scenes))

    @cached_property
    def _ends(self) -> Float[np.ndarray, " k"]:
        """End of each task [s]."""
        return np.cumsum([story.duration for story in self.stories])

    @property
    def duration(self) -> float:
        """[s]"""
        return float(self._ends[-1])

    def at(self, seconds: float) -> Moment:
        """Return the moment at a time [s], clipped to the duration."""
        last = len(self.stories) - 1
        k = min(int(np.searchsorted(self._ends, seconds, side="right")), last)
        story, began = self.stories[k], float(self._ends[k]) - self.stories[k].duration
        moment, task = story.at(seconds - began), story.task
        phase = f"task {k + 1} of {last + 1}, {task.verb} {task.object}: {moment.phase}"
        room = ActiveRoom(self.scenes[k], task.object, task.joint)
        return replace(moment, phase=phase, room=room)
