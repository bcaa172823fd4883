"""Where the gap lies: legs, set-ups, runs, times, directions."""
