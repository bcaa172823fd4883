"""The diagnosis of the gap, and what planned readings could find, for the result."""
