"""Tests of arrays, units, text and files."""
