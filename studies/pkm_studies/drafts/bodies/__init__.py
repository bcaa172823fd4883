"""Machines from models of bodies and joints: MJCF, and URDF with a table of loops."""
