"""Machines: one module each, with a `machine` attribute."""
