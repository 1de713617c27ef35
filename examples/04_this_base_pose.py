"""Is this base pose feasible, and if not, why?"""

import momapos

scene = momapos.load_scene("kitchen_small")
robot = momapos.load_robot("segway_ur5e")
task = momapos.make_task(scene, "open", "fridge", "door_hinge")
for base_pose in ((1.25, -1.0, 2.98), (2.6, -1.6, 0.0), (0.6, -0.3, 1.57)):
    attempt = momapos.check_base_pose(scene, robot, task, base_pose)
    print(base_pose, "feasible" if attempt.motion else attempt.reason)
