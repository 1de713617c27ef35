"""The helper's half of the compiling: what finds the arm's path and the way of the base."""

from __future__ import annotations

import gc
from dataclasses import replace

import numpy as np

from momapos.geometry.transforms import pose_planar
from momapos.kinematics.world import build_world
from momapos.manipulation.arm_path import ArmPath, find_paths
from momapos.manipulation.motion import MotionConfig, task_motion
from momapos.manipulation.tasks import make_task
from momapos.navigation.footprint_map import build_navigation_map
from momapos.navigation.global_path import Path, plan_path
from momapos.robots.robot import load_robot
from momapos.scene.files import load_scene

_FAR = np.array([1000.0, 0.0, 0.0])
"""A base pose at which no room is in the arm's way [m, m, rad]."""


def path_of_an_arm_at_rest() -> ArmPath:
    """Find the path of an arm that stands still, far from any room.

    Kernels know no robot, so that any arm compiles them for all. Inverse kinematics comes first
    and takes longest; what comes before it in an answer is being compiled elsewhere meanwhile.
    """
    robot = load_robot("segway_ur5e")
    T_base_tool = robot.chain.tool_poses(robot.home)
    scene = load_scene("kitchen_small")
    task = make_task(scene, "open", "microwave", None, None)
    motion = task_motion(scene, robot, task, MotionConfig())
    world = build_world(
        motion.static, motion.moving, motion.grasped, motion.labels, robot.spheres, clearance=0.0
    )
    Ts = np.tile(pose_planar(_FAR) @ T_base_tool, (1, len(motion.object_q), 1, 1))
    still = replace(motion, Ts_world_tool=Ts)
    return find_paths(robot, world, still, _FAR[None], np.zeros(1, np.int64))[0]


def way_round_a_corner() -> Path | None:
    """Plan a way of a base that needs the map of the floor, so that all its kernels are used."""
    robot = load_robot("segway_ur5e")
    ground = build_navigation_map(load_scene("kitchen_small"), robot)
    return plan_path(ground, np.array([1.9, -1.6, 1.5708]), np.array([1.353, -1.014, 2.978]))


if __name__ == "__main__":
    # numba makes objects by the million; a tenth of the time goes to looking for dead cycles.
    gc.disable()
    path_of_an_arm_at_rest()
    way_round_a_corner()
