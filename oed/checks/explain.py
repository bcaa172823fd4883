"""Which mistake explains readings that do not fit: each is undone, and fitted again.

Compared is the penalised sum of squares, which correct readings have near their number.
A variant explains the readings where it brings this ratio down to what noise allows,
and far below that of the readings as given.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.checks.change import find_change
from oed.checks.fit import Fit, fit, linear_model
from oed.checks.mistakes import (
    Alternatives,
    Variant,
    VariantOfAmount,
    variants,
    variants_of_amount,
)
from oed.checks.outliers import find_outliers
from oed.checks.session import SessionReadings

#: readings of which at most the variants are compared
MOST_READINGS = 240
#: largest ratio of residuals to stated noise of readings that are explained
EXPLAINED = 2.5
#: least gain of the log likelihood
GAIN = 20.0
#: the same for a change, which has twice the parameters: least factor of the ratio
IMPROVEMENT = 2.0
#: log likelihood by which explanations may differ that are equally likely
EQUAL = 5.0
#: log likelihood that a value costs which a variant leaves out
DROPPED = 5.0
#: variants that are fitted, the likeliest in the linear model first
FITTED = 6
#: share of the misfit that an amount may leave, linear at the fit as given
PROMISING = 0.7
#: steps of an amount, and relative change at which it has settled
STEPS, SETTLED = 12, 1e-4
#: amounts are wrong only from so many of their standard deviations
SIGNIFICANT = 6.0


#: mistakes that an effect of the machine can mimic: a diagnosis tells them apart
PHYSICAL = ("offset", "run", "tool", "change")


@dataclasses.dataclass(frozen=True)
class Explanation:
    """A mistake that explains the readings.

    kind    of mistake
    what    the mistake as a sentence, without a full stop
    before  residual over the stated noise, of the readings as given
    after   the same with the mistake undone
    cost    negative log likelihood with the mistake undone, up to a constant
    penalty  part of it for rescaled readings and for those left out
    """

    kind: str
    what: str
    before: float
    after: float
    cost: float
    penalty: float = 0.0


def explain(
    session: SessionReadings, solution: Fit | None, alternatives: Alternatives
) -> list[Explanation]:
    """Mistakes that explain the readings of a session, equally well, best first.

    `solution` is the fit of the readings as given; None where they cannot be fitted.
    Discrete mistakes come before those of an unknown amount, and a change between parts
    of the session comes last: they have more freedom.
    """
    before, some = np.inf if solution is None else solution.ratio, _sample(session)
    for candidates in (_discrete, _of_amount, _change):
        explained = candidates(some, alternatives, before)
        best = sorted(explained, key=lambda one: one.cost)
        # penalties are of the sample, and so must be what is gained
        best = [one for one in best if _explains(one, before, len(some))]
        if best:
            return [one for one in best if one.cost <= best[0].cost + EQUAL]
    return []


def _explains(one: Explanation, before: float, values: int) -> bool:
    """Whether the misfit falls to the noise, by far more than chance lowers it.

    Compared are log likelihoods at the noise level that suits each best, the stated one
    at least: readings of larger noise are no mistake.
    """
    if one.after > EXPLAINED or one.after >= before:
        return False
    if one.kind == "change" and one.after * IMPROVEMENT > before:
        return False
    gain = values * float(np.log(before) - np.log(max(one.after, 1.0)))
    return gain - one.penalty >= GAIN


def _discrete(
    session: SessionReadings, alternatives: Alternatives, before: float
) -> list[Explanation]:
    """Explanations by variants without an unknown amount: the likeliest are fitted."""
    screened = _screened(session, alternatives)[:FITTED]
    explanations = []
    for variant in screened:
        solution = fit(variant.session)
        if solution is None:
            continue
        if solution.ratio > EXPLAINED:
            solution = _without_outliers(variant.session, solution)
        dropped = len(session) - len(solution.session)
        penalty = DROPPED * dropped - variant.log_scale
        cost = 0.5 * solution.penalised + penalty
        explanation = Explanation(
            variant.kind, variant.what, before, solution.ratio, cost, penalty
        )
        explanations.append(explanation)
    return explanations


def _screened(session: SessionReadings, alternatives: Alternatives) -> list[Variant]:
    """Variants of distinct readings, by their cost in the linear model."""
    model = linear_model(session)
    costs: list[tuple[float, Variant]] = []
    for variant in variants(session, alternatives):
        varied = variant.session
        of_poses = model
        if varied.series is not session.series:
            of_poses = linear_model(varied)
        if of_poses is None:
            continue
        dropped = len(session) - len(varied)
        cost = 0.5 * of_poses.penalised(varied.y) - variant.log_scale
        cost += DROPPED * dropped
        if not any(abs(cost - other) <= 1e-9 * abs(other) for other, _ in costs):
            costs.append((cost, variant))
    costs.sort(key=lambda one: one[0])
    return [variant for _, variant in costs]


def _sample(session: SessionReadings) -> SessionReadings:
    """Evenly spaced readings of a long session."""
    count = 1 + int(session.reading_of_value[-1])
    if count <= MOST_READINGS:
        return session
    return session.take(np.linspace(0, count - 1, MOST_READINGS).astype(np.intp))


def _without_outliers(session: SessionReadings, solution: Fit) -> Fit:
    """The fit without outliers, where there are few; the fit as it is otherwise."""
    result = find_outliers(session, np.empty(0, dtype=np.intp))
    if result is None or result.exhausted:
        return solution
    return result.rest


# -- unknown amounts -------------------------------------------------------------------


def _of_amount(
    session: SessionReadings, alternatives: Alternatives, before: float
) -> list[Explanation]:
    """Explanations by variants whose amount is estimated with the parameters."""
    explanations = []
    solution = fit(session)
    if solution is None:
        return []
    for variant in variants_of_amount(session):
        if not _promising(variant, solution):
            continue
        estimated = fit_amount(variant)
        if estimated is None:
            continue
        amount, sd, fitted = estimated
        if abs(amount) < SIGNIFICANT * sd:
            continue
        what = variant.what(amount, sd)
        cost = 0.5 * fitted.penalised
        explanation = Explanation(variant.kind, what, before, fitted.ratio, cost)
        explanations.append(explanation)
    return explanations


def _promising(variant: VariantOfAmount, solution: Fit) -> bool:
    """Whether the best amount, linear at the fit as given, reduces the misfit."""
    slope, precision = _amount_slope(variant, 0.0, solution)
    if precision <= 0.0:
        return False
    remaining = solution.penalised - slope**2 / precision
    return remaining <= PROMISING * solution.penalised


def fit_amount(variant: VariantOfAmount) -> tuple[float, float, Fit] | None:
    """Amount and standard deviation, SI, with the fit at it; None where none is found.

    Gauss-Newton on the amount, with the parameters eliminated at each step.
    """
    amount, start = 0.0, None
    for _ in range(STEPS):
        session = variant.shift(amount)
        solution = fit(session, start)
        if solution is None:
            return None
        start = solution.theta
        slope, precision = _amount_slope(variant, amount, solution)
        if precision <= 0.0:
            return None
        step = -slope / precision
        sd = precision**-0.5
        if abs(step) <= max(SETTLED * abs(amount), 0.02 * sd):
            return amount, sd, solution
        amount += step
    return None


def _amount_slope(
    variant: VariantOfAmount, amount: float, solution: Fit
) -> tuple[float, float]:
    """Half slope and curvature of the penalised sum of squares over the amount."""
    here, there = solution.session, variant.shift(amount + variant.step)
    differences = [
        one.y - one.measurement.readings(one.series, solution.theta)
        for one in (there, here)
    ]
    change = differences[0] - differences[1]
    slope = solution.noise.whiten(change) / variant.step
    half = solution.half_covariance()
    shared = half.T @ (solution.slopes.T @ slope)
    r = solution.linear_residual()
    common = half.T @ (solution.slopes.T @ r)
    return float(slope @ r - shared @ common), float(slope @ slope - shared @ shared)


# -- a change --------------------------------------------------------------------------


def _change(
    session: SessionReadings, alternatives: Alternatives, before: float
) -> list[Explanation]:
    """The explanation by two parts that fit alone, and not together."""
    change = find_change(session)
    if change is None:
        return []
    what = (
        f"the readings up to row {change.last_row} and those from row"
        f" {change.first_row} fit alone but not together: another machine, or something"
        " moved between them"
    )
    return [Explanation("change", what, before, change.ratio, 0.0)]
