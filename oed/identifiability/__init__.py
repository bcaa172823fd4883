"""What readings determine: rank, combinations, information, remedies.

Assessment            what a set of readings determines
Identifiability       rank, combinations and what is lost
Scaling               columns in SI, as lengths, or in units of tolerances
analyse               the identifiability that a Jacobian of readings has
column_scale          the factor by which each column of H is multiplied
combination_text      a linear combination of parameters, as text
explain               an assessment in sentences, with remedies
lost_motions          rigid motions that no reading determines
parameter_covariance  the same in SI
posterior_covariance  covariance by readings and prior, in units of tolerances
prior_information     information of the prior, in units of tolerances
recoveries            trials that recover lost directions, in phrases
scaled                Jacobian of readings, whitened and scaled
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.identifiability.assessment import Assessment, recoveries
    from oed.identifiability.identifiability import (
        Identifiability,
        Scaling,
        analyse,
        column_scale,
        lost_motions,
        parameter_covariance,
        posterior_covariance,
        prior_information,
        scaled,
    )
    from oed.identifiability.sentences import combination_text, explain
else:
    # imported when first used: a module of the room may need little of it
    __getattr__ = door(__name__)
