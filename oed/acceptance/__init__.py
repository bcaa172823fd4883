"""Acceptance tests of a compensated machine, and conformity with tolerances.

AcceptancePlan       poses to measure, and when a machine passes
MIN_POWER            power below which a test confirms nothing
Promise              what was promised of pose components, and how errors may be shaped
judge                verdicts on the errors measured at the planned poses
measured_rms_within  probability of conformity of an rms error that was measured
parameter_within     probability that a parameter lies within limits
plan_acceptance      the fewest poses that reach a power
positioning          accuracy and repeatability of ISO 230-2
rms_within           probability that a predicted rms error is within its limit
smooth_functions     shapes of errors that no parameter makes
state_limits         limits and power of given poses
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.acceptance.plan import (
        MIN_POWER,
        AcceptancePlan,
        Promise,
        judge,
        measured_rms_within,
        parameter_within,
        plan_acceptance,
        positioning,
        rms_within,
        smooth_functions,
        state_limits,
    )
else:
    # imported when first used: a tolerance needs no plan
    __getattr__ = door(__name__)
