"""Second visits to cases of the second generator: what the advised readings decide."""
