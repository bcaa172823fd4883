"""A machine read by instruments: readings, slopes, noise of readings, simulation."""
