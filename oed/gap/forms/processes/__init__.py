"""Unknown effects as smooth processes of low rank over the machine's state."""
