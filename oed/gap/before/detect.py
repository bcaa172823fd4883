"""Detectability of each effect by planned readings, and its separation from rivals.

With the metric M = (Sigma + H Lambda H^T)^-1, in which what calibration absorbs no
longer counts, and G_k the columns of effect k per prior standard deviation of each
coefficient, A_kl = G_k^T M G_l and

    lambda_k   = beta^T A_kk beta                                  (detectability),
    lambda_k|j = beta^T [A_kk - A_kj (A_jj + P)^-1 A_jk] beta      (separation from j).

A test with k columns finds lambda with the power of the noncentral chi-square. A
rival's textbook coefficients are as good as free (`ROOM` prior standard deviations), so
that size alone distinguishes no effects. Its columns that adapt the form keep their
prior; its constants have the most absorbing of their values. Source: Box and Hill 1967,
Atkinson and Fedorov 1975 (T-optimality); Bjorck and Golub 1973 (principal angles).
"""

import dataclasses
import functools
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg, optimize, sparse, special
from scipy.sparse import csgraph

from oed import units
from oed.base import Array, Index, Mask
from oed.effect_model import Effect
from oed.gap.data.evidence import separated
from oed.gap.data.problem import GapProblem, Metric, Signature, untestable
from oed.linear_algebra import canonical_rows, eigenvectors, first_largest, size_order
from oed.measurement import Measurement
from oed.noise import NoiseLaw
from oed.result import (
    DetectabilityRecord,
    DetectabilityTable,
    RivalRecord,
    SharedRecord,
)

# Forms of effects, one for each value of their constants, as columns of readings.

#: prior standard deviations that a rival's textbook coefficients may go to
RIVAL_SD = 100.0


@dataclasses.dataclass(frozen=True, eq=False)
class ColumnSet:
    """Columns of one explanation among those of all."""

    effect: str  #: what it explains the readings by
    at: Index  #: (k,) numbers of its columns
    precision: Array  #: (k,) prior precision of its coefficients as a rival's


@dataclasses.dataclass(frozen=True, eq=False)
class Form(ColumnSet):
    """An effect at one set of constants, with the signature that its columns are of."""

    signature: Signature

    @property
    def textbook(self) -> Index:
        """Which of its columns are textbook columns; all where it has none."""
        plain = np.flatnonzero(np.logical_not(self.signature.shape))
        return plain if plain.size else np.arange(len(self.at))


@dataclasses.dataclass(frozen=True, eq=False)
class EffectForms:
    """Forms of all testable effects."""

    by_effect: dict[str, list[Form]]  #: {effect: its forms}
    reasons: dict[str, str]  #: {effect: why the readings cannot test it}
    columns: Array  #: (N, K) of all forms, in units of the stated noise


def effect_forms(
    problem: GapProblem, effects: Sequence[Effect], most: int | None = None
) -> EffectForms:
    """Forms over the constants' grids, or `most` of them, that change a reading."""
    by_effect: dict[str, list[Form]] = {}
    reasons: dict[str, str] = {}
    blocks = [np.zeros((len(problem), 0))]
    start = 0
    for effect in effects:
        reason = untestable(effect, problem.states)
        grid = effect.constant_grid() if reason is None else []
        if most is not None and len(grid) > most:
            places = np.linspace(0, len(grid) - 1, most).round().astype(int)
            grid = [grid[k] for k in np.unique(places)]
        every = [problem.signature(effect, constants) for constants in grid]
        for signature in every:
            if signature.names:
                columns = np.arange(start, start + len(signature.names))
                precision = np.where(signature.shape, 1.0, RIVAL_SD**-2)
                form = Form(effect.name, columns, precision, signature)
                by_effect.setdefault(effect.name, []).append(form)
                blocks.append(problem.noise_units(signature.columns))
                start += len(columns)
        if effect.name not in by_effect:
            reasons[effect.name] = reason or "it changes none of these readings"
    return EffectForms(by_effect, reasons, np.hstack(blocks))


# Power of a test that finds a gap: the noncentral chi-square.

FALSE_ALARM = 0.01  #: probability that a test finds a gap which is none
MIN_POWER = 0.90  #: probability that a test finds a gap, from which on the gap is found


def power(lam: float, columns: int) -> float:
    """Probability that a test with `columns` degrees of freedom finds a gap of lambda."""
    level = special.chdtri(columns, FALSE_ALARM)
    return float(1.0 - special.chndtr(level, columns, lam))


@functools.cache
def needed_lambda(columns: int) -> float:
    """Least lambda that a test finds with POWER: 14.9 for 1 column, 28.6 for 12."""

    def excess(lam: float) -> float:
        return power(lam, columns) - MIN_POWER

    return float(optimize.brentq(excess, 1e-6, 1e4))


# Confusion of effects: principal angles, imitated combinations, classes.
#
# What a rival's form with columns R_j leaves of R_k, all after calibration has absorbed
# what it can, has the trace tr A_kk - |L_j^-1 R_j^T R_k|^2, L_j L_j^T = A_jj + P. An effect
# may have thousands of columns: their products with those of another are made a few forms
# at a time.
#
# Combinations of an effect's coefficients are put into words, in prior standard deviations.

MIN_SEPARATION = 5.0  #: sqrt(lambda_k|j) below which the two cannot be distinguished
RIVAL_SHARE = 0.5  #: share of lambda_k that a rival must absorb to count as one
#: principal angle, deg, below which a combination of one effect is a combination of the
#: other to these readings
SAME_ANGLE = 1.0
#: share of the mean by which coefficients that are common may differ
COMMON_TOLERANCE = 0.1
PRODUCT_NUMBERS = 2_000_000  #: numbers in an array of such products: 16 MB
#: pairs of forms whose smallest angle is sought at once, those of most in common first
ANGLES_AT_ONCE = 64


class RemainingForms:
    """What calibration leaves of all forms of an effect.

    forms    F of them
    columns  (N, K) of the forms, one after the other
    starts   (F,) first column of each
    grams    (k, k) Gram matrices of each form's columns
    axes     (N, m) orthonormal directions in which each form's textbook columns are seen
    """

    def __init__(self, forms: Sequence[Form], remaining: Array) -> None:
        """Of an effect's forms, out of the remaining columns (N, all) of all effects."""
        self.forms = forms
        self.columns = remaining[:, np.concatenate([form.at for form in forms])]
        self.starts = np.cumsum([0, *(len(form.at) for form in forms)])[:-1]
        self.grams: list[Array] = []
        self.axes: list[Array] = []
        for k, form in enumerate(forms):
            columns = self.of_form(k)
            self.grams.append(columns.T @ columns)
            block = self.grams[-1][np.ix_(form.textbook, form.textbook)]
            energy, vectors = np.linalg.eigh(block)  # of which the space alone matters
            seen = energy > _least_seen(float(energy.max(initial=0.0)))
            root = vectors[:, seen] / np.sqrt(energy[seen])
            self.axes.append(columns[:, form.textbook] @ root)

    @property
    def effect(self) -> str:
        """Its name."""
        return self.forms[0].effect

    def of_form(self, k: int) -> Array:
        """Columns (N, k) of a form."""
        start = self.starts[k]
        return self.columns[:, start : start + len(self.forms[k].at)]

    @functools.cached_property
    def absorbing(self) -> list[Array]:
        """L_j^-1 R_j^T (k, N) of each form as a rival."""
        halves = []
        for k, (form, gram) in enumerate(zip(self.forms, self.grams, strict=True)):
            root = np.linalg.cholesky(gram + np.diag(form.precision))
            columns = self.of_form(k).T
            halves.append(linalg.solve_triangular(root, columns, lower=True))
        return halves

    @functools.cached_property
    def padded_axes(self) -> Array:
        """The axes (F, m, N), with zeros where a form has fewer than another."""
        most = max(axes.shape[1] for axes in self.axes)
        padded = np.zeros((len(self.axes), most, len(self.columns)))
        for k, axes in enumerate(self.axes):
            padded[k, : axes.shape[1]] = axes.T
        return padded

    def traces_left_by(self, rival: "RemainingForms") -> Array:
        """Traces (F, F') of what each form of a rival leaves of each form."""
        absorbed = np.empty((len(self.forms), len(rival.forms)))
        most = max(len(half) for half in rival.absorbing)
        step = max(1, PRODUCT_NUMBERS // (most * self.columns.shape[1]))
        for first in range(0, len(rival.forms), step):
            halves = rival.absorbing[first : first + step]
            squares = (np.concatenate(halves) @ self.columns) ** 2
            ends = np.cumsum([0, *(len(half) for half in halves)])[:-1]
            of_forms = np.add.reduceat(squares, self.starts, axis=1)
            of_both = np.add.reduceat(of_forms, ends, axis=0)
            absorbed[:, first : first + step] = of_both.T
        return np.array([[np.trace(gram)] for gram in self.grams]) - absorbed

    def smallest_angle(self, rival: "RemainingForms") -> float:
        """Smallest principal angle, deg, of any form with any of a rival; 90 without any."""
        ours, theirs = self.padded_axes, rival.padded_axes
        of_ours = ours.reshape(-1, ours.shape[2])
        step = max(1, PRODUCT_NUMBERS // (len(of_ours) * max(theirs.shape[1], 1)))
        largest = 0.0
        for first in range(0, len(theirs), step):
            some = theirs[first : first + step]
            cross = of_ours @ some.reshape(-1, ours.shape[2]).T
            shape = (len(ours), ours.shape[1], *some.shape[:2])
            blocks = cross.reshape(shape).swapaxes(1, 2)
            blocks = blocks.reshape(-1, ours.shape[1], some.shape[1])
            largest = max(largest, _largest_cosine(blocks, largest))
        return float(np.rad2deg(np.arccos(min(largest, 1.0))))


def _largest_cosine(blocks: Array, least: float) -> float:
    """Largest singular value of matrices (b, m, m'), where it is above the least."""
    bounds = np.sqrt(np.einsum("bij,bij->b", blocks, blocks))
    order = np.argsort(-bounds)
    for first in range(0, len(order), ANGLES_AT_ONCE):
        some = order[first : first + ANGLES_AT_ONCE]
        if bounds[some[0]] <= least:
            break
        values = np.linalg.svd(blocks[some], compute_uv=False)
        least = max(least, float(values.max(initial=0.0)))
    return least


def effect_rival(effect: RemainingForms, rival: RemainingForms) -> RivalRecord:
    """How well an effect is distinguished from a rival at its most absorbing constants:
    by mean separation and smallest angle.
    """
    remaining = effect.traces_left_by(rival)
    least = remaining.min(axis=1)
    hardest = int(np.argmin(least))
    nearest = int(np.argmin(remaining[hardest]))
    columns = effect.of_form(hardest), rival.of_form(nearest)
    both = np.hstack(columns)
    split = columns[0].shape[1]
    numbers = np.arange(both.shape[1])
    form = dataclasses.replace(effect.forms[hardest], at=numbers[:split])
    other = dataclasses.replace(rival.forms[nearest], at=numbers[split:])
    return RivalRecord(
        name=rival.effect,
        separation=max(float(least.mean()), 0.0) ** 0.5,
        angle_deg=effect.smallest_angle(rival),
        shared=_shared(both.T @ both, form, other),
    )


def _principal_angles(gram: Array, form: Form, rival: Form) -> tuple[Array, Array]:
    """Principal angles (r,), deg ascending, and their unit combinations (k, r)."""
    columns, others = form.at[form.textbook], rival.at[rival.textbook]
    root = visible_root(gram[np.ix_(columns, columns)])
    rival_root = visible_root(gram[np.ix_(others, others)])
    cross = root.T @ gram[np.ix_(columns, others)] @ rival_root
    u, cosine, _ = np.linalg.svd(cross)
    missing = np.zeros(u.shape[1] - len(cosine))
    cosine = np.append(np.minimum(cosine, 1.0), missing)
    vectors = root @ canonical_rows(u.T, cosine).T
    lengths = np.linalg.norm(vectors, axis=0)
    return np.rad2deg(np.arccos(cosine)), vectors / lengths


def visible_root(gram: Array) -> Array:
    """R (k, r), R R^T the pseudo-inverse of a Gram matrix over what can be seen."""
    values, vectors = eigenvectors(gram)
    visible = values > _least_seen(float(values.max(initial=0.0)))
    return vectors[:, visible] / np.sqrt(values[visible])


def _least_seen(largest: float) -> float:
    """Energy from which a direction is seen."""
    return min(1.0, 0.01 * max(largest, 1e-300))


def _shared(gram: Array, form: Form, rival: Form) -> list[SharedRecord]:
    """Visible combinations of textbook coefficients that the rival imitates."""
    angles, vectors = _principal_angles(gram, form, rival)
    columns = form.at[form.textbook]
    block = np.ix_(form.textbook, form.textbook)
    inner = gram[np.ix_(columns, columns)]
    left = separated(gram, form.at, rival.at, rival.precision)[block]
    names = [form.signature.names[k] for k in form.textbook]
    shared = []
    for angle, v in zip(angles, vectors.T, strict=True):
        whole = float(v @ inner @ v)
        distinct = float(max(v @ left @ v, 0.0))
        visible = whole >= needed_lambda(1)
        imitated = distinct < min(MIN_SEPARATION**2, RIVAL_SHARE * whole)
        if angle < SAME_ANGLE or (visible and imitated):
            shares = v / v[first_largest(v)]
            combination = dict(zip(names, shares.tolist(), strict=True))
            record = SharedRecord(
                words=combination_words(combination),
                combination=combination,
                detectability=float(np.sqrt(whole)),
                separation=float(np.sqrt(distinct)),
                angle_deg=float(angle),
            )
            shared.append(record)
    return shared


def indistinguishable(
    names: Sequence[str], separation: Array, visible: Mask
) -> tuple[list[list[str]], list[list[str]]]:
    """Connected groups of visible effects, and pairs (k, j) of k absorbed by j.

    separation (K, K) sqrt(lambda_k|j), sqrt(lambda_k) on the diagonal; half is lost
    """
    detectability = np.diag(separation)[:, None]
    least = np.minimum(MIN_SEPARATION, np.sqrt(RIVAL_SHARE) * detectability)
    others = ~np.eye(len(names), dtype=bool)
    both_visible = visible[:, None] & visible[None, :]
    close = (separation < least) & both_visible & others
    _, label = csgraph.connected_components(sparse.csr_matrix(close), directed=False)
    groups: dict[int, list[str]] = {}
    for name, number in zip(names, label, strict=True):
        groups.setdefault(int(number), []).append(name)
    classes = [members for members in groups.values() if len(members) > 1]
    return classes, [[names[k], names[j]] for k, j in np.argwhere(close)]


def combination_words(combination: Mapping[str, float]) -> str:
    """A combination of coefficients, its largest share 1, in words."""
    values = np.array(list(combination.values()))
    names = list(combination)
    if len(values) == 1:
        return names[0]
    mean = values.mean()
    if np.all(np.abs(values - mean) < COMMON_TOLERANCE * abs(mean)):
        return f"common to {', '.join(names[:-1])} and {names[-1]}"
    terms = []
    for k in size_order(values):
        if abs(values[k]) >= 0.2:
            sign, size = "-" if values[k] < 0 else "+", f"{abs(values[k]):.2g}"
            factor = "" if size == "1" else f"{size} "
            terms.append(f"{sign} {factor}{names[k]}")
    return " ".join(terms).removeprefix("+ ")


PRIOR_DRAWS = 400  #: draws from an effect's prior for its median least size


def detect(
    problem: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
    rng: np.random.Generator,
) -> DetectabilityTable:
    """What planned readings (`oed.gap.data.problem.assemble`) could find.

    Sizes of readings are in the fine unit of their channel (`_fine_units`). Raises
    ValueError for no effect, or effects of one name.
    """
    names_of_effects = [effect.name for effect in effects]
    if not names_of_effects or len(set(names_of_effects)) < len(names_of_effects):
        raise ValueError(f"give at least one effect, each once, not {names_of_effects}")
    forms = effect_forms(problem, effects)
    metric = Metric(problem, law)
    white = metric.whiten(forms.columns)
    energy = np.einsum("nk,nk->k", white, white)
    remaining = metric.remaining(white)
    if len(remaining) > remaining.shape[1]:  # the same products from fewer rows
        remaining = linalg.qr(remaining, mode="r", check_finite=False)[0]
        remaining = remaining[: remaining.shape[1]]
    left = {
        name: RemainingForms(of_effect, remaining)
        for name, of_effect in forms.by_effect.items()
    }
    records = []
    for effect in effects:
        reason = forms.reasons.get(effect.name)
        record = DetectabilityRecord(
            effect.name, effect.about, power=FALSE_ALARM, not_testable=reason
        )
        if reason is None:
            record = _record(problem, left, energy, effect, rng)
        records.append(record)
    testable = [record for record in records if record.not_testable is None]
    names = [record.name for record in testable]
    separation = np.diag([record.detectability for record in testable])
    angles = np.zeros_like(separation)
    for k, record in enumerate(testable):
        for rival in record.rivals:
            j = names.index(rival.name)
            separation[k, j], angles[k, j] = rival.separation, rival.angle_deg
    visible = np.array([record.visible for record in testable], dtype=bool)
    classes, absorbed = indistinguishable(names, separation, visible)
    same = np.argwhere(np.triu(angles < SAME_ANGLE, 1))
    return DetectabilityTable(
        readings=len(problem),
        effects=records,
        names=names,
        separation=separation.tolist(),
        angles_deg=angles.tolist(),
        classes=classes,
        absorbed=absorbed,
        exact=[[names[k], names[j]] for k, j in same],
    )


def _fine_units(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel, in which the sizes of readings are given."""
    fine: dict[str, str] = {}
    for setup in measurement.setups.values():
        fine |= {c.name: units.FINE[c.unit] for c in setup.instrument.channels}
    return fine


def _record(
    problem: GapProblem,
    left: Mapping[str, RemainingForms],
    energy: Array,
    effect: Effect,
    rng: np.random.Generator,
) -> DetectabilityRecord:
    """Detectability of one effect; `energy` (K,) before calibration absorbs."""
    forms, grams = left[effect.name].forms, left[effect.name].grams
    traces = np.array([max(float(np.trace(g)), 0.0) for g in grams])
    raw = np.array([energy[form.at].sum() for form in forms])
    remaining = traces / np.maximum(raw, 1e-300)
    columns = max(len(g) for g in grams)
    needed, mean = needed_lambda(columns), float(traces.mean())
    detectability = float(np.sqrt(mean))
    count = -(-PRIOR_DRAWS // len(forms))
    draws = [rng.standard_normal((len(g), count)) for g in grams]
    signature, least, median = {}, {}, {}
    fine = _fine_units(problem.measurement)
    for channel, rows in problem.rows.groupby("channel", sort=False).indices.items():
        spreads = [_spread(form, rows) for form in forms]
        mean_square = np.mean([np.trace(spread) for spread in spreads])
        pairs = zip(spreads, grams, strict=True)
        best = min(_least_rms(*pair, needed) for pair in pairs)
        typical = _median_rms(spreads, grams, draws, needed)
        unit = units.factor(fine[channel])
        signature[channel] = float(np.sqrt(mean_square)) / unit
        least[channel] = _bounded(best / unit)
        median[channel] = _bounded(typical / unit)
    others = [other for name, other in left.items() if name != effect.name]
    rivals = [effect_rival(left[effect.name], other) for other in others]
    return DetectabilityRecord(
        name=effect.name,
        about=effect.about,
        columns=columns,
        detectability=detectability,
        low=float(np.sqrt(traces.min())),
        high=float(np.sqrt(traces.max())),
        power=power(mean, columns),
        visible=detectability**2 >= needed,
        signature=signature,
        absorbed=float(1.0 - np.sqrt(np.mean(remaining))),
        least=least,
        median=median,
        sizes=_least_sizes(forms, grams, needed),
        rivals=sorted(rivals, key=lambda rival: rival.separation),
    )


def _spread(form: Form, rows: Index) -> Array:
    """S (k, k) with beta^T S beta the mean square of a channel's readings, SI."""
    columns = form.signature.columns[rows]
    return columns.T @ columns / len(rows)


def _median_rms(
    spreads: Sequence[Array],
    grams: Sequence[Array],
    draws: Sequence[Array],
    needed: float,
) -> float:
    """Root mean square, SI, that is found: median over draws (k, d) from the prior."""
    rms = []
    for spread, gram, beta in zip(spreads, grams, draws, strict=True):
        lam = np.maximum(_quadratic(gram, beta), 1e-300)
        rms.append(np.sqrt(needed / lam) * np.sqrt(_quadratic(spread, beta)))
    return float(np.median(np.concatenate(rms)))


def _quadratic(matrix: Array, draws: Array) -> Array:
    forms = np.einsum("kd,kl,ld->d", draws, matrix, draws)
    return np.asarray(np.maximum(forms, 0.0))


def _least_rms(spread: Array, gram: Array, needed: float) -> float:
    """Smallest RMS, SI, over all combinations of coefficients with lambda = needed."""
    size = float(np.trace(spread))
    if size <= 0.0:
        return 0.0
    ridge = 1e-12 * size * np.eye(len(spread))
    best = linalg.eigh(gram, spread + ridge, eigvals_only=True)[-1]
    return float(np.sqrt(needed / best)) if best > 0.0 else float("inf")


def _least_sizes(
    forms: Sequence[Form], grams: Sequence[Array], needed: float
) -> dict[str, float | None]:
    """Least size of each textbook coefficient alone, at its most visible constants."""
    least: dict[str, float] = {}
    for form, gram in zip(forms, grams, strict=True):
        signature = form.signature
        for k in np.flatnonzero(~signature.shape):
            name = signature.names[k]
            lam = float(gram[k, k])
            size = float("inf")
            if lam > 1e-12:
                size = (needed / lam) ** 0.5 * float(signature.scales[k])
            least[name] = min(size, least.get(name, float("inf")))
    return {name: _bounded(size) for name, size in least.items()}


def _bounded(size: float) -> float | None:
    return size if size < 1e6 else None
