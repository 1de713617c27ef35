"""Print why a task is infeasible: how many base poses were rejected for which reason."""

import momapos

scene = momapos.load_scene("kitchen_small")
robot = momapos.load_robot("segway_ur5e")  # its arm is mounted at 1 m: the drawer is too low
task = momapos.make_task(scene, "open", "cabinet_right", "drawer_bottom_slide")
plan = momapos.plan_base_placement(scene, robot, task).plan

print(plan.status)
for reason, count in plan.candidates.rejections.items():
    print(f"{count:>7}  {reason}")
