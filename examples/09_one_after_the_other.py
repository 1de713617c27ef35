"""Yield several feasible base poses within the region where the robot may stand."""

from itertools import islice

import momapos

scene = momapos.load_scene("kitchen_small")
robot = momapos.load_robot("segway_ur5e")
task = momapos.make_task(scene, "open", "cabinet_right", "drawer_middle_slide")
region = momapos.BaseRegion(facing=1.6, most_driving=2.0)

answers = momapos.iter_placements(scene, robot, task, region=region)
for answer in islice(answers, 5):
    assert answer.plan.base_pose is not None
    x, y, yaw = answer.plan.base_pose
    print(f"({x:.2f} m, {y:.2f} m, {yaw:.2f} rad) after {answer.plan.navigation_cost:.2f} m")
answers.close()
