"""Trees of links and joints: URDF files, forward and inverse kinematics, collision."""
