"""A loose object that the hand takes along: it moves with the tool."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

import numpy as np

from momapos.core.geometry import invert
from momapos.model.records import Motion, Task
from momapos.model.scene import Scene

from .phases import PhaseKind

if TYPE_CHECKING:
    from collections.abc import Sequence

    from jaxtyping import Float, Int


@dataclass(frozen=True)
class Carried:
    """A loose object that the hand takes along."""

    T_world_rest: Float[np.ndarray, "4 4"]
    """Pose of its root link where it stands before it is picked, or after it is placed."""
    T_tool_object: Float[np.ndarray, "4 4"]
    """The same as the hand holds it."""

    @classmethod
    def of(cls, scene: Scene, task: Task, motion: Motion) -> Carried | None:
        """What a motion takes along; None where it moves a joint of something that stands."""
        if task.joint is not None:
            return None
        item = scene.object(task.object)
        T_world_rest = item.link_poses()[item.model.urdf.root]
        return cls(T_world_rest, invert(motion.Ts_world_tool[0]) @ T_world_rest)

    def at_end(self, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
        """Pose of its root link when all is done."""
        if task.verb == "place":
            return self.T_world_rest
        return motion.Ts_world_tool[-1] @ self.T_tool_object

    def poses(
        self,
        task: Task,
        kinds: Sequence[PhaseKind],
        phase: Int[np.ndarray, " t"],
        Ts_world_tool: Float[np.ndarray, "t 4 4"],
    ) -> Float[np.ndarray, "t 4 4"]:
        """Poses of its root link over time.

        A picked object is carried from when the gripper closes, a placed one until it opens.

        Args:
            task: What is done with it.
            kinds: Of all phases, in order.
            phase: Index of the phase of each moment.
            Ts_world_tool: Pose of the tool at each moment.
        """
        if task.verb == "pick":
            held = phase >= list(kinds).index(PhaseKind.CLOSE)
        else:
            held = phase < list(kinds).index(PhaseKind.OPEN)
        carried = Ts_world_tool @ self.T_tool_object
        return np.where(held[:, None, None], carried, self.T_world_rest)
