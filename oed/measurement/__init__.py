"""A machine read by instruments: readings, slopes, noise of readings, simulation."""

from oed.measurement.measurement import Measurement, Series
from oed.measurement.simulation import draw_parameters, draw_readings

__all__ = ["Measurement", "Series", "draw_parameters", "draw_readings"]
