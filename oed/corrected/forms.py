"""Chooses each effect's constants and sizes by the evidence of the readings.

With prior N(0, 1) on the coefficients and a free noise level, the log evidence of
columns U is -1/2 log |A| - N/2 log(r^T M r - b^T A^-1 b), A = 1 + U^T M U, b = U^T M r;
M takes out what the machine's parameters can explain (`oed.gap.data.problem`).

A joint estimate shows the sizes of effects and of their groups. A group is what belongs
together: the coefficients of one leg, say. They are N(0, t^2). An estimate made with some
t, divided by its prior, is what the readings alone tell of a group; with it t is
estimated again:

- the groups of an effect share a size, its expected one or larger (`oed.effect_model`);
- one group in ten is of any larger size, so that one leg whose conversion is wrong is not
  pulled to zero, and the others are not set free.

Sizes are posterior medians: where the readings tell nothing, the expected one.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, special

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES, FAR_SHARE, Effect
from oed.gap import ActingEffectForm, GapProblem, Metric, Signature

MAX_FULL_GRID = 64  #: constants beyond which textbook forms alone are scanned
N_PASSES = 2  #: passes over the effects
#: precision that readings add to a prior's, as a share of it, below which an estimate says
#: nothing: its value is exact to 0.03 standard deviations, which is 0.3 of those that the
#: readings alone would have there
MIN_PRECISION_SHARE = 0.01
#: sizes from the expected one on; those below it count as it
SIZES = EFFECT_SIZES.values[EFFECT_SIZES.values >= 1.0]
#: numbers of the coefficients of each group of an effect, among those of all effects
Groups = Sequence[Index]


@dataclasses.dataclass(frozen=True)
class ChosenForm(ActingEffectForm):
    """The form of an effect that suits the readings best."""

    signature: Signature  #: change of the readings per prior standard deviation


def choose_forms(
    problem: GapProblem, effects: Sequence[Effect]
) -> tuple[ChosenForm, ...]:
    """The forms of effects that act together; effects that change nothing are absent."""
    evidence = FormEvidence(problem)
    chosen: dict[str, ChosenForm] = {}
    for _ in range(N_PASSES):
        for effect in effects:
            others = [f for name, f in chosen.items() if name != effect.name]
            best = _best_form(problem, evidence, effect, others)
            if best is not None:
                chosen[effect.name] = best
    return tuple(chosen.values())


def _best_form(
    problem: GapProblem,
    evidence: "FormEvidence",
    effect: Effect,
    others: Sequence[ChosenForm],
) -> ChosenForm | None:
    """The form of one effect of highest evidence, next to others; None without any."""
    parts = [problem.noise_units(f.signature.columns * f.size) for f in others]
    fixed = np.hstack([np.zeros((len(problem), 0)), *parts])
    grid = effect.constant_grid()
    textbook = len(grid) > MAX_FULL_GRID
    best = None
    best_value = -np.inf
    for constants in grid:
        signature = problem.signature(effect, constants, textbook=textbook)
        if not signature.names:
            continue
        columns = problem.noise_units(signature.columns)
        values = evidence.of_sizes(fixed, columns)
        if values.max() > best_value:
            best_value = float(values.max())
            size = float(EFFECT_SIZES.values[np.argmax(values)])
            best = ChosenForm(effect, constants, signature.names, size, signature)
    if best is None or not textbook:
        return best
    adapted = problem.signature(effect, best.constants)
    return dataclasses.replace(best, names=adapted.names, signature=adapted)


class FormEvidence:
    """Evidence of columns for the residual (N,) of a problem, under independent noise of
    the stated ratios whose level is profiled out.
    """

    def __init__(self, problem: GapProblem) -> None:
        self.residual = problem.residual
        self._metric = Metric(problem, problem.stated_law)

    def log_evidence(self, columns: Array) -> float:
        """Log evidence of columns (N, k), in noise units."""
        return _log_evidence(self._products(columns), len(self.residual))

    def of_sizes(self, fixed: Array, columns: Array) -> Array:
        """Log evidence (S,) of columns (N, k) at each size, with the size's prior.

        fixed  (N, f) columns that are in the model as they are
        """
        products = self._products(np.hstack([fixed, columns]))
        values = []
        for size in EFFECT_SIZES.values:
            scale = np.ones(len(products))
            scale[fixed.shape[1] : -1] = size
            scaled = products * np.outer(scale, scale)
            values.append(_log_evidence(scaled, len(self.residual)))
        return np.array(values) + EFFECT_SIZES.log_shares

    def unexplained(self, columns: Array) -> float:
        """Sum of squares that columns with their prior leave of the residual."""
        return _solve(self._products(columns))[1]

    def _products(self, columns: Array) -> Array:
        """Inner products (k + 1, k + 1) of columns and residual."""
        both = np.column_stack([columns, self.residual])
        return self._metric.gram(both, both)


def _log_evidence(products: Array, size: int) -> float:
    log_det, unexplained = _solve(products)
    return -0.5 * log_det - 0.5 * size * float(np.log(unexplained))


def _solve(products: Array) -> tuple[float, float]:
    """Log determinant of A, and sum of squares that the columns leave."""
    inner = products[:-1, :-1] + np.eye(len(products) - 1)
    b = products[:-1, -1]
    total = float(products[-1, -1])
    root = linalg.cholesky(inner, lower=True)
    explained = float(np.sum(linalg.solve_triangular(root, b, lower=True) ** 2))
    log_det = 2.0 * float(np.log(np.diag(root)).sum())
    return log_det, max(total - explained, 1e-12 * total)


def groups_by_effect(forms: Sequence[ChosenForm]) -> list[Groups]:
    """The groups of each effect: the coefficients of one label together."""
    effects: list[Groups] = []
    count = 0
    for form in forms:
        members: dict[str, list[int]] = {}
        for label in form.signature.labels:
            members.setdefault(label, []).append(count)
            count += 1
        every = members.values()
        effects.append([np.array(numbers, dtype=np.intp) for numbers in every])
    return effects


def updated_sizes(
    effects: Sequence[Groups], sizes: Array, values: Array, covariance: Array
) -> Array:
    """Sizes (k,) by estimate and covariance (k, k), made with other sizes."""
    updated = sizes.copy()
    for groups in effects:
        table = []
        for members in groups:
            of_group = covariance[np.ix_(members, members)]
            prior = float(sizes[members[0]])
            likelihood = _undo_prior(values[members], of_group, prior)
            table.append(_log_evidences(*likelihood))
        for members, size in zip(groups, _group_sizes(np.array(table)), strict=True):
            updated[members] = size
    return updated


def _undo_prior(values: Array, covariance: Array, prior: float) -> tuple[Array, Array]:
    """An estimate divided by its prior N(0, prior^2): information (k,), precision (k,).

    Both are along the principal axes of the covariance (k, k). Where the readings hardly
    add to the prior, they agree with none.
    """
    variance, axes = np.linalg.eigh(covariance)
    variance = np.maximum(variance, np.finfo(float).tiny)
    precision = np.maximum(1.0 / variance - prior**-2, 0.0)
    is_seen = precision > MIN_PRECISION_SHARE * prior**-2
    return np.where(is_seen, axes.T @ values / variance, 0.0), precision


def _log_evidences(information: Array, precision: Array) -> Array:
    """Log evidence (S,) of each size for a group, against none at all."""
    square = SIZES[:, None] ** 2
    growth = 1.0 + precision * square
    return np.asarray(
        0.5 * (information**2 * square / growth - np.log(growth)).sum(axis=1)
    )


def _group_sizes(table: Array) -> Array:
    """Sizes (g,) of the groups of an effect, from their log evidences (g, S)."""
    log_shares = EFFECT_SIZES.log_shares
    larger = log_shares[-len(SIZES) + 1 :]
    log_common = np.append(special.logsumexp(log_shares[: -len(larger)]), larger)
    common = _median(log_common + _log_mixtures(table).sum(axis=0))
    far = np.full(len(SIZES), -np.inf)
    far[common] = np.log1p(-FAR_SHARE)
    beyond = len(SIZES) - common - 1
    if beyond:
        far[common + 1 :] = np.log(FAR_SHARE / beyond)
    return SIZES[[_median(far + row) for row in table]]


def _log_mixtures(table: Array) -> Array:
    """Log evidence (g, S) of groups at a common size, each with its chance to be far."""
    mixtures = table.copy()
    for k in range(len(SIZES) - 1):
        beyond = special.logsumexp(table[:, k + 1 :], axis=1)
        far = np.log(FAR_SHARE / (len(SIZES) - k - 1)) + beyond
        mixtures[:, k] = np.logaddexp(np.log1p(-FAR_SHARE) + table[:, k], far)
    return mixtures


def _median(log_weights: Array) -> int:
    """Number of the median size."""
    shares = np.cumsum(special.softmax(log_weights))
    return int(np.searchsorted(shares, 0.5))
