"""A generator back-end of base poses for pycram's locations.

A `Location` of pycram (CRAM's Python framework) iterates over its back-end for pose candidates, and
yields those that its world and validators accept. A back-end is any iterable.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing
from dataclasses import dataclass
from typing import Generic, TypeVar

from momapos.model.records import ANYWHERE, BaseRegion, ReachScorer, Task
from momapos.model.robots import Robot
from momapos.model.scene import Scene
from momapos.planning import DEFAULT, PipelineConfig, iter_placements

Pose = TypeVar("Pose")


@dataclass(frozen=True, eq=False)
class PlacementBackend(Generic[Pose]):
    """Base poses for a task, in the order of `iter_placements`; each iteration starts a new search.

    It has no `merge`, because the poses of another back-end can't be tested for membership. Use
    `region` or more validators of the location instead.
    """

    scene: Scene
    robot: Robot
    task: Task
    make_pose: Callable[[float, float, float], Pose]
    """Makes a pycram pose from x [m], y [m] and yaw [rad] on the floor of its world, such as
    `lambda x, y, yaw: Pose.from_xyz_rpy(x, y, 0.0, yaw=yaw, reference_frame=world.root)`."""
    reach: ReachScorer | None = None
    """The robot's reachability map; None to load it."""
    region: BaseRegion = ANYWHERE
    """Region of allowed base poses."""
    config: PipelineConfig = DEFAULT
    """Configuration and time limit of the search."""
    seed: int = 0

    def __iter__(self) -> Iterator[Pose]:
        """Yield poses until there are no more, or the time is over.

        Plans whose base moves in the manipulation are left out, because they need several poses.

        Raises:
            MomaposError: See `iter_placements`.
        """
        answers = iter_placements(
            self.scene, self.robot, self.task, self.reach,
            region=self.region, config=self.config, seed=self.seed,
        )  # fmt: skip
        with closing(answers):  # type: ignore[type-var]
            for answer in answers:
                if answer.plan.moves_base:
                    continue
                assert answer.plan.base_pose is not None
                yield self.make_pose(*answer.plan.base_pose)
