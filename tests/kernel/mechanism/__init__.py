"""Tests of kinematics."""
