"""The diagnosis of the gap, as sections of the result."""
