"""Steps of a run: each takes the state of a run and returns the next one."""
