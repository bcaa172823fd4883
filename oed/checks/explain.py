"""Which mistake explains readings that do not fit: the posterior over all of them.

Every usual mistake is undone, for the file, for each set-up, each run and the first or
last rows (`oed.checks.mistakes`). All are screened in the linear model
(`oed.checks.screening`); the likeliest are fitted. A mistake is named by its posterior
probability against the others and against none: noise of another law, or an effect that
is not in the model (`oed.checks.evidence`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.checks.candidates import HOPELESS, MISTAKEN, candidates
from oed.checks.fit import Fit
from oed.checks.mistakes import Alternatives, Given
from oed.checks.screening import Screening
from oed.checks.session import SessionReadings
from oed.checks.undone import Undone, as_given, undone

#: readings of which at most the mistakes are compared
MOST_READINGS = 1000
#: log odds against no mistake from which one is named: forms of noise and effects are
#: known so well; share of the best one's probability from which another is named as well
LOG_ODDS, SHARE = 10.0, 0.007
#: misfit over the noise that may remain where a mistake explains readings
EXPLAINED = 3.0
#: kinds that may explain what a specific mistake explains as well, and misfit that is
#: noise: a specific mistake that leaves no more ends the search
GENERAL = ("contradiction", "change", "disorder", "size", "run")
SETTLED = 1.5


@dataclasses.dataclass(frozen=True)
class Explanation:
    """A mistake that explains the readings.

    kind         of mistake
    what         the mistake as a sentence, without a full stop
    before       misfit over the stated noise, of the readings as given
    after        the same with the mistake undone; NaN where no readings are left
    log_odds     against no mistake
    probability  among all mistakes and none
    """

    kind: str
    what: str
    before: float
    after: float
    log_odds: float = np.inf
    probability: float = 1.0


def explain(
    session: SessionReadings,
    solution: Fit | None,
    alternatives: Alternatives,
    *,
    thorough: bool = True,
) -> list[Explanation]:
    """Mistakes that explain the readings of a session, likeliest first.

    solution  fit of the readings as given; None where they cannot be fitted
    thorough  whether mistakes are fitted that the linear model does not favour; not
              needed where a noise law explains the readings
    """
    measurement = alternatives.measurement
    given = Given(dataclasses.replace(_sample(session), measurement=measurement))
    before = np.inf if solution is None else solution.ratio
    screening = Screening(given)
    nothing = as_given(given, screening.as_given().scale)
    chosen = candidates(given, screening, thorough=thorough)
    fitted: list[Undone] = []
    for some in (chosen.first, chosen.then):
        fitted += [one for c in some if (one := undone(given, c)) is not None]
        if any(_settles(one, nothing) for one in fitted):
            break
    return _explanations(_distinct(fitted), nothing, before)


def _settles(one: Undone, nothing: Undone | None) -> bool:
    """Whether a specific mistake leaves the noise alone."""
    odds = np.inf if nothing is None else one.log_posterior - nothing.log_posterior
    is_specific = one.kind not in GENERAL and one.ratio <= SETTLED
    return bool(is_specific and odds >= HOPELESS)


def _distinct(fitted: Sequence[Undone]) -> list[Undone]:
    """Mistakes of different words, likeliest first."""
    best: dict[str, Undone] = {}
    for one in sorted(fitted, key=lambda one: -one.log_posterior):
        best.setdefault(one.what, one)
    return list(best.values())


def _explanations(
    ranked: Sequence[Undone], nothing: Undone | None, before: float
) -> list[Explanation]:
    """Mistakes that are as likely as must be and explain, of those from the likeliest on."""
    if not ranked:
        return []
    alone = np.log1p(-MISTAKEN) + nothing.log_posterior if nothing else -np.inf
    posterior = np.array([one.log_posterior for one in ranked])
    if posterior[0] < alone + LOG_ODDS:
        return []
    weights = special.softmax(np.append(posterior, alone))[:-1]
    explanations = [
        Explanation(
            kind=one.kind,
            what=one.what,
            before=before,
            after=one.ratio,
            log_odds=float(value - alone),
            probability=float(weight),
        )
        for one, value, weight in zip(ranked, posterior, weights, strict=True)
        if weight >= SHARE * weights[0]
    ]
    return explanations if _explains(explanations[0]) else []


def _explains(one: Explanation) -> bool:
    """Whether a mistake leaves no misfit, or less than half of it in orders of magnitude.

    What remains then is the noise, or an effect.
    """
    return bool(np.isnan(one.after) or one.after <= max(EXPLAINED, np.sqrt(one.before)))


def _sample(session: SessionReadings) -> SessionReadings:
    """Evenly spaced readings of a long session."""
    count = 1 + int(session.reading_of_value[-1])
    if count <= MOST_READINGS:
        return session
    return session.take(np.linspace(0, count - 1, MOST_READINGS).astype(np.intp))
