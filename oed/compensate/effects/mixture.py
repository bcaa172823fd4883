"""Parameters after a diagnosis: the mixture over its answers.

With P_a the probability of answer a (no gap, effects too small to be seen, each set of
effects, something of no known form) and p(theta, b | a) the posterior of parameters and
coefficients if it is right, what is known of the machine is

    p(theta, b) = sum_a P_a p(theta, b | a).

Its mean is that of the answers' means m_a, its covariance what they leave within and
between them, sum_a P_a [C_a + (m_a - m)(m_a - m)^T] (Hoeting, Madigan, Raftery and
Volinsky 1999, Stat. Sci. 14, 382-401). Each answer's posterior is that of the one fitter.
In a draw of one answer the effects of all others are 0.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.compensate.effects.effect_maps import ActingForm
from oed.compensate.effects.expected_columns import ExpectedColumns
from oed.compensate.effects.fit import (
    CorrectedEstimate,
    EffectReadings,
    estimate_with_effects,
)
from oed.compensate.effects.forms import ChosenForm
from oed.estimation import identification
from oed.estimation.discrepancy import Discrepancy
from oed.estimation.estimate import Estimate
from oed.estimation.identification import IdentificationError
from oed.gap.data.diagnosis import AnswerForm
from oed.measurement.measurement import Measurement, Series
from oed.mechanism.kinematics import AssemblyError
from oed.model.effect import Effect
from oed.posterior import laplace
from oed.posterior.log_density import OutOfBoundsError
from oed.result.gap import AnswerRecord

#: probability from which an answer is fitted
LEAST_SHARE = 0.02
#: draws of each answer's posterior, and of the mixture
DRAWS = 2000


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerPosterior:
    """What is known of the machine if one answer of a diagnosis is right.

    effects       names of the effects of known form
    unseen        whether effects act that are too small to be seen
    unknown       whether something of no known form acts
    probability   of the answer, by the diagnosis
    mean          (n,) parameters, SI
    covariance    (n, n) of the parameters
    theta         (m, n) draws of the parameters, SI
    columns       of what acts beside the parameters; None where nothing does
    coefficients  (m, k) draws of what acts, one for each draw of the parameters
    """

    effects: tuple[str, ...]
    unseen: bool
    unknown: bool
    probability: float
    mean: Array
    covariance: Array
    theta: Array
    columns: ExpectedColumns | None = None
    coefficients: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerMixture:
    """What is known of the machine after a diagnosis.

    answers   those that were fitted, the decision's first
    rest      probability of all others
    """

    answers: tuple[AnswerPosterior, ...]
    rest: float

    @functools.cached_property
    def shares(self) -> Array:
        """Probabilities (a,) of the answers among those that were fitted."""
        probabilities = np.array([a.probability for a in self.answers])
        return np.asarray(probabilities / probabilities.sum())

    @functools.cached_property
    def mean(self) -> Array:
        """Mean parameters (n,), SI."""
        return np.asarray(self.shares @ np.array([a.mean for a in self.answers]))

    @property
    def covariance(self) -> Array:
        """Covariance (n, n) of the parameters, within and between the answers."""
        total = np.zeros((len(self.mean), len(self.mean)))
        for share, answer in zip(self.shares, self.answers, strict=True):
            offset = answer.mean - self.mean
            total += share * (answer.covariance + np.outer(offset, offset))
        return total

    def quantiles(self, levels: Sequence[float]) -> Array:
        """Quantiles (levels, n) of each parameter, by the draws in their shares."""
        theta = np.vstack([a.theta for a in self.answers])
        weights = np.concatenate(
            [
                np.full(len(a.theta), share / len(a.theta))
                for share, a in zip(self.shares, self.answers, strict=True)
            ]
        )
        order = np.argsort(theta, axis=0, kind="stable")
        values = np.take_along_axis(theta, order, axis=0)
        reached = np.cumsum(weights[order], axis=0) - 0.5 * weights[order]
        columns = range(theta.shape[1])
        return np.column_stack(
            [np.interp(levels, reached[:, k], values[:, k]) for k in columns]
        )

    def draw(self, rng: np.random.Generator, count: int = DRAWS) -> MixtureDraws:
        """Draws of the machine: answers in their shares, each with its effects."""
        edges = np.round(np.concatenate([[0.0], np.cumsum(self.shares)]) * count)
        counts = np.diff(edges).astype(int)
        taken = [
            rng.permutation(np.arange(max(n, len(a.theta))) % len(a.theta))[:n]
            for a, n in zip(self.answers, counts, strict=True)
        ]
        theta = [a.theta[rows] for a, rows in zip(self.answers, taken, strict=True)]
        acting = [
            (k, a.columns) for k, a in enumerate(self.answers) if a.columns is not None
        ]
        widths = [columns.mixing.shape[1] for _, columns in acting]
        ends = np.concatenate([[0], np.cumsum(widths)]).astype(int)
        coefficients = np.zeros((count, ends[-1]))
        starts = np.concatenate([[0], np.cumsum(counts)])
        for number, (k, _) in enumerate(acting):
            rows = slice(starts[k], starts[k + 1])
            block = slice(ends[number], ends[number + 1])
            coefficients[rows, block] = self.answers[k].coefficients[taken[k]]
        return MixtureDraws(
            np.vstack(theta),
            np.repeat(np.arange(len(self.answers)), counts),
            side_by_side([columns for _, columns in acting]),
            coefficients,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class MixtureDraws:
    """Draws of the machine after a diagnosis.

    theta         (m, n) parameters, SI
    answer        (m,) number of the answer that each belongs to
    columns       of all effects of all answers; None where nothing acts in any
    coefficients  (m, k) of them
    """

    theta: Array
    answer: Index
    columns: ExpectedColumns | None
    coefficients: Array


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An answer, or what two answers share.

    constants  {effect: its constants} of the effects of known form
    """

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
        forms: Sequence[AnswerForm],
        without_effects: Estimate,
    ) -> AnswerMixture:
        """The mixture over the answers that are probable enough.

        forms            of the answers, as in a Diagnosis
        without_effects  the fit of the geometry alone, with no gap

        An answer that no fit follows is left out; without any, the geometry alone stays.
        """
        fitted = [
            posterior
            for candidate in _candidates(answers, forms)
            if candidate.probability >= LEAST_SHARE
            for posterior in self._posteriors(candidate, without_effects)
        ]
        if not fitted:
            nothing = _Candidate({}, False, False, 1.0)
            fitted = [self._geometry(nothing, without_effects)]
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
        named = columns_of_forms(fitted.forms)
        beside = [named] if columns is None else [named, columns]
        return self._drawn(
            candidate,
            fitted.measurement,
            fitted.series,
            estimate,
            side_by_side(beside),
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
        drawn = laplace.draw_approximation(
            measurement, series, self.readings.y, estimate, self.rng, DRAWS
        )
        count = len(estimate.theta) if count is None else count
        coefficients = np.hstack([drawn.theta[:, count:], drawn.effects])
        return AnswerPosterior(
            effects=tuple(candidate.constants),
            unseen=candidate.unseen,
            unknown=candidate.unknown,
            probability=candidate.probability,
            mean=estimate.theta[:count],
            covariance=estimate.covariance[:count, :count],
            theta=drawn.theta[:, :count],
            columns=columns,
            coefficients=coefficients,
        )


def _candidates(
    answers: Sequence[AnswerRecord], forms: Sequence[AnswerForm]
) -> Iterator[_Candidate]:
    """The answers at sizes that show; all that no reading shows is one of its own."""
    for answer, form in zip(answers, forms, strict=True):
        if answer.visible > 0.0:
            yield _Candidate(form.constants, False, form.unknown, answer.visible)
    yield _Candidate({}, True, False, sum(answer.unseen for answer in answers))


def with_constants(effect: Effect, constants: Mapping[str, float]) -> Effect:
    """The effect with its constants at one value each."""
    values = {name: (value,) for name, value in constants.items()}
    return dataclasses.replace(effect, constants=values)


def columns_of_forms(forms: Sequence[ChosenForm]) -> ExpectedColumns:
    """Effects in the forms of a fit, one column a coefficient."""
    acting = tuple(
        ActingForm(form.effect, form.constants, form.signature.names) for form in forms
    )
    columns = np.hstack([form.signature.columns for form in forms])
    names = [
        f"{form.effect.name}: {name}" for form in forms for name in form.signature.names
    ]
    count = len(names)
    discrepancy = Discrepancy(
        columns=columns,
        group=np.arange(count, dtype=np.intp),
        names=tuple(names),
        unknown=np.zeros(count, dtype=bool),
    )
    return ExpectedColumns(discrepancy, acting, np.eye(count))


def side_by_side(parts: Sequence[ExpectedColumns]) -> ExpectedColumns | None:
    """The columns of several, one after the other; None of none."""
    if len(parts) < 2:
        return parts[0] if parts else None
    names: list[str] = []
    forms: list[ActingForm] = []
    groups: list[Index] = []
    for part in parts:
        groups.append(part.discrepancy.group + len(names))
        names += part.discrepancy.names
        forms += part.forms
    discrepancy = Discrepancy(
        columns=np.hstack([part.discrepancy.columns for part in parts]),
        group=np.concatenate(groups),
        names=tuple(names),
        unknown=np.concatenate([part.discrepancy.unknown for part in parts]),
    )
    mixing = linalg.block_diag(*[part.mixing for part in parts])
    return ExpectedColumns(discrepancy, tuple(forms), mixing)
