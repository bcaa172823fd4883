"""Errors over the workspace after compensation: prediction, budget, acceptance."""
