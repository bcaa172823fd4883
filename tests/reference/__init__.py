"""Published and frozen numbers, each with its source."""
