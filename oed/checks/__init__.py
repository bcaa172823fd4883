"""Checks of readings before they are fitted: ranges, mistakes, outliers, copies.

session    readings as checks use them
ranges     predicted range of every reading
fit        fit within the tolerances, and what all others predict of a reading
outliers   readings that all others contradict, to set aside or in doubt; far_reading: one of
           them, outlier_odds: the odds of a gross error and of its place
mistakes   the usual mistakes, undone
explain    which mistake explains readings that do not fit
change     a change between two parts of a session
copies     readings that no instrument took
senses     order and direction of runs that contradict each other
times      times that contradict the order of readings, or each other
goodness   residuals against the stated noise
blind      mistakes that readings cannot reveal
check      all of them on one session
"""

from oed.checks.check import CheckedSession, check_session
from oed.checks.findings import CheckFinding, Severity
from oed.checks.goodness import Goodness
from oed.checks.session import SessionReadings, session

__all__ = [
    "CheckFinding",
    "CheckedSession",
    "Goodness",
    "SessionReadings",
    "Severity",
    "check_session",
    "session",
]
