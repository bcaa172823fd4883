"""Parameters and noise from readings, and how sessions of a machine differ."""

from oed.estimation.estimate import Estimate
from oed.estimation.identification import identify

__all__ = ["Estimate", "identify"]
