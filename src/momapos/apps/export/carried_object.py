"""A movable object in the hand, which moves with the tool."""

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


@dataclass(frozen=True, eq=False)
class CarriedObject:
    """A movable object that is picked or placed."""

    T_world_rest: Float[np.ndarray, "4 4"]
    """Pose of its root link before it is picked, or after it is placed."""
    T_tool_object: Float[np.ndarray, "4 4"]
    """Pose of its root link in the hand."""

    @classmethod
    def of(cls, scene: Scene, task: Task, motion: Motion) -> CarriedObject | None:
        """Return the object that a motion carries; None if the motion moves a joint."""
        if task.joint is not None:
            return None
        item = scene.object(task.object)
        T_world_rest = item.link_poses()[item.model.urdf.root]
        return cls(T_world_rest, invert(motion.Ts_world_tool[0]) @ T_world_rest)

    def at_end(self, task: Task, motion: Motion) -> Float[np.ndarray, "4 4"]:
        """Return the final pose of its root link."""
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
        """Return the poses of its root link over time.

        A picked object is carried after the gripper closes, a placed one until the gripper opens.

        Args:
            task: Pick or place.
            kinds: Kinds of all phases, in order.
            phase: Index of the phase of each sample.
            Ts_world_tool: Pose of the tool at each sample.
        """
        if task.verb == "pick":
            held = phase >= list(kinds).index(PhaseKind.CLOSE)
        else:
            held = phase < list(kinds).index(PhaseKind.OPEN)
        carried = Ts_world_tool @ self.T_tool_object
        return np.where(held[:, None, None], carried, self.T_world_rest)
