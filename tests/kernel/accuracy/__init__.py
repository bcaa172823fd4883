"""Tests of the accuracy after compensation."""
