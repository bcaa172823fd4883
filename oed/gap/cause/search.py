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

from oed.base.arrays import Array, Index
from oed.gap.cause.form_products import FormProducts
from oed.gap.cause.hypothesis import Hypothesis, log_prior
from oed.gap.cause.remainder import SIZES as UNKNOWN_SIZES
from oed.gap.data import evidence
from oed.gap.data.evidence import Grams
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.model.size_prior import EFFECT_SIZES
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers

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
    """A further effect over a base: its log evidence, its best form and size."""

    log_evidence: float
    atom: int
    size: float


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
        self._atoms = [atom.columns for atom in library.atoms]
        self._effect = np.array([atom.effect for atom in library.atoms])
        self._atoms_of = {
            effect: np.array(library.atoms_of(effect), dtype=np.intp)
            for effect in library.effects
        }
        self._candidates = candidates
        names = {name for h in candidates for name in h.effects}
        in_question = names if candidates else set(library.effects)
        self._forms = FormProducts(problem, library, processes, law, in_question)
        self._tables: dict[tuple[str, tuple[tuple[int, float], ...]], Array] = {}
        self._hypotheses: list[Hypothesis] = []

    @property
    def grams(self) -> Grams:
        """Grams of all columns of the effects."""
        return self._forms.grams

    def release(self) -> None:
        """Give the memory of all products back; who needs one again computes it."""
        self._forms.release()
        self._tables.clear()

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
        return self._atoms[atom]

    # -- one hypothesis ----------------------------------------------------------------

    def grams_with(self, atoms: Sequence[int], sizes: Sequence[float]) -> Grams:
        """Grams with these forms in the model."""
        return self._select(self.grams, atoms, sizes)

    def noise_level(self, h: Hypothesis) -> float:
        """Noise level of what a hypothesis does not explain."""
        columns, sizes = [self._atoms[k] for k in h.atoms], list(h.sizes)
        selected = self._columns_of_set(h)
        grams = self._forms.products.grams(selected)
        if h.process is not None:
            grams = self._forms.remainders.grams_with(grams, selected, h.process)
            columns.append(np.arange(len(selected), len(grams.b)))
            sizes.append(h.process_size)
        return evidence.noise_level(grams.select_in_order(columns, sizes)[0])

    def law_at(self, level: float) -> NoiseLaw:
        """The law at a noise level, with the outliers' distribution."""
        law = dataclasses.replace(self.law, level=level)
        return law if self.outliers is None else self.outliers.with_outliers(law)

    def forms(self, h: Hypothesis, part: int) -> list[tuple[float, Hypothesis]]:
        """A hypothesis with each form of one of its parts, likeliest first, with shares.

        Parts are its effects in order, then its unknown remainder. Each form has its
        best size.
        """
        shares = self._shares_of_forms(h, part)
        return [(share, h.with_form(part, form, size)) for share, form, size in shares]

    def _shares_of_forms(
        self, h: Hypothesis, part: int
    ) -> list[tuple[float, int, float]]:
        """Probability, number and best size of each form of a part, likeliest first."""
        if part == len(h.effects):
            table = self._forms.remainders.log_evidences(
                self._grams_alone(h), self._selected(h)
            )
            numbers, sizes = np.arange(len(table)), UNKNOWN_SIZES
        else:
            others = h.others(part)
            atoms = [h.atoms[j] for j in others]
            numbers, sizes = self._atoms_of[h.effects[part]], SIZES
            table = self._log_posterior(
                h.effects[part], atoms, [h.sizes[j] for j in others]
            )
        shares = special.softmax(special.logsumexp(table, axis=1))
        best = sizes[np.argmax(table, axis=1)]
        order = np.argsort(-shares, kind="stable")
        return [(float(shares[k]), int(numbers[k]), float(best[k])) for k in order]

    def likeness(self, h: Hypothesis) -> dict[str, float]:
        """Probability of each form of a hypothesis' unknown remainder, in words.

        The likeliest form comes first.
        """
        by_form: dict[str, float] = {}
        for share, form, _ in self._shares_of_forms(h, len(h.effects)):
            about = self.processes.atoms[form].about
            by_form[about] = by_form.get(about, 0.0) + share
        return dict(sorted(by_form.items(), key=lambda item: -item[1]))

    # -- sets of effects ---------------------------------------------------------------

    def screen(self, grams: Grams, without: Iterable[str]) -> dict[str, Further]:
        """Each further effect's log evidence over `grams`, its best form and size."""
        others = np.flatnonzero(~np.isin(self._effect, list(without)))
        if not others.size:
            return {}
        table = grams.log_evidences([self._atoms[k] for k in others], SIZES)
        posterior = table + self._forms.log_prior_of_all[others]
        best = {}
        for effect in dict.fromkeys(self._effect[others]):
            rows = np.flatnonzero(self._effect[others] == effect)
            of_effect = posterior[rows]
            row, column = _argmax(of_effect)
            best[str(effect)] = Further(
                log_evidence=float(np.logaddexp.reduce(of_effect, axis=None)),
                atom=int(others[rows[row]]),
                size=float(SIZES[column]),
            )
        return best

    def fit(
        self,
        effects: Sequence[str],
        atoms: Sequence[int],
        sizes: Sequence[float],
    ) -> Hypothesis:
        """Hypothesis of a set of effects: best forms by turns, evidence over all forms.

        `atoms` and `sizes` are the forms to start from.
        """
        best, best_sizes = list(atoms), list(sizes)
        further_forms = 0.0
        for _ in range(ROUNDS):
            before = (tuple(best), tuple(best_sizes))
            further_forms = 0.0
            for i, effect in enumerate(effects):
                others = [j for j in range(len(effects)) if j != i]
                other_atoms = [best[j] for j in others]
                other_sizes = [best_sizes[j] for j in others]
                table = self._table(effect, other_atoms, other_sizes)
                numbers = self._atoms_of[effect]
                posterior = self._log_posterior(effect, other_atoms, other_sizes)
                row, column = _argmax(posterior)
                best[i], best_sizes[i] = int(numbers[row]), float(SIZES[column])
                over_all = float(np.logaddexp.reduce(posterior, axis=None))
                further_forms += over_all - float(table[row, column])
            if (tuple(best), tuple(best_sizes)) == before:
                break
        h = Hypothesis(
            effects=tuple(effects),
            unknown=False,
            atoms=tuple(best),
            sizes=tuple(best_sizes),
            process=None,
            process_size=0.0,
            log_evidence=further_forms + self._log_law,
            log_prior=log_prior(len(effects), False, len(self.library.effects)),
        )
        base = self._grams_alone(h).base
        return dataclasses.replace(h, log_evidence=base + h.log_evidence)

    def add_unknown(self, h: Hypothesis) -> Hypothesis:
        """The same set of effects with an unknown remainder, orthogonal to them."""
        remainder = self._forms.remainders.best(self._grams_alone(h), self._selected(h))
        return dataclasses.replace(
            h,
            unknown=True,
            process=remainder.process,
            process_size=remainder.size,
            log_evidence=h.log_evidence + remainder.log_evidence,
            log_prior=log_prior(len(h.effects), True, len(self.library.effects)),
        )

    def _table(
        self,
        effect: str,
        others: Sequence[int],
        sizes: Sequence[float],
    ) -> Array:
        """Log evidence (atoms, sizes) of an effect's forms over none.

        Other forms are in the model at their sizes.
        """
        key = (effect, tuple(zip(others, sizes, strict=True)))
        if key not in self._tables:
            selected = [self._atoms[k] for k in others]
            forms = [self._atoms[k] for k in self._atoms_of[effect]]
            columns = np.unique(np.concatenate(forms))
            grams = self._forms.products.grams(np.concatenate([*selected, columns]))
            grams, start = grams.select_in_order(selected, sizes)
            places = [start + np.searchsorted(columns, form) for form in forms]
            self._tables[key] = grams.log_evidences(places, SIZES)
        return self._tables[key]

    def _log_posterior(
        self,
        effect: str,
        others: Sequence[int],
        sizes: Sequence[float],
    ) -> Array:
        """As `_table`, with the prior of forms and sizes."""
        table = self._table(effect, others, sizes)
        return table + self._forms.log_prior[self._atoms_of[effect]]

    def _select(
        self,
        grams: Grams,
        atoms: Sequence[int],
        sizes: Sequence[float],
    ) -> Grams:
        for atom, size in zip(atoms, sizes, strict=True):
            grams = grams.select(self._atoms[atom], size)
        return grams

    def _columns_of_set(self, h: Hypothesis) -> Index:
        """Columns of all forms of a set of effects, one after the other."""
        return np.concatenate([_NONE, *[self._atoms[k] for k in h.atoms]])

    def _selected(self, h: Hypothesis) -> list[tuple[Index, float]]:
        """Columns of each effect of a set in its form, with its size."""
        forms = zip(h.atoms, h.sizes, strict=True)
        return [(self._atoms[atom], size) for atom, size in forms]

    def _grams_alone(self, h: Hypothesis) -> Grams:
        """Grams of the columns of a set of effects alone, these in the model."""
        columns = [self._atoms[k] for k in h.atoms]
        grams = self._forms.products.grams(self._columns_of_set(h))
        return grams.select_in_order(columns, h.sizes)[0]

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
            grams = self._select(self.grams, base.atoms, base.sizes)
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


def _argmax(table: Array) -> tuple[int, int]:
    """Row and column of the largest entry."""
    row, column = np.unravel_index(int(np.argmax(table)), table.shape)
    return int(row), int(column)
