"""Tests of readings and their slopes."""
