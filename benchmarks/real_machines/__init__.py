"""Accuracy on machines with small effects, by an independent generator."""
