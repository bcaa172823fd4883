"""Parameters and noise from readings, and how sessions of a machine differ."""

from oed.estimation.estimate import Estimate
from oed.estimation.identification import IdentificationError, identify

__all__ = ["Estimate", "IdentificationError", "identify"]
