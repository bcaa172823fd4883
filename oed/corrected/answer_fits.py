"""Fits each answer of a diagnosis, and mixes them: geometry, named effects, what acts beside.

With P_a the probability of answer a (no gap, each set of effects, these beside small
effects, something of no known form) and p(theta, b | a) the posterior of parameters and
coefficients if it is right, what is known of the machine is

    p(theta, b) = sum_a P_a p(theta, b | a).

Its mean is that of the answers' means m_a, its covariance what they leave within and
between them, sum_a P_a [C_a + (m_a - m)(m_a - m)^T] (Hoeting, Madigan, Raftery and
Volinsky 1999, Stat. Sci. 14, 382-401). Each answer's posterior is that of the one fitter.
In a draw of one answer the effects of all others are 0.
"""

import contextlib
import dataclasses
import functools
from collections.abc import Callable, Iterator, Mapping, Sequence

import numpy as np
from scipy import linalg, special

from oed import posterior
from oed.base import Array, Index
from oed.corrected.estimate import CorrectedEstimate
from oed.corrected.fit import EffectReadings
from oed.effect_model import Effect
from oed.effects import ExpectedColumns
from oed.estimation import Discrepancy, Estimate, IdentificationError, identify
from oed.gap import UNSEEN_SHARE, AnswerContent
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.posterior import OutOfBoundsError
from oed.result import AnswerRecord

N_DRAWS = 2000  #: draws of the mixture: each answer has as many as its share of them


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerPosterior:
    """What is known of the machine if one answer of a diagnosis is right."""

    effects: tuple[str, ...]  #: as the diagnosis names them; none: no gap
    unseen: bool  #: whether small effects of one common size act as well
    probability: float  #: of the answer, by the diagnosis
    mean: Array  #: (n,) parameters, SI
    covariance: Array  #: (n, n) of the parameters
    theta: Array  #: (m, n) draws of the parameters, SI
    #: the fit; its theta has coefficients of named effects after the parameters
    estimate: Estimate
    #: (m, d) draws of the law's coordinates, one for each of the parameters
    noise_law: Array
    #: of what acts beside the parameters; None where nothing does
    columns: ExpectedColumns | None = None
    #: (m, k) draws of what acts, one for each draw of the parameters
    coefficients: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerMixture:
    """What is known of the machine after a diagnosis."""

    #: those that were fitted, the decision's first
    answers: tuple[AnswerPosterior, ...]
    rest: float  #: probability of all others

    @functools.cached_property
    def shares(self) -> Array:
        """Probabilities (a,) of the answers among those that were fitted."""
        probabilities = np.array([a.probability for a in self.answers])
        return np.asarray(probabilities / probabilities.sum())

    @functools.cached_property
    def mean(self) -> Array:
        """Mean parameters (n,), SI."""
        return np.asarray(self.shares @ np.array([a.mean for a in self.answers]))

    @functools.cached_property
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

    def rows(self, rng: np.random.Generator, count: int = N_DRAWS) -> list[Index]:
        """Numbers of draws of each answer: `count` in all, in the answers' shares."""
        edges = np.round(np.concatenate([[0.0], np.cumsum(self.shares)]) * count)
        counts = np.diff(edges).astype(int)
        return [
            rng.permutation(np.arange(max(n, len(a.theta))) % len(a.theta))[:n]
            for a, n in zip(self.answers, counts, strict=True)
        ]

    def draw(self, rng: np.random.Generator, count: int = N_DRAWS) -> "MixtureDraws":
        """Draws of the machine: answers in their shares, each with its effects."""
        taken = self.rows(rng, count)
        pairs = list(zip(self.answers, taken, strict=True))
        acting = [a.columns for a in self.answers if a.columns is not None]
        # in a draw of one answer the effects of all others are 0
        coefficients = linalg.block_diag(
            *(
                np.zeros((len(rows), 0)) if a.columns is None else a.coefficients[rows]
                for a, rows in pairs
            )
        )
        return MixtureDraws(
            np.vstack([a.theta[rows] for a, rows in pairs]),
            np.repeat(np.arange(len(taken)), [len(rows) for rows in taken]),
            ExpectedColumns.side_by_side(acting),
            coefficients,
        )


@dataclasses.dataclass(frozen=True, eq=False)
class MixtureDraws:
    """Draws of the machine after a diagnosis."""

    theta: Array  #: (m, n) parameters, SI
    answer: Index  #: (m,) number of the answer that each belongs to
    #: of all effects of all answers; None where nothing acts in any
    columns: ExpectedColumns | None
    coefficients: Array  #: (m, k) of them


MIN_PROBABILITY = 0.02  #: probability from which an answer is fitted
MIN_DRAWS = 300  #: draws of each answer at least
#: probability from which an answer is fitted with small effects as well
MIN_SPLIT_PROBABILITY = 0.1


@dataclasses.dataclass(frozen=True)
class _Candidate:
    """An answer, with what no reading shows."""

    effects: tuple[str, ...]  #: as the diagnosis names them
    #: {effect: its constants} of the effects of known form that act
    constants: Mapping[str, Mapping[str, float]]
    unknown: bool  #: whether something of no known form acts
    probability: float


@dataclasses.dataclass(frozen=True, eq=False)
class _AnswerFit:
    """A fit of an answer: geometry, effects of known form, and what acts beside them."""

    measurement: Measurement
    series: Sequence[Series]
    estimate: Estimate
    parameters: int  #: number of leading entries of theta that are no coefficients
    #: of the effects whose coefficients follow, and of those drawn beside
    columns: ExpectedColumns | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerFits:
    """How the answers of a diagnosis are fitted."""

    readings: EffectReadings  #: what is fitted
    effects: Sequence[Effect]  #: that the diagnosis knows
    #: what effects of known and of no known form do at their expected sizes; None where
    #: no effect changes a reading
    allowed: ExpectedColumns | None
    estimate_noise: bool  #: whether the noise law is estimated
    rng: np.random.Generator  #: for the draws
    max_iterations: int = 100
    #: the fit with the effects of the decision, where there is one
    corrected: CorrectedEstimate | None = None

    def fit(
        self,
        answers: Sequence[AnswerRecord],
        contents: Sequence[AnswerContent],
        without_effects: Estimate,
    ) -> AnswerMixture | None:
        """The mixture over the `contents` that are probable enough and have a fit; None
        without any. `without_effects` is the fit of the geometry alone.
        """
        fitted = [
            posterior
            for candidate in _candidates(answers, contents)
            if candidate.probability >= MIN_PROBABILITY
            for posterior in self._posteriors(candidate, without_effects)
        ]
        if not fitted:
            return None
        rest = 1.0 - sum(posterior.probability for posterior in fitted)
        return AnswerMixture(tuple(fitted), max(rest, 0.0))

    def _posteriors(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> Iterator[AnswerPosterior]:
        """Posteriors of an answer without and with small effects, by their evidence."""
        fit = _fitted(lambda: self._known_form(candidate, without_effects))
        if fit is None:
            return
        with_others = _fitted(lambda: self._with_others(candidate, fit))
        share = 0.0
        if with_others is not None:
            share = _share_beside(candidate, with_others.estimate)
        parts = ((1.0 - share, fit, False), (share, with_others, not candidate.unknown))
        for part, which, unseen in parts:
            probability = part * candidate.probability
            if which is not None and probability >= MIN_PROBABILITY:
                named = dataclasses.replace(candidate, probability=probability)
                with contextlib.suppress(AssemblyError, OutOfBoundsError):
                    yield self._drawn(named, which, unseen)

    def _known_form(
        self, candidate: _Candidate, without_effects: Estimate
    ) -> _AnswerFit | None:
        """Geometry and named effects; those of the decision are fitted."""
        readings, known = self.readings, candidate.constants
        if not known:
            count = len(without_effects.theta)
            return _AnswerFit(
                readings.measurement, readings.series, without_effects, count
            )
        fitted = self.corrected
        forms = () if fitted is None else fitted.forms
        if {form.effect.name: dict(form.constants) for form in forms} != known:
            by_name = {effect.name: effect for effect in self.effects}
            fitted = readings.estimate(
                [by_name[name].with_constants(known[name]) for name in known],
                without_effects.theta,
                estimate_noise=self.estimate_noise,
                max_iterations=self.max_iterations,
            )
        if fitted is None:
            return None
        of = fitted.measurement, fitted.series, fitted.estimate, fitted.parameters
        return _AnswerFit(*of, fitted.columns)

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

    def _columns_beside(self, candidate: _Candidate) -> ExpectedColumns | None:
        """Columns of what acts beside the geometry and the named effects."""
        allowed = self.allowed
        is_minor = (
            candidate.probability < MIN_SPLIT_PROBABILITY and not candidate.unknown
        )
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
        draws = max(round(N_DRAWS * candidate.probability), MIN_DRAWS)
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
    log_odds = special.logit(UNSEEN_SHARE) + estimate.effects.log_evidence
    return float(special.expit(log_odds))
