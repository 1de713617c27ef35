"""The part that a task moves, at any value of its joint."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, get_args

import numpy as np

from momapos.core import TaskError, owner_cache
from momapos.core.geometry import apply, invert
from momapos.model.records import JointVerb, Task
from momapos.model.scene import Scene, SceneObject, latch_to_turn
from momapos.model.urdf import Joint, opening_of

from .convex import Body, overlap
from .exact_shapes import (
    Shapes,
    concave_surface,
    elements_of,
    join,
    moving_names,
    of_bodies,
    prepared,
    prepared_static,
)
from .link_bodies import BodyPaths, LinkBodies, body_poses, paths_of

if TYPE_CHECKING:
    from jaxtyping import Bool, Float, Int


@dataclass(frozen=True, eq=False)
class MovedLatch:
    """A latch on the part, which a task turns before the part moves."""

    joint: Joint
    start: float
    """Value in the scene [rad] or [m]."""
    goal: float
    """Value from which on the part is free [rad] or [m]."""
    body: int
    """Index of the body that it moves."""


MAX_WAY = 10.0
"""Length of the path of an object that is lifted [m]."""


def way_of(lift: float, slide: Sequence[float] = (0.0, 0.0, 0.0)) -> Float[np.ndarray, "3 3"]:
    """Return the corners of the path of an object that is slid and then lifted [m]."""
    out = np.array(slide, float)
    return np.stack([np.zeros(3), out, out + np.array([0.0, 0.0, lift])])


@dataclass(frozen=True, eq=False)
class MovedPart:
    """The links that a joint and its mimic joints move, or a whole object."""

    name: str
    joint: Joint | None
    """None for a whole object; its value is then how far it is moved along `way` [m]."""
    start: float
    """Value of the joint in the scene [rad] or [m]."""
    rest: float
    """Value of the joint where the object is closed: zero, or the nearest limit."""
    goal: float
    """Value that the task requests."""
    shapes: Shapes
    """Shapes of the part, by the body that carries each."""
    paths: BodyPaths
    """Poses of these bodies at joint values."""
    latch: MovedLatch | None = None
    """The latch to turn; None if there is none."""
    links: Mapping[str, tuple[int, Float[np.ndarray, "4 4"]]] = field(default_factory=dict)
    """The body that carries each of its links, and the link's pose in it."""
    way: Float[np.ndarray, "k 3"] = field(default_factory=lambda: way_of(MAX_WAY))
    """Corners of the path of a whole object, relative to where it stands [m]."""

    def turned(self, count: int) -> Float[np.ndarray, " n"] | None:
        """Return values of the turned latch, for a number of states; None without a latch."""
        return None if self.latch is None else np.full(count, self.latch.goal)

    def poses(
        self, values: Float[np.ndarray, " s"], latch_q: Float[np.ndarray, " s"] | None = None
    ) -> Float[np.ndarray, "s b 4 4"]:
        """Return world poses of the part's bodies at values of joint and latch.

        Without values, the latch is as in the scene.
        """
        if self.joint is not None:
            leaders = {self.joint.name: values}
            if self.latch is not None:
                rest = np.full(len(values), self.latch.start)
                leaders[self.latch.joint.name] = rest if latch_q is None else latch_q
            return self.paths.at(leaders)
        Ts = np.repeat(self.paths.offsets[None], len(values), axis=0)
        at = np.append(0.0, np.cumsum(np.linalg.norm(np.diff(self.way, axis=0), axis=1)))
        Ts[:, 0, :3, 3] += np.stack([np.interp(values, at, x) for x in self.way.T], axis=1)
        return Ts

    def placed(
        self, values: Float[np.ndarray, " s"], latch_q: Float[np.ndarray, " s"] | None = None
    ) -> Float[np.ndarray, "s k 4 4"]:
        """Return world poses of the shapes at values of joint and latch, see `poses`."""
        return self.placed_at(self.poses(values, latch_q))

    def placed_at(
        self, Ts_world_body: Float[np.ndarray, "s b 4 4"]
    ) -> Float[np.ndarray, "s k 4 4"]:
        """Return world poses of the shapes, given those of the bodies."""
        return self.shapes.placed(Ts_world_body)

    def nearest_body(self, point: Float[np.ndarray, "3"], value: float) -> int:
        """Return which body is nearest to a point in the world, at a joint value."""
        Ts = self.poses(np.array([value]))[0]
        if len(Ts) == 1:
            return 0
        T_body_world = invert(Ts)
        local = T_body_world[:, :3, :3] @ point + T_body_world[:, :3, 3]
        return int(np.argmin([self.distance(x, body) for body, x in enumerate(local)]))

    def nearest_point(self, point: Float[np.ndarray, "3"], body: int) -> Float[np.ndarray, "3"]:
        """Return the nearest point of the boxes around a body's shapes, in its frame [m]."""
        own = np.flatnonzero(self.shapes.body == body)
        Ts = self.shapes.Ts_body_shape[own]
        local = apply(invert(Ts), point[None])[:, 0]
        half = self.shapes.half[own]
        inside = np.clip(local, -half, half)
        best = int(np.linalg.norm(local - inside, axis=1).argmin())
        return np.asarray(Ts[best, :3, :3] @ inside[best] + Ts[best, :3, 3])

    def distance(self, point: Float[np.ndarray, "3"], body: int = 0) -> float:
        """Return the distance of a point in a body's frame from its shapes [m]; negative inside."""
        own = np.flatnonzero(self.shapes.body == body)
        Ts_shape_part = invert(self.shapes.Ts_body_shape[own])
        local = Ts_shape_part[:, :3, :3] @ point + Ts_shape_part[:, :3, 3]
        beyond = np.abs(local) - self.shapes.half[own]
        least = np.linalg.norm(np.maximum(beyond, 0.0), axis=1)
        least = np.where(beyond.max(1) < 0.0, beyond.max(1), least)
        nearest, T = np.inf, np.eye(4)
        for index in np.argsort(least).tolist():
            if least[index] >= nearest:
                break
            T[:3, 3] = local[index]
            nearest = min(nearest, -overlap(_POINT, self.shapes.core(int(own[index])), T))
        return nearest


@dataclass(frozen=True, eq=False)
class OwnElements:
    """The collision elements of the part's object, by their index in `shapes_of`."""

    item: SceneObject
    task: Task
    standing: Shapes
    """Those that the task does not move, in world coordinates; hollow meshes are in pieces."""
    of_part: Int[np.ndarray, " m"]
    """Element of each shape of the part."""
    of_standing: Int[np.ndarray, " k"]
    """Element that each standing shape is, or is a piece of."""
    movable: Bool[np.ndarray, " e"]
    """Whether a joint of the object moves the element."""
    displaced: Bool[np.ndarray, " e"]
    """Whether another joint of the object has moved the element from rest."""
    loose: Bool[np.ndarray, " e"]
    """Whether the element belongs to another object that rests on the object."""
    first: int = 0
    """Index of the first standing shape among all obstacles of a scene."""
    T_world_frame: Float[np.ndarray, "4 4"] = field(default_factory=lambda: np.eye(4))
    """Frame in which the shapes stand still, at its pose in the given scene."""

    def surface(self, element: int) -> Float[np.ndarray, "t 3 3"] | None:
        """Return an element's triangles in the frame; None if its hull is good enough."""
        link, triangles = concave_surface(self.item.model, element)
        if not len(triangles):
            return None
        bodies, _ = prepared(self.item.model)
        T_world_body = _body_poses(self.item, bodies)[bodies.of_link[link]]
        T = invert(self.T_world_frame) @ T_world_body @ bodies.T_body_link[link]
        return np.asarray(apply(T, triangles.reshape(-1, 3))).reshape(-1, 3, 3)


_REST_TOLERANCE = 1e-3
"""Largest difference from its rest value of a joint at rest [rad] or [m]."""
_POINT = Body(np.zeros((1, 3)), 0.0, 0.0)


def split(scene: Scene, task: Task) -> tuple[MovedPart, Shapes, OwnElements]:
    """Split a scene into the part that a task moves and all other shapes, in world coordinates.

    Returns:
        The part, the other shapes, which are its obstacles, and the elements of its own object.

    Raises:
        UnknownNameError: There is no such object or joint.
        TaskError: The task names a joint but no value, or opens an object without a joint.
    """
    target = scene.object(task.object)
    if task.joint is None and task.verb in get_args(JointVerb):
        raise TaskError(f"task: joint must be given to {task.verb} {task.object!r}")
    if task.joint is not None and task.to is None:
        raise TaskError(f"task: to must be given for joint {task.joint!r} of {task.object!r}")
    if task.joint is not None:
        target.joint(task.joint)
    part, own = split_object(target, task)
    fixed = [own.standing if item is target else obstacle(item) for item in scene.objects]
    counts = [len(shapes) for shapes in fixed]
    if target in scene.objects:  # not if the task moves no object
        own = replace(own, first=sum(counts[: scene.objects.index(target)]))
    return part, join(fixed, [f"{item.name}/" for item in scene.objects]), own


@owner_cache()
def split_object(item: SceneObject, task: Task) -> tuple[MovedPart, OwnElements]:
    """Split an object into the part that a task moves and the rest, cached for all its scenes."""
    bodies, hulls = prepared(item.model)
    own_body = hulls.body
    hulls = _in_world(item, bodies, replace(hulls, names=moving_names(item.model)))
    moved = _moved_shapes(task, bodies, hulls)
    standing, element = _standing(item)
    kept = np.flatnonzero(~np.isin(element, moved))
    own = OwnElements(
        item=item,
        task=task,
        standing=standing.take(kept),
        of_part=moved,
        of_standing=element[kept],
        movable=own_body > 0,
        displaced=np.isin(own_body, _displaced(item, task, bodies)),
        loose=np.array([link in item.model.contents for link, _ in elements_of(item.model)], bool),
    )
    return _part(item, task, bodies, hulls.take(moved)), own


def within_part(part: MovedPart, own: OwnElements) -> Iterator[tuple[MovedPart, OwnElements]]:
    """Yield each pair of bodies of a part, as if one moved and the other one stood still.

    The frame is that of the standing body. Only a body that carries the moving one is its bearing.
    """
    Ts_world_body = part.poses(np.array([part.start]))[0]
    for moving, parent in enumerate(part.paths.parent):
        for frame in range(moving):
            still, moved = (np.flatnonzero(part.shapes.body == body) for body in (frame, moving))
            element = own.of_part[still]
            yield (
                replace(
                    part,
                    shapes=part.shapes.take(moved),
                    paths=replace(part.paths, frame=frame),
                ),
                replace(
                    own,
                    standing=part.shapes.take(still),
                    of_part=own.of_part[moved],
                    of_standing=element,
                    movable=np.full(len(own.movable), parent != frame),
                    displaced=np.zeros(len(own.displaced), bool),
                    T_world_frame=Ts_world_body[frame],
                ),
            )


def _displaced(item: SceneObject, task: Task, bodies: LinkBodies) -> list[int]:
    """Return the bodies that other joints than the task's have moved from rest."""
    values, rest = item.values(), item.model.rest
    moved: set[int] = set()
    for name, value in values.items():
        if name != task.joint and abs(value - rest[name]) > _REST_TOLERANCE:
            moved |= bodies.moved_by(name)
    return sorted(moved)


def moved_part(item: SceneObject, task: Task) -> MovedPart:
    """Return the part of an object that a task moves."""
    bodies, hulls = prepared(item.model)
    hulls = _in_world(item, bodies, hulls)
    return _part(item, task, bodies, hulls.take(_moved_shapes(task, bodies, hulls)))


def _moved_shapes(task: Task, bodies: LinkBodies, shapes: Shapes) -> Int[np.ndarray, " m"]:
    """Return the indices of the shapes that a task moves."""
    everything = frozenset(range(len(bodies)))
    return of_bodies(shapes, everything if task.joint is None else bodies.moved_by(task.joint))


def obstacle(item: SceneObject) -> Shapes:
    """Return the shapes of an object that is in the way; none if it lies flat on the floor."""
    shapes = static_shapes(item)
    return shapes.take(np.arange(0)) if item.is_flat else shapes


def static_shapes(item: SceneObject) -> Shapes:
    """Return the shapes of an object that stands still, in world coordinates."""
    return _standing(item)[0]


@owner_cache()
def _standing(item: SceneObject) -> tuple[Shapes, Int[np.ndarray, " k"]]:
    """Return an object's shapes in world coordinates and their elements, cached.

    Most objects of a scene are the same in all its versions and for all tasks.
    """
    bodies, shapes, element = prepared_static(item.model)
    return _in_world(item, bodies, shapes), element


def _in_world(item: SceneObject, bodies: LinkBodies, shapes: Shapes) -> Shapes:
    """Return shapes of an object in world coordinates."""
    return shapes.moved_to(shapes.placed(_body_poses(item, bodies)[None])[0])


def _body_poses(item: SceneObject, bodies: LinkBodies) -> Float[np.ndarray, "b 4 4"]:
    """Return world poses of an object's bodies; mimic joints follow their leaders."""
    mimics = {joint.name for joint in bodies.joints if joint is not None and joint.mimic}
    values = {name: value for name, value in item.values().items() if name not in mimics}
    return body_poses(bodies, values, item.T_world_object)[0]


def _part(item: SceneObject, task: Task, bodies: LinkBodies, shapes: Shapes) -> MovedPart:
    """Build the moved part from its shapes, which are in world coordinates."""
    joint, latch, start, rest, goal = None, None, 0.0, 0.0, 0.0
    paths, body = BodyPaths((), (), item.T_world_object[None]), np.zeros(len(shapes), np.int64)
    Ts_world_body, carrier = _body_poses(item, bodies), dict.fromkeys(range(len(bodies)), 0)
    if task.joint is not None and task.to is not None:
        joint = bodies.joints[bodies.of_joint[task.joint]]
        start, goal = item.values()[task.joint], task.to
        rest = opening_of(item.model, task.joint).closed
        held = latch_to_turn(item, task.joint)
        leaders = (task.joint,) if held is None else (task.joint, held.joint)
        paths, of_body = paths_of(bodies, leaders, Ts_world_body)
        carrier = dict(of_body)
        if held is not None:
            turns = item.joint(held.joint)
            at = carrier[bodies.of_joint[held.joint]]
            latch = MovedLatch(turns, item.values()[held.joint], held.to, at)
        body = np.array([carrier[b] for b in shapes.body.tolist()], np.int64)
    named = replace(join([shapes], [f"{item.name}/"]), body=body)
    part = MovedPart(item.name, joint, float(start), float(rest), float(goal), named, paths, latch)
    Ts_body_world = invert(part.poses(np.array([start]))[0])
    links = {
        name: (carrier[b], Ts_body_world[carrier[b]] @ Ts_world_body[b] @ bodies.T_body_link[name])
        for name, b in bodies.of_link.items()
        if b in carrier
    }
    solid = named.moved_to(Ts_body_world[body] @ named.Ts_body_shape)
    return replace(part, shapes=solid, links=links)
