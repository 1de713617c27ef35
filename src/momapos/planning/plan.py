"""Plan a base placement: the method's stages in order.

The scene is known here; perception, navigation and simulation are separate packages.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from momapos.core import InputError
from momapos.planning.grasps import TaskMotion, hand_path, own_poses, task_motion
from momapos.planning.importance import Selection, rank
from momapos.planning.placement import OURS, search

from .any_grasp import with_any_grasp, with_any_retreat
from .base_use import with_other_use
from .max_opening import plan_max_opening
from .query import PlacementQuery
from .refine_model import initial_selection, refine_model
from .result import PlacementResult
from .search_setup import prepare_search
from .time_limit import unless_late


def plan_placement(query: PlacementQuery) -> PlacementResult:
    """Return where the robot must stand, and how it moves, to do a task.

    Important objects get a kinematic model, all others are boxes. A box that a plan comes near is
    modeled, and the plan is checked again. "Infeasible" is returned only with every object modeled.

    For a task that requests the maximum, the answer is for the largest value that works, to a
    degree or a centimeter, and the plan's task names it. If the time runs out before all larger
    values are excluded, the plan's task does not claim that it is the largest.

    Raises:
        SceneError: The robot collides at its start pose.
        TaskError: The gripper cannot hold the object.
        InputError: The configuration names a method that only `plan_with_method` knows.
    """
    method = query.config.place.method
    if method not in OURS:
        raise InputError(
            f"plan_base_placement searches by {' or '.join(OURS)}, not by {method!r}; "
            "plan_by_method knows the others"
        )
    if query.config.motion.grasps.own == "first":
        return _with_own_first(query)
    return plan_max_opening(query, plan_to_value) if query.task.farthest else plan_to_value(query)


def _with_own_first(query: PlacementQuery) -> PlacementResult:
    """Answer the query with the user's own grasps alone or else, without an answer, with all."""
    alone, both = (
        replace(query, config=replace(query.config, motion=replace(
            query.config.motion, grasps=replace(query.config.motion.grasps, own=own)
        )))
        for own in ("only", "too")
    )  # fmt: skip
    if not len(own_poses(query.robot, query.task.object, query.task.joint)):
        return plan_placement(both)
    answer = plan_placement(alone)
    return answer if answer.plan.status != "infeasible" else plan_placement(both)


def plan_to_value(query: PlacementQuery) -> PlacementResult:
    """Answer the query for the value that its task names."""
    with query.in_time():
        fixed = _from_one_pose(query)
        answer = unless_late(lambda: with_other_use(query, fixed, _from_one_pose), fixed)
    return replace(answer, plan=replace(answer.plan, timing=query.watch.timing))


def _from_one_pose(query: PlacementQuery) -> PlacementResult:
    """Answer the query with a base that stands at one pose."""
    return with_any_retreat(query, lambda one: with_any_grasp(one, _with_first_handle))


def _with_first_handle(query: PlacementQuery) -> PlacementResult:
    """Answer the query with the first handle in which the hand is free."""
    scene, robot, task, config = query.scene, query.robot, query.task, query.config
    watch = query.watch
    if task.poses:  # no object is the task's, from which others could be important
        with watch.stage("model"):
            motion = task_motion(scene, robot, task, config.motion)
        answer = _search(query, None, motion)
        return replace(answer, plan=replace(answer.plan, timing=watch.timing))
    with watch.stage("importance"):
        path = hand_path(scene, task.object, task.joint, task.to)
        ranked = rank(scene, task.object, config.ranking, path=path, seed=query.seed)
    with watch.stage("model"):
        motion = task_motion(scene.with_box_proxies({task.object}), robot, task, config.motion)
    selection = initial_selection(query, ranked, motion)
    first = _search(query, selection, motion)
    result = unless_late(lambda: _with_larger_models(query, selection, motion, first), first)
    return replace(result, plan=replace(result.plan, timing=watch.timing))


def _with_larger_models(
    query: PlacementQuery, selection: Selection, motion: TaskMotion, result: PlacementResult
) -> PlacementResult:
    """Model further objects until an answer is certain."""
    while True:
        if result.plan.feasible:
            selection, certain = refine_model(query, selection, result)
        else:
            certain = result.plan.status == "timeout" or not selection.boxes
            selection = selection if certain else selection.relax_alpha()
        if certain:
            return replace(result, plan=replace(result.plan, key_objects=selection.record()))
        result = _search(query, selection, motion)


def _search(
    query: PlacementQuery, selection: Selection | None, motion: TaskMotion
) -> PlacementResult:
    """Search base poses with the selected objects modeled, or all."""
    place, watch, scene = query.config.place, query.watch, query.scene
    boxes = () if selection is None else selection.boxes
    if selection is not None:
        scene = scene.with_box_proxies(selection.names)
    ready = prepare_search(query, scene, motion)
    # Only a fully modeled scene can prove a task infeasible; before that, one round of samples is
    # enough.
    brief = replace(place, grid=False, rounds=min(1, place.rounds))
    config = brief if boxes else place
    with watch.stage("search"):
        found = search(ready.problem, config, np.random.default_rng(query.seed))
    if found.timed_out or not boxes:
        found.accept_fallback()
    if found.is_no and not boxes:
        with watch.stage("search"):
            found.merge(ready.refine(found, config))
        found.accept_fallback()
    if found.is_no and not boxes:
        with found.in_time():
            for more in ready.multi_grasp_searches(config):
                with watch.stage("search"):
                    found.merge(more())
                found.accept_fallback()
                if not found.is_no:
                    break
    answer, key = ready.result(found), None if selection is None else selection.record()
    return replace(answer, plan=replace(answer.plan, key_objects=key))
