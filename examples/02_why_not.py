"""When the answer is no, the plan says why: how many poses were refused for which reason."""

from momapos import load_robot, load_scene, make_task, plan_base_placement

scene = load_scene("kitchen_small")
robot = load_robot("segway_ur5e")  # its arm stands a metre high: the lowest drawer is too low
task = make_task(scene, "open", "cabinet_right", "drawer_bottom_slide")

plan = plan_base_placement(scene, robot, task).plan
print(plan.status)
for reason, count in plan.candidates.rejections.items():
    print(f"{count:>7}  {reason}")
