"""Noise laws that all hypotheses share, weighted so that sums over them integrate.

The noise law is not known before the gap is, and the evidence of a hypothesis is an
integral over laws u with the prior p(u) of `oed.noise.prior`:

    p(r | h) = integral p(r | h, u) p(u) du.

Laws are drawn from the posteriors p(u | r, a) of a few models a: no gap, any gap, the
gaps that look best. With Z_a = p(r | a), draws u_l, l = 1 ... L, as many of each model,
give (Veach and Guibas 1995, balance heuristic)

    p(r | h) = sum_l W_l p(r | h, u_l),    1 / W_l = (L / A) sum_a p(r | a, u_l) / Z_a.

It is exact for h = a alone, and the same laws serve every hypothesis. A common factor
on the noise is integrated over in closed form (`evidence`); the laws hold the rest.

In the evidence under one law, what single readings have and what is carried along whitens all readings, in linear
time. What a run shares and how large the channels' noise is change a few products
alone: laws that differ in no more have the whitening in common.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.gap.data import evidence
from oed.gap.data.problem import GapProblem
from oed.noise.law import NoiseLaw, law_of
from oed.noise.law_mode import find_mode, polish, root_about, signed
from oed.noise.prior import CARRIED, REACH, RUN, SEAT, SPARSE, NoisePrior
from oed.noise.proposal import split_student
from oed.noise.shared import SharedProducts, taken_out

#: points of a model's posterior, by which its evidence is computed
POINTS = 48
#: coordinates beyond which a law is not looked at, in prior sd: what a run shares is
#: below some hundred times the noise, and single readings keep some of it
FARTHEST = 4.5
#: laws that are drawn of each model
EACH = 4

#: a noise law, and the log of its weight
WeighedLaw = tuple[NoiseLaw, float]


@dataclasses.dataclass(frozen=True, eq=False)
class LawPosterior:
    """Posterior of the noise law with some columns in the model.

    columns       (N, k') compressed, the parameters' slopes among them
    mode          the most probable law
    draws         (EACH, d) coordinates of laws drawn from it
    log_evidence  of the readings, over all laws
    """

    columns: Array
    mode: NoiseLaw
    draws: Array
    log_evidence: float


def posterior(problem: GapProblem, columns: Array) -> LawPosterior:
    """The law's posterior with columns (N, k) of prior N(0, 1) in the model."""
    compressed = evidence.compress(problem, columns)
    prior, log_evidences = _prior(problem), LawEvidence(problem, compressed)

    def cost(u: Array) -> Array:
        values = log_evidences(_laws(problem, u))
        log_prior = -0.5 * (u**2).sum(axis=1) - 0.5 * u.shape[1] * np.log(2.0 * np.pi)
        return np.asarray(-values - log_prior)

    mode = np.zeros(prior.dimensions - 1)
    if len(mode):
        mode = find_mode(cost, prior.starts()[:, 1:], FARTHEST)
        mode = polish(cost, mode, FARTHEST)
    # where all but the common factor is stated, or the mode is in a corner, as where
    # rows are copies of others, one law is possible
    draws, log_evidence = np.tile(mode, (EACH, 1)), -float(cost(mode[None])[0])
    if len(mode):
        proposal = split_student(cost, mode, signed(root_about(cost, mode)))
        points = proposal.points(POINTS)
        points = points[np.abs(points).max(axis=1) < FARTHEST]
        if len(points):
            log_weights = -cost(points) - proposal.log_density(points)
            total = float(special.logsumexp(log_weights))
            draws = points[_systematic(points, np.exp(log_weights - total))]
            log_evidence = total - float(np.log(POINTS))
    law = _laws(problem, mode[None])[0]
    return LawPosterior(compressed, law, draws, log_evidence)


def mixture(
    problem: GapProblem, posteriors: Sequence[LawPosterior]
) -> list[WeighedLaw]:
    """Laws drawn from several posteriors, with the logs of their weights W."""
    laws = _laws(problem, np.vstack([p.draws for p in posteriors]))
    table = np.column_stack(
        [LawEvidence(problem, p.columns)(laws) - p.log_evidence for p in posteriors]
    )
    each = len(laws) / len(posteriors)
    log_weights = -special.logsumexp(table, axis=1) - np.log(each)
    return list(zip(laws, map(float, log_weights), strict=True))


def _systematic(points: Array, weights: Array) -> list[int]:
    """Numbers (EACH,) of points drawn by their weights, spread along the widest axis."""
    offsets = points - weights @ points
    _, vectors = np.linalg.eigh((offsets * weights[:, None]).T @ offsets)
    order = np.argsort(offsets @ signed(vectors)[:, -1])
    levels = (np.arange(EACH) + 0.5) / EACH
    places = np.searchsorted(np.cumsum(weights[order]), levels)
    return [int(k) for k in order[np.minimum(places, len(order) - 1)]]


def _prior(problem: GapProblem) -> NoisePrior:
    """The prior of the laws; its first scale, the common factor, is kept at 1.

    What is stated is in the stated errors, and no part of the laws.
    """
    groups = int(problem.channel.max()) + 1
    names = [f"noise of channel {k + 1}" for k in range(groups)]
    if problem.statement.carried is None:
        names += [CARRIED, REACH]
    if problem.level is None or problem.level.any():
        names.append(RUN)
    if problem.seat.any():
        names.append(SEAT)
    return NoisePrior(tuple(names), groups, SPARSE, problem.statement)


def _laws(problem: GapProblem, u: Array) -> list[NoiseLaw]:
    """Laws at coordinates (L, d), all but the first scale's."""
    laws = _prior(problem).laws(np.column_stack([np.zeros(len(u)), u]))
    return [law_of(laws, k, problem.channel) for k in range(len(u))]


# -- evidence under many laws ----------------------------------------------------------


@dataclasses.dataclass(frozen=True, eq=False)
class _Products:
    """Products of residual and columns, whitened by all but what segments share.

    log_det   log determinant of that covariance
    channels  (C, m, m) of the readings of each channel
    inner     (S, K, K) of the errors that each segment shares
    cross     (S, K, m) of these with residual and columns
    """

    log_det: float
    channels: Array
    inner: Array
    cross: Array


class LawEvidence:
    """Log evidence, with columns in the model, as a function of the noise law."""

    def __init__(self, problem: GapProblem, columns: Array) -> None:
        """Prepare columns (N, k), the parameters' slopes among them."""
        self._problem, self._columns, layout = problem, columns, problem.layout
        values = np.column_stack([problem.residual, columns])
        self._values = values[layout.order]
        self._channel = problem.channel[layout.order]
        self._channels = np.unique(self._channel)
        #: whether each segment has one channel, so that its scale is a factor
        self._apart = problem.stated is None or len(self._channels) == 1

    def __call__(self, laws: Sequence[NoiseLaw]) -> Array:
        """Log evidences (L,) under laws of level 1, which is integrated over.

        Single readings of a law all have the same variance, 1 less what is carried.
        """
        if not self._apart:
            every = [
                evidence.log_evidence(self._problem, law, self._columns) for law in laws
            ]
            return np.array(every)
        products: dict[tuple[float, float], _Products] = {}
        values = []
        for law in laws:
            key = law.ar1_sd, law.ar1_length
            if key not in products:
                products[key] = self._whitened(law)
            values.append(self._log_evidence(law, products[key]))
        return np.array(values)

    def _whitened(self, law: NoiseLaw) -> _Products:
        unit = dataclasses.replace(law, channel_ratio=None)
        errors = unit.errors(self._problem, self._problem.layout)
        banded = errors.banded()
        white = banded.whiten(errors.unmixed(self._values))
        common = law.shared(self._problem, errors.order)
        columns = banded.whiten(errors.unmixed(common))
        shared = SharedProducts(columns, errors.starts)
        log_det = banded.log_det
        if errors.unmix is not None:
            log_det -= 2.0 * float(np.log(errors.unmix.diagonal()).sum())
        parts = [white]
        if len(self._channels) > 1:
            parts = [white[self._channel == g] for g in self._channels]
        return _Products(
            log_det=log_det,
            channels=np.array([part.T @ part for part in parts]),
            inner=shared.inner,
            cross=shared.of_segments(white),
        )

    def _log_evidence(self, law: NoiseLaw, products: _Products) -> float:
        scale = np.ones(len(self._channel))
        if law.channel_ratio is not None:
            scale = law.channel_ratio[self._problem.layout.order]
        starts = self._problem.layout.starts
        _, first = np.unique(self._channel, return_index=True)
        sizes = law.shared_sizes(self._problem, self._problem.layout.order)
        cross = products.cross / scale[starts, None, None]
        removed, log_shared = taken_out(products.inner, cross, sizes)
        weights = 1.0 / scale[first] ** 2
        whole = np.tensordot(weights, products.channels, axes=1) - removed
        of_scales = 2.0 * float(np.log(scale).sum())
        log_det = products.log_det + float(log_shared) + of_scales
        return evidence.log_evidence_of_products(whole, log_det, len(scale))
