"""Plans of readings: criteria, bounds, search, stages."""

from oed.design.exchange import Choice, choose

__all__ = ["Choice", "choose"]
