"""Which effects act: a search over sets of effects, with and without an unknown
remainder, by closed-form evidence.

An effect's evidence is the sum over its forms (atoms) and sizes. For a set of effects
the sum over all combinations is taken about the best one: with a* the best forms,

    log sum_a w(a) p(r | a) ~ log p(r | a*) + sum_i ( log sum_a_i w(a_i) p(r | a_i,
    a*_others) - log p(r | a*) ).

An effect rarely has the form that it has in a book. Where it carries most of the gap
and an unknown remainder beside it the rest, it is likelier that it acts in a form of
its own than that something unknown looks like it: an unknown alone is held against the
best effect with a remainder by the share of the gap that this effect carries. Nor is a
second effect that explains next to nothing beside the first as likely as another.

The noise law is a nuisance: every set of effects is given the one of several laws that
suits it best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterable, Iterator, Sequence

import numpy as np
from scipy import special

from oed.arrays import Array, Index
from oed.gap.data import evidence
from oed.gap.data.evidence import SIZES, Grams
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.noise.law import NoiseLaw
from oed.noise.outliers import Outliers

#: prior probabilities: no gap, one effect, two, three, an unknown alone, one or two
#: with an unknown remainder
PRIOR = {
    "none": 0.34,
    "one": 0.24,
    "two": 0.08,
    "three": 0.01,
    "unknown": 0.10,
    "one+": 0.19,
    "two+": 0.04,
}
#: how large an unknown may be, against a micrometre
UNKNOWN_SIZES = np.array([0.1, 0.3, 1.0, 3.0, 10.0, 30.0, 100.0])
#: log evidence below the best at which sets are not taken further, and how many are
BEHIND, WIDE = 14.0, 8
ROUNDS = 4
#: expected lambda of a form below which its size is taken for none at all
SEEN = 9.0
#: log odds of an effect beside an unknown remainder: slope and even point in its share
#: of the gap, and their bound
SLOPE, EVEN, STEEPEST = 8.0, 0.4, 6.0
#: share of what a set of effects explains below which the least of them may be what the
#: others have of their own form, and log odds by which the set is less likely where it
#: explains nothing
LITTLE, MINOR = 0.1, 2.0
#: power of the evidence among explanations of a gap: their forms are models all, and
#: none of them quite true (a learning rate as of Gruenwald and van Ommen 2017, Bayesian
#: Anal. 12, 1069-1103)
RATE = 0.9
_NONE = np.empty(0, dtype=np.intp)


@dataclasses.dataclass(frozen=True)
class Hypothesis:
    """A set of effects, with or without an unknown remainder.

    atoms, sizes   best form and size of each effect;  process: the best unknown
                   process's number, and its size
    log_evidence   of the readings, over forms and sizes;  log_prior;  law: number of
                   the noise law that suits it best
    share          of what the readings hold beyond noise that the effects explain, not
                   the unknown remainder
    least          share of what several effects explain that is lost without the least
                   of them
    """

    effects: tuple[str, ...]
    unknown: bool
    atoms: tuple[int, ...]
    sizes: tuple[float, ...]
    process: int | None
    process_size: float
    log_evidence: float
    log_prior: float
    law: int = 0
    share: float = 1.0
    least: float = 1.0

    @property
    def score(self) -> float:
        """Log posterior up to a constant."""
        return self.log_evidence + self.log_prior

    @property
    def key(self) -> tuple[frozenset[str], bool]:
        """What it says, whatever the forms."""
        return frozenset(self.effects), self.unknown


class Search:
    """The search under one noise law. strays: what `problem`'s residuals have been told
    to be without, if any.
    """

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        law: NoiseLaw,
        log_prior: float,
        strays: Outliers | None = None,
    ) -> None:
        (
            self.problem,
            self.library,
            self.processes,
            self.law,
            self.log_prior,
            self.strays,
        ) = (
            problem,
            library,
            processes,
            law,
            log_prior,
            strays,
        )
        self._odds = log_prior + (0.0 if strays is None else strays.log_odds)
        self.grams: Grams = evidence.grams(
            problem,
            Metric(problem, law),
            np.hstack([library.columns, processes.columns]),
        )
        offset = library.columns.shape[1]
        self._own = self.grams.subset(np.arange(offset))
        self._atoms = [a.columns for a in library.atoms]
        self._weights = np.array([a.log_weight for a in library.atoms])
        self._owner = np.array([a.effect for a in library.atoms])
        #: log weight (atoms, sizes) of each form at each size
        self._shares = self._weights[:, None] + self._weighed(self._atoms, SIZES)
        self._of = {
            e: np.array(library.atoms_of(e), dtype=np.intp) for e in library.effects
        }
        self._known: dict[tuple[str, tuple[tuple[int, float], ...]], Array] = {}
        self._found: list[Hypothesis] = []
        self._processes = [a.columns + offset for a in processes.atoms]
        self._process_groups = (
            evidence.group_by_count(self._processes) if self._processes else []
        )
        self._process_shares = (
            np.array([a.log_weight for a in processes.atoms])[:, None]
            - np.log(max(len(processes.effects), 1))
            + self._weighed(self._processes, UNKNOWN_SIZES)
        )

    def _weighed(self, choices: Sequence[Index], sizes: Array) -> Array:
        """Log prior share (atoms, sizes) of each size: those that could not be seen are
        no hypotheses.
        """
        if not choices:
            return np.zeros((0, len(sizes)))
        own = np.diag(self.grams.gram)
        energy = np.array([own[c].sum() for c in choices])[:, None] * sizes**2
        worth = energy > SEEN
        worth[:, -1] = True
        return np.asarray(
            np.where(worth, -np.log(worth.sum(axis=1, keepdims=True)), -np.inf)
        )

    def columns_of(self, atom: int) -> Index:
        """Columns of a form."""
        return self._atoms[atom]

    # -- sets of effects ---------------------------------------------------------------

    def given(self, atoms: Sequence[int], sizes: Sequence[float]) -> Grams:
        """Grams with these forms selected."""
        found = self.grams
        for atom, size in zip(atoms, sizes, strict=True):
            found = found.select(self._atoms[atom], size)
        return found

    def level(self, h: Hypothesis) -> float:
        """Noise level that a hypothesis leaves."""
        found = self.given(h.atoms, h.sizes)
        if h.process is not None:
            found = found.select(self._processes[h.process], h.process_size)
        return evidence.noise_level(found)

    def law_at(self, level: float) -> NoiseLaw:
        """The law at a level, and how many readings are far off."""
        law = dataclasses.replace(self.law, level=level)
        return law if self.strays is None else self.strays.law(law)

    def alternatives(
        self, h: Hypothesis, i: int, count: int = 4
    ) -> list[tuple[int, float]]:
        """The next best forms of the i-th effect of a hypothesis, with their best
        sizes.
        """
        others = [j for j in range(len(h.effects)) if j != i]
        told = self._beside(
            h.effects[i], [h.atoms[j] for j in others], [h.sizes[j] for j in others]
        )
        mine = self._of[h.effects[i]]
        weighed = told + self._shares[mine]
        order = np.argsort(-weighed.max(axis=1))[: count + 1]
        chosen = [(int(mine[k]), float(SIZES[np.argmax(weighed[k])])) for k in order]
        return [c for c in chosen if c[0] != h.atoms[i]][:count]

    def screen(
        self, found: Grams, without: Iterable[str]
    ) -> dict[str, tuple[float, int, float]]:
        """Each further effect's log evidence over `found`, its best form and size."""
        left = np.flatnonzero(~np.isin(self._owner, list(without)))
        if not left.size:
            return {}
        told = found.log_evidences([self._atoms[k] for k in left])
        weighed = told + self._shares[left]
        best = {}
        for effect in dict.fromkeys(self._owner[left]):
            at = np.flatnonzero(self._owner[left] == effect)
            row, column = np.unravel_index(
                int(np.argmax(weighed[at])), weighed[at].shape
            )
            best[str(effect)] = (
                float(np.logaddexp.reduce(weighed[at], axis=None)),
                int(left[at[row]]),
                float(SIZES[column]),
            )
        return best

    def settle(
        self, effects: Sequence[str], atoms: Sequence[int], sizes: Sequence[float]
    ) -> Hypothesis:
        """Best forms of a set of effects by turns, from a start, and the set's evidence
        over all forms.
        """
        chosen, size = list(atoms), list(sizes)
        spare = 0.0
        for _ in range(ROUNDS):
            before, spare = (tuple(chosen), tuple(size)), 0.0
            for i, effect in enumerate(effects):
                told = self._beside(effect, [chosen[j] for j in range(len(effects)) if j != i],
                                    [size[j] for j in range(len(effects)) if j != i])  # fmt: skip
                mine = self._of[effect]
                weighed = told + self._shares[mine]
                row, column = np.unravel_index(int(np.argmax(weighed)), weighed.shape)
                chosen[i], size[i] = int(mine[row]), float(SIZES[column])
                spare += float(np.logaddexp.reduce(weighed, axis=None)) - float(
                    told[row, column]
                )
            if (tuple(chosen), tuple(size)) == before:
                break
        found = Hypothesis(
            effects=tuple(effects),
            unknown=False,
            atoms=tuple(chosen),
            sizes=tuple(size),
            process=None,
            process_size=0.0,
            log_evidence=spare + self._odds,
            log_prior=self._prior(len(effects), False),
        )
        left = self._selected(found)
        whole, least = left.base + found.log_evidence, self._least(found, left.energy)
        return dataclasses.replace(found, log_evidence=whole, least=least)

    def _least(self, h: Hypothesis, rest: float) -> float:
        """Share of what the effects of a set explain, all but `rest`, that is lost
        without the least of them.
        """
        whole = self.grams.energy - rest
        if len(h.effects) < 2 or whole <= 0.0:
            return 1.0
        gains = []
        for i in range(len(h.effects)):
            others = [j for j in range(len(h.effects)) if j != i]
            kept = dataclasses.replace(
                h,
                atoms=tuple(h.atoms[j] for j in others),
                sizes=tuple(h.sizes[j] for j in others),
            )
            gains.append(self._selected(kept).energy - rest)
        return float(min(gains) / whole)

    def _beside(
        self, effect: str, others: Sequence[int], sizes: Sequence[float]
    ) -> Array:
        """Log evidence (atoms, sizes) of an effect's forms over none, beside other
        forms that are selected.
        """
        key = (effect, tuple(zip(others, sizes, strict=True)))
        if key not in self._known:
            used = [self._atoms[k] for k in others]
            mine = np.unique(np.concatenate([self._atoms[k] for k in self._of[effect]]))
            part = self.grams.subset(np.concatenate([*used, mine]))
            start = 0
            for columns, size in zip(used, sizes, strict=True):
                part = part.select(np.arange(start, start + len(columns)), size)
                start += len(columns)
            places = [
                start + np.searchsorted(mine, self._atoms[k]) for k in self._of[effect]
            ]
            self._known[key] = part.log_evidences(places)
        return self._known[key]

    def with_unknown(self, known: Hypothesis) -> Hypothesis:
        """The same set of effects with an unknown remainder, orthogonal to them."""
        if not self._processes:
            return dataclasses.replace(
                known, unknown=True, log_evidence=-np.inf, log_prior=-np.inf
            )
        selected = np.concatenate([_NONE, *[self._atoms[k] for k in known.atoms]])
        sizes = np.concatenate(
            [
                np.empty(0),
                *[
                    np.full(len(self._atoms[k]), s)
                    for k, s in zip(known.atoms, known.sizes, strict=True)
                ],
            ]
        )
        plain, apart = self._selected(known), list(self._apart(selected))
        told = self._remainders(plain, apart)
        row, column = np.unravel_index(int(np.argmax(told)), told.shape)
        size, level = float(UNKNOWN_SIZES[column]), evidence.noise_level(plain) ** 2
        gram, b = next(
            (g[n == row][0], p[n == row][0]) for n, g, p in apart if row in n
        )
        rest = evidence.excess_energy(gram / level, b / level, size * np.sqrt(level))
        mine = evidence.excess_energy(
            self.grams.gram[np.ix_(selected, selected)] / level,
            self.grams.b[selected] / level,
            sizes * np.sqrt(level),
        )
        return dataclasses.replace(
            known,
            unknown=True,
            process=int(row),
            process_size=size,
            share=mine / (mine + rest) if mine + rest > 0.0 else 0.5,
            log_evidence=known.log_evidence
            + float(np.logaddexp.reduce(told, axis=None)),
            log_prior=self._prior(len(known.effects), True),
        )

    def _remainders(
        self, plain: Grams, apart: Iterable[tuple[Index, Array, Array]]
    ) -> Array:
        """Log evidence (processes, sizes) of each process beside selected effects."""
        told = np.empty((len(self._processes), len(UNKNOWN_SIZES)))
        for numbers, gram, b in apart:
            told[numbers] = plain.log_ratio(
                *evidence.explained_energy(gram, b, UNKNOWN_SIZES)
            )
        return np.asarray(told + self._process_shares)

    def likeness(self, h: Hypothesis) -> dict[str, float]:
        """Probability of each form, in words, of a hypothesis' unknown remainder, the
        likeliest first.
        """
        selected = np.concatenate([_NONE, *[self._atoms[k] for k in h.atoms]])
        told = special.softmax(
            special.logsumexp(
                self._remainders(self._selected(h), self._apart(selected)), axis=1
            )
        )
        found: dict[str, float] = {}
        for atom, share in zip(self.processes.atoms, told, strict=True):
            found[atom.about] = found.get(atom.about, 0.0) + float(share)
        return dict(sorted(found.items(), key=lambda item: -item[1]))

    def _selected(self, h: Hypothesis) -> Grams:
        """Grams of the columns of a set of effects alone, these selected."""
        columns = [self._atoms[k] for k in h.atoms]
        found, start = self.grams.subset(np.concatenate([_NONE, *columns])), 0
        for mine, size in zip(columns, h.sizes, strict=True):
            found = found.select(np.arange(start, start + len(mine)), size)
            start += len(mine)
        return found

    def _apart(self, selected: Index) -> Iterator[tuple[Index, Array, Array]]:
        """Processes with as many columns: their numbers (a,), Gram matrices (a, d, d),
        projections (a, d), without what selected columns could explain.
        """
        gram, b = self.grams.gram, self.grams.b
        root = evidence.inverse_root(gram[np.ix_(selected, selected)])
        half, told = root.T @ gram[selected], root.T @ b[selected]
        for at, rows in self._process_groups:
            over = half[:, rows]
            left = gram[rows[:, :, None], rows[:, None, :]] - np.einsum(
                "kad,kae->ade", over, over
            )
            yield at, left, b[rows] - np.einsum("kad,k->ad", over, told)

    def _prior(self, count: int, unknown: bool) -> float:
        number = max(len(self.library.effects), 1)
        names = {0: "none", 1: "one", 2: "two", 3: "three"}
        if unknown:
            names = {0: "unknown", 1: "one+", 2: "two+", 3: "two+"}
        return float(np.log(PRIOR[names[count]]) - np.log(special.comb(number, count)))

    # -- the search --------------------------------------------------------------------

    def run(self) -> list[Hypothesis]:
        """The hypotheses worth comparing, best first: none, singles, pairs and triples,
        and these with an unknown.
        """
        if not self._found:
            self._found = self._run()
        return self._found

    def _run(self) -> list[Hypothesis]:
        empty = self.settle((), (), ())
        singles = self._grown([empty])
        pairs = self._grown(singles[:WIDE])
        triples = self._grown(pairs[: WIDE // 2])
        known = [empty, *singles, *pairs, *triples]
        known.sort(key=lambda h: -h.score)
        worth = [h for h in known if h.score > known[0].score - 2.0 * BEHIND][
            : 2 * WIDE
        ]
        if empty not in worth:
            worth.append(empty)
        mixed = [self.with_unknown(h) for h in worth if h in worth[:WIDE] or h is empty]
        return sorted([*known, *mixed], key=lambda h: -h.score)

    def _grown(self, bases: Sequence[Hypothesis]) -> list[Hypothesis]:
        """Each base with one effect more: the best few settled, best first."""
        tried: dict[frozenset[str], tuple[float, Hypothesis, str, int, float]] = {}
        for base in bases:
            found = self._own
            for atom, size in zip(base.atoms, base.sizes, strict=True):
                found = found.select(self._atoms[atom], size)
            for effect, (gain, atom, size) in self.screen(found, base.effects).items():
                key, told = frozenset((*base.effects, effect)), base.log_evidence + gain
                if key not in tried or tried[key][0] < told:
                    tried[key] = (told, base, effect, atom, size)
        ranked = sorted(tried.values(), key=lambda t: -t[0])
        if bases and len(bases[0].effects) > 0:
            ranked = [t for t in ranked if t[0] > ranked[0][0] - BEHIND][: 2 * WIDE]
        made = [
            self.settle(
                (*base.effects, effect), (*base.atoms, atom), (*base.sizes, size)
            )
            for _, base, effect, atom, size in ranked
        ]
        return sorted(made, key=lambda h: -h.score)


def compare(searches: Sequence[Search]) -> list[Hypothesis]:
    """Hypotheses under the law that suits each best, by log posterior, best first."""
    best: dict[tuple[frozenset[str], bool], Hypothesis] = {}
    for number, search in enumerate(searches):
        for h in search.run():
            h = _leading(_named(dataclasses.replace(h, law=number)))
            if h.key not in best or best[h.key].score < h.score:
                best[h.key] = h
    alone, mixed = (
        (frozenset[str](), True),
        [h for h in best.values() if h.unknown and h.effects],
    )
    if mixed and alone in best:
        most = max(mixed, key=lambda h: h.score)
        worth = max(_odds(most.share), 0.0)
        best[alone] = dataclasses.replace(
            best[alone], log_prior=best[alone].log_prior - worth
        )
    return sorted(best.values(), key=lambda h: -h.score)


def _odds(share: float) -> float:
    """Log odds that an effect acts, from its share of what the readings hold beyond
    noise: known effects in forms of their own keep most of it, what chance lends to a
    rival of an unknown one is little.
    """
    return float(np.clip(SLOPE * (share - EVEN), -STEEPEST, STEEPEST))


def _named(h: Hypothesis) -> Hypothesis:
    """With the prior of effects beside an unknown remainder that carry little of the
    gap lowered.
    """
    if not h.unknown or not h.effects:
        return h
    return dataclasses.replace(h, log_prior=h.log_prior + min(_odds(h.share), 0.0))


def _leading(h: Hypothesis) -> Hypothesis:
    """With the prior lowered of sets of which one explains next to nothing: it is
    likelier the others' own form.
    """
    return dataclasses.replace(
        h, log_prior=h.log_prior - MINOR * max(1.0 - h.least / LITTLE, 0.0)
    )


def probabilities(hypotheses: Sequence[Hypothesis]) -> Array:
    """Posterior probabilities of hypotheses: that there is a gap as told, its causes a
    little flatter.
    """
    scores = np.array([h.score for h in hypotheses])
    gap = np.array([bool(h.effects) or h.unknown for h in hypotheses], dtype=bool)
    if gap.any():
        flat = RATE * scores[gap]
        scores[gap] = flat - special.logsumexp(flat) + special.logsumexp(scores[gap])
    return np.asarray(special.softmax(scores))
