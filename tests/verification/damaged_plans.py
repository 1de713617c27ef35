"""Ways to corrupt the plan of `door_case`, each with the check that must detect it."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from door_case import OPEN, Case, cupboard_urdf

MUTATIONS: dict[str, tuple[Callable[[Case], None], str]] = {}


def mutation(check: str) -> Callable[[Callable[[Case], None]], Callable[[Case], None]]:
    """Register a corruption of the plan under its name."""

    def register(corrupt: Callable[[Case], None]) -> Callable[[Case], None]:
        MUTATIONS[corrupt.__name__] = (corrupt, check)
        return corrupt

    return register


def held(case: Case) -> dict[str, Any]:
    manipulation: dict[str, Any] = case.plan["manipulation"]
    return manipulation


@mutation("FK position against T_world_tool")
def base_shifted(case: Case) -> None:
    case.plan["base_pose"]["x"] -= 0.02


@mutation("FK rotation against T_world_tool")
def base_turned(case: Case) -> None:
    case.plan["base_pose"]["yaw"] += 0.05


@mutation("FK position against T_world_tool")
def joints_in_another_order(case: Case) -> None:
    case.plan["joints"][1:3] = case.plan["joints"][2:0:-1]


@mutation("FK position against T_world_tool")
def another_tool_link(case: Case) -> None:
    case.plan["robot"]["tool_link"] = "palm"


@mutation("FK rotation against T_world_tool")
def tool_poses_turned(case: Case) -> None:
    T = np.array(held(case)["T_world_tool"])
    T[:, :3, :2] = T[:, :3, 1::-1] * [1.0, -1.0]
    held(case)["T_world_tool"] = T.tolist()


@mutation("T_world_tool is a rigid transform")
def tool_poses_scaled(case: Case) -> None:
    T = np.array(held(case)["T_world_tool"])
    T[:, :3, :3] *= 1.01
    held(case)["T_world_tool"] = T.tolist()


@mutation("approach present")
def no_approach(case: Case) -> None:
    case.plan["approach"] = []


@mutation("approach ends where the manipulation starts")
def approach_ends_elsewhere(case: Case) -> None:
    case.plan["approach"][-1][0] += 0.01


@mutation("object moves monotonically (largest step back)")
def a_step_back(case: Case) -> None:
    for key in ("q", "object_q", "T_world_tool"):
        rows = held(case)[key]
        rows[20], rows[21] = rows[21], rows[20]


@mutation("joint limits (excess)")
def a_joint_beyond_its_limit(case: Case) -> None:
    for row in case.q():
        row[5] += 2 * np.pi


@mutation("object ends at task.to")
def another_goal(case: Case) -> None:
    case.plan["task"]["to"] = 1.1


@mutation("object starts at the scene's value")
def the_door_stands_open_in_the_scene(case: Case) -> None:
    case.scene["objects"][0]["joints"]["hinge"] = 0.05


@mutation("object within its joint limits (excess)")
def the_door_turns_less_far(case: Case) -> None:
    case.cupboard = case.cupboard.replace('upper="1.2"', 'upper="0.9"')


@mutation("grasp slips: translation in the moved part")
def the_door_lags_behind(case: Case) -> None:
    case.set_door_values(OPEN * np.linspace(0.0, 1.0, 41) ** 1.2)


@mutation("grasp slips: rotation in the moved part")
def the_tool_turns_in_the_handle(case: Case) -> None:
    rows = held(case)["q"]
    for k, row in enumerate(rows):
        row[5] += 0.1 * k / len(rows)


@mutation("largest step of the manipulation")
def a_jump(case: Case) -> None:
    for key in ("q", "object_q", "T_world_tool"):
        del held(case)[key][5:35]


@mutation("base collision with the scene")
def furniture_under_the_base(case: Case) -> None:
    case.obstacle([0.3, 0.3, 0.5], [-0.75, 0.1, 0.3])


@mutation("base collision with the scene")
def the_door_hits_the_base(case: Case) -> None:
    case.robot = case.robot.replace('size="0.4 0.4 0.5"', 'size="0.9 0.4 0.65"')


@mutation("moved part collision with the scene")
def an_obstacle_in_the_way_of_the_door(case: Case) -> None:
    case.obstacle([0.04, 0.04, 0.04], [-0.007, 0.06, 0.45])


@mutation("arm collision with the scene")
def an_obstacle_in_the_way_of_the_forearm(case: Case) -> None:
    case.obstacle([0.04, 0.04, 0.1], [-0.2, 0.25, 0.85])


@mutation("arm collision with the scene")
def an_obstacle_on_the_approach(case: Case) -> None:
    row = list(case.plan["approach"][0])
    row[0] += 1.0
    case.plan["approach"].insert(0, row)
    case.obstacle([0.08, 0.08, 0.08], [-0.14, 0.57, 0.8])


@mutation("robot self-collision")
def the_arm_folds_into_the_base(case: Case) -> None:
    row = list(case.plan["approach"][0])
    row[1], row[2] = 2.6, 2.0
    case.plan["approach"].insert(0, row)


@mutation("arm below the floor")
def the_arm_reaches_through_the_floor(case: Case) -> None:
    row = list(case.plan["approach"][0])
    row[1:] = [2.3, 0.8, 0.0, 0.0, 0.0]
    case.plan["approach"].insert(0, row)


@mutation("base outside the floor polygon")
def the_floor_ends_under_the_base(case: Case) -> None:
    case.scene["floor"] = [[-0.8, -3.0], [3.0, -3.0], [3.0, 3.0], [-0.8, 3.0]]


@mutation("grasp point to the moved part")
def the_tool_is_far_from_the_part(case: Case) -> None:
    case.cupboard = cupboard_urdf(handle=False)


@mutation("q, object_q, T_world_tool have equal length >= 2")
def a_single_state(case: Case) -> None:
    for key in ("q", "object_q", "T_world_tool"):
        held(case)[key] = held(case)[key][:1]


@mutation("status is solved")
def not_solved(case: Case) -> None:
    case.plan["status"] = "infeasible"
