"""Tests of identifiability."""
