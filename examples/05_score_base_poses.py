"""Score 10,000 base poses for a tool pose with the reachability map."""

import numpy as np

import momapos

robot = momapos.load_robot("fetch")
reach = momapos.load_reach_map(robot)
T_world_tool = np.eye(4)
T_world_tool[:3, 3] = 0.0, 0.0, 0.9  # the tool points along the world's x axis
base_poses = np.random.default_rng(0).uniform([-1, -1, -np.pi], [1, 1, np.pi], (10_000, 3))
scores = reach.score_base_poses(base_poses, T_world_tool)
print(f"{np.mean(scores > 0):.1%} can reach it, the best one from", base_poses[scores.argmax()])
