"""Study files: their tables and how they are read."""
