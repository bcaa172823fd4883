"""Parameters and noise from readings, and what readings contradict.

Discrepancy              what effects that the model lacks can do to the readings
Estimate                 identified parameters, their covariance, residuals and noise
IdentifiableCoordinates  directions that some reading determines, and the others
IdentificationError      the readings cannot be fitted
Minima                   least sums of squares of many machines
add_warnings             adds the sentences for the user to an estimate
contradicted_parameters  held parameters that readings contradict
fit_machines             parameters of many machines with the same readings
identify                 the parameters of one machine
minimise                 least squares of many machines at once
noise_numbers            the numbers of an estimated noise law
predict_runs             predicts each run from the others
tolerance_factor         a common factor on all tolerances, by its evidence
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.estimation.contradictions import contradicted_parameters, tolerance_factor
    from oed.estimation.coordinates import IdentifiableCoordinates
    from oed.estimation.discrepancy import Discrepancy
    from oed.estimation.estimate import Estimate, add_warnings
    from oed.estimation.fit_stages import IdentificationError
    from oed.estimation.fitter import Minima, minimise
    from oed.estimation.identification import fit_machines, identify
    from oed.estimation.noise_summary import noise_numbers
    from oed.estimation.run_prediction import predict_runs
else:
    __getattr__ = door(__name__)
