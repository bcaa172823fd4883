"""Machines, instruments, effects and formats by name."""
