"""Readings files."""
