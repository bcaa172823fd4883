"""Checks of readings before they are fitted: mistakes, outliers, copies, times.

CheckFinding           what is wrong, in a sentence, and how harmful it is
CheckedSession         a session with its findings, its outliers and what explains them
Goodness               residuals against the stated noise
SessionReadings        readings as checks use them
Severity               how harmful a finding is
check_session          all checks on one session
goodness_of_delivered  goodness of the parameters that are delivered
session_readings       the readings of series, for checks
unseen_mistakes        mistakes that readings cannot reveal
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.checks.blind import unseen_mistakes
    from oed.checks.check import CheckedSession, check_session
    from oed.checks.findings import CheckFinding, Severity
    from oed.checks.fit import Goodness
    from oed.checks.judgement import goodness_of_delivered
    from oed.checks.session import SessionReadings, session_readings
else:
    # imported when first used: a plan checks no readings
    __getattr__ = door(__name__)
