"""Forecast compensation of a study: nodes to measure, and the controller's table."""
