"""The method, one call a stage.

Perception, driving and physics are stages of their own; here a scene is known, and the answer is
where to stand and how to move.
"""

from __future__ import annotations

import time
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from functools import cache, lru_cache
from importlib import metadata
from typing import TYPE_CHECKING

import numpy as np

from momapos.config import PipelineConfig
from momapos.errors import SceneError
from momapos.geometry.polygons import all_inside, inscribed_radius
from momapos.importance.key_objects import Selection, everything, start_of
from momapos.importance.rank import Importance, rank
from momapos.kinematics.base_collision import base_hits
from momapos.kinematics.collision import FREE
from momapos.kinematics.hulls import Boxes
from momapos.kinematics.world import World, build_world
from momapos.manipulation.feasibility import Feasibility, hand_clears
from momapos.manipulation.handles import opening_direction
from momapos.manipulation.motion import LIFT, TaskMotion, in_room, room_boxes, task_motion
from momapos.manipulation.nearness import near_boxes, stood_boxes, swept_boxes
from momapos.manipulation.tasks import hand_path, openable
from momapos.navigation.cost_map import FloorPlan, build_cost_map, floor_plan
from momapos.navigation.start import find_start
from momapos.placement.area import Site, footprints
from momapos.placement.place import Barred, Problem, Search, search
from momapos.protocols import Clock, ReachScorer
from momapos.robots.robot import Robot
from momapos.scene.scene import Scene, upright_boxes
from momapos.types import Motion, PlacementPlan, Task
from momapos.verification.exact import ExactWorld

if TYPE_CHECKING:
    from jaxtyping import Float

DEFAULT = PipelineConfig()
ROOM_MARGIN = 2.0
"""Free border that is mapped around a room without a known floor [m]."""


@dataclass(frozen=True)
class Answer:
    """A plan, and what the search saw on the way; the latter is for pictures and benchmarks."""

    plan: PlacementPlan
    site: Site
    motion: TaskMotion
    search: Search
    start: Float[np.ndarray, "3"]
    slides: bool
    """Whether the part slides [m]; it turns otherwise [rad]."""


@dataclass
class _Stopwatch:
    clock: Clock
    seconds: dict[str, float] = field(default_factory=dict)

    @contextmanager
    def stage(self, name: str) -> Iterator[None]:
        began = self.clock()
        yield
        self.seconds[name] = self.seconds.get(name, 0.0) + self.clock() - began


def place(
    scene: Scene,
    robot: Robot,
    task: Task,
    reach: ReachScorer,
    *,
    start: Float[np.ndarray, "3"] | None = None,
    barred: Barred | None = None,
    config: PipelineConfig = DEFAULT,
    seed: int = 0,
    clock: Clock = time.perf_counter,
) -> Answer:
    """Answer where the robot must stand, and how it moves, to do a task.

    Objects that matter are modelled, all others are boxes; what turns out to matter later is
    modelled then. A "no" is given with everything modelled.

    Args:
        scene: The room.
        robot: The mobile manipulator.
        task: What is to be done, see `make_task`.
        reach: The robot's reachability map.
        start: Where the base is now: x [m], y [m], yaw [rad]; the scene's start by default.
        barred: Rules base poses out, such as those that were driven to in vain.
        config: How to search.
        seed: Same seed, same answer.
        clock: Measures the stages and the timeout.

    Raises:
        SceneError: The start is no free pose.
        TaskError: The gripper cannot hold the object.
    """
    ask = _Question(
        scene, robot, task, reach, barred, config, seed, _Stopwatch(clock), clock()
    )  # fmt: skip
    with ask.watch.stage("importance"):
        path = hand_path(scene, task.object, task.joint, task.to)
        ranked = rank(scene, task.object, config.importance, path=path, seed=seed)
    with ask.watch.stage("model"):
        motion = task_motion(scene.boxed({task.object}), robot, task, config.motion)
    selection = ask.first_selection(ranked, motion, start)
    while True:
        answer = ask.answer(selection, motion, start)
        if answer.plan.status == "solved":
            selection, holds = ask.look_around(selection, answer)
            if holds:
                break
        elif answer.plan.status == "timeout" or not selection.boxes:
            break
        else:
            selection = selection.lowered()
    timing = {**ask.watch.seconds, "total": clock() - ask.began}
    plan = replace(answer.plan, key_objects=selection.record(), timing=timing)
    return replace(answer, plan=plan)


@dataclass(frozen=True)
class _Question:
    """One question, and the stages of its answer."""

    scene: Scene
    robot: Robot
    task: Task
    reach: ReachScorer
    barred: Barred | None
    config: PipelineConfig
    seed: int
    watch: _Stopwatch
    began: float

    def first_selection(
        self, ranked: Importance, motion: TaskMotion, start: Float[np.ndarray, "3"] | None
    ) -> Selection:
        """S at the configured alpha, with what the door or the robot stands in already."""
        if self.config.place.method == "exhaustive":
            return everything(ranked)
        selection = start_of(ranked)
        names = selection.boxes
        boxes = self._boxes(names)
        hit = swept_boxes(motion, boxes, margin=0.0)
        begin = self.scene.start if start is None else start
        if begin is not None and np.isfinite(begin).all() and len(begin) == 3:
            hit |= stood_boxes(self.robot, np.asarray(begin, float), boxes, margin=0.0)
        return selection.join(names[i] for i in np.flatnonzero(hit))

    def answer(
        self, selection: Selection, motion: TaskMotion, start: Float[np.ndarray, "3"] | None
    ) -> Answer:
        """Search with the selected objects modelled."""
        robot, config, clock = self.robot, self.config, self.watch.clock
        with self.watch.stage("model"):
            modelled = self.scene.boxed(selection.names)
            motion = in_room(motion, modelled)
            world = arm_world(robot, motion, config)
            roomy, obstacle = hand_clears(robot, world, motion)
            if roomy.any():
                motion = replace(motion, Ts_world_tool=motion.Ts_world_tool[roomy])
        with self.watch.stage("drive"):
            plan = room_plan(motion.standing_boxes(), self.scene.floor, base_height(robot))
            start = start_pose(self.scene, robot, motion, start)
            cost = build_cost_map(plan, start[:2], radius=inscribed_radius(robot.footprint))
        with self.watch.stage("exact model"):
            exact = ExactWorld(modelled, robot, self.task)
            blocked = exact.blocked(LIFT)
        site = Site(
            robot=robot,
            Ts_world_tool=np.ascontiguousarray(motion.Ts_world_tool[:, motion.coarse]),
            static=motion.static,
            sweep=motion.sweep(),
            floor=self.scene.floor,
            clearance=config.place.clearance,
        )

        def refuse(base: Float[np.ndarray, "3"], found: Motion) -> str | None:
            with self.watch.stage("exact check"):
                return exact.refusal((float(base[0]), float(base[1]), float(base[2])), found)

        # What is compiled and read before, once after installation, is not the search's time.
        left, begun = config.timeout - self.watch.seconds.get("search", 0.0), clock()

        def out_of_time() -> bool:
            return clock() - begun > left

        feasible = Feasibility(robot, world, motion, config.planner, refuse, self.seed, out_of_time)
        problem = Problem(
            site=site,
            reach=self.reach,
            travel_cost=cost.lengths,
            attempt=feasible,
            screen=feasible.screen,
            hopeless=blocked or ("" if roomy.any() else f"the hand hits {obstacle} in every grasp"),
            start=start,
            out_of_time=out_of_time,
            barred=self.barred,
        )
        # Only a room without stand-ins can tell that there is no base pose at all; in any other one
        # round of samples has to do.
        some = replace(config.place, grid=False, rounds=min(1, config.place.rounds))
        search_config = some if selection.boxes else config.place
        with self.watch.stage("search"):
            result = search(problem, search_config, np.random.default_rng(self.seed))
        return Answer(
            plan=_plan(self.scene, robot, self.task, result, config, self.seed),
            site=site,
            motion=motion,
            search=result,
            start=start,
            slides=slides(self.scene, self.task),
        )

    def look_around(self, selection: Selection, answer: Answer) -> tuple[Selection, bool]:
        """Model what a plan comes near, and check it again, until nothing new is near.

        Returns:
            The selection, and whether the plan holds with it.
        """
        found, pose = answer.plan.motion, answer.plan.base_pose
        assert found is not None
        assert pose is not None
        while selection.boxes:
            with self.watch.stage("look around"):
                names = selection.boxes
                near = near_boxes(
                    self.robot, answer.motion, np.array(pose), found, self._boxes(names),
                    margin=self.config.near,
                )  # fmt: skip
            if not near.any():
                break
            joined = selection.join(names[i] for i in np.flatnonzero(near))
            selection = replace(joined, rounds=selection.rounds + 1)
            with self.watch.stage("exact check"):
                modelled = self.scene.boxed(selection.names)
                refusal = ExactWorld(modelled, self.robot, self.task).refusal(pose, found)
            if refusal is not None:
                return selection, False
        return selection, True

    def _boxes(self, names: Sequence[str]) -> Boxes:
        """The boxes that stand for objects."""
        return upright_boxes([self.scene.object(name) for name in names])


@cache
def _versions() -> dict[str, str]:
    """What the answer depends on, beside its inputs."""
    return {name: metadata.version(name) for name in ("momapos", "numpy", "ompl")}


def slides(scene: Scene, task: Task) -> bool:
    """Whether a task moves a part along a line, and does not turn it."""
    if task.joint is None:
        return False
    return scene.object(task.object).model.joint(task.joint).kind == "prismatic"


def arm_world(robot: Robot, motion: TaskMotion, config: PipelineConfig) -> World:
    """The room as the arm's collision kernel wants it."""
    return build_world(
        motion.static,
        motion.moving,
        motion.grasped,
        motion.labels,
        robot.spheres,
        clearance=config.arm_clearance,
    )


def base_height(robot: Robot) -> float:
    """Height up to which things are in the way of the base [m]."""
    return float((robot.base.center + robot.base.half)[:, 2].max(initial=0.3))


def room_plan(boxes: Boxes, floor: Float[np.ndarray, "k 2"] | None, height: float) -> FloorPlan:
    """What stands in the way of a base of some height."""
    return floor_plan(boxes, height=height, margin=ROOM_MARGIN, floor=floor)


@lru_cache(maxsize=32)
def _roomy_start(scene: Scene, height: float) -> Float[np.ndarray, "3"]:
    """A roomy place in front of the furniture, all of it modelled."""
    return find_start(room_plan(room_boxes(scene), scene.floor, height), _in_front(scene))


def start_pose(
    scene: Scene, robot: Robot, motion: TaskMotion, start: Float[np.ndarray, "3"] | None
) -> Float[np.ndarray, "3"]:
    """The start that was given, the scene's, or a roomy place in front of the furniture.

    Raises:
        SceneError: The base cannot stand there.
    """
    given = start if start is not None else scene.start
    if given is None:
        return _roomy_start(scene, base_height(robot))
    pose = np.asarray(given, float)
    if pose.shape != (3,) or not np.isfinite(pose).all():
        raise SceneError("the start must be three numbers: x [m], y [m], yaw")
    hit = int(base_hits(pose[None], robot.base, motion.standing_boxes(), clearance=0.0)[0])
    where = f"start ({pose[0]:.2f}, {pose[1]:.2f}, {np.degrees(pose[2]):.0f} deg)"
    if hit != FREE:
        raise SceneError(f"{where}: the base of {robot.name} would hit {motion.labels[hit]}")
    if scene.floor is not None and not all_inside(scene.floor, footprints(robot, pose[None]))[0]:
        raise SceneError(f"{where}: the base of {robot.name} would stand off the floor")
    return pose


def _in_front(scene: Scene) -> Float[np.ndarray, "2"]:
    """A point before the doors and drawers of the room, on the side to which they open."""
    points = [
        point[:2] + 1.5 * direction[:2]
        for name, joint in openable(scene)
        for point, direction in [opening_direction(scene.object(name), joint)]
    ]
    if points:
        return np.mean(points, axis=0)
    return np.mean([item.bounds[:, :2].mean(0) for item in scene.objects], axis=0)


def _plan(
    scene: Scene,
    robot: Robot,
    task: Task,
    result: Search,
    config: PipelineConfig,
    seed: int,
) -> PlacementPlan:
    solved = result.motion is not None and result.base is not None
    base = result.base
    return PlacementPlan(
        scene=str(scene.path) if scene.path else scene.name,
        robot_name=robot.name,
        robot_urdf=str(robot.model.urdf.path),
        base_link=robot.base_link,
        tool_link=robot.tool_link,
        task=task,
        status="solved" if solved else "timeout" if result.timed_out else "infeasible",
        joints=robot.arm_joints,
        base_pose=None if base is None else (float(base[0]), float(base[1]), float(base[2])),
        motion=result.motion,
        navigation_cost=float(result.cost) if solved else None,
        candidates=result.candidates(),
        method=config.place.method,
        seed=seed,
        versions=_versions(),
    )
