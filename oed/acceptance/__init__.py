"""Acceptance tests of a compensated machine, and conformity with tolerances.

AcceptancePlan       poses to measure, and when a machine passes
MIN_POWER            power below which a test confirms nothing
Promise              what was promised of pose components, and how errors may be shaped
judge                verdicts on the errors measured at the planned poses
measured_rms_within  probability of conformity of an rms error that was measured
positioning          accuracy and repeatability of ISO 230-2
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
        positioning,
        smooth_functions,
    )
else:
    # imported when first used: a tolerance needs no plan
    __getattr__ = door(__name__)
