"""The plan of stages, as a section of the result and as files."""
