"""Fits each answer of a diagnosis: geometry, named effects, and what acts beside them."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from oed.compensate.effects.expected_columns import ExpectedColumns
from oed.compensate.effects.fit import (
    CorrectedEstimate,
    EffectReadings,
    estimate_with_effects,
)
from oed.compensate.effects.mixture import (
    DRAWS,
    AnswerMixture,
    AnswerPosterior,
    columns_of_forms,
    side_by_side,
)
from oed.estimation import identification
from oed.estimation.estimate import Estimate
from oed.estimation.identification import IdentificationError
from oed.gap.data.diagnosis import AnswerContent
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.model.effect import Effect
from oed.posterior import laplace
from oed.posterior.log_density import OutOfBoundsError
from oed.result.gap import AnswerRecord

#: probability from which an answer is fitted
LEAST_SHARE = 0.02
#: draws of each answer at least
LEAST_DRAWS = 300


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An answer, or what no reading shows of all answers.

    effects    as the diagnosis names them
    constants  {effect: its constants} of the effects of known form that act
    unseen     whether effects act that are too small to be seen
    unknown    whether something of no known form acts
    """

    effects: tuple[str, ...]
    constants: Mapping[str, Mapping[str, float]]
    unseen: bool
    unknown: bool
    probability: float


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
        """The posterior of an answer; none where it cannot be fitted."""
        try:
            if candidate.constants:
                posterior = self._named(candidate, without_effects)
            elif candidate.unseen or candidate.unknown:
                posterior = self._unnamed(candidate)
            else:
                posterior = self._geometry(candidate, without_effects)
        except (AssemblyError, IdentificationError, OutOfBoundsError):
            return
        if posterior is not None:
            yield posterior

    def _geometry(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> AnswerPosterior:
        """No gap: the geometry alone."""
        readings = self.readings
        return self._drawn(
            candidate, readings.measurement, readings.series, without_effects
        )

    def _unnamed(self, candidate: _Candidate) -> AnswerPosterior | None:
        """Small effects, or something of no known form, beside the geometry."""
        columns, readings = self._columns_beside(candidate), self.readings
        if columns is None:
            return None
        series = tuple(s.separate_poses() for s in readings.series)
        estimate = identification.identify(
            readings.measurement,
            series,
            readings.y,
            estimate_noise=True,
            discrepancy=columns.discrepancy,
            max_iterations=self.max_iterations,
            rng=self.rng,
        )
        return self._drawn(candidate, readings.measurement, series, estimate, columns)

    def _named(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> AnswerPosterior | None:
        """Named effects, and what acts beside them."""
        fitted = self._with_effects(candidate, without_effects)
        if fitted is None:
            return None
        columns = self._columns_beside(candidate)
        estimate = fitted.estimate
        if columns is not None:
            estimate = identification.identify(
                fitted.measurement,
                fitted.series,
                self.readings.y,
                estimate_noise=True,
                start=estimate.theta,
                discrepancy=columns.discrepancy,
                max_iterations=self.max_iterations,
                rng=self.rng,
            )
        parts = [columns_of_forms(fitted.forms)]
        if columns is not None:
            parts.append(columns)
        return self._drawn(
            candidate,
            fitted.measurement,
            fitted.series,
            estimate,
            side_by_side(parts),
            fitted.parameters,
        )

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
        if allowed is None or candidate.unseen:
            return allowed
        if not candidate.unknown:
            return None
        unknown = allowed.discrepancy.unknown[allowed.discrepancy.group]
        return allowed.take(unknown) if unknown.any() else None

    def _drawn(
        self,
        candidate: _Candidate,
        measurement: Measurement,
        series: Sequence[Series],
        estimate: Estimate,
        columns: ExpectedColumns | None = None,
        count: int | None = None,
    ) -> AnswerPosterior:
        """The posterior of a fit; the first `count` entries of theta are parameters."""
        draws = max(round(DRAWS * candidate.probability), LEAST_DRAWS)
        drawn = laplace.draw_approximation(
            measurement, series, self.readings.y, estimate, self.rng, draws
        )
        count = len(estimate.theta) if count is None else count
        coefficients = np.hstack([drawn.theta[:, count:], drawn.effects])
        return AnswerPosterior(
            effects=candidate.effects,
            unseen=candidate.unseen,
            probability=candidate.probability,
            mean=estimate.theta[:count],
            covariance=estimate.covariance[:count, :count],
            theta=drawn.theta[:, :count],
            columns=columns,
            coefficients=coefficients,
        )


def _candidates(
    answers: Sequence[AnswerRecord], contents: Sequence[AnswerContent]
) -> Iterator[_Candidate]:
    """The answers at sizes that show; all that no reading shows is one of its own."""
    for answer, content in zip(answers, contents, strict=True):
        if answer.visible > 0.0:
            yield _Candidate(
                answer.effects,
                content.constants,
                False,
                content.unknown,
                answer.visible,
            )
    yield _Candidate((), {}, True, False, sum(answer.unseen for answer in answers))


def with_constants(effect: Effect, constants: Mapping[str, float]) -> Effect:
    """The effect with these constants at one value each."""
    values = {name: (value,) for name, value in constants.items()}
    return dataclasses.replace(effect, constants={**effect.constants, **values})
