"""Coverage of intervals and bands on readings of an independent exact geometry."""
