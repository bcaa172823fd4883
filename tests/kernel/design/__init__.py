"""Tests of designs and their certificates."""
