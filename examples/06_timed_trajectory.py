"""Turn a plan into a timed trajectory, and write it as a CSV file."""

import tempfile
from pathlib import Path

import momapos

scene, robot = momapos.load_scene("kitchen_small"), momapos.load_robot("fetch")
task = momapos.make_task(scene, "open", "microwave")
plan = momapos.plan_base_placement(scene, robot, task).plan
trajectory = momapos.time_plan(plan, robot, momapos.SpeedConfig(manipulation_speed=0.3), step=0.01)
print(f"{trajectory.times[-1]:.1f} s, fastest {abs(trajectory.velocities).max():.2f} rad/s")
with tempfile.TemporaryDirectory() as folder:
    trajectory.write_csv(Path(folder) / "trajectory.csv")
