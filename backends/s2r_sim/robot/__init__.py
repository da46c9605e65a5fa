"""The robot: its constants, its kinematics, its rigid-body model, and the signals between it and its controller."""
