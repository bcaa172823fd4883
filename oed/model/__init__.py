"""What a model states: machine, instrument, effect, the series of readings, their sizes."""
