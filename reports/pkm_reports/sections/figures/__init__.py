"""The figures of a report, one a file: each has `draw`, from a section of the result."""
