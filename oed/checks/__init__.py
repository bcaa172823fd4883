"""Checks of readings before they are fitted: mistakes, outliers, copies, times.

CheckFinding           what is wrong, in a sentence, and how harmful it is
CheckedSession         a session with its findings, its outliers and what explains them
Explanation            a mistake that explains readings which do not fit
FarReading             a reading far from what all others predict of it
Goodness               residuals against the stated noise
PHYSICAL_KINDS         kinds of mistakes that an effect of the machine can mimic
SessionReadings        readings as checks use them
Severity               how harmful a finding is
check_session          all checks on one session
goodness_of_delivered  goodness of the parameters that are delivered
misfits                how far readings miss with and without a mistake, in words
session_readings       the readings of series, for checks
unseen_mistakes        mistakes that readings cannot reveal
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.checks.blind import unseen_mistakes
    from oed.checks.check import CheckedSession, check_session
    from oed.checks.explain import Explanation
    from oed.checks.findings import CheckFinding, Severity
    from oed.checks.fit import Goodness
    from oed.checks.judgement import goodness_of_delivered
    from oed.checks.mistakes import PHYSICAL_KINDS
    from oed.checks.outlier_odds import FarReading
    from oed.checks.sentences import misfits
    from oed.checks.session import SessionReadings, session_readings
else:
    # imported when first used: a plan checks no readings
    __getattr__ = door(__name__)
