"""Plans as other programs take them: trajectories, ROS 2 messages, recordings, planning scenes."""
