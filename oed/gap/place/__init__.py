"""Where the gap lies: legs, runs, stretches of time and phase, directions."""
