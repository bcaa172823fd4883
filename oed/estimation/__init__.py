"""Parameters and noise from readings, and how sessions of a machine differ."""
