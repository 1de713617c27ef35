"""Where does the robot stand to open the microwave, and how does it move?"""

from momapos import load_robot, load_scene, make_task, place
from momapos.cache import default_cache_dir
from momapos.reachability.store import load_or_build

scene = load_scene("kitchen_small")
robot = load_robot("segway_ur5e")
task = make_task(scene, "open", "microwave")
reach = load_or_build(robot, default_cache_dir(), None)  # built once, then read from the cache

plan = place(scene, robot, task, reach).plan
print(plan.status, plan.base_pose, f"{plan.navigation_cost:.2f} m to drive")
assert plan.motion is not None
print(len(plan.motion.q), "arm states while the door turns from", plan.motion.object_q[0],
      "to", round(plan.motion.object_q[-1], 2), "rad")  # fmt: skip
