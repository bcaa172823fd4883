"""Identifiability, least squares and posterior as sections of the result."""
