"""Plan where the robot stands to open the fridge, and how it moves."""

import momapos

scene = momapos.load_scene("kitchen_small")
robot = momapos.load_robot("segway_ur5e")
task = momapos.make_task(scene, "open", "fridge", "door_hinge")
plan = momapos.plan_base_placement(scene, robot, task).plan

print(plan.status, plan.base_pose, f"{plan.navigation_cost:.2f} m to drive")
assert plan.motion is not None
print(len(plan.motion.q), "arm states while the door turns to", plan.motion.object_q[-1], "rad")
