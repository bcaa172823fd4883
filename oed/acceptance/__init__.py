"""Acceptance tests of a compensated machine, and conformity with tolerances.

AcceptancePlan       poses to measure, and when a machine passes
MIN_POWER            power below which a test confirms nothing
Promise              what was promised of pose components, and how errors may be shaped
judge                verdicts on the errors measured at the planned poses
measured_rms_within  probability of conformity of an rms error that was measured
parameter_within     probability that a parameter lies within limits
positioning          accuracy and repeatability of ISO 230-2
rms_within           probability that a predicted rms error is within its limit
smooth_functions     shapes of errors that no parameter makes
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
        positioning,
        rms_within,
        smooth_functions,
    )
else:
    # imported when first used: a tolerance needs no plan
    __getattr__ = door(__name__)
