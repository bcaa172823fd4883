"""Stages of a study: each turns the kernel's objects into a section of the result."""
