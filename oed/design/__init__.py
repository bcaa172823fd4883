"""Choice of readings: criteria, rules, search and certificate.

CRITERIA       the criteria by name
Candidates     readings or runs to choose from, as blocks with noise, time and set-up
Choice         chosen candidates and their certificate
Criterion      a criterion over the columns of candidates
DesignProblem  candidates and rules, and the plans chosen from them
Nuisances      unknowns beside the parameters that candidates allow for
Objective      a concave function of the candidates' weights
PlanEvaluator  values of plans, and of plans with each candidate added
QuotaSet       numbers of readings from selections of the candidates
Rules          number of readings, time, set-ups, distances and quotas of a plan
SizeCurve      accuracy by the number of readings
Tangent        a line above an objective
choose         candidates chosen by a criterion
compound       a weighted mean of criteria
relax          optimal weights of candidates, with their bound
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.design.candidates import Candidates, Nuisances
    from oed.design.catalogue import CRITERIA
    from oed.design.design_problem import DesignProblem
    from oed.design.evaluator import PlanEvaluator
    from oed.design.exchange import Choice, choose
    from oed.design.forms import Criterion, compound
    from oed.design.how_many import SizeCurve
    from oed.design.objective import Objective, Tangent
    from oed.design.quotas import QuotaSet
    from oed.design.relaxation import relax
    from oed.design.rules import Rules
else:
    # imported when first used: a report needs the criteria alone
    __getattr__ = door(__name__)
