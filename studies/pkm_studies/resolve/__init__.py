"""Turns a study's tables into the kernel's objects, in SI units."""
