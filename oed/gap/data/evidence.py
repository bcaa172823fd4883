"""Log evidence of columns with Gaussian coefficients, in closed form.

With Gram matrix A = G^T M G and b = G^T M r, coefficients N(0, t^2) in units of the
noise,

    2 log p(r | G, t) - 2 log p(r | no gap) =
        -log |1 + t^2 A| - (N + 2a) log(1 - gain / (2 b0 + r^T M r)),
    gain = b^T (1 / t^2 + A)^-1 b.

The noise level s is integrated out: s^2 is inverse gamma (a, b0), and all prior
variances scale with it. The Schur complement takes out columns selected before, so that
each step of a search is of this form again.
"""

import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from numpy.typing import ArrayLike
from scipy import special

from oed import linear_algebra
from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES
from oed.gap.data.columns import VALUES_AT_ONCE, Block, Columns
from oed.gap.data.problem import GapProblem, Metric
from oed.noise import Laws, NoiseLaw
from oed.noise_law import NoisePrior, ResidualModel, draw_laws

#: share of a column's energy, before anything absorbs of it, up to which what remains of
#: it in some direction is rounding
ENERGY_TOLERANCE = 1e-9
#: energy of a direction of columns, at their sizes, that is far below the noise
UNSEEN_ENERGY = 0.09
USUAL_SIZE = EFFECT_SIZES.usual[-1]  #: the largest usual size of an effect
#: columns that are whitened at once: more take memory and no less time
COLUMNS_AT_ONCE = 64
#: size of a direction of columns, in units of the noise, below which `compress` drops it
MIN_SIZE = 0.03
#: shape of the inverse gamma prior of the squared noise level: its stated value to within
#: a factor of about two
LEVEL_SHAPE = 2.0
LEVEL_RATE = 2.0  #: rate of the same prior


@dataclasses.dataclass(frozen=True)
class Grams:
    """Inner products of K columns and of the residual, in a metric."""

    gram: Array  #: (K, K) Gram matrix of the columns
    b: Array  #: (K,) projections of the residual on the columns
    #: (K,) energy of the columns before parameters and other columns absorb
    whole: Array
    energy: float  #: r^T M r of the residual
    size: int  #: number of readings
    base: float  #: log evidence of no further column

    def take(self, columns: Index) -> "Grams":
        """Grams of some of the columns."""
        return dataclasses.replace(
            self,
            gram=self.gram[np.ix_(columns, columns)],
            b=self.b[columns],
            whole=self.whole[columns],
        )

    def select(self, columns: Index, size: float) -> "Grams":
        """Grams with `columns` in the model, their coefficients N(0, size^2)."""
        if not len(columns):
            return self
        energy, axes = self._directions(columns)
        inflation = 1.0 + size**2 * energy
        selected = self._without(columns, axes * (size / np.sqrt(inflation)))
        gain = np.array(self.energy - selected.energy)
        log_det = np.array(np.log(inflation).sum())
        ratio = self.log_ratio(gain, log_det).item()
        return dataclasses.replace(selected, base=self.base + ratio)

    def taken_by(
        self, forms: Sequence[Index], sizes: Sequence[float]
    ) -> tuple[Array, Array]:
        """What forms in the model, one after the other, take of everything.

        Products (k, K) of the directions that they explain with all columns, and (k,) with
        the residual: what is left of A and b is A - T^T T and b - T^T u.
        """
        rows = np.concatenate([np.empty(0, dtype=np.intp), *forms])
        gram, b = self.gram[rows], self.b[rows]
        taken = [gram[:0]]
        projected = [b[:0]]
        start = 0
        for form, size in zip(forms, sizes, strict=True):
            own = slice(start, start + len(form))
            start = own.stop
            least = ENERGY_TOLERANCE * self.whole[form].max()
            energy, axes = _clear_directions(gram[own, form], least)
            root = axes * (size / np.sqrt(1.0 + size**2 * energy))
            over, along = root.T @ gram[own], root.T @ b[own]
            gram -= over[:, rows].T @ over
            b -= over[:, rows].T @ along
            taken.append(over)
            projected.append(along)
        return np.vstack(taken), np.concatenate(projected)

    def project_out(self, columns: Index, size: float = USUAL_SIZE) -> "Grams":
        """Grams without what `columns` of unbounded coefficients can explain."""
        if not len(columns):
            return self
        return self._without(columns, self.visible_root(columns, size))

    def visible_root(self, columns: Index, size: float) -> Array:
        """Combinations R (k, m) of some columns, of unit energy, that a size shows."""
        energy, axes = self._directions(columns)
        visible = energy > UNSEEN_ENERGY / max(size, USUAL_SIZE) ** 2
        return axes[:, visible] / np.sqrt(energy[visible])

    def _directions(self, columns: Index) -> tuple[Array, Array]:
        """Energies (m,), axes (k, m) of directions of columns, not rounding."""
        least = ENERGY_TOLERANCE * self.whole[columns].max()
        return _clear_directions(self.gram[np.ix_(columns, columns)], least)

    def _without(self, columns: Index, root: Array) -> "Grams":
        """Grams less what combinations `root` (k, m) of some columns take."""
        half = root.T @ self.gram[columns]
        projected = root.T @ self.b[columns]
        return dataclasses.replace(
            self,
            gram=self.gram - half.T @ half,
            b=self.b - half.T @ projected,
            energy=self.energy - float(projected @ projected),
        )

    def log_ratio(self, gain: Array, log_det: Array) -> Array:
        """Log evidence of columns that explain `gain` of the energy, over no column."""
        share = np.maximum(1.0 - gain / (2.0 * LEVEL_RATE + self.energy), 1e-300)
        power = 0.5 * self.size + LEVEL_SHAPE
        return -0.5 * log_det - power * np.log(share)

    def log_evidences(
        self,
        choices: Sequence[Index],
        sizes: Array,
        beside: tuple[Array, Array] | None = None,
    ) -> Array:
        """Log evidence (choices, sizes) of each choice of columns, over no column.

        beside  what forms in the model take (`taken_by`); none by default
        """
        alone = self
        table = np.zeros((len(choices), len(sizes)))
        if beside is not None:
            energy = self.energy - float(beside[1] @ beside[1])
            alone = dataclasses.replace(self, energy=energy)
        for numbers, rows in group_by_count(choices):
            gram, b = self.gram[rows[:, :, None], rows[:, None, :]], self.b[rows]
            if beside is not None:
                gram, b = left_beside(gram, b, beside[0][:, rows], beside[1])
            least = ENERGY_TOLERANCE * self.whole[rows].max(axis=1, initial=0.0)
            gain, log_det = explained_energy(gram, b, sizes, least)
            table[numbers] = alone.log_ratio(gain, log_det)
        return table


def left_beside(
    gram: Array, b: Array, taken: Array, projected: Array
) -> tuple[Array, Array]:
    """What directions (k,) leave of Gram matrices (a, d, d) and projections b (a, d).

    taken       (k, a, d) products of the directions with the columns
    projected   (k,) with the residual
    """
    over = taken.transpose(1, 0, 2)
    left = gram - over.swapaxes(1, 2) @ over
    return left, b - projected @ over


def _clear_directions(gram: Array, least: float) -> tuple[Array, Array]:
    """Energies (m,) and axes (k, m) of a Gram matrix (k, k), those above the least."""
    energy, axes = np.linalg.eigh(gram)
    clear = energy > least
    return energy[clear], axes[:, clear]


def group_by_count(choices: Sequence[Index]) -> list[tuple[Index, Index]]:
    """Numbers (a,) and columns (a, d) of the choices of each number of columns."""
    counts = np.array([len(choice) for choice in choices], dtype=int)
    groups = []
    for count in np.unique(counts):
        numbers = np.flatnonzero(counts == count)
        groups.append((numbers, np.array([choices[int(k)] for k in numbers])))
    return groups


def separated(gram: Array, columns: Index, rival: Index, precision: Array) -> Array:
    """What a rival leaves of some columns: A_kk - A_kj (A_jj + P)^-1 A_jk.

    Grams (..., K, K); columns `columns` (k,), those of the rival (j,) with their prior
    precision (j,). The result is (..., k, k).
    """
    cross = gram[..., rival[:, None], columns]
    inner = gram[..., rival[:, None], rival] + np.diag(precision)
    absorbed = np.swapaxes(cross, -1, -2) @ np.linalg.solve(inner, cross)
    return np.asarray(gram[..., columns[:, None], columns] - absorbed)


def explained_energy(
    gram: Array, b: Array, sizes: Array, least: Array
) -> tuple[Array, Array]:
    """Energy that columns explain at each prior size, and log determinants.

    For Gram matrices (a, d, d) and projections b (a, d), both results are (a, sizes).
    Directions of less energy than `least` (a,) are none.
    """
    values, vectors = np.linalg.eigh(gram)
    clear = values > least[:, None]
    energy = np.where(clear, np.einsum("akj,ak->aj", vectors, b) ** 2, 0.0)
    return linear_algebra.explained_energy(
        np.where(clear, values, 0.0), energy, sizes**2
    )


class WhitenedColumns:
    """Columns (N, K) in a metric, of which some at a time are wanted as Grams.

    Columns of many readings take much memory once they are whitened: `grams_of` and
    `ChoiceGrams` have few at a time.
    """

    def __init__(
        self,
        problem: GapProblem,
        metric: Metric,
        columns: Array,
        residual: Array | None = None,
    ) -> None:
        """Whiten the columns; the residual's scores (N,) in the metric may be known."""
        if residual is None:
            residual = metric.scores(problem.residual[:, None])[:, 0]
        #: (K,) energy of each column before the parameters absorb
        self.whole = np.zeros(columns.shape[1])
        #: (N, K) scores in the metric
        self.scores = np.empty((metric.size, columns.shape[1]))
        for start in range(0, columns.shape[1], COLUMNS_AT_ONCE):
            some = slice(start, start + COLUMNS_AT_ONCE)
            white = metric.whiten(columns[:, some])
            self.whole[some] = np.einsum("nk,nk->k", white, white)
            self.scores[:, some] = metric.remaining(white)
        self._energy = float(residual @ residual)
        base = log_student(metric.log_det, self._energy, metric.size)
        self._base = float(base)
        #: (K,) projections of the residual
        self.b = self.scores.T @ residual

    def grams(self, columns: slice | Index = slice(None)) -> Grams:
        """Grams of some columns; `base` is the log evidence of no gap."""
        some = self.scores[:, columns]
        return Grams(
            gram=some.T @ some,
            b=self.b[columns],
            whole=self.whole[columns],
            energy=self._energy,
            size=len(some),
            base=self._base,
        )


def grams_of(
    problem: GapProblem, metric: Metric, columns: Columns, numbers: Index
) -> Grams:
    """Grams of the columns `numbers` (K,): few are whitened at a time, and each once."""
    count = len(numbers)
    chunks = -(-count // COLUMNS_AT_ONCE)
    residual = metric.scores(problem.residual[:, None])[:, 0]
    scores, b, whole = np.empty((metric.size, count)), np.empty(count), np.empty(count)
    for part in np.array_split(np.arange(count), max(chunks, 1)):
        forms = columns.take(numbers[part])
        some = WhitenedColumns(problem, metric, forms, residual)
        scores[:, part], b[part], whole[part] = some.scores, some.b, some.whole
    gram = scores.T @ scores
    return dataclasses.replace(some.grams(slice(0)), gram=gram, b=b, whole=whole)


class ChoiceGrams:
    """Inner products of K columns, those among columns of one choice alone.

    grams     Gram matrix (d, d) of each choice
    diagonal  (K,) energy of each column
    b, whole  (K,) as of `Grams`
    """

    def __init__(
        self,
        problem: GapProblem,
        metric: Metric,
        columns: Columns,
        choices: Sequence[Index],
    ) -> None:
        """Whiten one choice at a time. Grams of choices within others are theirs."""
        residual = metric.scores(problem.residual[:, None])[:, 0]
        self.diagonal, self.b, self.whole = np.zeros((3, columns.shape[1]))
        holder, place = np.full((2, columns.shape[1]), -1, dtype=np.intp)
        found: dict[int, Array] = {}
        for k in sorted(range(len(choices)), key=lambda k: -len(choices[k])):
            choice = choices[k]
            holders = np.unique(holder[choice])
            if len(holders) != 1 or holders[0] < 0:
                holder[choice], place[choice] = k, np.arange(len(choice))
                forms = columns.take(choice)
                own = WhitenedColumns(problem, metric, forms, residual).grams()
                self.b[choice], self.whole[choice] = own.b, own.whole
                self.diagonal[choice], found[k] = own.gram.diagonal(), own.gram
            rows = place[choice]
            found[k] = found[int(holder[choice[0]])][np.ix_(rows, rows)]
        self.grams = [found[k] for k in range(len(choices))]


def log_student(log_det: ArrayLike, energy: ArrayLike, size: int) -> Array:
    """Log density of readings with r^T C^-1 r = energy, their level integrated out."""
    half = 0.5 * size + LEVEL_SHAPE
    constant = (
        special.gammaln(half)
        - special.gammaln(LEVEL_SHAPE)
        + LEVEL_SHAPE * np.log(LEVEL_RATE)
        - 0.5 * size * np.log(2.0 * np.pi)
    )
    log_energy = np.log(LEVEL_RATE + 0.5 * np.asarray(energy))
    return np.asarray(constant - 0.5 * np.asarray(log_det) - half * log_energy)


def compress(
    problem: GapProblem, blocks: Iterable[Block] = (), least: float = MIN_SIZE
) -> Array:
    """Columns (N, k') with the same covariance as [H Lambda^1/2, columns of blocks].

    They are orthogonal, the largest first. Directions of less size than the `least`, by
    default far below the noise, are left out. Those of long sessions are found from
    triangles of some rows after others.
    """
    count, slopes = len(problem), Block.of(problem.slopes)
    columns = Columns(count, [slopes, *blocks])
    width = columns.shape[1]
    step = max(VALUES_AT_ONCE // max(width, 1), 2 * width, 1)
    rows = [slice(start, start + step) for start in range(0, count, step)]
    triangle = np.zeros((0, width))
    for some in rows:
        triangle = np.vstack([triangle, columns.all(some)])
        if len(rows) > 1:
            triangle = np.asarray(np.linalg.qr(triangle, mode="r"))
    _, sizes, turn = np.linalg.svd(triangle, full_matrices=False)
    axes = turn[sizes > least].T
    compressed = np.empty((count, axes.shape[1]))
    for some in rows:
        compressed[some] = columns.all(some) @ axes
    return compressed


def visible(compressed: Array) -> Array:
    """Those of compressed columns (N, k) that are not far below the noise."""
    return np.asarray(compressed[:, np.linalg.norm(compressed, axis=0) > MIN_SIZE])


def log_evidence(
    problem: GapProblem, law: NoiseLaw, columns: Array, rows: Index | None = None
) -> float:
    """Log evidence of the readings `rows`, all by default, their level integrated out.

    The readings are r ~ N(0, s^2 (Sigma + columns columns^T)) under a law. `columns`
    (N, k) hold the parameters' slopes too, as from `compress`.
    """
    factor = law.factor(problem.structure, rows)
    white = factor.whiten(np.column_stack([columns, problem.residual]))
    products = white.T @ white
    products[:-1, :-1] += np.eye(columns.shape[1])
    products[-1, -1] += np.finfo(float).eps  # readings may have no error at all
    diagonal = np.diag(np.linalg.cholesky(products))
    log_det = factor.log_det + 2.0 * np.log(diagonal[:-1]).sum()
    return float(log_student(log_det, diagonal[-1] ** 2, len(white)))


def noise_level(grams: Grams) -> float:
    """Noise level of what is not explained: the mode of s."""
    energy = LEVEL_RATE + 0.5 * grams.energy
    return float(np.sqrt(energy / (0.5 * grams.size + LEVEL_SHAPE)))


# Noise laws that all hypotheses share, weighted so that sums over them integrate.
#
# The noise law is not known before the gap is, and the evidence of a hypothesis is an
# integral over laws u with the prior p(u) of `oed.noise.prior`:
#
# p(r | h) = integral p(r | h, u) p(u) du.
#
# Laws are drawn from the posteriors p(u | r, a) of a few models a: no gap, any gap, the
# gaps that look best. With Z_a = p(r | a), draws u_l, l = 1 ... L, as many of each model,
# give (Veach and Guibas 1995, balance heuristic)
#
# p(r | h) = sum_l W_l p(r | h, u_l),    1 / W_l = (L / A) sum_a p(r | a, u_l) / Z_a.
#
# It is exact for h = a alone, and the same laws serve every hypothesis. A common factor
# on the noise is integrated over in closed form (`evidence`); the laws hold the rest.

N_POINTS = 48  #: points of a model's posterior, by which its evidence is computed
#: coordinates beyond which a law is not looked at, in prior sd: what a run shares is
#: below some hundred times the noise, and single readings keep some of it
MAX_COORDINATE = 4.5
DRAWS_OF_EACH = 4  #: laws that are drawn of each model

WeighedLaw = tuple[NoiseLaw, float]  #: a noise law, and the log of its weight


@dataclasses.dataclass(frozen=True, eq=False)
class LawPosterior:
    """Posterior of the noise law with some columns in the model."""

    columns: Array  #: (N, k') compressed, the parameters' slopes among them
    mode: NoiseLaw  #: the most probable law
    draws: Array  #: (EACH, d) coordinates of laws drawn from it
    log_evidence: float  #: of the readings, over all laws


def posterior(problem: GapProblem, columns: Array) -> LawPosterior:
    """The law's posterior with columns (N, k), the slopes among them, in the model."""
    prior, model = _prior(problem), linear_model(problem, columns)

    def cost(u: Array) -> Array:
        values = log_evidences(model, _laws(problem, u))
        log_prior = -0.5 * (u**2).sum(axis=1) - 0.5 * u.shape[1] * np.log(2.0 * np.pi)
        return np.asarray(-values - log_prior)

    starts = prior.starts()[:, 1:]
    drawn = draw_laws(
        cost, starts, MAX_COORDINATE, points=N_POINTS, draws=DRAWS_OF_EACH
    )
    law = NoiseLaw(_laws(problem, drawn.mode[None]))
    return LawPosterior(columns, law, drawn.draws, drawn.log_integral)


def mixture(
    problem: GapProblem, posteriors: Sequence[LawPosterior]
) -> list[WeighedLaw]:
    """Laws drawn from several posteriors, with the logs of their weights W."""
    laws = _laws(problem, np.vstack([p.draws for p in posteriors]))
    table = np.column_stack(
        [
            log_evidences(linear_model(problem, p.columns), laws) - p.log_evidence
            for p in posteriors
        ]
    )
    each = len(laws) / len(posteriors)
    log_weights = -special.logsumexp(table, axis=1) - np.log(each)
    drawn = [NoiseLaw(laws.take([k])) for k in range(len(laws))]
    return list(zip(drawn, map(float, log_weights), strict=True))


def _prior(problem: GapProblem) -> NoisePrior:
    """The prior of the laws; its first scale, the common factor, is kept at 1."""
    return NoisePrior.of(problem.structure).sparse()


def _laws(problem: GapProblem, u: Array) -> Laws:
    """Laws at coordinates (L, d), all but the first scale's."""
    return _prior(problem).laws(np.column_stack([np.zeros(len(u)), u]))


def linear_model(problem: GapProblem, columns: Array) -> ResidualModel:
    """The residual as a linear model of columns (N, k), parameters' slopes among them."""
    structure = problem.structure
    residual, slopes = (structure.standardise(v) for v in (problem.residual, columns))
    return ResidualModel(structure, residual, slopes, np.zeros(columns.shape[1]))


def log_evidences(model: ResidualModel, laws: Laws) -> Array:
    """Log evidences (L,) of a problem's model under each law, the level integrated out."""
    solved = model.solve(laws)
    structure = model.structure
    log_det = solved.log_size + 2.0 * structure.log_unit
    return log_student(log_det, solved.energy, len(structure))
