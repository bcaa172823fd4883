"""Search over sets of effects by closed-form evidence, under one noise law.

An effect's evidence is the sum over its forms (atoms) and sizes. For a set of effects
the sum over all combinations is taken about the best one: with a* the best forms,

    log sum_a w(a) p(r | a) ~ log p(r | a*)
        + sum_i ( log sum_a_i w(a_i) p(r | a_i, a*_others) - log p(r | a*) ).
"""

import copy
import dataclasses
import functools
from collections.abc import Iterable, Mapping, Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES, UNKNOWN_SIZES
from oed.gap.data import evidence
from oed.gap.data.evidence import ChoiceGrams, Grams, WhitenedColumns
from oed.gap.data.problem import GapProblem, Metric
from oed.gap.forms import discrepancy
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw
from oed.noise_law import Outliers
from oed.result import UNKNOWN

# Hypotheses of a diagnosis: sets of effects, with or without an unknown remainder.

#: prior probabilities: nothing acts, or nothing that the readings show (two of seven
#: sizes of a gap); one effect, two, three, an unknown alone, one or two with an unknown
#: remainder
PRIOR = {
    "none": 0.34,
    "unseen": 0.19,
    "one": 0.17,
    "two": 0.06,
    "three": 0.007,
    "unknown": 0.07,
    "one+": 0.135,
    "two+": 0.028,
}
#: prior probability that something acts that is too small to be seen, where nothing shows
UNSEEN_SHARE = PRIOR["unseen"] / (PRIOR["unseen"] + PRIOR["none"])
#: kinds of PRIOR by the number of effects, without and with an unknown remainder
_WITHOUT_UNKNOWN = (("none", "unseen"), ("one",), ("two",), ("three",))
_WITH_UNKNOWN = (("unknown",), ("one+",), ("two+",), ("two+",))

#: what a hypothesis says, whatever its forms: effects, whether an unknown acts
Key = tuple[frozenset[str], bool]


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A set of effects, with or without an unknown remainder, and no more that shows."""

    effects: tuple[str, ...]  #: names of the effects
    unknown: bool  #: whether an unknown remainder acts as well
    atoms: tuple[int, ...]  #: number of each effect's best form in the library
    sizes: tuple[float, ...]  #: size of each effect's best form
    #: number of the best unknown process; None without a remainder
    process: int | None = None
    process_size: float = 0.0  #: size of the best unknown process
    log_evidence: float = 0.0  #: of the readings, over all forms and sizes
    log_prior: float = 0.0  #: log prior probability
    law: int = 0  #: number of the noise law that suits it best
    #: number of equally good noise laws that its evidence rests on
    effective_laws: float = 1.0
    #: log predictive density of whole withheld runs; nan where not known
    log_prediction: float = float("nan")

    @property
    def score(self) -> float:
        """Log posterior up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def key(self) -> Key:
        """What it says, whatever its forms."""
        return frozenset(self.effects), self.unknown

    @property
    def names(self) -> tuple[str, ...]:
        """Its effects, and an unknown."""
        return (*self.effects, UNKNOWN) if self.unknown else self.effects

    @property
    def is_gap(self) -> bool:
        """Whether it says that there is a gap."""
        return bool(self.effects) or self.unknown

    def without(self, i: int) -> tuple[tuple[int, ...], tuple[float, ...]]:
        """Forms and sizes of all its effects but the i-th."""
        atoms = self.atoms[:i] + self.atoms[i + 1 :]
        return atoms, self.sizes[:i] + self.sizes[i + 1 :]

    def with_form(self, part: int, form: int, size: float) -> "Hypothesis":
        """The same with another form of one part, an effect or the remainder."""
        if part == len(self.effects):
            return dataclasses.replace(self, process=form, process_size=size)
        atoms, sizes = list(self.atoms), list(self.sizes)
        atoms[part], sizes[part] = form, size
        return dataclasses.replace(self, atoms=tuple(atoms), sizes=tuple(sizes))

    def forms(
        self, library: Library, processes: Library
    ) -> list[tuple[Library, int, float]]:
        """Library, number and size of each of its forms, the remainder's last."""
        pairs = zip(self.atoms, self.sizes, strict=True)
        forms = [(library, atom, size) for atom, size in pairs]
        if self.process is not None:
            forms.append((processes, self.process, self.process_size))
        return forms

    def columns(
        self, library: Library, processes: Library, factor: float = 1.0
    ) -> Array:
        """Columns (N, k) of its forms at their sizes, times a factor."""
        forms = self.forms(library, processes)
        parts = [of.scaled_columns(atom, factor * size) for of, atom, size in forms]
        return np.hstack([np.zeros((len(library.columns), 0)), *parts])


def log_prior(count: int, unknown: bool, effects: int) -> float:
    """Log prior of one set of `count` effects out of `effects`."""
    kinds = _WITH_UNKNOWN if unknown else _WITHOUT_UNKNOWN
    sets = special.comb(max(effects, 1), count)
    probability = sum(PRIOR[kind] for kind in kinds[count])
    return float(np.log(probability) - np.log(sets))


#: columns of each selected effect, with the size of its coefficients
Selected = Sequence[tuple[Index, float]]
_NO_COLUMNS = np.empty(0, dtype=np.intp)
#: how large an unknown may be, against the noise
REMAINDER_SIZES = UNKNOWN_SIZES.values


class Remainders:
    """The processes that an unknown remainder may be, under one noise law."""

    def __init__(
        self, products: ChoiceGrams, processes: Library, log_kinds: Array
    ) -> None:
        """Lay out the processes, those with as many columns together.

        products    of their columns
        log_kinds   (processes,) log prior of the kind of each
        """
        self.products = products
        self._columns = [atom.columns for atom in processes.atoms]
        #: numbers (a,), columns (a, d) and Gram matrices (a, d, d)
        self._groups = [
            (numbers, rows, np.array([products.grams[k] for k in numbers]))
            for numbers, rows in evidence.group_by_count(self._columns)
        ]
        log_weights = np.array([atom.log_weight for atom in processes.atoms])
        energy = energies(products.diagonal, self._columns)
        log_sizes = UNKNOWN_SIZES.log_visible_shares(energy)
        #: (processes, sizes) log prior of each
        self.log_prior = (log_weights + log_kinds)[:, None] + log_sizes

    def __len__(self) -> int:
        return len(self._columns)

    def log_evidences(self, alone: Grams, taken: Array, projected: Array) -> Array:
        """Log evidence (processes, sizes) of each process, over no remainder.

        alone       grams of the selected columns, these in the model
        taken       products (k, P) of directions that the selected effects could explain
                    with all processes' columns
        projected   (k,) with the residual
        """
        table = np.empty((len(self._columns), len(REMAINDER_SIZES)))
        products = self.products
        for numbers, rows, blocks in self._groups:
            over = taken[:, rows]
            gram, b = evidence.left_beside(blocks, products.b[rows], over, projected)
            least = evidence.ENERGY_TOLERANCE * products.whole[rows].max(axis=1)
            gain, log_det = evidence.explained_energy(gram, b, REMAINDER_SIZES, least)
            table[numbers] = alone.log_ratio(gain, log_det)
        return np.asarray(table + self.log_prior)


def energies(diagonal: Array, choices: Sequence[Index]) -> Array:
    """Energy (a,) of each choice of columns, from that of each column (K,)."""
    return np.array([diagonal[columns].sum() for columns in choices])


#: log evidence below the best at which sets are not taken further
MAX_LOG_DEFICIT = 14.0
N_SETS = 8  #: number of sets that are taken further
MAX_ROUNDS = 4  #: rounds in which the effects of a set take turns at their best forms
EFFECT_SIZE_VALUES = EFFECT_SIZES.values  #: sizes of effects, in expected sizes


@dataclasses.dataclass(frozen=True, slots=True)
class Further:
    """A further effect over a base: its log evidence, its best form and size."""

    log_evidence: float
    atom: int
    size: float
    of_best: float  #: log evidence of that form at that size alone


class Search:
    """Hypotheses about a problem's residuals under one noise law."""

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        law: NoiseLaw,
        log_prior: float,
        *,
        outliers: Outliers | None = None,
        candidates: Sequence[Hypothesis] = (),
        given: GapProblem | None = None,
    ) -> None:
        """Lay out the forms of all effects.

        log_prior    of the noise law
        outliers     those that the problem's residuals are without, if any
        candidates   hypotheses to evaluate in place of a search
        given        the problem with its outliers; the same by default
        """
        self.problem = problem
        self.given = problem if given is None else given
        self.library = library
        self.processes = processes
        self.law = law
        self.log_prior = log_prior
        self.outliers = outliers
        log_outliers = 0.0 if outliers is None else outliers.log_odds
        self._log_law = log_prior + log_outliers
        self._atoms_of = {
            effect: np.array(library.atoms_of(effect), dtype=np.intp)
            for effect in library.effects
        }
        self._candidates = candidates
        names = {name for h in candidates for name in h.effects}
        of_question = names if candidates else set(library.effects)
        forms = [atom.columns for atom in library.atoms if atom.effect in of_question]
        #: numbers of the columns of the effects in question
        self._needed = np.unique(np.concatenate([_NO_COLUMNS, *forms]))
        #: products (k, P) of the columns of effects' forms with all processes' columns
        self._cross: dict[bytes, Array] = {}
        self._posteriors: dict[tuple[str, tuple[tuple[int, float], ...]], Array] = {}
        self._hypotheses: list[Hypothesis] = []

    def release(self) -> None:
        """Give the memory of all products back; who needs one again computes it."""
        for name in ("_metric", "_questioned", "_remainders", "grams"):
            self.__dict__.pop(name, None)
        self._cross.clear()
        self._posteriors.clear()

    def with_weight(self, log_prior: float) -> "Search":
        """The same search with another log prior of its noise law."""
        other = copy.copy(self)
        change = log_prior - self.log_prior
        other.log_prior = log_prior
        other._log_law = self._log_law + change
        other._hypotheses = [
            dataclasses.replace(h, log_evidence=h.log_evidence + change)
            for h in self._hypotheses
        ]
        return other

    def columns_of(self, atom: int) -> Index:
        """Columns of a form."""
        return self.library.atoms[atom].columns

    def constants(self, h: Hypothesis) -> dict[str, Mapping[str, float]]:
        """{effect: its constants} in the forms of a hypothesis."""
        atoms = [self.library.atoms[k] for k in h.atoms]
        return {atom.effect: atom.constants for atom in atoms}

    # -- products of all forms' columns, computed where one is asked for ---------------
    @functools.cached_property
    def _metric(self) -> Metric:
        """The metric of the law."""
        return Metric(self.problem, self.law)

    @functools.cached_property
    def _questioned(self) -> Grams:
        """Grams of the columns of the effects in question."""
        return self._grams_of(self._needed)

    def _grams_of(self, columns: Index) -> Grams:
        library = self.library.columns
        return evidence.grams_of(self.problem, self._metric, library, columns)

    def _place(self, columns: Index) -> Index:
        """Numbers of some columns among those of the effects in question."""
        return np.searchsorted(self._needed, columns)

    def _grams_among(self, columns: Index) -> Grams:
        """Grams of some columns of the effects in question."""
        return self._questioned.take(self._place(columns))

    @functools.cached_property
    def _remainders(self) -> "Remainders":
        """The processes that an unknown remainder may be."""
        processes = self.processes
        choices = [atom.columns for atom in processes.atoms]
        products = ChoiceGrams(self.problem, self._metric, processes.columns, choices)
        log_kinds = discrepancy.log_shares(processes, self.library)
        return Remainders(products, processes, log_kinds)

    def _log_remainders(self, h: Hypothesis) -> Array:
        """Log evidence (processes, sizes) of each process beside a set, over no remainder."""
        alone, selected = self._selected(h)
        return self._remainders.log_evidences(alone, *self._taken(selected))

    def _with_processes(self, columns: Index) -> Array:
        """Products (k, P) of the columns of a form with all processes' columns."""
        key = columns.tobytes()
        if key not in self._cross:
            form = self._metric.precision(self.library.columns.take(columns))
            self._cross[key] = self.processes.columns.products(form)
        return self._cross[key]

    def _taken(self, selected: Selected) -> tuple[Array, Array]:
        """Products (k, P), (k,) of what effects explain with processes and residual."""
        columns = np.concatenate([_NO_COLUMNS, *(c for c, _ in selected)])
        grams = self._grams_among(columns)
        parts = [self._with_processes(c) for c, _ in selected]
        cross = np.vstack([np.zeros((0, len(self._remainders.products.b))), *parts])
        taken, projected = [np.zeros((0, cross.shape[1]))], [np.zeros(0)]
        start = 0
        for own, size in selected:
            rows = np.arange(start, start + len(own))
            start += len(own)
            root = grams.visible_root(rows, size)
            over, residual = root.T @ cross[rows], root.T @ grams.b[rows]
            cross = cross - (grams.gram[:, rows] @ root) @ over
            grams = grams.project_out(rows, size)
            taken.append(over)
            projected.append(residual)
        return np.vstack(taken), np.concatenate(projected)

    @functools.cached_property
    def grams(self) -> Grams:
        """Grams of all columns of all effects."""
        columns = np.arange(self.library.columns.shape[1])
        if len(self._needed) == len(columns):
            return self._questioned
        return self._grams_of(columns)

    @functools.cached_property
    def _log_prior(self) -> Array:
        """Log prior (atoms, sizes) of each form of the effects in question."""
        diagonal = np.zeros(self.library.columns.shape[1])
        diagonal[self._needed] = self._questioned.gram.diagonal()
        return self._log_prior_by(diagonal)

    @functools.cached_property
    def _log_prior_of_all(self) -> Array:
        """The same of each form of all effects."""
        return self._log_prior_by(self.grams.gram.diagonal())

    def _log_prior_by(self, diagonal: Array) -> Array:
        atoms = self.library.atoms
        log_weights = np.array([atom.log_weight for atom in atoms])
        energy = energies(diagonal, [atom.columns for atom in atoms])
        return log_weights[:, None] + EFFECT_SIZES.log_visible_shares(energy)

    # -- one hypothesis ----------------------------------------------------------------
    def grams_with(self, atoms: Sequence[int], sizes: Sequence[float]) -> Grams:
        """Grams of the columns of forms alone, these in the model one after the other."""
        columns = [self.columns_of(k) for k in atoms]
        grams = self._grams_among(np.concatenate([_NO_COLUMNS, *columns]))
        start = 0
        for form, size in zip(columns, sizes, strict=True):
            grams = grams.select(np.arange(start, start + len(form)), size)
            start += len(form)
        return grams

    def noise_level(self, h: Hypothesis) -> float:
        """Noise level of what a hypothesis does not explain."""
        columns = h.columns(self.library, self.processes)
        grams = WhitenedColumns(self.problem, self._metric, columns).grams()
        return evidence.noise_level(grams.select(np.arange(columns.shape[1]), 1.0))

    def law_at(self, level: float) -> NoiseLaw:
        """The law at a noise level, with the outliers' distribution."""
        law = dataclasses.replace(self.law, level=level)
        return law if self.outliers is None else self.outliers.with_outliers(law)

    def forms(self, h: Hypothesis, part: int) -> list[tuple[float, Hypothesis]]:
        """A hypothesis with each form of one of its parts, likeliest first, with shares.

        Parts are its effects in order, then its unknown remainder. Each form has its
        best size.
        """
        if part == len(h.effects):
            table = self._log_remainders(h)
            numbers = np.arange(len(table))
            sizes = REMAINDER_SIZES
        else:
            table = self._log_posterior(h.effects[part], *h.without(part))
            numbers, sizes = self._atoms_of[h.effects[part]], EFFECT_SIZE_VALUES
        shares = special.softmax(special.logsumexp(table, axis=1))
        best = sizes[np.argmax(table, axis=1)]
        return [
            (float(shares[k]), h.with_form(part, int(numbers[k]), float(best[k])))
            for k in np.argsort(-shares, kind="stable")
        ]

    def log_form_prior(self, h: Hypothesis) -> float:
        """Log prior of a hypothesis' forms and sizes among those that its parts can have."""
        total = 0.0
        for atom, size in zip(h.atoms, h.sizes, strict=True):
            total += self._log_prior[atom, np.searchsorted(EFFECT_SIZE_VALUES, size)]
        if h.process is not None:
            number = np.searchsorted(REMAINDER_SIZES, h.process_size)
            total += self._remainders.log_prior[h.process, number]
        return float(total)

    # -- sets of effects ---------------------------------------------------------------
    def screen(
        self, without: Iterable[str], atoms: Sequence[int], sizes: Sequence[float]
    ) -> dict[str, Further]:
        """Each further effect's log evidence, its best form and size, beside some forms."""
        further = [e for e in self.library.effects if e not in set(without)]
        if not further:
            return {}
        tried = np.sort(np.concatenate([self._atoms_of[e] for e in further]))
        beside = self.grams.taken_by([self.columns_of(k) for k in atoms], sizes)
        table = self.grams.log_evidences(
            [self.columns_of(k) for k in tried], EFFECT_SIZE_VALUES, beside
        )
        posterior = table + self._log_prior_of_all[tried]
        best = {}
        for effect in further:
            rows = np.searchsorted(tried, self._atoms_of[effect])
            best[effect] = self._best(tried[rows], posterior[rows])
        return best

    def _best(self, atoms: Index, posterior: Array) -> Further:
        """The best of some forms by their log posterior (atoms, sizes)."""
        row, column = np.unravel_index(int(np.argmax(posterior)), posterior.shape)
        return Further(
            log_evidence=float(np.logaddexp.reduce(posterior, axis=None)),
            atom=int(atoms[row]),
            size=float(EFFECT_SIZE_VALUES[column]),
            of_best=float(posterior[row, column] - self._log_prior[atoms[row], column]),
        )

    def fit(
        self, effects: Sequence[str], atoms: Sequence[int], sizes: Sequence[float]
    ) -> Hypothesis:
        """Hypothesis of effects from forms: best by turns, evidence over all."""
        count = len(self.library.effects)
        prior = log_prior(len(effects), False, count)
        h = Hypothesis(
            tuple(effects), False, tuple(atoms), tuple(sizes), log_prior=prior
        )
        further_forms = 0.0
        for _ in range(MAX_ROUNDS):
            before = h
            further_forms = 0.0
            for i, effect in enumerate(effects):
                table = self._log_posterior(effect, *h.without(i))
                best = self._best(self._atoms_of[effect], table)
                h = h.with_form(i, best.atom, best.size)
                further_forms += best.log_evidence - best.of_best
            if h == before:
                break
        base = self._selected(h)[0].base
        total = base + (further_forms + self._log_law)
        return dataclasses.replace(h, log_evidence=total)

    def add_unknown(self, h: Hypothesis) -> Hypothesis:
        """The same set of effects with an unknown remainder, orthogonal to them."""
        table = self._log_remainders(h)
        process, size = np.unravel_index(int(np.argmax(table)), table.shape)
        over_none = float(np.logaddexp.reduce(table, axis=None))
        return dataclasses.replace(
            h,
            unknown=True,
            process=int(process),
            process_size=float(REMAINDER_SIZES[size]),
            log_evidence=h.log_evidence + over_none,
            log_prior=log_prior(len(h.effects), True, len(self.library.effects)),
        )

    def _log_posterior(
        self, effect: str, others: Sequence[int], sizes: Sequence[float]
    ) -> Array:
        """Log posterior (atoms, sizes) of forms over none, beside others."""
        key = (effect, tuple(zip(others, sizes, strict=True)))
        if key not in self._posteriors:
            grams, place = self._questioned, self._place
            selected = [place(self.columns_of(k)) for k in others]
            forms = [place(self.columns_of(k)) for k in self._atoms_of[effect]]
            beside = grams.taken_by(selected, sizes)
            table = grams.log_evidences(forms, EFFECT_SIZE_VALUES, beside)
            prior = self._log_prior[self._atoms_of[effect]]
            self._posteriors[key] = table + prior
        return self._posteriors[key]

    def _selected(self, h: Hypothesis) -> tuple[Grams, list[tuple[Index, float]]]:
        """Grams of a set's columns alone, these in the model; the columns and sizes."""
        selected = [
            (self.columns_of(k), t) for k, t in zip(h.atoms, h.sizes, strict=True)
        ]
        return self.grams_with(h.atoms, h.sizes), selected

    # -- the search --------------------------------------------------------------------
    def run(self) -> list[Hypothesis]:
        """No gap, one to three effects, and these with an unknown, best first."""
        if not self._hypotheses:
            chosen = self._candidates
            unsorted = [self._evaluate(h) for h in chosen] if chosen else self._run()
            self._hypotheses = sorted(unsorted, key=lambda h: -h.score)
            if self._candidates:  # one of many searches, of which few are asked again
                self.release()
        return self._hypotheses

    def _evaluate(self, candidate: Hypothesis) -> Hypothesis:
        """A hypothesis of another search under this one's law."""
        h = self.fit(candidate.effects, candidate.atoms, candidate.sizes)
        return self.add_unknown(h) if candidate.unknown else h

    def _run(self) -> list[Hypothesis]:
        empty = self.fit((), (), ())
        singles = self._extend([empty])
        pairs = self._extend(singles[:N_SETS])
        triples = self._extend(pairs[: N_SETS // 2])
        without_unknown = [empty, *singles, *pairs, *triples]
        without_unknown.sort(key=lambda h: -h.score)
        # an effect may show beside an unknown alone: every single one is tried with it
        extended = [
            h for k, h in enumerate(without_unknown) if k < N_SETS or len(h.effects) < 2
        ]
        mixed = [self.add_unknown(h) for h in extended if len(self._remainders)]
        return [*without_unknown, *mixed]

    def _extend(self, bases: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Each base with one effect more: the best few fitted, best first."""
        tried: dict[frozenset[str], tuple[float, Hypothesis, str, Further]] = {}
        for base in bases:
            screened = self.screen(base.effects, base.atoms, base.sizes)
            for effect, further in screened.items():
                key = frozenset((*base.effects, effect))
                total = base.log_evidence + further.log_evidence
                if key not in tried or tried[key][0] < total:
                    tried[key] = (total, base, effect, further)
        ranked = sorted(tried.values(), key=lambda t: -t[0])
        if ranked and bases[0].effects:
            least = ranked[0][0] - MAX_LOG_DEFICIT
            ranked = [t for t in ranked if t[0] > least][: 2 * N_SETS]
        fitted = []
        for _, base, effect, further in ranked:
            atoms = (*base.atoms, further.atom)
            sizes = (*base.sizes, further.size)
            fitted.append(self.fit((*base.effects, effect), atoms, sizes))
        return sorted(fitted, key=lambda h: -h.score)
