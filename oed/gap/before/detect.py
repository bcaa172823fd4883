"""What planned readings could find, before any is taken: detectability of each effect,
and from which rivals.

With the metric M = (Sigma + H Lambda H^T)^-1, in which what calibration absorbs no
longer counts, and G_k the columns of effect k per prior standard deviation of each
coefficient,

    lambda_k = beta^T A_kk beta,                                       A_kl = G_k^T M G_l    (detectability)
    lambda_k|j = beta^T [A_kk - A_kj (A_jj + P)^-1 A_jk] beta          (distinguishability from the rival j).

A test with k columns finds lambda with the power of the noncentral chi-square. A
rival's textbook coefficients are as good as free (`ROOM` prior standard deviations), so
that size alone tells no effects apart; its columns that adapt the form keep their
prior; its constants take the most absorbing of their values. Source: Box and Hill 1967,
Atkinson and Fedorov 1975 (T-optimality); Bjorck and Golub 1973 (principal angles).
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg, optimize, sparse, stats
from scipy.sparse import csgraph

from oed.arrays import Array, Index, Mask
from oed.effect import Effect
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable
from oed.noise.law import NoiseLaw

#: false alarm and power that "is found" stands for
FALSE_ALARM, POWER = 0.01, 0.90
#: sqrt(lambda_k|j) below which the two cannot be told apart
APART = 5.0
#: share of lambda_k that a rival must take to count as one
HALF = 0.5
#: prior standard deviations that a rival's textbook coefficients may go to
ROOM = 100.0
#: principal angle, deg, below which a combination of one effect is a combination of the
#: other to these readings
SAME = 1.0
#: draws from an effect's prior for its median least size
DRAWS = 400


@functools.cache
def needed(
    columns: int, false_alarm: float = FALSE_ALARM, power: float = POWER
) -> float:
    """Least lambda that a test with `columns` degrees of freedom finds with that power:
    14.9 for 1, 28.6 for 12.
    """
    level = stats.chi2.isf(false_alarm, columns)
    root = optimize.brentq(
        lambda x: stats.ncx2.sf(level, columns, x) - power, 1e-6, 1e4
    )
    return float(root)


def ideal_power(
    lam: float, columns: int, alternatives: int = 1, false_alarm: float = FALSE_ALARM
) -> float:
    """Chance that a gap of `lam` is found where the best of `alternatives` tests is
    taken at a joint false alarm.
    """
    single = -np.expm1(np.log1p(-false_alarm) / alternatives)
    return float(stats.ncx2.sf(stats.chi2.isf(single, columns), columns, lam))


# -- results ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True, slots=True)
class SharedSignature:
    """A combination of an effect's coefficients that a rival imitates.

    combination  {coefficient: share}, in prior standard deviations, the largest 1;
                 words the same in words
    seen, apart  sqrt(lambda_k) and sqrt(lambda_k|j) at one prior standard deviation
                 along it
    angle        principal angle, deg
    """

    combination: Mapping[str, float]
    words: str
    seen: float
    apart: float
    angle: float


@dataclasses.dataclass(frozen=True, slots=True)
class EffectRival:
    """How well an effect can be told from another.

    apart   sqrt(lambda_k|j) expected over the effect's prior, the rival at its most
            absorbing constants
    angle   smallest principal angle, deg, of the textbook columns over directions that
            can be seen
    shared  combinations that can be seen, but not told from the rival, or that are the
            same whatever their size
    """

    name: str
    apart: float
    angle: float
    shared: tuple[SharedSignature, ...] = ()


@dataclasses.dataclass(frozen=True, slots=True, kw_only=True)
class Detectability:
    """What the readings can find of one effect; figures are means over the grid of its
    constants unless told.

    columns        coefficients that change some reading
    detectability  sqrt(lambda_k) at the prior sizes (expected: the root of the trace);
                   low, high over the constants
    power          chance of finding it at that size, for one test with all its columns
    signature      {channel: root mean square of its readings at the prior sizes, SI},
                   before calibration
    absorbed       share of that signature (in units of the noise) which calibration
                   absorbs
    least, median  {channel: smallest RMS, SI, that is found, in the most visible form;
                   the median over the prior}
    sizes          {coefficient: its least size when it acts alone, in its own unit},
                   inf where it cannot be seen
    rivals         ascending by `apart`
    not_testable   why nothing can be said; None where it can be tested
    """

    effect: str
    columns: int = 0
    detectability: float = 0.0
    low: float = 0.0
    high: float = 0.0
    power: float = FALSE_ALARM
    signature: Mapping[str, float] = dataclasses.field(default_factory=dict)
    absorbed: float = 0.0
    least: Mapping[str, float] = dataclasses.field(default_factory=dict)
    median: Mapping[str, float] = dataclasses.field(default_factory=dict)
    sizes: Mapping[str, float] = dataclasses.field(default_factory=dict)
    rivals: tuple[EffectRival, ...] = ()
    not_testable: str | None = None

    @property
    def visible(self) -> bool:
        """Whether it is found with the wanted power at its prior size."""
        return self.not_testable is None and self.detectability**2 >= needed(
            self.columns
        )


@dataclasses.dataclass(frozen=True, kw_only=True)
class Detection:
    """What a plan could find, of all effects.

    effects   in the order asked for
    names     (K,) of those that can be tested
    apart     (K, K) sqrt(lambda_k|j) of row k after column j is absorbed;
              sqrt(lambda_k) on the diagonal
    angles    (K, K) smallest principal angles, deg; 0 on the diagonal
    classes   groups of visible effects that can not all be told from one another
    absorbed  (k, j): k cannot be told from j, though j may be from k
    exact     pairs of which some combinations are the same to these readings, whatever
              their size
    """

    effects: tuple[Detectability, ...]
    names: tuple[str, ...]
    apart: Array
    angles: Array
    classes: tuple[tuple[str, ...], ...]
    absorbed: tuple[tuple[str, str], ...]
    exact: tuple[tuple[str, str], ...]

    def of(self, name: str) -> Detectability:
        """One effect's row. Raises KeyError."""
        for row in self.effects:
            if row.effect == name:
                return row
        raise KeyError(
            f"no effect {name!r}; there are {[e.effect for e in self.effects]}"
        )

    @property
    def not_testable(self) -> dict[str, str]:
        """{effect: why}."""
        return {
            e.effect: e.not_testable for e in self.effects if e.not_testable is not None
        }


# -- the metric as a Euclidean space ---------------------------------------------------


class Embedding:
    """Changes of the readings as vectors whose inner products are those of M: less what
    calibration absorbs.
    """

    def __init__(self, problem: GapProblem, law: NoiseLaw) -> None:
        self._metric = Metric(problem, law)
        self._basis, size, _ = np.linalg.svd(
            self._metric.whiten(problem.slopes), full_matrices=False
        )
        self._lost = 1.0 - 1.0 / np.sqrt(1.0 + size**2)

    def white(self, values: Array) -> Array:
        """Values (N, k), in units of the stated noise, whitened by the noise law:
        before calibration.
        """
        return self._metric.whiten(values)

    def __call__(self, values: Array) -> Array:
        """The same after calibration: (I + X X^T)^-1/2 of the whitened, X the whitened
        slopes.
        """
        white = self.white(values)
        return np.asarray(
            white - self._basis @ (self._lost[:, None] * (self._basis.T @ white))
        )


@dataclasses.dataclass(frozen=True)
class _Form:
    """An effect at one set of constants: where its columns are in the Gram matrix."""

    signature: Signature
    at: Index
    raw: float  # trace of its Gram matrix before calibration

    @property
    def plain(self) -> Index:
        """Its textbook columns; all where it has none."""
        kept = np.logical_not(self.signature.shape)
        return self.at[kept] if kept.any() else self.at


class _Table:
    """Gram matrix of all forms of all testable effects."""

    def __init__(
        self, problem: GapProblem, law: NoiseLaw, effects: Sequence[Effect], room: float
    ) -> None:
        self.refused: dict[str, str] = {}
        self.forms: dict[str, list[_Form]] = {}
        embedding, blocks, start = (
            Embedding(problem, law),
            [np.zeros((len(problem), 0))],
            0,
        )
        for effect in effects:
            for made in self._signatures(problem, effect):
                columns = problem.in_noise_units(made.columns)
                raw = float(np.sum(embedding.white(columns) ** 2))
                at = np.arange(start, start + columns.shape[1])
                self.forms.setdefault(effect.name, []).append(_Form(made, at, raw))
                blocks.append(columns)
                start += columns.shape[1]
        told = embedding(np.hstack(blocks))
        self.gram = told.T @ told
        shape = [f.signature.shape for forms in self.forms.values() for f in forms]
        loose = np.concatenate([np.zeros(0, dtype=bool), *shape])
        self.penalty = np.where(loose, 1.0, room**-2)

    def _signatures(self, problem: GapProblem, effect: Effect) -> list[Signature]:
        reason = untestable(effect, problem.states)
        if reason is not None:
            self.refused[effect.name] = reason
            return []
        made = [problem.signature(effect, point) for point in effect.grid()]
        kept = [s for s in made if s.names]
        if not kept:
            self.refused[effect.name] = "it changes none of these readings"
        return kept

    def own(self, form: _Form) -> Array:
        """A_kk (k, k)."""
        return np.asarray(self.gram[np.ix_(form.at, form.at)])

    def apart(self, form: _Form, rival: _Form) -> Array:
        """A_kk less what the rival absorbs."""
        inner = self.gram[np.ix_(rival.at, rival.at)] + np.diag(self.penalty[rival.at])
        cross = self.gram[np.ix_(rival.at, form.at)]
        return np.asarray(
            self.own(form) - cross.T @ linalg.solve(inner, cross, assume_a="pos")
        )

    def worst(self, form: _Form, rival: str) -> _Form:
        """The rival's form that absorbs most of what the effect is expected to do."""
        return min(
            self.forms[rival], key=lambda f: float(np.trace(self.apart(form, f)))
        )


# -- the table -------------------------------------------------------------------------


def detect(
    problem: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    room: float = ROOM,
    apart: float = APART,
) -> Detection:
    """What readings as planned (`oed.gap.data.problem.assemble`) could find, with a noise
    law.

    `apart` is the sqrt(lambda_k|j) below which two effects count as one class. Raises
    ValueError for no effect, or effects of one name.
    """
    asked = [e.name for e in effects]
    if not asked or len(set(asked)) < len(asked):
        raise ValueError(f"give at least one effect, each once, not {asked}")
    table = _Table(problem, law, effects, room)
    names = tuple(table.forms)
    told, angles = (
        np.zeros((len(names), len(names))),
        np.zeros((len(names), len(names))),
    )
    rows: dict[str, Detectability] = {}
    for k, name in enumerate(names):
        rivals = [_rival(table, name, other, apart) for other in names if other != name]
        row = _row(problem, table, name, rng)
        rows[name] = dataclasses.replace(
            row, rivals=tuple(sorted(rivals, key=lambda r: r.apart))
        )
        told[k, k] = row.detectability
        for r in rivals:
            j = names.index(r.name)
            told[k, j], angles[k, j] = r.apart, r.angle
    for name, why in table.refused.items():
        rows[name] = Detectability(effect=name, not_testable=why)
    visible = np.array([rows[n].visible for n in names], dtype=bool)
    classes, absorbed = _classes(names, told, visible, apart)
    return Detection(
        effects=tuple(rows[n] for n in asked),
        names=names,
        apart=told,
        angles=angles,
        classes=classes,
        absorbed=absorbed,
        exact=tuple(
            (names[k], names[j]) for k, j in np.argwhere(np.triu(angles < SAME, 1))
        ),
    )


def _row(
    problem: GapProblem, table: _Table, name: str, rng: np.random.Generator
) -> Detectability:
    forms = table.forms[name]
    owns = [table.own(f) for f in forms]
    traces = np.array([max(float(np.trace(a)), 0.0) for a in owns])
    columns = max(len(f.at) for f in forms)
    level = needed(columns)
    channels = _channels(problem)
    moved = {
        c: [_spread(f.signature, rows) for f in forms] for c, rows in channels.items()
    }
    draws = [rng.standard_normal((len(a), -(-DRAWS // len(forms)))) for a in owns]
    factors = [
        np.sqrt(level / np.maximum(_forms_of(a, b), 1e-300))
        for a, b in zip(owns, draws, strict=True)
    ]
    median = {}
    for c, spread in moved.items():
        rms = [
            f * np.sqrt(_forms_of(s, b))
            for f, s, b in zip(factors, spread, draws, strict=True)
        ]
        median[c] = float(np.median(np.concatenate(rms)))
    return Detectability(
        effect=name,
        columns=columns,
        detectability=float(np.sqrt(traces.mean())),
        low=float(np.sqrt(traces.min())),
        high=float(np.sqrt(traces.max())),
        power=ideal_power(float(traces.mean()), columns),
        signature={
            c: float(np.sqrt(np.mean([np.trace(s) for s in told])))
            for c, told in moved.items()
        },
        absorbed=float(
            1.0 - np.sqrt(np.mean(traces / np.maximum([f.raw for f in forms], 1e-300)))
        ),
        least={
            c: min(_least(s, a, level) for s, a in zip(told, owns, strict=True))
            for c, told in moved.items()
        },
        median=median,
        sizes=_sizes(forms, owns, level),
    )


def _channels(problem: GapProblem) -> dict[str, Index]:
    """Rows of each channel's readings."""
    return {
        str(c): np.asarray(at, dtype=np.intp)
        for c, at in problem.rows.groupby("channel", sort=False).indices.items()
    }


def _spread(made: Signature, rows: Index) -> Array:
    """S with beta^T S beta the mean square of a channel's readings, SI."""
    some = made.columns[rows]
    return np.asarray(some.T @ some / len(rows))


def _forms_of(matrix: Array, draws: Array) -> Array:
    """Quadratic forms (d,) of draws (k, d)."""
    return np.asarray(np.maximum(np.einsum("kd,kl,ld->d", draws, matrix, draws), 0.0))


def _least(spread: Array, own: Array, level: float) -> float:
    """Smallest RMS over all combinations of coefficients with lambda = level."""
    size = float(np.trace(spread))
    if size <= 0.0:
        return 0.0
    best = linalg.eigh(
        own, spread + 1e-12 * size * np.eye(len(spread)), eigvals_only=True
    )[-1]
    return float(np.sqrt(level / best)) if best > 0.0 else float("inf")


def _sizes(
    forms: Sequence[_Form], owns: Sequence[Array], level: float
) -> dict[str, float]:
    """Least size of each textbook coefficient alone, at the constants that show it
    best.
    """
    found: dict[str, float] = {}
    for form, own in zip(forms, owns, strict=True):
        for k, name in enumerate(form.signature.names):
            if not form.signature.shape[k]:
                lam = float(own[k, k])
                size = (
                    (level / lam) ** 0.5 * float(form.signature.scales[k])
                    if lam > 1e-12
                    else float("inf")
                )
                found[name] = min(size, found.get(name, float("inf")))
    return found


def _rival(table: _Table, name: str, other: str, apart: float) -> EffectRival:
    forms = table.forms[name]
    nearest = [table.worst(f, other) for f in forms]
    traces = [
        float(np.trace(table.apart(f, r))) for f, r in zip(forms, nearest, strict=True)
    ]
    angles = [_angles(table, f, r)[0] for f in forms for r in table.forms[other]]
    smallest = min(float(angle[0]) if len(angle) else 90.0 for angle in angles)
    k = int(np.argmin(traces))
    shared = _shared(table, forms[k], nearest[k], apart)
    return EffectRival(other, max(float(np.mean(traces)), 0.0) ** 0.5, smallest, shared)


def _angles(table: _Table, form: _Form, rival: _Form) -> tuple[Array, Array]:
    """Principal angles (r,), deg ascending, of the textbook columns, and the
    combinations (k, r) of unit length.
    """
    left, right = _root(table.gram, form.plain), _root(table.gram, rival.plain)
    cross = left.T @ table.gram[np.ix_(form.plain, rival.plain)] @ right
    u, cosine, _ = np.linalg.svd(cross)
    cosine = np.append(np.minimum(cosine, 1.0), np.zeros(u.shape[1] - len(cosine)))
    vectors = left @ u
    return np.rad2deg(np.arccos(cosine)), vectors / np.linalg.norm(vectors, axis=0)


def _root(gram: Array, at: Index) -> Array:
    """R (k, r) with R^T A R = 1 over the directions that can be seen: one noise at a
    prior standard deviation.
    """
    values, vectors = np.linalg.eigh(gram[np.ix_(at, at)])
    kept = values >= min(1.0, 0.01 * max(float(values[-1]), 1e-300))
    return np.asarray(vectors[:, kept] / np.sqrt(np.maximum(values[kept], 1e-300)))


def _shared(
    table: _Table, form: _Form, rival: _Form, apart: float
) -> tuple[SharedSignature, ...]:
    """Combinations of the textbook coefficients that are visible and not told from the
    rival, or the same as its.
    """
    angles, vectors = _angles(table, form, rival)
    place = np.searchsorted(form.at, form.plain)
    own, left = (
        table.own(form)[np.ix_(place, place)],
        table.apart(form, rival)[np.ix_(place, place)],
    )
    names = [form.signature.names[k] for k in place]
    found = []
    for angle, v in zip(angles, vectors.T, strict=True):
        seen, told = float(v @ own @ v), float(max(v @ left @ v, 0.0))
        if angle < SAME or (seen >= needed(1) and told < min(apart**2, HALF * seen)):
            share = v / v[np.argmax(np.abs(v))]
            combination = {n: float(s) for n, s in zip(names, share, strict=True)}
            found.append(
                SharedSignature(
                    combination,
                    in_words(combination),
                    float(np.sqrt(seen)),
                    float(np.sqrt(told)),
                    float(angle),
                )
            )
    return tuple(found)


def in_words(combination: Mapping[str, float]) -> str:
    """A combination of coefficients, its largest share 1, in words."""
    values = np.array(list(combination.values()))
    names = list(combination)
    if len(values) == 1:
        return names[0]
    if np.all(np.abs(values - values.mean()) < 0.1 * abs(values.mean())):
        return f"common to {', '.join(names[:-1])} and {names[-1]}"
    order = [
        k for k in np.argsort(-np.abs(values), kind="stable") if abs(values[k]) >= 0.2
    ]
    sizes = [f"{abs(values[k]):.2g}" for k in order]
    signs = ["-" if values[k] < 0 else "+" for k in order]
    terms = [
        f"{s} {'' if v == '1' else v + ' '}{names[k]}"
        for s, v, k in zip(signs, sizes, order, strict=True)
    ]
    return " ".join(terms).removeprefix("+ ")


def _classes(
    names: Sequence[str], apart: Array, visible: Mask, least: float
) -> tuple[tuple[tuple[str, ...], ...], tuple[tuple[str, str], ...]]:
    """Connected groups of visible effects, and who cannot be told from whom.

    A rival counts where it takes half of lambda_k at least: what is hardly seen is near
    every rival.
    """
    most = np.minimum(least, np.sqrt(HALF) * np.diag(apart)[:, None])
    close = (
        (apart < most)
        & visible[:, None]
        & visible[None, :]
        & ~np.eye(len(names), dtype=bool)
    )
    _, label = csgraph.connected_components(sparse.csr_matrix(close), directed=False)
    groups = [
        tuple(n for n, g in zip(names, label, strict=True) if g == group)
        for group in np.unique(label)
    ]
    edges = tuple((names[k], names[j]) for k, j in np.argwhere(close))
    return tuple(g for g in groups if len(g) > 1), edges
