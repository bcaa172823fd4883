"""The result of an identification: parameters, covariance, residuals, noise, warnings."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from oed import text, units
from oed.base import Array
from oed.fit_limits import FAR_TOLERANCES, GUESS_RATIO, chi2_is_large

if TYPE_CHECKING:
    from oed.estimation.coordinates import IdentifiableCoordinates
    from oed.estimation.discrepancy import SampledEffects
    from oed.estimation.law_stage import LawCheck
    from oed.measurement import Measurement
    from oed.noise import Noise
    from oed.noise_law import NoisePosterior

#: distance from a bound, standard deviations, within which an estimate is near it
BOUND_MARGIN = 2.0
MAX_NAMED = 6  #: parameters that a warning names, the widest first


@dataclasses.dataclass(frozen=True)
class FitStage:
    """One stage of an identification."""

    patterns: tuple[str, ...]  #: of the names of the parameters that it frees
    iterations: int  #: evaluations of the model
    rms_before: float  #: root mean square of the whitened residuals where it starts
    rms_after: float  #: the same where it ends


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Identified parameters.

    theta             (n,) maximum a posteriori, SI
    covariance        (n, n) posterior (Laplace), SI; directions that no reading
                      determines keep their prior variance
    prior_sd          (n,) tolerances of the last stage, SI
    coordinates       identifiable coordinates of the last stage
    z                 (r,) the solution in them
    residuals         (N,) y - f(theta), SI
    residuals_before  (N,) the same at the start
    noise             noise used, SI; of the most probable law where it was estimated
    dof               readings less effectively determined directions
    chi2              sum of squared `residuals` whitened by the stated noise. With
                      effects, of what they leave at their mean
    stages            the stages of the fit
    warnings          sentences that a user must read
    noise_posterior   of the noise law; None where the noise is as stated
    robust_readings   (N,) readings, SI, with those far off replaced; None likewise
    effects           draws of effects that the model lacks; None where none were allowed
    law_check         whether the estimated law, without a course through the session,
                      explains the readings as noise; None where its course does, or where
                      the noise is as stated, or effects are allowed. Where it does not,
                      the estimate is that of the stated weights, `widened`, without a
                      noise posterior

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.estimation import identify
    >>> from oed.measurement import draw_parameters, draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> rng = np.random.default_rng(1)
    >>> truth = draw_parameters(measurement, rng)
    >>> y = draw_readings(measurement, [series], truth, rng)
    >>> estimate = identify(measurement, [series], y)
    >>> estimate.theta.shape, estimate.covariance.shape
    ((13,), (13, 13))
    >>> bool(estimate.chi2 / estimate.dof < 2.0)
    True
    """

    WEAK: ClassVar = 0.3  #: shrinkage above which a parameter is weakly identified
    AT_PRIOR: ClassVar = 0.7  #: shrinkage above which it stays at its prior

    theta: Array
    covariance: Array
    prior_sd: Array
    coordinates: IdentifiableCoordinates
    z: Array
    residuals: Array
    residuals_before: Array
    noise: Noise
    dof: float
    chi2: float
    stages: tuple[FitStage, ...]
    warnings: tuple[str, ...]
    noise_posterior: NoisePosterior | None = None
    robust_readings: Array | None = None
    effects: SampledEffects | None = None
    law_check: LawCheck | None = None

    @property
    def sd(self) -> Array:
        """Posterior standard deviations (n,), SI."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def contradicted(self) -> LawCheck | None:
        """The check of the noise law, where the readings contradict it."""
        check = self.law_check
        return check if check is not None and check.is_contradicted else None

    @property
    def scatter(self) -> float:
        """Scatter of readings over the stated noise, where the noise law is rejected."""
        if self.contradicted is None:
            return 1.0
        return float(np.sqrt(max(self.chi2 / max(self.dof, 1.0), 1.0)))

    @property
    def widening(self) -> float:
        """Factor on noise and tolerances in the intervals."""
        return 1.0 if self.contradicted is None else self.contradicted.widening

    def widened(self, factor: float) -> Estimate:
        """The same values, with noise and tolerances a factor as large.

        Both alike, so that doubt of the noise moves no value. Directions that no reading
        determines keep their tolerance: no residual tells of them.
        """
        null = self.coordinates.null_basis
        lost = null @ null.T
        return dataclasses.replace(
            self,
            covariance=factor**2 * (self.covariance - lost) + lost,
            coordinates=self.coordinates.widened(factor),
            z=self.z / factor,
            noise=self.noise.scaled(factor),
        )

    @property
    def shrinkage(self) -> Array:
        """Posterior over prior standard deviation (n,); 0 for held parameters.

        1 means that the readings carry no information. Where intervals are widened, with
        the tolerances, it is that of the fit before: lost directions were not widened.
        """
        lost = (self.coordinates.null_basis**2).sum(axis=1)
        variance = (self.sd**2 - lost) / self.widening**2 + lost
        sd = np.sqrt(np.maximum(variance, 0.0))
        free = self.prior_sd > 0
        ratio = np.zeros_like(self.sd)
        return np.asarray(np.divide(sd, self.prior_sd, out=ratio, where=free))


def add_warnings(
    measurement: Measurement,
    estimate: Estimate,
    *,
    is_judged: bool = False,
    explained_as_stated: bool = False,
) -> Estimate:
    """The estimate with sentences that a user must read; none where the fit is sound.

    is_judged            whether a check of the readings says how large the residuals are
    explained_as_stated  whether the stated noise explains them at other parameters
    """
    at_prior, weak = Estimate.AT_PRIOR, Estimate.WEAK
    listed = {
        "these stay near their tolerance, the readings hardly determine them": (
            _wide_parameters(measurement, estimate, at_prior, np.inf)
        ),
        "these are weakly identified, their posterior stays wide": (
            _wide_parameters(measurement, estimate, weak, at_prior)
        ),
        f"these ended more than {FAR_TOLERANCES:.0f} tolerances from where they began;"
        " widen [prior] or doubt the model": _far_parameters(measurement, estimate),
        "these lie near a bound of theirs, which estimate and sd ignore; draws of the"
        " posterior and predictions keep to it": (
            _bounded_parameters(measurement, estimate)
        ),
    }
    sentences = [
        f"{what}: {', '.join(names)}" for what, names in listed.items() if names
    ]
    sentences += contradicted_law(estimate)
    if not is_judged:
        sentences += large_residuals(estimate, explained_as_stated=explained_as_stated)
    return dataclasses.replace(estimate, warnings=tuple(sentences))


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
            f"neighbouring readings share an error of {check.correlated:.1f} times the stated"
            " noise, which is more than a stated noise can be wrong by"
        )
    return [
        f"{reason}: the model may lack an effect; `oed diagnose` looks for it. The readings"
        " have their stated weights, as in least squares, and all standard deviations are"
        f" those of noise and tolerances {check.widening:.1f} times the stated ones"
    ]


def large_residuals(
    estimate: Estimate, *, explained_as_stated: bool = False
) -> list[str]:
    """A sentence on residuals that the stated noise does not explain."""
    if not chi2_is_large(estimate.chi2, estimate.dof):
        return []
    ratio = np.sqrt(estimate.chi2 / estimate.dof)
    opening = f"the residuals are {ratio:.1f} times the stated noise"
    if explained_as_stated:
        return [
            f"{opening} at these parameters; at others, less likely by the estimated noise"
            " law, that noise explains them: poses read again tell noise from geometry"
        ]
    if ratio > GUESS_RATIO:
        return [
            f"{opening}: an effect of this size is not in the model, or the readings have a mistake"
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
    """Parameters of a shrinkage between two, but those of an earlier posterior."""
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
    far = np.flatnonzero(free & (deviation > FAR_TOLERANCES * estimate.prior_sd))
    return [measurement.names[k] for k in far]


def _bounded_parameters(measurement: Measurement, estimate: Estimate) -> list[str]:
    """Parameters whose bound is within two standard deviations, or was passed."""
    margin = BOUND_MARGIN * estimate.sd
    bounds = measurement.bounds
    near = (estimate.theta - margin < bounds[:, 0]) | (
        estimate.theta + margin > bounds[:, 1]
    )
    return [measurement.names[k] for k in measurement.bounded if near[k]]
