"""Where does the robot stand to open the microwave, and how does it move?"""

from momapos import load_robot, load_scene, make_task, plan_base_placement

scene = load_scene("kitchen_small")
robot = load_robot("segway_ur5e")
task = make_task(scene, "open", "microwave")

plan = plan_base_placement(scene, robot, task).plan
print(plan.status, plan.base_pose, f"{plan.navigation_cost:.2f} m to drive")
assert plan.motion is not None
print(len(plan.motion.q), "arm states while the door turns from", plan.motion.object_q[0],
      "to", round(plan.motion.object_q[-1], 2), "rad")  # fmt: skip
