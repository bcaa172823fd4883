"""The diagnosis in a third world: readings of simulated physics, on three machines."""
