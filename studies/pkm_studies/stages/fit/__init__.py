"""Identifiability, identification and posterior as sections of the result."""
