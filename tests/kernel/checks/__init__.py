"""Tests of checks of readings."""
