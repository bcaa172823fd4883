"""Which effects act? The answer of an observer that knows the second generator.

It knows each effect's distribution, how often one acts, two or none, and a prior of
noise laws. An effect's distribution is replaced by Gaussian ones of the same second
moment, as in `observers`, each of five sizes. Of two effects the one that explains more is taken
first: its likeliest forms are put into the model, and every form of every other effect is
tried beside each.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg, special

from benchmarks.second.noise_laws import Law, LawModel
from benchmarks.second.observers import DrawnEffects
from benchmarks.second.replay import Replay
from oed.base import Array, Index

#: first forms of a pair that are taken further under each law
FIRST = 8
#: share of a distribution's variance that its smallest directions may lose
LOST = 1e-3
#: log posterior behind the best at which a law is not looked at for pairs
BEHIND = 12.0

#: names of the effects that act; none for no gap
Names = frozenset[str]


@dataclasses.dataclass(frozen=True)
class Frequencies:
    """How often nothing acts, one effect and two, and of which names.

    single  {name: share of all cases}
    pair    share of each unordered pair of the listed names
    none    share without an effect
    """

    none: float
    single: Mapping[str, float]
    pair: float
    listed: tuple[str, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class _Forms:
    """Gaussian distributions of all effects, whitened, in blocks of columns.

    columns  (n, K) of all forms, of unit size
    block    columns of each form
    name     name of each form's effect
    share    log prior share of each form among its effect's
    """

    columns: Array
    block: tuple[Index, ...]
    name: tuple[str, ...]
    share: Array


def log_posterior(
    replay: Replay,
    data: Array,
    drawn: DrawnEffects,
    frequencies: Frequencies,
    sizes: Array,
    grid: Sequence[Law],
) -> list[dict[Names, float]]:
    """Log posterior of each set of names, up to a constant, for each of data (n, R)."""
    singles = [_Model(LawModel(replay, law), drawn, data, sizes) for law in grid]
    results = []
    for r in range(data.shape[1]):
        looks = np.array([model.best_single(r) for model in singles])
        terms: dict[Names, list[float]] = {}
        for model, look in zip(singles, looks, strict=True):
            likely = look > looks.max() - BEHIND
            found = model.log_terms(r, frequencies, pairs=bool(likely))
            for names, value in found.items():
                terms.setdefault(names, []).append(value)
        results.append({n: float(special.logsumexp(v)) for n, v in terms.items()})
    return results


def _forms(model: LawModel, drawn: DrawnEffects) -> _Forms:
    white = model.whiten(drawn.columns)
    norms = np.linalg.norm(white, axis=0)
    white = white / np.maximum(norms, 1e-9 * norms.max())
    columns, names, shares = [], [], []
    for name, groups in drawn.groups.items():
        for members, share in groups:
            part = white[:, members] / np.sqrt(len(members))
            left, values, _ = linalg.svd(part, full_matrices=False)
            kept = values**2 > LOST / len(values)
            columns.append(left[:, kept] * values[kept])
            names.append(name)
            shares.append(np.log(share))
    ends = np.cumsum([part.shape[1] for part in columns])
    starts = ends - [part.shape[1] for part in columns]
    block = [np.arange(a, b) for a, b in zip(starts, ends, strict=True)]
    return _Forms(np.hstack(columns), tuple(block), tuple(names), np.array(shares))


class _Model:
    """All forms under one law, with data (n, R)."""

    def __init__(
        self, model: LawModel, drawn: DrawnEffects, data: Array, sizes: Array
    ) -> None:
        self._model, self._sizes = model, sizes
        self._log_density, self._white = model.scores(data)
        self._forms = _forms(model, drawn)
        self._gram = self._forms.columns.T @ self._forms.columns
        self._slopes = self._forms.columns.T @ self._white
        self._tables_of = [
            self._tables(self._gram, slopes) for slopes in self._slopes.T
        ]

    def best_single(self, r: int) -> float:
        """Log of law's prior times density, with the best single form or none."""
        best = float(self._singles(r).max())
        return float(self._log_density[r]) + self._model.law.log_prior + max(best, 0.0)

    def log_terms(
        self, r: int, frequencies: Frequencies, *, pairs: bool
    ) -> dict[Names, float]:
        """Log of prior times density, of each set of names."""
        base = float(self._log_density[r]) + self._model.law.log_prior
        terms: dict[Names, float] = {frozenset(): base + np.log(frequencies.none)}
        for name, value in self._by_name(self._singles(r)).items():
            terms[frozenset({name})] = base + value + np.log(frequencies.single[name])
        if pairs:
            for names, value in self._pairs(r, frequencies).items():
                terms[names] = base + value + np.log(frequencies.pair)
        return terms

    def _pairs(self, r: int, frequencies: Frequencies) -> dict[Names, float]:
        """Log density ratio of pairs over none, by the forms that come first."""
        gain, log_det = self._tables_of[r]
        names = np.array(self._forms.name)
        open_to = np.isin(names, frequencies.listed)[:, None]
        shares = self._log_shares()
        ranked = np.where(open_to, self._singles(r), -np.inf)
        is_new = np.ones(ranked.shape, dtype=bool)
        values: dict[Names, list[float]] = {}
        for number in np.argsort(-ranked, axis=None)[:FIRST]:
            form, k = divmod(int(number), len(self._sizes))
            is_new[form, k] = False
            gram, slopes = self._given(r, self._forms.block[form], self._sizes[k])
            more, more_det = self._tables(gram, slopes)
            ratio = self._ratio(r, gain[form, k] + more, log_det[form, k] + more_det)
            ratio = ratio + shares + shares[form, 0]
            # two forms that both come first are met once
            ratio = np.where(open_to & is_new, ratio, -np.inf)
            for name, value in self._by_name(ratio).items():
                if name != names[form] and np.isfinite(value):
                    values.setdefault(frozenset({names[form], name}), []).append(value)
        return {n: float(special.logsumexp(v)) for n, v in values.items()}

    def _singles(self, r: int) -> Array:
        return self._ratio(r, *self._tables_of[r]) + self._log_shares()

    def _given(self, r: int, block: Index, size: float) -> tuple[Array, Array]:
        """Gram matrix and slopes of all columns with a form in the model."""
        own = self._gram[np.ix_(block, block)] + np.eye(len(block)) / size**2
        root = linalg.cholesky(own, lower=True)
        half = linalg.solve_triangular(root, self._gram[block], lower=True)
        along = linalg.solve_triangular(root, self._slopes[block, r], lower=True)
        return self._gram - half.T @ half, self._slopes[:, r] - half.T @ along

    def _tables(self, gram: Array, slopes: Array) -> tuple[Array, Array]:
        """Half the energy and log determinant (forms, sizes) of each form."""
        shape = len(self._forms.block), len(self._sizes)
        gain, log_det = np.zeros(shape), np.zeros(shape)
        for f, block in enumerate(self._forms.block):
            values, axes = np.linalg.eigh(gram[np.ix_(block, block)])
            values = np.maximum(values, 1e-12)
            energy = (axes.T @ slopes[block]) ** 2 / values
            inflation = values * self._sizes[:, None] ** 2
            gain[f] = 0.5 * (inflation / (1.0 + inflation)) @ energy
            log_det[f] = np.log1p(inflation).sum(axis=1)
        return gain, log_det

    def _ratio(self, r: int, gain: Array, log_det: Array) -> Array:
        ratio = self._model.log_ratio(self._white[:, r : r + 1], gain)
        return np.asarray(ratio - 0.5 * log_det)

    def _log_shares(self) -> Array:
        return np.asarray(self._forms.share[:, None] - np.log(len(self._sizes)))

    def _by_name(self, table: Array) -> dict[str, float]:
        names = np.array(self._forms.name)
        return {
            name: float(special.logsumexp(table[names == name]))
            for name in dict.fromkeys(self._forms.name)
        }
