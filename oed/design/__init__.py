"""Plans of readings: criteria, bounds, search, stages."""

from oed.design.candidate_file import open_candidates
from oed.design.exchange import Choice, choose
from oed.design.large import choose_from_file

__all__ = ["Choice", "choose", "choose_from_file", "open_candidates"]
