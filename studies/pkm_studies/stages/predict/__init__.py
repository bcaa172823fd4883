"""Predicted accuracy and held-out readings as sections of the result."""
