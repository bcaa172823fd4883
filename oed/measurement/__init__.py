"""A machine read by instruments: readings, slopes, noise of readings, simulation."""

from oed.measurement.fixed_reading import commands_at_fixed_reading
from oed.measurement.measurement import Measurement, Series
from oed.measurement.reading_noise import reading_covariances
from oed.measurement.simulation import draw_parameters, draw_readings

__all__ = [
    "Measurement",
    "Series",
    "commands_at_fixed_reading",
    "draw_parameters",
    "draw_readings",
    "reading_covariances",
]
