"""Search over sets of effects by closed-form evidence, under one noise law.

An effect's evidence is the sum over its forms (atoms) and sizes. For a set of effects
the sum over all combinations is taken about the best one: with a* the best forms,

    log sum_a w(a) p(r | a) ~ log p(r | a*)
        + sum_i ( log sum_a_i w(a_i) p(r | a_i, a*_others) - log p(r | a*) ).
"""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Iterable, Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES
from oed.gap.cause.form_products import SIZES as UNKNOWN_SIZES
from oed.gap.cause.form_products import FormProducts
from oed.gap.cause.hypothesis import Hypothesis, log_prior
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams, WhitenedColumns
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.noise import NoiseLaw
from oed.noise_law import Outliers

#: log evidence below the best at which sets are not taken further
BEHIND = 14.0
#: number of sets that are taken further
SETS = 8
#: rounds in which the effects of a set take turns at their best forms
ROUNDS = 4
#: sizes of effects, in expected sizes
SIZES = EFFECT_SIZES.values
_NONE = np.empty(0, dtype=np.intp)


@dataclasses.dataclass(frozen=True, slots=True)
class Further:
    """A further effect over a base: its log evidence, its best form and size.

    of_best  log evidence of that form at that size alone
    """

    log_evidence: float
    atom: int
    size: float
    of_best: float


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
        in_question = names if candidates else set(library.effects)
        self._forms = FormProducts(problem, library, processes, law, in_question)
        self._posteriors: dict[tuple[str, tuple[tuple[int, float], ...]], Array] = {}
        self._hypotheses: list[Hypothesis] = []

    @property
    def grams(self) -> Grams:
        """Grams of all columns of the effects."""
        return self._forms.grams

    def release(self) -> None:
        """Give the memory of all products back; who needs one again computes it."""
        self._forms.release()
        self._posteriors.clear()

    def with_weight(self, log_prior: float) -> Search:
        """The same search with another log prior of its noise law."""
        other = copy.copy(self)
        change = log_prior - self.log_prior
        other.log_prior, other._log_law = log_prior, self._log_law + change
        other._hypotheses = [
            dataclasses.replace(h, log_evidence=h.log_evidence + change)
            for h in self._hypotheses
        ]
        return other

    def columns_of(self, atom: int) -> Index:
        """Columns of a form."""
        return self.library.atoms[atom].columns

    # -- one hypothesis ----------------------------------------------------------------

    def grams_with(self, atoms: Sequence[int], sizes: Sequence[float]) -> Grams:
        """Grams with these forms in the model."""
        grams = self.grams
        for atom, size in zip(atoms, sizes, strict=True):
            grams = grams.select(self.columns_of(atom), size)
        return grams

    def noise_level(self, h: Hypothesis) -> float:
        """Noise level of what a hypothesis does not explain."""
        columns = h.columns(self.library, self.processes)
        grams = WhitenedColumns(self.problem, self._forms.metric, columns).grams()
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
            table = self._forms.remainders.log_evidences(*self._selected(h))
            numbers, sizes = np.arange(len(table)), UNKNOWN_SIZES
        else:
            table = self._log_posterior(h.effects[part], *h.without(part))
            numbers, sizes = self._atoms_of[h.effects[part]], SIZES
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
            total += self._forms.log_prior[atom, np.searchsorted(SIZES, size)]
        if h.process is not None:
            place = np.searchsorted(UNKNOWN_SIZES, h.process_size)
            total += self._forms.remainders.log_prior[h.process, place]
        return float(total)

    # -- sets of effects ---------------------------------------------------------------

    def screen(self, grams: Grams, without: Iterable[str]) -> dict[str, Further]:
        """Each further effect's log evidence over `grams`, its best form and size."""
        further = [e for e in self.library.effects if e not in set(without)]
        if not further:
            return {}
        atoms = np.sort(np.concatenate([self._atoms_of[e] for e in further]))
        table = grams.log_evidences([self.columns_of(k) for k in atoms], SIZES)
        posterior = table + self._forms.log_prior_of_all[atoms]
        best = {}
        for effect in further:
            rows = np.searchsorted(atoms, self._atoms_of[effect])
            best[effect] = self._best(atoms[rows], posterior[rows])
        return best

    def _best(self, atoms: Index, posterior: Array) -> Further:
        """The best of some forms by their log posterior (atoms, sizes)."""
        row, column = np.unravel_index(int(np.argmax(posterior)), posterior.shape)
        return Further(
            log_evidence=float(np.logaddexp.reduce(posterior, axis=None)),
            atom=int(atoms[row]),
            size=float(SIZES[column]),
            of_best=float(
                posterior[row, column] - self._forms.log_prior[atoms[row], column]
            ),
        )

    def fit(
        self,
        effects: Sequence[str],
        atoms: Sequence[int],
        sizes: Sequence[float],
    ) -> Hypothesis:
        """Hypothesis of a set of effects: best forms by turns, evidence over all forms.

        `atoms` and `sizes` are the forms to start from.
        """
        count = len(self.library.effects)
        h = Hypothesis(
            effects=tuple(effects),
            unknown=False,
            atoms=tuple(atoms),
            sizes=tuple(sizes),
            process=None,
            process_size=0.0,
            log_evidence=0.0,
            log_prior=log_prior(len(effects), False, count),
        )
        further_forms = 0.0
        for _ in range(ROUNDS):
            before, further_forms = h, 0.0
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
        remainder = self._forms.remainders.best(*self._selected(h))
        return dataclasses.replace(
            h,
            unknown=True,
            process=remainder.process,
            process_size=remainder.size,
            log_evidence=h.log_evidence + remainder.log_evidence,
            log_prior=log_prior(len(h.effects), True, len(self.library.effects)),
        )

    def _log_posterior(
        self, effect: str, others: Sequence[int], sizes: Sequence[float]
    ) -> Array:
        """Log evidence (atoms, sizes) of an effect's forms over none, with their prior.

        Other forms are in the model at their sizes.
        """
        key = (effect, tuple(zip(others, sizes, strict=True)))
        if key not in self._posteriors:
            selected = [self.columns_of(k) for k in others]
            forms = [self.columns_of(k) for k in self._atoms_of[effect]]
            columns = np.unique(np.concatenate(forms))
            grams = self._forms.effects.grams(np.concatenate([*selected, columns]))
            grams, start = grams.select_in_order(selected, sizes)
            places = [start + np.searchsorted(columns, form) for form in forms]
            prior = self._forms.log_prior[self._atoms_of[effect]]
            self._posteriors[key] = grams.log_evidences(places, SIZES) + prior
        return self._posteriors[key]

    def _selected(self, h: Hypothesis) -> tuple[Grams, list[tuple[Index, float]]]:
        """Grams of a set's columns alone, these in the model; the columns and sizes."""
        columns = [self.columns_of(k) for k in h.atoms]
        grams = self._forms.effects.grams(np.concatenate([_NONE, *columns]))
        selected = list(zip(columns, h.sizes, strict=True))
        return grams.select_in_order(columns, h.sizes)[0], selected

    # -- the search --------------------------------------------------------------------

    def run(self) -> list[Hypothesis]:
        """The hypotheses worth comparing, best first.

        No gap, single effects, pairs and triples, and these with an unknown.
        """
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
        pairs = self._extend(singles[:SETS])
        triples = self._extend(pairs[: SETS // 2])
        known = [empty, *singles, *pairs, *triples]
        known.sort(key=lambda h: -h.score)
        # an effect may show beside an unknown alone: every single one is tried with it
        extended = [h for k, h in enumerate(known) if k < SETS or len(h.effects) < 2]
        mixed = [self.add_unknown(h) for h in extended if len(self._forms.remainders)]
        return [*known, *mixed]

    def _extend(self, bases: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Each base with one effect more: the best few fitted, best first."""
        tried: dict[frozenset[str], tuple[float, Hypothesis, str, Further]] = {}
        for base in bases:
            grams = self.grams_with(base.atoms, base.sizes)
            for effect, further in self.screen(grams, base.effects).items():
                key = frozenset((*base.effects, effect))
                total = base.log_evidence + further.log_evidence
                if key not in tried or tried[key][0] < total:
                    tried[key] = (total, base, effect, further)
        ranked = sorted(tried.values(), key=lambda t: -t[0])
        if ranked and bases[0].effects:
            least = ranked[0][0] - BEHIND
            ranked = [t for t in ranked if t[0] > least][: 2 * SETS]
        fitted = []
        for _, base, effect, further in ranked:
            atoms = (*base.atoms, further.atom)
            sizes = (*base.sizes, further.size)
            fitted.append(self.fit((*base.effects, effect), atoms, sizes))
        return sorted(fitted, key=lambda h: -h.score)
