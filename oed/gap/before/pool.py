"""Pool of candidate runs with the targets that they are to separate."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.effect import Effect
from oed.gap.before.combinations import in_words
from oed.gap.before.separation import Separation, Target
from oed.gap.before.table import ROOM
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable
from oed.noise.law import NoiseLaw

#: forms of an effect (values of its constants) that stand for its grid
FORMS = 6
_NONE = np.empty(0, dtype=np.intp)

#: effect, rival and combination in words
PairKey = tuple[str, str, str]


@dataclasses.dataclass(frozen=True)
class PairSeparation:
    """How well a plan separates a combination of coefficients from a rival.

    effect           name of the effect
    rival            name of the rival
    words            the combination, at one prior standard deviation of each
                     coefficient in it
    detectability    sqrt(lambda_k)
    separation       sqrt(lambda_k|j), the rival at its most absorbing constants
    """

    effect: str
    rival: str
    words: str
    detectability: float
    separation: float


@dataclasses.dataclass(frozen=True)
class NamedTarget:
    """A target with the names that it is of, for one form of the rival."""

    effect: str
    rival: str
    words: str
    target: Target

    @property
    def key(self) -> PairKey:
        """What it is of, whatever the rival's form."""
        return self.effect, self.rival, self.words


class Pool:
    """Candidate runs with the Gram matrices of slopes and effects' columns.

    grams      (C, m, m) of the runs
    base       (m, m) of the prior
    targets    all combinations to be separated, each from each form of a rival
    """

    def __init__(
        self,
        problem: GapProblem,
        law: NoiseLaw,
        rows: Sequence[Index],
        wanted: Sequence[Effect],
        rivals: Sequence[Effect] = (),
        *,
        pairs: Sequence[tuple[str, str]] | None = None,
        combinations: Mapping[str, Sequence[Mapping[str, float]]] | None = None,
        room: float = ROOM,
    ) -> None:
        """Lay out the targets and compute the Gram matrices.

        problem         holds all candidates (`oed.gap.before.runs.prepare`)
        rows            (C,) readings of each run
        wanted          effects that are separated from each other and from the rivals
        rivals          further effects
        pairs           (effect, rival) to be separated instead
        combinations    {effect: coefficients in prior standard deviations} to be
                        separated; by default the coefficients of all legs alike, and
                        each alone
        room            prior standard deviations that a rival's textbook coefficients
                        may go to

        An effect's own constants are the middle ones of its grid. Raises ValueError for
        effects that no candidate can test.
        """
        self.problem, self.law = problem, law
        self.rows, self.room = tuple(rows), room
        effects = list({e.name: e for e in (*wanted, *rivals)}.values())
        self._forms: dict[str, list[tuple[Signature, Index]]] = {}
        blocks, start = [], 0
        for effect in effects:
            for form in _signatures(problem, effect):
                stop = start + form.columns.shape[1]
                forms = self._forms.setdefault(effect.name, [])
                forms.append((form, np.arange(start, stop)))
                blocks.append(problem.in_noise_units(form.columns))
                start = stop
        self._compute_grams(np.hstack(blocks))
        names = [effect.name for effect in effects]
        if pairs is None:
            pairs = [(e.name, r) for e in wanted for r in names if r != e.name]
        unknown = sorted({name for pair in pairs for name in pair} - set(names))
        if unknown:
            raise ValueError(
                f"pairs name effects that are not given: {unknown}; there are {names}"
            )
        self.targets: list[NamedTarget] = []
        for effect_name, rival in pairs:
            given = (combinations or {}).get(effect_name)
            self.targets += self._targets(effect_name, rival, given)
        if not self.targets:
            raise ValueError(
                "there is nothing to tell apart: give two effects at least"
            )

    def _compute_grams(self, columns: Array) -> None:
        """Gram matrices of the runs and of the prior, in convenient coordinates.

        In these all runs together and the prior have unit information on the
        parameters, and what the parameters can absorb of the effects is taken out.
        """
        n, count = self.problem.slopes.shape[1], columns.shape[1]
        values = np.hstack([self.problem.slopes, columns])
        white = [self.law.factor(self.problem, at).whiten(values) for at in self.rows]
        prior = np.hstack([np.eye(n), np.zeros((n, count))])
        whole = np.vstack([*white, prior])
        root = np.linalg.qr(whole[:, :n], mode="r")
        turned = linalg.solve_triangular(root, np.eye(n))
        absorbed = turned @ (turned.T @ (whole[:, :n].T @ whole[:, n:]))
        zeros = np.zeros((count, n))
        change = np.block([[turned, -absorbed], [zeros, np.eye(count)]])
        changed = [x @ change for x in white]
        self.grams = np.array([x.T @ x for x in changed])
        self.base = (prior @ change).T @ (prior @ change)
        # back from the coordinates' volume to that of the parameters in prior standard
        # deviations
        self.log_scale = 2.0 * float(np.log(np.abs(np.diag(root))).sum())

    def _targets(
        self,
        effect: str,
        rival: str,
        given: Sequence[Mapping[str, float]] | None,
    ) -> list[NamedTarget]:
        """Combinations of an effect's coefficients, each from each form of a rival."""
        forms = self._forms[effect]
        middle, at = forms[len(forms) // 2]
        targets = []
        for combination in given or _combinations(middle):
            shares = np.array([combination.get(name, 0.0) for name in middle.names])
            if not shares.any():
                raise ValueError(
                    f"{effect} has no coefficient among {sorted(combination)}; it has"
                    f" {list(middle.names)}"
                )
            words = in_words(combination)
            for form, there in self._forms[rival]:
                precision = np.where(form.shape, 1.0, self.room**-2)
                target = Target(at, shares, there, precision)
                targets.append(NamedTarget(effect, rival, words, target))
        return targets

    def separation(
        self,
        targets: Sequence[int],
        share: float,
        fixed: Index = _NONE,
    ) -> Separation:
        """The objective with some of the targets, by their numbers.

        share    of D in the compound
        fixed    runs that are part of any plan
        """
        return Separation(
            grams=self.grams,
            base=self.base + self.grams[fixed].sum(axis=0),
            size=self.problem.slopes.shape[1],
            targets=tuple(self.targets[k].target for k in targets),
            share=share,
        )

    def all_targets(self, share: float, fixed: Index = _NONE) -> Separation:
        """The objective with all targets."""
        return self.separation(range(len(self.targets)), share, fixed)

    def lambdas(self, runs: Index) -> Array:
        """lambda (T,) of every target in a plan."""
        separation = self.all_targets(0.0)
        return separation.lambdas(separation.of(runs))

    def volume(self, runs: Index) -> float:
        """log det of the parameters' information with their prior.

        Parameters are in prior standard deviations.
        """
        n = self.problem.slopes.shape[1]
        information = self.grams[runs][:, :n, :n].sum(axis=0)
        m = self.base[:n, :n] + information
        return float(np.linalg.slogdet(m)[1]) + self.log_scale

    def pair_separations(self, runs: Index) -> tuple[PairSeparation, ...]:
        """What a plan of these runs separates, ascending by separation.

        Each combination from each rival, at the worst constants.
        """
        separation = self.all_targets(0.0)
        n, m = separation.size, separation.of(runs)
        cross = m[:n, n:]
        profiled = m[n:, n:] - m[n:, :n] @ np.linalg.solve(m[:n, :n], cross)
        worst: dict[PairKey, PairSeparation] = {}
        for named, value in zip(self.targets, self.lambdas(runs), strict=True):
            root = float(value) ** 0.5
            if named.key in worst and root >= worst[named.key].separation:
                continue
            t = named.target
            block = profiled[np.ix_(t.columns, t.columns)]
            energy = max(float(t.shares @ block @ t.shares), 0.0)
            worst[named.key] = PairSeparation(*named.key, energy**0.5, root)
        return tuple(sorted(worst.values(), key=lambda pair: pair.separation))

    def hardest(self, runs: Index) -> list[int]:
        """For each combination and rival the target of least lambda in a plan."""
        lam = self.lambdas(runs)
        hardest: dict[PairKey, int] = {}
        for k, named in enumerate(self.targets):
            if named.key not in hardest or lam[k] < lam[hardest[named.key]]:
                hardest[named.key] = k
        return sorted(hardest.values())


def _signatures(problem: GapProblem, effect: Effect) -> list[Signature]:
    """The effect's forms, at most `FORMS` of its grid.

    Raises ValueError where no candidate can test it.
    """
    reason = untestable(effect, problem.states)
    forms: list[Signature] = []
    if reason is None:
        grid = effect.constant_grid()
        if len(grid) > FORMS:
            places = np.linspace(0, len(grid) - 1, FORMS).round().astype(int)
            grid = [grid[k] for k in np.unique(places)]
        every = [problem.signature(effect, point) for point in grid]
        forms = [form for form in every if form.names]
    if not forms:
        why = reason or "it changes none of the candidate readings"
        raise ValueError(f"{effect.name} cannot be tested by these candidates: {why}")
    return forms


def _combinations(form: Signature) -> list[dict[str, float]]:
    """All legs alike, for each kind of textbook coefficient, and each one alone."""
    kinds: dict[str, dict[str, float]] = {}
    for name, label, shape in zip(form.names, form.labels, form.shape, strict=True):
        if not shape:
            kind = name.removeprefix(label) if label else name
            kinds.setdefault(kind, {})[name] = 1.0
    alike = [kind for kind in kinds.values() if len(kind) > 1]
    single = [{name: 1.0} for kind in kinds.values() for name in kind]
    return alike + single
