"""Find a small change that makes an infeasible task feasible, by trying changes.

A change is a joint at its other end, an object that is moved or absent, another force, or a wider
region for the base; bisection finds how little of it is enough.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING, Any, TypeAlias

import numpy as np

from momapos.core import Clock, MomaposError, OutOfTimeError, Stopwatch, processor_time, time_limit
from momapos.core.geometry import (
    all_inside,
    contains,
    edge_distances,
    place_points,
    pose_planar,
    wrap_angle,
)
from momapos.model.collision import FREE, base_hits
from momapos.model.records import (
    ANYWHERE,
    RULED_OUT,
    JointResistance,
    Outline,
    PoseStatus,
    ReachScorer,
    is_text_of,
)
from momapos.model.robots import Robot
from momapos.model.scene import (
    Scene,
    SceneObject,
    area_name,
    assumes_springs,
    upright_boxes,
    with_assumptions,
)
from momapos.model.urdf import Boxes
from momapos.planning.grasps import hand_path, scene_boxes
from momapos.verification import PlanVerifier

from .max_opening import MIN_TIMEOUT, by_samples
from .partial_opening import is_beyond_any_opening
from .plan import plan_to_value
from .query import PlacementQuery
from .result import PlacementResult
from .time_limit import ADVICE, cut_short, time_left, with_note

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int

    from momapos.model.urdf import Joint


MAX_TRIALS = 10
"""Maximum number of searches [-]. Not a time, so that a busy machine gives the same advice; of 8
infeasible tasks in two kitchens, 5 become feasible in trials 5 to 10 and 3 in none of 16."""


@dataclass
class Trials:
    """Searches by samples, whose plans pass the exact check."""

    clock: Clock
    end: float
    """When the time is up, by the clock [s]."""
    left: int = MAX_TRIALS
    """Number of further searches [-]."""

    @property
    def late(self) -> bool:
        """Return whether the time is up."""
        return self.clock() >= self.end

    @property
    def over(self) -> bool:
        """Return whether no search is left."""
        return self.left <= 0 or self.late

    def solve(self, query: PlacementQuery, *, count: int | None = None) -> PlacementResult | None:
        """Return a solved answer; None if none was found, or if the query is invalid.

        Args:
            query: The variant.
            count: Number of samples; by default that of the configuration.
        """
        if self.over:
            return None
        self.left -= 1
        left = max(self.end - self.clock(), MIN_TIMEOUT)
        config = by_samples(query.config)
        place = config.place if count is None else replace(config.place, count=count)
        config = replace(config, place=place, timeout=left)
        trial = replace(query, config=config, watch=Stopwatch(query.watch.clock))
        try:
            found = plan_to_value(trial)
        except MomaposError:
            # Such as a start that collides after the change, or a hand that holds nothing.
            return None
        return found if found.plan.feasible else None

    def keeps(self, answer: PlacementResult, scene: Scene) -> bool:
        """Return whether a plan is valid in another scene, unless the time is up."""
        plan = answer.plan
        if self.late or plan.base_pose is None or plan.motion is None:
            return False
        verifier = PlanVerifier(with_assumptions(scene, plan), answer.prepared.robot, plan.task)
        arm = verifier.check(plan.base_pose, plan.motion)
        return arm.valid and all(check.ok for check in verifier.drive_checks(plan))

    def smallest(
        self, solve: Callable[[int], PlacementResult | None], size: int, known: PlacementResult
    ) -> tuple[int, PlacementResult]:
        """Return the smallest size of a change that has a plan, by bisection, and the answer.

        Args:
            solve: Returns a solved answer for a size, or None.
            size: A size with a plan.
            known: Its answer.
        """
        low, best = 0, (size, known)
        while best[0] - low > 1 and not self.over:
            middle = (low + best[0]) // 2
            found = solve(middle)
            if found is None:
                low = middle
            else:
                best = (middle, found)
        return best


NEAR_OBJECTS = 1.2
"""Objects whose boxes are this near the hand's path can keep the robot away: half a base and an
arm's reach, less what the arm must bend [m]."""
MAX_OBJECTS = 8
"""Maximum number of objects that are removed for a trial, one at a time [-]."""
MAX_JOINTS = 6
"""Maximum number of joints that are put at another end for a trial, one at a time [-]."""
SAME_VALUE = 0.01
"""A joint that would move less is there already [rad] or [m]."""
_FORCES = (PoseStatus.OVERLOAD, PoseStatus.TIPS_OVER)
_FIXED = ("wall", "floor", "ceiling", "window")
"""Categories that no user removes."""

Change: TypeAlias = "tuple[str, PlacementResult]"
"""A change in words, and an answer with a plan."""
Robots: TypeAlias = "Iterable[tuple[str, Callable[[], tuple[Robot, ReachScorer]]]]"
"""Names of robots, and functions that load each with its reachability map."""


def with_advice(
    answer: PlacementResult, others: Robots = (), *, clock: Clock = processor_time
) -> PlacementResult:
    """Add to an infeasible answer the first change with which a plan exists.

    The changes, in this order: a wider restriction of the base pose; no springs, where they are
    assumed and forces refuse the task; a door or drawer of
    furniture that is hit at its other end; one of the objects near the part moved, as little as
    trials show, or else removed; another robot. Each trial is a search by samples, whose plan
    passes the exact check. Their number is limited, and the time limit of the answer includes them.

    Args:
        answer: The answer; returned unchanged unless it is infeasible and has its query.
        others: Other robots.
        clock: Measures the time.
    """
    query = answer.query
    if query is None or answer.plan.status != "infeasible":
        return answer
    watch = Stopwatch(clock)
    left, change = time_left(answer.plan, query.config.timeout), None
    trials = Trials(clock, clock() + left)
    with watch.stage(ADVICE), suppress(OutOfTimeError), time_limit(left, clock):
        change = next(_changes(answer, query, others, trials), None)
    answer = replace(
        answer, plan=replace(answer.plan, timing={**answer.plan.timing, **watch.seconds})
    )
    base = None if change is None else change[1].plan.base_pose
    if change is None or base is None:
        return answer if not trials.late else with_note(answer, cut_short("the trials for advice"))
    x, y, yaw = base
    advice = f"feasible {change[0]}, from ({x:.3f}, {y:.3f}, {np.degrees(yaw):.1f} deg)"
    return replace(answer, plan=replace(answer.plan, advice=advice))


def _changes(
    answer: PlacementResult, query: PlacementQuery, others: Robots, trials: Trials
) -> Iterator[Change]:
    rejections = answer.plan.candidates.rejections
    if query.region != ANYWHERE and any(is_text_of(text, RULED_OUT) for text in rejections):
        relaxed = relaxed_restriction(query, trials)
        if relaxed is not None:
            yield relaxed
    yield from _without_springs(answer, query, trials)
    yield from _with_other_joints(query, " ".join(rejections), trials)
    hindered = query.task.joint is None or not is_beyond_any_opening(answer)
    for name in objects_in_the_way(answer, query) if hindered else ():
        without = trials.solve(_without(query, name))
        if without is not None:
            move = smallest_move(query, name, without, trials)
            yield (f"without {name}", without) if move is None else (move.words(name), move.answer)
    if query.keep_grasps is None:
        for name, load in others:
            if trials.over:
                return
            robot, reach = load()
            found = trials.solve(replace(query, robot=robot, reach=reach))
            if found is not None:
                yield f"with {name}", found


def _without_springs(
    answer: PlacementResult, query: PlacementQuery, trials: Trials
) -> Iterator[Change]:
    """Yield an answer without the springs that are assumed, if forces are what refuses the task.

    The weight of a part may help to move it, against friction for example.
    """
    task, known = query.task, answer.prepared.motion.resistance
    if task.joint is None or known is None:
        return
    forces = bool(answer.prepared.motion.refusal) or any(
        one.status in _FORCES for one in answer.search.counts()
    )
    item, config = query.scene.object(task.object), query.config.motion.grasps.resistance
    if forces and assumes_springs(item, task.joint, config):
        stated = item.resistance.get(task.joint, JointResistance())
        weighed = {task.object: {task.joint: replace(stated, balanced=False)}}
        found = trials.solve(replace(query, scene=query.scene.with_resistance(weighed)))
        if found is not None:
            yield f"without springs that bear the weight of {task.object}/{task.joint}", found


def _with_other_joints(query: PlacementQuery, reasons: str, trials: Trials) -> Iterator[Change]:
    """Yield answers with a joint at its other end, for furniture that the reasons name.

    Joints whose parts are named come first.
    """
    task = query.task
    found: list[tuple[bool, SceneObject, Joint]] = []
    for item in query.scene.objects:
        if not _names(reasons, f"{item.name}/"):
            continue
        for name, joint in item.model.joints.items():
            if (item.name, name) != (task.object, task.joint) and joint.mimic is None:
                links = item.model.moved_by(name)
                hit = any(_names(reasons, f"{item.name}/{link}") for link in links)
                found.append((not hit, item, joint))
    for _, item, joint in sorted(found, key=lambda one: one[0])[:MAX_JOINTS]:
        for end in _other_ends(item, joint):
            scene = query.scene.with_joint(item.name, joint.name, end)
            answer = trials.solve(replace(query, scene=scene))
            if answer is not None:
                slides = joint.kind == "prismatic"
                to = f"{100 * end:.0f} cm" if slides else f"{np.degrees(end):.0f} deg"
                yield f"with {item.name}/{joint.name} at {to}", answer


def _other_ends(item: SceneObject, joint: Joint) -> list[float]:
    """Return the limits of a joint at which it is not now, the farther one first [rad] or [m]."""
    now = item.values()[joint.name]
    ends = sorted((joint.lower, joint.upper), key=lambda end: -abs(end - now))
    return [end for end in ends if SAME_VALUE < abs(end - now) < np.inf]


def _names(reasons: str, label: str) -> bool:
    """Return whether the reasons name a link, or an object by its name and a slash.

    A longer name that contains the label does not count.
    """
    end = "" if label.endswith("/") else r"(?!\w)"
    return re.search(rf"(?<![\w/]){re.escape(label)}{end}", reasons) is not None


def objects_in_the_way(answer: PlacementResult, query: PlacementQuery) -> list[str]:
    """Return the objects that may keep a robot from a task, the most probable first.

    Those that the arm or the part hits come first, then those nearest to the path of the hand.
    """
    scene, task = query.scene, query.task
    path = hand_path(scene, task.object, task.joint, task.to)
    movable = [
        item
        for item in scene.objects
        if item.name != task.object and item.category.lower() not in _FIXED
    ]
    gaps = {item.name: _gap(item.bounds, path) for item in movable}
    words = " ".join(answer.plan.candidates.rejections)
    hit = {name for name in gaps if _names(words, f"{name}/")}
    near = [name for name, gap in gaps.items() if name in hit or gap < NEAR_OBJECTS]
    return sorted(near, key=lambda name: (name not in hit, gaps[name]))[:MAX_OBJECTS]


def _gap(bounds: Float[np.ndarray, "2 3"], points: Float[np.ndarray, "k 3"]) -> float:
    """Return the distance of points from a box [m]."""
    beyond = np.maximum(np.maximum(bounds[0] - points, points - bounds[1]), 0.0)
    return float(np.linalg.norm(beyond, axis=1).min())


def _without(query: PlacementQuery, name: str) -> PlacementQuery:
    return replace(query, scene=query.scene.without(name))


DISTANCES = (0.1, 0.2, 0.3, 0.4, 0.5, 0.6, 0.8, 1.0, 1.25, 1.5, 2.0, 2.5, 3.0)
"""Distances over which an object is moved for a trial [m]."""
DIRECTIONS = 16
"""Directions in which it is moved [-]."""
MAX_DIRECTIONS = 2
"""Directions that are planned for at each distance, those that leave a known plan the most room."""
CONTACT = 0.02
"""An object this near above another one stands on it [m]."""
FLUSH = 2e-3
"""Boxes that overlap less only touch [m]."""
MAX_EDGE = 2.5
"""Nobody moves a longer object; longer than beds and most sofas and tables [m]."""
ARM_ROOM = 0.15
"""Distance from the line between shoulder and hand that an arm takes up [m]."""
BUILT_IN = (
    "cabinet", "counter", "dishwasher", "door", "fridge", "hood", "island", "oven", "radiator",
    "refrigerator", "shelf", "sink", "stove", "toilet", "tub", "wardrobe",
)  # fmt: skip
"""Words in the categories of rigid objects that nobody moves for a task."""


@dataclass(frozen=True, eq=False)
class Move:
    """A displacement of an object with a plan."""

    distance: float
    """Its length [m]."""
    offset: Float[np.ndarray, "2"]
    """Displacement in the world, to a centimeter [m]."""
    answer: PlacementResult

    def words(self, name: str) -> str:
        """Return the move in words."""
        x, y = (self.offset + 0.0).tolist()
        return f"with {name} moved {100 * self.distance:.0f} cm, by ({x:+.2f}, {y:+.2f})"


def can_be_moved(scene: Scene, item: SceneObject) -> bool:
    """Return whether a person can easily move an object.

    Furniture with joints, walls, what is usually built in and what is very long stay, as do
    objects that carry or contain others, and those that stand neither on the floor nor on another
    object.
    """
    if item.wall is not None or item.model.joints or np.ptp(item.bounds, axis=0).max() > MAX_EDGE:
        return False
    if any(word in item.category.lower() for word in BUILT_IN):
        return False
    low, high = item.bounds
    others = np.array([o.bounds for o in scene.objects if o is not item]).reshape(-1, 2, 3)
    middle, bottom = others.mean(1), others[:, 0, 2]
    above = ((middle > low) & (middle < high))[:, :2].all(1)
    carried = above & (bottom > low[2] + CONTACT) & (bottom < high[2] + CONTACT)
    stands = low[2] <= CONTACT or bool(_on_support(scene, item, np.zeros((1, 2)))[0])
    return stands and not carried.any()


def smallest_move(
    query: PlacementQuery, name: str, without: PlacementResult, trials: Trials
) -> Move | None:
    """Return the smallest tried displacement of an object with which a plan exists, or None.

    The plan without the object bounds the displacement: it stays valid with the object out of its
    way. Then bisection looks for a smaller one, with this plan or another.

    Args:
        query: The infeasible query.
        name: Name of the object.
        without: The answer without the object.
        trials: Plans, and limits the time.
    """
    item = query.scene.object(name)
    if not can_be_moved(query.scene, item):
        return None
    offsets, number = free_offsets(query, item, without)
    room = _room_beside(without, item, offsets)
    found: dict[int, Float[np.ndarray, "2"]] = {}

    def solve(size: int, plans_again: bool = True) -> PlacementResult | None:
        """Answer with the object moved over distance number `size`."""
        rows = np.flatnonzero(number == size)
        rows = rows[np.argsort(-room[rows], kind="stable")][:MAX_DIRECTIONS]
        for again in (False, True)[: 1 + plans_again]:
            for row in rows:
                found[size], moved = offsets[row], _moved(query, item, offsets[row])
                answer = trials.solve(moved) if again else without
                if answer is not None and (again or trials.keeps(without, moved.scene)):
                    return answer
        return None

    crowded = np.setdiff1d(number, number[room >= 0.0])
    for size in (*np.unique(number[room >= 0.0]).tolist(), *crowded.tolist()):
        known = solve(size, plans_again=False)
        if known is not None:
            size, known = trials.smallest(solve, size, known)
            return Move(DISTANCES[size - 1], found[size], known)
    return None


def _moved(
    query: PlacementQuery, item: SceneObject, offset: Float[np.ndarray, "2"]
) -> PlacementQuery:
    T = item.T_world_object.copy()
    T[:2, 3] += offset
    other = replace(item, T_world_object=T)
    objects = tuple(other if one is item else one for one in query.scene.objects)
    return replace(query, scene=replace(query.scene, objects=objects))


def free_offsets(
    query: PlacementQuery, item: SceneObject, without: PlacementResult
) -> tuple[Float[np.ndarray, "k 2"], Int[np.ndarray, " k"]]:
    """Return the displacements that keep an object free [m], and the number of each distance.

    It stays on the floor, or on what it stands on, and away from other objects, from the moving
    part and from the robot at its start.
    """
    angle = np.arange(DIRECTIONS) * (2 * np.pi / DIRECTIONS)
    around = np.stack([np.cos(angle), np.sin(angle)], 1)
    offsets = (np.array(DISTANCES)[:, None, None] * around).reshape(-1, 2).round(2)
    scene = query.scene
    objects = tuple(one for one in scene.objects if one is not item)
    base = query.robot.base.moved(pose_planar(without.start))
    boxes = Boxes.join([
        scene_boxes(replace(scene, objects=objects)), without.prepared.motion.sweep(), base,
    ])  # fmt: skip
    own = Boxes.join(item.static_boxes.values())
    middle = item.bounds.mean(0) * [1.0, 1.0, 0.0]
    local = Boxes(own.center - middle, own.rotation, np.maximum(own.half - FLUSH, 1e-4))
    poses = np.column_stack([middle[:2] + offsets, np.zeros(len(offsets))])
    free = base_hits(poses, local, boxes, clearance=0.0) == FREE
    if scene.floor_polygon is not None:
        free &= all_inside(scene.floor_polygon, _outline(item) + offsets[:, None])
    if item.bounds[0, 2] > CONTACT:
        free &= _on_support(scene, item, offsets)
    return offsets[free], (1 + np.arange(len(offsets)) // DIRECTIONS)[free]


def _outline(item: SceneObject) -> Float[np.ndarray, "4 2"]:
    """Return the corners of the upright box around an object [m]."""
    box = upright_boxes([item])
    corners = box.half[0] * [[1, 1, 0], [-1, 1, 0], [-1, -1, 0], [1, -1, 0]]
    return np.asarray((corners @ box.rotation[0].T + box.center[0])[:, :2])


def _on_support(
    scene: Scene, item: SceneObject, offsets: Float[np.ndarray, "n 2"]
) -> Bool[np.ndarray, " n"]:
    """Return with which displacements an object stays on a top that is at its bottom."""
    outlines = _outline(item) + offsets[:, None]
    on = np.zeros(len(offsets), bool)
    for other in scene.objects:
        if other is item or abs(other.bounds[1, 2] - item.bounds[0, 2]) > CONTACT:
            continue
        on |= all_inside(_outline(other), outlines)
    return on


def _room_beside(
    answer: PlacementResult, item: SceneObject, offsets: Float[np.ndarray, "k 2"]
) -> Float[np.ndarray, " k"]:
    """Return how far a moved object stays from the robot of a plan; negative if it may touch [m].

    The robot counts as discs along its path, and as the line from its shoulder to its hand.
    """
    plan, robot = answer.plan, answer.prepared.robot
    assert plan.base_pose is not None
    assert plan.motion is not None
    radius = float(np.linalg.norm(robot.footprint, axis=1).max())
    path = np.array([plan.base_pose]) if plan.base_path is None else plan.base_path
    bases = np.array([plan.base_pose]) if plan.motion.base is None else plan.motion.base
    path = np.concatenate([path, bases])
    shoulder = place_points(bases, answer.prepared.geometry.shoulder[None, :2])[:, 0]
    tool = plan.motion.Ts_world_tool[:, :2, 3]
    share = np.linspace(0.0, 1.0, 5)[:, None, None]
    arm = (share * tool + (1.0 - share) * shoulder).reshape(-1, 2)
    points = np.concatenate([path[:, :2], arm])
    taken = np.repeat([radius, ARM_ROOM], [len(path), len(arm)])
    corners = item.bounds[None, :, None, :2] + offsets[:, None, None]
    beyond = np.maximum(np.maximum(corners[:, 0] - points, points - corners[:, 1]), 0.0)
    return np.asarray((np.linalg.norm(beyond, axis=2) - taken).min(1))


STEP = 0.05
"""Resolution of a wider area and of a longer drive [m]."""
TURN_STEP = np.radians(5.0)
"""Resolution of a wider angle [rad]."""
MAX_WIDENING = 2.0
"""An area that must grow by more is better dropped [m]."""
SAMPLES = 1024
"""Samples of a trial in an area, which contains few of them [-]."""

Relaxed: TypeAlias = "tuple[str, PlacementResult]"
"""A change in words, and the answer with it."""


def relaxed_restriction(query: PlacementQuery, trials: Trials) -> Relaxed | None:
    """Return a small change of the restrictions of the base pose with which a plan exists, or None.

    One restriction is relaxed if that is enough, as little as trials show. Else all are dropped.
    """
    anywhere = trials.solve(replace(query, region=ANYWHERE))
    if anywhere is None:
        return None
    found: Relaxed | None = None
    for relax, nothing in (
        (_keep_in, {"keep_in": ()}), (_keep_out, {"keep_out": ()}), (_facing, {"facing": None}),
        (_driving, {"most_driving": None}),
    ):  # fmt: skip
        free = _with(query, **nothing)
        if found is None and free.region != query.region:
            known = anywhere if free.region == ANYWHERE else trials.solve(free)
            found = None if known is None else relax(query, known, trials)
    return found or ("without the restrictions of the base pose", anywhere)


def _keep_in(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    areas = query.region.keep_in
    size = _steps(float(_beyond(query, areas, _base(known)[None])[0]), STEP)
    if size * STEP > MAX_WIDENING:
        return f"outside the keep-in {_area_names(query, areas)}", known
    free = _with(query, keep_in=())

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_within(free, areas, size * STEP), count=SAMPLES)

    size, best = trials.smallest(solve, size, known)
    return (
        f"with the keep-in {_area_names(query, areas)} widened by {100 * size * STEP:.0f} cm",
        best,
    )


def _keep_out(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    areas = query.region.keep_out
    for k, area in enumerate(areas):
        others = areas[:k] + areas[k + 1 :]
        found = trials.solve(_with(query, keep_out=others)) if others else known
        if found is not None:
            return f"without the keep-out {_area_names(query, (area,))}", found
    return f"without the keep-out {_area_names(query, areas)}", known


def _facing(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    angle = query.region.facing
    assert angle is not None
    base, target = _base(known), known.prepared.geometry.Ts_world_tool[0, 1, :2, 3]
    x, y = target - base[:2]
    turn = abs(float(wrap_angle(np.arctan2(y, x) - base[2])))

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_with(query, facing=angle + size * TURN_STEP))

    size, best = trials.smallest(solve, _steps(turn - angle, TURN_STEP), known)
    return (
        f"with the base facing the grasp within {np.degrees(angle + size * TURN_STEP):.0f} deg",
        best,
    )


def _driving(query: PlacementQuery, known: PlacementResult, trials: Trials) -> Relaxed | None:
    most, needed = query.region.most_driving, known.plan.navigation_cost
    assert most is not None
    assert needed is not None

    def solve(size: int) -> PlacementResult | None:
        return trials.solve(_with(query, most_driving=most + size * STEP))

    size, best = trials.smallest(solve, _steps(needed - most, STEP), known)
    return f"with a drive of up to {most + size * STEP:.2f} m", best


def _with(query: PlacementQuery, **changes: Any) -> PlacementQuery:
    """Return the query with other restrictions."""
    return replace(query, region=replace(query.region, **changes))


def _base(answer: PlacementResult) -> Float[np.ndarray, "3"]:
    assert answer.plan.base_pose is not None
    return np.array(answer.plan.base_pose)


def _steps(excess: float, step: float) -> int:
    """Return the number of steps that are at least an excess."""
    return max(1, int(np.ceil(excess / step - 1e-9)))


def _area_names(query: PlacementQuery, areas: tuple[Outline, ...]) -> str:
    """Return areas in words, by their names in the scene or else by where they are."""
    found = " and ".join(area_name(one, query.scene).removeprefix("area ") for one in areas)
    return f"area{'s' if len(areas) > 1 else ''} {found}"


def _within(query: PlacementQuery, areas: tuple[Outline, ...], most: float) -> PlacementQuery:
    """Return the query for base poses whose footprint leaves one of the areas by a distance."""
    keeps = query.keep_poses

    def near(poses: Float[np.ndarray, "n 3"]) -> Bool[np.ndarray, " n"]:
        kept = _beyond(query, areas, poses) <= most + 1e-9
        return kept if keeps is None else kept & keeps(poses)

    return replace(query, keep_poses=near)


def _beyond(
    query: PlacementQuery, areas: tuple[Outline, ...], poses: Float[np.ndarray, "n 3"]
) -> Float[np.ndarray, " n"]:
    """Return how far the footprint leaves the best of the areas at each base pose [m]."""
    footprint = query.robot.footprint
    middles = (footprint + np.roll(footprint, -1, axis=0)) / 2
    points = place_points(poses, np.concatenate([footprint, middles])).reshape(-1, 2)
    each = []
    for area in areas:
        polygon = np.array(area)
        outside = np.where(contains(polygon, points), 0.0, edge_distances(points, polygon))
        each.append(outside.reshape(len(poses), -1).max(1))
    return np.asarray(np.min(each, axis=0))
