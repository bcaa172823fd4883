"""Diagnosis of the gap between model and machine: effects, places, closure, advice."""
