"""The figures of the gap between model and machine."""
