"""Warnings on a fit, in sentences: weak parameters, far estimates, large residuals."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping

import numpy as np

from oed import text, units
from oed.estimation.estimate import Estimate
from oed.measurement import Measurement
from oed.trust import FAR, GUESS, chi2_is_large

#: distance from a bound, standard deviations, within which an estimate is near it
BOUND_MARGIN = 2.0
#: parameters that a warning names, the widest first
MAX_NAMED = 6


def with_warnings(measurement: Measurement, estimate: Estimate) -> Estimate:
    """The estimate with its sentences."""
    sentences = warnings(measurement, estimate)
    return dataclasses.replace(estimate, warnings=tuple(sentences))


def warnings(measurement: Measurement, estimate: Estimate) -> list[str]:
    """Sentences that a user must read; none where the fit is sound."""
    sentences = []
    unchanged = _wide_parameters(measurement, estimate, Estimate.AT_PRIOR, np.inf)
    if unchanged:
        sentences.append(
            "these stay near their tolerance, the readings hardly determine them: "
            + ", ".join(unchanged)
        )
    weak = _wide_parameters(measurement, estimate, Estimate.WEAK, Estimate.AT_PRIOR)
    if weak:
        sentences.append(
            "these are weakly identified, their posterior stays wide: "
            + ", ".join(weak)
        )
    far = _far_parameters(measurement, estimate)
    if far:
        sentences.append(
            f"these ended more than {FAR:.0f} tolerances from where they began; widen"
            f" [prior] or doubt the model: {', '.join(far)}"
        )
    near = _near_bounds(measurement, estimate)
    if near:
        sentences.append(
            "these lie near a bound of theirs, which estimate and sd ignore; draws of the"
            f" posterior and predictions keep to it: {', '.join(near)}"
        )
    return [*sentences, *contradicted_law(estimate), *large_residuals(estimate)]


def contradicted_law(estimate: Estimate) -> list[str]:
    """A sentence on an error that readings share and that is no noise."""
    check = estimate.contradicted
    if check is None:
        return []
    reason = (
        "what single channels and neighbouring readings have in common moves the"
        f" parameters {np.sqrt(check.ratio):.1f} times as far as noise would (probability"
        f" {check.probability:.2g})"
    )
    if not check.is_noise:
        reason = (
            f"neighbouring readings share an error of {check.carried:.1f} times the stated"
            " noise, which is more than a stated noise can be wrong by"
        )
    return [
        f"{reason}: the model may lack an effect; `oed diagnose` looks for it. The readings"
        " have their stated weights, as in least squares, and all standard deviations are"
        f" those of noise and tolerances {check.widening:.1f} times the stated ones"
    ]


def large_residuals(estimate: Estimate) -> list[str]:
    """A sentence on residuals that the stated noise does not explain."""
    if not chi2_is_large(estimate.chi2, estimate.dof):
        return []
    ratio = np.sqrt(estimate.chi2 / estimate.dof)
    opening = f"the residuals are {ratio:.1f} times the stated noise"
    if ratio > GUESS:
        return [
            f"{opening}: an effect of this size is not in the model, or the readings have"
            " a mistake"
        ]
    remedy = (
        "repeat readings on the spot: what scatters there is noise, and [noise] estimate ="
        " true allows for it"
    )
    if estimate.noise_posterior is not None or estimate.law_check is not None:
        remedy = "the intervals are as wide as the residuals ask for"
    return [
        f"{opening}: noise is understated, or an effect is not in the model; {remedy}"
    ]


def _wide_parameters(
    measurement: Measurement, estimate: Estimate, above: float, below: float
) -> list[str]:
    """Parameters whose shrinkage lies between the two, with their posterior.

    Those whose prior is the posterior of an earlier session are well known, whatever
    the readings add.
    """
    phrases = {}
    rows = zip(measurement.parameters, estimate.sd, estimate.shrinkage, strict=True)
    for parameter, sd, shrinkage in rows:
        if above < shrinkage <= below and parameter.expected is None:
            unit = units.display(parameter.unit)
            suffix = "" if unit == "1" else f" {unit}"
            value = f"{units.number(sd, unit):.2g}{suffix}"
            share = text.percent(shrinkage)
            phrase = f"{parameter.name} (sd {value}, {share} of its tolerance)"
            phrases[phrase] = float(shrinkage)
    return _widest(phrases)


def _widest(phrases: Mapping[str, float]) -> list[str]:
    """The phrases as they stand; of many, those of the largest values, and their number."""
    if len(phrases) <= MAX_NAMED + 1:
        return list(phrases)
    widest = sorted(phrases, key=lambda phrase: -phrases[phrase])[:MAX_NAMED]
    more = len(phrases) - len(widest)
    return [*widest, f"and {more} more, which the table of parameters marks"]


def _far_parameters(measurement: Measurement, estimate: Estimate) -> list[str]:
    deviation = np.abs(estimate.theta - estimate.coordinates.origin)
    free = estimate.prior_sd > 0
    far = np.flatnonzero(free & (deviation > FAR * estimate.prior_sd))
    return [measurement.names[k] for k in far]


def _near_bounds(measurement: Measurement, estimate: Estimate) -> list[str]:
    """Parameters whose bound is within two standard deviations, or was passed."""
    margin = BOUND_MARGIN * estimate.sd
    bounds = measurement.bounds
    near = (estimate.theta - margin < bounds[:, 0]) | (
        estimate.theta + margin > bounds[:, 1]
    )
    return [measurement.names[k] for k in measurement.bounded if near[k]]
