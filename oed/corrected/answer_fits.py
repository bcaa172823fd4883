"""Fits each answer of a diagnosis: geometry, named effects, and what acts beside them."""

from __future__ import annotations

import contextlib
import dataclasses
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from scipy import special

from oed import posterior
from oed.corrected.fit import CorrectedEstimate, EffectReadings, estimate_with_effects
from oed.corrected.mixture import (
    DRAWS,
    AnswerMixture,
    AnswerPosterior,
)
from oed.effects import ExpectedColumns
from oed.estimation import (
    Discrepancy,
    Estimate,
    IdentificationError,
    identify,
)
from oed.gap.cause.hypothesis import PRIOR
from oed.gap.data.diagnosis import AnswerContent
from oed.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.model.effect import Effect
from oed.posterior import OutOfBoundsError
from oed.result import AnswerRecord

#: probability from which an answer is fitted
LEAST_SHARE = 0.02
#: draws of each answer at least
LEAST_DRAWS = 300
#: probability from which an answer is fitted with small effects as well
LEAST_SPLIT = 0.1
#: prior probability that small effects act, where nothing shows them
SMALL_SHARE = PRIOR["unseen"] / (PRIOR["unseen"] + PRIOR["none"])


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An answer, with what no reading shows.

    effects    as the diagnosis names them
    constants  {effect: its constants} of the effects of known form that act
    unknown    whether something of no known form acts
    """

    effects: tuple[str, ...]
    constants: Mapping[str, Mapping[str, float]]
    unknown: bool
    probability: float


@dataclasses.dataclass(frozen=True, eq=False)
class _AnswerFit:
    """A fit of an answer: geometry, effects of known form, and what acts beside them.

    parameters  number of leading entries of theta that are no coefficients
    columns     of the effects whose coefficients follow, and of those drawn beside
    """

    measurement: Measurement
    series: Sequence[Series]
    estimate: Estimate
    parameters: int
    columns: ExpectedColumns | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerFits:
    """How the answers of a diagnosis are fitted.

    readings        what is fitted
    effects         that the diagnosis knows
    allowed         what effects of known and of no known form do at their expected sizes;
                    None where no effect changes a reading
    estimate_noise  whether the noise law is estimated
    rng             for the draws
    corrected       the fit with the effects of the decision, where there is one
    """

    readings: EffectReadings
    effects: Sequence[Effect]
    allowed: ExpectedColumns | None
    estimate_noise: bool
    rng: np.random.Generator
    max_iterations: int = 100
    corrected: CorrectedEstimate | None = None

    def fit(
        self,
        answers: Sequence[AnswerRecord],
        contents: Sequence[AnswerContent],
        without_effects: Estimate,
    ) -> AnswerMixture | None:
        """The mixture over the answers that are probable enough; None without any.

        contents         of the answers, as in a Diagnosis
        without_effects  the fit of the geometry alone, with no gap

        An answer that no fit follows is left out.
        """
        fitted = [
            posterior
            for candidate in _candidates(answers, contents)
            if candidate.probability >= LEAST_SHARE
            for posterior in self._posteriors(candidate, without_effects)
        ]
        if not fitted:
            return None
        rest = 1.0 - sum(posterior.probability for posterior in fitted)
        return AnswerMixture(tuple(fitted), max(rest, 0.0))

    def _posteriors(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> Iterator[AnswerPosterior]:
        """The posterior of an answer without and with small effects; none without a fit.

        Their evidence decides between the two.
        """
        fit = _fitted(lambda: self._known_form(candidate, without_effects))
        if fit is None:
            return
        with_others = _fitted(lambda: self._with_others(candidate, fit))
        share = 0.0
        if with_others is not None:
            share = _share_beside(candidate, with_others.estimate)
        parts = (
            (1.0 - share, fit, False),
            (share, with_others, not candidate.unknown),
        )
        for part, which, unseen in parts:
            probability = part * candidate.probability
            if which is not None and probability >= LEAST_SHARE:
                named = dataclasses.replace(candidate, probability=probability)
                with contextlib.suppress(AssemblyError, OutOfBoundsError):
                    yield self._drawn(named, which, unseen)

    def _known_form(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> _AnswerFit | None:
        """Geometry and named effects."""
        readings = self.readings
        if not candidate.constants:
            count = len(without_effects.theta)
            return _AnswerFit(
                readings.measurement, readings.series, without_effects, count
            )
        fitted = self._with_effects(candidate, without_effects)
        if fitted is None:
            return None
        return _AnswerFit(
            fitted.measurement,
            fitted.series,
            fitted.estimate,
            fitted.parameters,
            fitted.columns,
        )

    def _with_others(self, candidate: _Candidate, fit: _AnswerFit) -> _AnswerFit | None:
        """The same with what acts beside; None where nothing can."""
        columns = self._columns_beside(candidate)
        if columns is None:
            return None
        series = fit.series
        if fit.columns is None:  # with named effects they are apart
            series = tuple(s.separate_poses() for s in series)
        estimate = identify(
            fit.measurement,
            series,
            self.readings.y,
            estimate_noise=True,
            start=fit.estimate.theta,
            near=fit.estimate,
            discrepancy=columns.discrepancy,
            max_iterations=self.max_iterations,
            rng=self.rng,
        )
        every = (
            columns
            if fit.columns is None
            else ExpectedColumns.side_by_side([fit.columns, columns])
        )
        return dataclasses.replace(fit, series=series, estimate=estimate, columns=every)

    def _with_effects(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> CorrectedEstimate | None:
        """The fit with an answer's effects; that of the decision is known."""
        known = self.corrected
        if known is not None:
            forms = {form.effect.name: dict(form.constants) for form in known.forms}
            if forms == candidate.constants:
                return known
        by_name = {effect.name: effect for effect in self.effects}
        acting = [
            with_constants(by_name[name], constants)
            for name, constants in candidate.constants.items()
        ]
        return estimate_with_effects(
            self.readings,
            acting,
            without_effects.theta,
            estimate_noise=self.estimate_noise,
            max_iterations=self.max_iterations,
        )

    def _columns_beside(self, candidate: _Candidate) -> ExpectedColumns | None:
        """Columns of what acts beside the geometry and the named effects."""
        allowed = self.allowed
        is_minor = candidate.probability < LEAST_SPLIT and not candidate.unknown
        if allowed is None or is_minor:
            return None
        group = allowed.discrepancy.group
        if candidate.unknown:
            chosen = allowed.discrepancy.unknown[group]
            sizes = Discrepancy.LARGE
        else:
            owners = [name.split(":")[0] for name in allowed.discrepancy.names]
            chosen = ~np.isin(owners, list(candidate.constants))[group]
            sizes = Discrepancy.SMALL
        return allowed.take(chosen).of_sizes(sizes) if chosen.any() else None

    def _drawn(
        self, candidate: _Candidate, fit: _AnswerFit, unseen: bool
    ) -> AnswerPosterior:
        """The posterior of a fit."""
        estimate, count = fit.estimate, fit.parameters
        draws = max(round(DRAWS * candidate.probability), LEAST_DRAWS)
        drawn = posterior.draw_approximation(
            fit.measurement, fit.series, self.readings.y, estimate, self.rng, draws
        )
        return AnswerPosterior(
            effects=candidate.effects,
            unseen=unseen,
            probability=candidate.probability,
            mean=estimate.theta[:count],
            covariance=estimate.covariance[:count, :count],
            theta=drawn.theta[:, :count],
            estimate=estimate,
            noise_law=drawn.noise_law,
            columns=fit.columns,
            coefficients=np.hstack([drawn.theta[:, count:], drawn.effects]),
        )


def _candidates(
    answers: Sequence[AnswerRecord], contents: Sequence[AnswerContent]
) -> Iterator[_Candidate]:
    """The answers at sizes that show; all that no reading shows is with no gap."""
    unseen = sum(answer.unseen for answer in answers)
    for answer, content in zip(answers, contents, strict=True):
        if answer.visible > 0.0:
            probability = answer.visible
            if not answer.effects:
                probability, unseen = probability + unseen, 0.0
            yield _Candidate(
                answer.effects, content.constants, content.unknown, probability
            )
    yield _Candidate((), {}, False, unseen)


def _fitted(fit: Callable[[], _AnswerFit | None]) -> _AnswerFit | None:
    """What a fit gives; None where it fails."""
    try:
        return fit()
    except (AssemblyError, IdentificationError, OutOfBoundsError):
        return None


def _share_beside(candidate: _Candidate, estimate: Estimate) -> float:
    """Probability of a fit with what else acts, against the one without."""
    if candidate.unknown or estimate.effects is None:
        return 1.0
    log_odds = special.logit(SMALL_SHARE) + estimate.effects.log_evidence
    return float(special.expit(log_odds))


def with_constants(effect: Effect, constants: Mapping[str, float]) -> Effect:
    """The effect with these constants at one value each."""
    values = {name: (value,) for name, value in constants.items()}
    return dataclasses.replace(effect, constants={**effect.constants, **values})
