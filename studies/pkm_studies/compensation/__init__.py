"""Compensation files for controllers, from a result."""
