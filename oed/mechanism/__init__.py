"""A closure made to move: forward and inverse kinematics, slopes, linear pose errors."""
