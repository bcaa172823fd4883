"""Where a gap lies: scans over leg x run x time x phase x direction, corrected for how
many places are looked at.

Each look is a basis B (N, k) of what a fault in one place could do to the readings: a
change of one leg as a function of its travel, sense, force, time, another's motion, or
with a period along it; an offset or a wave in one run; a shift of the reading, of the
legs or of the tool along its axis in a window of the session; a bump in a window of the
phase. Its statistic is the energy of the residual that the basis explains once the
parameters have absorbed what they can,

    T = r^T M B (B^T M B)^-1 B^T M r,    M = (Sigma + H Lambda H^T)^-1,

a chi-square of rank(B) degrees of freedom where there is no gap: looks with different
numbers of columns are compared by their p-values. These are corrected for the whole
family by a parametric bootstrap of the least p-value (Westfall and Young 1993, single
step), r* ~ N(0, Sigma + H Lambda H^T), in which M refits the parameters each time;
beyond the bootstrap's resolution by Bonferroni's bound. Where effects that are known to
act have their legs is a question of its own, and its looks a family of their own. A gap
shows in several places at once; the least p-value tells which confines it best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.arrays import Array, Index, Mask
from oed.gap.data.diagnosis import Block
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.tail import log_tail
from oed.gap.place import regions as looking
from oed.gap.place import warm_up as warmed
from oed.noise.law import NoiseLaw

#: share of a direction's energy that must survive the calibration, or be its own, for
#: it to count as a column
SURVIVES = 1e-4
#: log p-value that a window of the session may be worse by than another and go first,
#: if it lasts to the end
LASTING = 2.0
#: blocks of a kind that are told, beyond the first only those with p-values below
TOLD, LIKELY = 4, 0.05
#: share of what heat explains below which a stretch of it is not told
PART = 0.03


def where(
    problem: GapProblem,
    law: NoiseLaw,
    rng: np.random.Generator,
    *,
    columns: Array | None = None,
    labels: Sequence[str] | None = None,
    known: bool = False,
    draws: int = 500,
) -> tuple[Block, ...]:
    """Blocks in which the gap lies, those that confine it best first.

    columns, labels  (N, k) of what was selected, in units of the stated noise, and the
                     blocks (`leg 1`, "") that they belong to: those of a leg are one
                     more look at it, few are looked for in each run. That they were
                     chosen is not in the correction: `legs_of` tells whether a leg
                     carries them
    known            whether these effects are all there is: legs are then told by the
                     effects' own columns alone, if all of them belong to a leg or a
                     set-up
    draws            of the bootstrap

    Told are all legs (and `all legs` where the same change in each confines the gap
    better than any one leg) and, of runs, times, phases and directions, the best and up
    to three more that do not overlap with it and have p < 0.05. `strength` is the
    block's share of the energy that the residual has beyond what the noise accounts
    for; it means something where p is small. Where not all of what acts is known and a
    tool that is warmed for a while explains more than what shifts for a while, the
    times told are those in which it was warmed. The law is taken as known, its level
    too. Raises ValueError for columns that do not fit.
    """
    looks = list(looking.looks(problem, columns, labels, known))
    root = _Root(problem, law)
    scan = _Scan(root, looks)
    scores = root.scores(problem.residual)
    energy = scan.energy(scores[:, None])[:, 0]
    own = log_tail(energy, scan.rank)
    corrected = _corrected(
        own,
        scan,
        rng.standard_normal((len(problem), draws)),
        np.array([k.own for k in looks]),
    )
    beyond = np.maximum(energy - scan.rank, 0.0)
    total = max(float(scores @ scores) - len(problem), float(beyond.max()), 1e-300)
    found = [
        _Candidate(look, float(score), float(p), float(e / total))
        for look, score, p, e in zip(looks, own, corrected, beyond, strict=True)
    ]
    sharp = [_sharp(problem, root, scores, f) for f in _told(found)]
    return tuple(
        f.block for f in (sharp if known else _heated(problem, root, scores, sharp))
    )


def least(
    problem: GapProblem, law: NoiseLaw, rng: np.random.Generator, *, draws: int = 500
) -> float:
    """The least p-value of all places, corrected for how many are looked at. Of
    readings without a gap it is uniform; larger where the law was told from the same
    readings.
    """
    root = _Root(problem, law)
    scan = _Scan(root, list(looking.looks(problem)))
    own = log_tail(scan.energy(root.scores(problem.residual)[:, None])[:, 0], scan.rank)
    drawn = rng.standard_normal((len(problem), draws))
    return float(_corrected(own, scan, drawn, np.zeros(len(own), dtype=bool)).min())


def legs_of(
    labels: Sequence[str], mean: Array, covariance: Array, *, scale: float | Array = 1.0
) -> tuple[Block, ...]:
    """Which blocks (`leg 1`) carry an effect with coefficients of their own, the
    clearest first.

    labels      (k,) block of each coefficient; those without ("") are left out, but
                taken into account
    mean, covariance   (k,), (k, k) posterior of the coefficients, whose prior is N(0,
                       scale^2), scale one or (k,)

    A block's posterior is N(m, V), its prior N(0, S): W = (V^-1 - S^-1)^-1 is the
    variance of the estimate b = W V^-1 m that the readings give with the other
    coefficients under their prior, and b^T W^-1 b a chi-square of as many degrees of
    freedom as the block has columns where it carries nothing. p-values are corrected by
    Holm's rule (1979). `strength` is the block's share of the signatures' energies m^T
    G^T M G m. Raises ValueError for shapes that differ.
    """
    prior = np.broadcast_to(np.asarray(scale, dtype=float), mean.shape)
    if covariance.shape != (len(mean), len(mean)) or len(labels) != len(mean):
        raise ValueError(
            f"{len(labels)} labels, mean {mean.shape} and covariance {covariance.shape}"
            " do not fit"
        )
    m, V = mean / prior, covariance / np.outer(prior, prior)
    gained = np.linalg.inv(V) - np.eye(len(m))
    names = [n for n in dict.fromkeys(labels) if n]
    own, energy = [], []
    for name in names:
        at = [k for k, label in enumerate(labels) if label == name]
        inverse = np.linalg.inv(V[np.ix_(at, at)])
        values, vectors = np.linalg.eigh(inverse - np.eye(len(at)))
        known = values > 1e-9 * np.abs(values).max(initial=1.0)
        told = (vectors.T @ (inverse @ m[at]))[known]
        own.append(
            float(log_tail(np.array(told**2 / values[known]).sum(), float(known.sum())))
        )
        energy.append(max(float(m[at] @ gained[np.ix_(at, at)] @ m[at]), 0.0))
    total, running, found = max(sum(energy), 1e-300), 0.0, []
    for rank, k in enumerate(np.argsort(own, kind="stable")):
        running = max(
            running, float(np.exp(min(own[k] + np.log(len(names) - rank), 0.0)))
        )
        found.append(Block(names[k], running, energy[k] / total))
    return tuple(found)


# -- statistics ------------------------------------------------------------------------


class _Root:
    """M^1/2 for vectors, whose products are the inner products of the metric: M = W^T
    (1 - U D U^T) W.
    """

    def __init__(self, problem: GapProblem, law: NoiseLaw) -> None:
        self._metric = Metric(problem, law)
        self._axes, size, _ = np.linalg.svd(
            self._metric.whiten(problem.slopes), full_matrices=False
        )
        self._shrink = 1.0 - 1.0 / np.hypot(1.0, size)

    def scores(self, values: Array) -> Array:
        """Values (N,) or (N, k): N(0, I) where they are readings without a gap."""
        return self.both(values)[1]

    def both(self, values: Array) -> tuple[Array, Array]:
        """Values whitened by the noise alone, and by what the parameters may do as
        well.
        """
        white = self._metric.whiten(values)
        return white, white - (self._axes * self._shrink) @ (self._axes.T @ white)


class _Scan:
    """All looks made orthonormal in the metric, those with as many columns together."""

    def __init__(self, root: _Root, looks: Sequence[looking.Look]) -> None:
        self._parts: list[
            tuple[Index, Array]
        ] = []  # numbers of the looks (g,); directions (g, k, N)
        self.rank = np.zeros(len(looks))
        widths = np.array([look.basis.shape[1] for look in looks])
        for width in np.unique(widths):
            at = np.asarray(np.flatnonzero(widths == width), dtype=np.intp)
            white, whole = root.both(np.hstack([looks[int(k)].basis for k in at]))
            size = np.linalg.norm(white, axis=0)
            whole = whole / np.where(size > 0.0, size, 1.0)
            stack = whole.T.reshape(len(at), width, -1)
            values, vectors = np.linalg.eigh(stack @ stack.transpose(0, 2, 1))
            kept = values > SURVIVES
            factor = np.where(kept, 1.0 / np.sqrt(np.where(kept, values, 1.0)), 0.0)
            self._parts.append(
                (at, (vectors * factor[:, None, :]).transpose(0, 2, 1) @ stack)
            )
            self.rank[at] = kept.sum(axis=1)

    def energy(self, scores: Array) -> Array:
        """Energy (looks, m) of scores (N, m) that each look explains."""
        energy = np.empty((len(self.rank), scores.shape[1]))
        for at, directions in self._parts:
            wide = directions.reshape(-1, directions.shape[-1]) @ scores
            energy[at] = (
                np.square(wide).reshape(len(at), -1, scores.shape[1]).sum(axis=1)
            )
        return energy

    def least(self, energy: Array, some: Mask) -> Array:
        """Logarithm (m,) of the least p-value of some looks (looks,) that explain
        energies (looks, m).
        """
        ranks = np.unique(self.rank[some])
        most = np.array(
            [energy[some & (self.rank == rank)].max(axis=0) for rank in ranks]
        )
        return np.asarray(log_tail(most, ranks[:, None]).min(axis=0))


def _corrected(own: Array, scan: _Scan, scores: Array, apart: Mask) -> Array:
    """p-values (looks,) corrected for all looks of a family, from the logarithms of
    their own and the bootstrap's scores (N, draws): where a known effect acts (`apart`)
    is one family, the others are another.
    """
    energy, found = scan.energy(scores), np.empty(len(own))
    for some in (apart, ~apart):
        if some.any():
            found[some] = _against(own[some], scan.least(energy, some))
    return found


def _against(own: Array, least: Array) -> Array:
    """p-values (looks,) of one family, from the logarithms of their own and of the
    bootstrap's least (draws,).
    """
    seen = (1.0 + np.searchsorted(np.sort(least), own, side="right")) / (
        len(least) + 1.0
    )
    with np.errstate(under="ignore"):
        return np.asarray(
            np.minimum(seen, np.exp(np.minimum(own + np.log(len(own)), 0.0)))
        )


# -- what is told ----------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True)
class _Candidate:
    """A look with the log of its own p-value, the corrected p-value and its share of
    the energy.
    """

    look: looking.Look
    own: float
    p: float
    strength: float

    @property
    def block(self) -> Block:
        return Block(self.look.place, self.p, min(self.strength, 1.0))


def _told(found: Sequence[_Candidate]) -> list[_Candidate]:
    """The best look of each place; of overlapping places the best, shifts that last to
    the end before nearly equals.
    """
    end = max((max(f.look.cells) for f in found if f.look.kind == "time"), default=0)

    def badness(f: _Candidate) -> float:
        return f.own - (
            LASTING if f.look.kind == "time" and end in f.look.cells else 0.0
        )

    ranked = sorted(found, key=badness)
    kept: list[_Candidate] = []
    for f in ranked:
        same = [k for k in kept if k.look.kind == f.look.kind]
        if f.look.kind in ("leg", "set-up"):
            new = f.look.place not in [k.look.place for k in same] and (
                f.look.place != looking.ALL or not same
            )
        else:
            apart = not any(k.look.cells & f.look.cells for k in same)
            new = apart and (not same or (len(same) < TOLD and f.p < LIKELY))
        if new:
            kept.append(f)
    return sorted(kept, key=lambda f: f.own)


def _sharp(
    problem: GapProblem, root: _Root, scores: Array, found: _Candidate
) -> _Candidate:
    """A likely window of the session with its ends moved, by up to a cell, to where it
    explains most.
    """
    look = found.look
    if look.kind != "time" or look.form == looking.SELECTED or found.p >= LIKELY:
        return found
    clock = looking.clock_of(problem)
    starts, clock = looking.starts_of(problem), np.unique(clock[np.isfinite(clock)])
    bounds = np.append(starts, np.inf)
    a, b = min(look.cells), max(look.cells) + 1

    def best(windows: Sequence[tuple[float, float]]) -> tuple[float, float]:
        tried = [
            w
            for at in windows
            for w in looking.window(problem, *at, look.cells)
            if w.form == look.form
        ]
        return windows[int(np.argmax(_Scan(root, tried).energy(scores[:, None])[:, 0]))]

    last = float(clock[clock < bounds[b]].max())
    first, last = best(
        [
            (float(t), last)
            for t in clock[clock > bounds[a - 1]]
            if t < bounds[a + 1] and t <= last
        ]
    )
    if b < len(starts):
        ends = clock[(clock >= max(first, bounds[b - 1])) & (clock < bounds[b + 1])]
        first, last = best([(first, float(t)) for t in ends])
    moved = next(
        w
        for w in looking.window(problem, first, last, look.cells)
        if w.form == look.form
    )
    return dataclasses.replace(found, look=moved)


def _heated(
    problem: GapProblem, root: _Root, scores: Array, told: Sequence[_Candidate]
) -> list[_Candidate]:
    """With the stretches in which the tool was warmed, if they explain more, in place
    of windows of the session.
    """
    times = [f for f in told if f.look.kind == "time"]
    if not times or times[0].p >= LIKELY:
        return list(told)
    first = times[0]
    clock = looking.clock_of(problem)
    plain = float(_Scan(root, [first.look]).energy(scores[:, None])[0, 0])
    found = warmed.stretches(problem, root.scores, plain)
    if not found:
        return list(told)
    whole = sum(s.energy for s in found)
    places = [
        dataclasses.replace(
            first,
            look=dataclasses.replace(
                first.look, place=looking.span(clock, s.first, s.last)
            ),
            strength=first.strength * s.energy / whole,
        )
        for s in found[:TOLD]
        if s.energy > PART * whole
    ]
    return sorted(
        [*places, *(f for f in told if f.look.kind != "time")], key=lambda f: f.own
    )
