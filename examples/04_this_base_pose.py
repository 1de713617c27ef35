"""Check base poses: is one feasible, and if not, why, and how far does the door open?"""

import math

import momapos

scene = momapos.load_scene("kitchen_small")
robot = momapos.load_robot("segway_ur5e")
task = momapos.make_task(scene, "open", "fridge", "door_hinge")
for base_pose in ((1.25, -1.0, 2.98), (1.05, -1.15, 2.98), (2.6, -1.6, 0.0)):
    attempt = momapos.check_base_pose(scene, robot, task, base_pose)
    print(base_pose, "feasible" if attempt.motion else attempt.reason)
    if attempt.motion is None and attempt.farthest is not None:
        print(f"  but to {math.degrees(attempt.farthest):.0f} degrees")
