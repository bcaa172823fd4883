"""The choice of readings, and what is reported of it."""
