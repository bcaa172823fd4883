"""Choose runs that tell wanted effects apart: under which conditions (payload,
direction, feed, tool, time) to measure.

Each ordered pair of a wanted effect and a rival gives targets: combinations of the
effect's coefficients at their prior sizes, to be told from the rival with the
parameters profiled out. The least lambda_{k|j} over all targets is maximised,
compounded with D so that the parameters stay identifiable (`oed.gap.before.apart`). Candidates
are whole runs, each under one condition and at a cost; the plan comes from greedy
starts and exchanges (`oed.design.search`), and a relaxation to weights between 0 and 1
bounds every plan (`oed.design.relaxation`).
"""

from __future__ import annotations

import dataclasses
import itertools
import math
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.design import relaxation
from oed.design.relaxation import Relaxation
from oed.design.rules import Rules
from oed.design.search import search, select_greedily
from oed.effect import Effect
from oed.gap.before.apart import SHARP, Separation, SeparationJudge, Target
from oed.gap.before.detect import ROOM, in_words
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable
from oed.noise.law import NoiseLaw

#: forms of an effect (values of its constants) that stand for its grid
FORMS = 6
#: share of D in the compound
SHARE = 0.1
#: plans that are tried one by one where there are no more: the best is then proven
ENUMERATED = 20_000
#: of which so many at once
CHUNK = 256
#: times that targets may join a search
JOINS = 4
#: gap of the relaxation that is good enough, in log lambda
GAP = 1e-3


@dataclasses.dataclass(frozen=True)
class PairSeparation:
    """How well a plan tells a combination of an effect's coefficients from a rival.

    effect, rival   names;  words: the combination, at one prior standard deviation of
                    each coefficient in it
    seen, apart     sqrt(lambda_k) and sqrt(lambda_k|j), the rival at its most absorbing
                    constants
    """

    effect: str
    rival: str
    words: str
    seen: float
    apart: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunChoice:
    """Chosen runs.

    runs        (n,) which candidates, ascending
    apart       least sqrt(lambda_k|j) over all targets;  bound: no plan under the rules
                exceeds it
    told        every pair and combination, ascending by `apart`
    value       of the compound, in logs;  above: no plan's exceeds it;  efficiency
                exp(value - above) at the least
    volume      log det of the parameters' information with their prior
    seconds     that the runs take, set-ups included, where costs are known
    proven      all plans were tried: apart and value belong to the best
    """

    runs: Index
    apart: float
    bound: float
    told: tuple[PairSeparation, ...]
    value: float
    above: float
    volume: float
    seconds: float
    proven: bool

    @property
    def efficiency(self) -> float:
        """exp(value - above)."""
        return float(np.exp(min(self.value - self.above, 0.0)))


@dataclasses.dataclass(frozen=True)
class _Aim:
    """A target with what it is of; the other forms of its rival beside the one it was
    given.
    """

    effect: str
    rival: str
    words: str
    target: Target


class Pool:
    """Candidate runs with the Gram matrices of slopes and effects' columns, and every
    target.
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
        """`problem` holds all candidates, rows (C,) which readings each run has
        (`oed.gap.before.runs.prepared`).

        Every wanted effect is told from every other wanted one and from `rivals`;
        `pairs` (effect, rival) says which instead. combinations {effect: coefficients
        in prior standard deviations}: what is to be told; by default the coefficients
        of all legs alike, and each by itself. An effect's own constants are the middle
        ones of its grid. Raises ValueError for effects that no candidate can test.
        """
        self.problem, self.law, self.rows, self.room = problem, law, tuple(rows), room
        effects = list({e.name: e for e in (*wanted, *rivals)}.values())
        self._forms: dict[str, list[tuple[Signature, Index]]] = {}
        blocks, start = [], 0
        for effect in effects:
            for made in _signatures(problem, effect):
                at = np.arange(start, start + made.columns.shape[1])
                self._forms.setdefault(effect.name, []).append((made, at))
                blocks.append(problem.in_noise_units(made.columns))
                start += made.columns.shape[1]
        self._gram(np.hstack(blocks))
        names = [e.name for e in effects]
        told = (
            [(e.name, r) for e in wanted for r in names if r != e.name]
            if pairs is None
            else list(pairs)
        )
        unknown = sorted({n for pair in told for n in pair} - set(names))
        if unknown:
            raise ValueError(
                f"pairs name effects that are not given: {unknown}; there are {names}"
            )
        self.aims = [
            a for k, j in told for a in self._aims(k, j, (combinations or {}).get(k))
        ]
        if not self.aims:
            raise ValueError(
                "there is nothing to tell apart: give two effects at least"
            )

    def _gram(self, columns: Array) -> None:
        """Gram matrices of the runs (C, m, m) and of the prior, in coordinates in which
        all runs together and the prior have unit information on the parameters and what
        these can absorb of the effects is taken out.
        """
        n = self.problem.slopes.shape[1]
        stack = [
            _white(self.problem, self.law, at, self.problem.slopes, columns)
            for at in self.rows
        ]
        held = np.hstack([np.eye(n), np.zeros((n, columns.shape[1]))])
        root = np.linalg.qr(np.vstack([*stack, held])[:, :n], mode="r")
        turned = linalg.solve_triangular(root, np.eye(n))
        whole = np.vstack([*stack, held])
        absorbed = turned @ (turned.T @ (whole[:, :n].T @ whole[:, n:]))
        change = np.block(
            [
                [turned, -absorbed],
                [np.zeros((columns.shape[1], n)), np.eye(columns.shape[1])],
            ]
        )
        moved = [x @ change for x in stack]
        self.grams = np.array([x.T @ x for x in moved])
        self.base = (held @ change).T @ (held @ change)
        # back from the coordinates' volume to that of the parameters in prior standard
        # deviations
        self.scale = 2.0 * float(np.log(np.abs(np.diag(root))).sum())

    def _aims(
        self, effect: str, rival: str, wanted: Sequence[Mapping[str, float]] | None
    ) -> list[_Aim]:
        forms = self._forms[effect]
        made, at = forms[len(forms) // 2]  # the middle of the constants' grid
        aims = []
        for combination in wanted or _combinations(made):
            shares = np.array([combination.get(n, 0.0) for n in made.names])
            if not shares.any():
                raise ValueError(
                    f"{effect} has no coefficient among {sorted(combination)}; it has"
                    f" {list(made.names)}"
                )
            for other, there in self._forms[rival]:
                precision = np.where(other.shape, 1.0, self.room**-2)
                aims.append(
                    _Aim(
                        effect,
                        rival,
                        in_words(combination),
                        Target(at, shares, there, precision),
                    )
                )
        return aims

    def separation(self, aims: Sequence[int], share: float, kept: Index) -> Separation:
        """The objective with some of the targets; runs that are `kept` in any plan are
        part of what is held.
        """
        return Separation(
            grams=self.grams,
            base=self.base + self.grams[kept].sum(axis=0),
            size=self.problem.slopes.shape[1],
            targets=tuple(self.aims[k].target for k in aims),
            share=share,
        )

    def lambdas(self, runs: Index) -> Array:
        """lambda (T,) of every target in a plan."""
        everything = self.separation(
            range(len(self.aims)), 0.0, np.empty(0, dtype=np.intp)
        )
        return everything.lambdas(everything.of(runs))

    def volume(self, runs: Index) -> float:
        """log det of the parameters' information, with their prior, in prior standard
        deviations.
        """
        n = self.problem.slopes.shape[1]
        m = self.base[:n, :n] + self.grams[runs][:, :n, :n].sum(axis=0)
        return float(np.linalg.slogdet(m)[1]) + self.scale

    def told(self, runs: Index) -> tuple[PairSeparation, ...]:
        """What a plan of these runs tells, ascending: each combination from each rival,
        at the worst constants.
        """
        lam = self.lambdas(runs)
        found: dict[tuple[str, str, str], PairSeparation] = {}
        everything = self.separation(
            range(len(self.aims)), 0.0, np.empty(0, dtype=np.intp)
        )
        n, m = everything.size, everything.of(runs)
        left = m[n:, n:] - m[n:, :n] @ np.linalg.solve(m[:n, :n], m[:n, n:])
        for aim, value in zip(self.aims, lam, strict=True):
            t = aim.target
            seen = (
                max(
                    float(t.shares @ left[np.ix_(t.columns, t.columns)] @ t.shares), 0.0
                )
                ** 0.5
            )
            key = (aim.effect, aim.rival, aim.words)
            if key not in found or value**0.5 < found[key].apart:
                found[key] = PairSeparation(*key, seen, float(value) ** 0.5)
        return tuple(sorted(found.values(), key=lambda x: x.apart))


def choose(
    pool: Pool,
    rules: Rules,
    rng: np.random.Generator,
    *,
    share: float = SHARE,
    kept: Index | None = None,
    rounds: int = 12,
) -> RunChoice:
    """Choose runs of the pool under the rules (number of runs, or a budget; set-ups),
    besides those `kept`.

    `share` of the compound is D's: 0 only tells effects apart, 1 is D alone. Raises
    ValueError where the rules allow no run, or the share is not from 0 to 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"the share of D must lie between 0 and 1, not {share:g}")
    kept = np.empty(0, dtype=np.intp) if kept is None else kept
    count = len(pool.rows)
    if rules.size is not None and not 0 < rules.size <= count - len(kept):
        raise ValueError(
            f"cannot choose {rules.size} different runs out of {count - len(kept)}"
            " candidates"
        )
    if not rules.additions(np.empty(0, dtype=np.intp), count).any():
        raise ValueError(
            "the rules allow no run at all: raise the number of runs or the budget"
        )
    if (
        rules.only_size
        and rules.size is not None
        and math.comb(count - len(kept), rules.size) <= ENUMERATED
    ):
        return _choice(
            pool,
            *_enumerated(pool, rules.size, share, kept),
            kept,
            share,
            rules,
            proven=True,
        )
    return _choice(
        pool,
        *_searched(pool, rules, rng, share, kept, rounds),
        kept,
        share,
        rules,
        proven=False,
    )


def _choice(
    pool: Pool,
    runs: Index,
    above: float,
    top: float,
    kept: Index,
    share: float,
    rules: Rules,
    *,
    proven: bool,
) -> RunChoice:
    whole = np.sort(np.concatenate([runs, kept]))
    everything = pool.separation(range(len(pool.aims)), share, kept[:0])
    told, shift = pool.told(whole), share * pool.scale / everything.size
    return RunChoice(
        runs=whole,
        apart=told[0].apart,
        bound=max(float(np.exp(0.5 * top)), told[0].apart),
        told=told,
        value=float(everything.worth(everything.of(whole))) + shift,
        above=above + shift,
        volume=pool.volume(whole),
        seconds=rules.time_of(runs) if rules.cost is not None else 0.0,
        proven=proven,
    )


def _enumerated(
    pool: Pool, size: int, share: float, kept: Index
) -> tuple[Index, float, float]:
    """The best of all plans, its value, and the largest least log lambda of any."""
    free = np.setdiff1d(np.arange(len(pool.rows)), kept)
    plans = free[
        np.array(list(itertools.combinations(range(len(free)), size)), dtype=np.intp)
    ]
    judged = pool.separation(range(len(pool.aims)), share, kept)
    values, least = [], []
    for some in np.array_split(plans, -(-len(plans) // CHUNK)):
        m = judged.base + pool.grams[some].sum(axis=1)
        values.append(judged.worth(m))
        least.append(np.log(judged.lambdas(m).min(axis=0)))
    value = np.concatenate(values)
    best = int(np.argmax(value))
    return plans[best], float(value[best]), float(np.concatenate(least).max())


def _searched(
    pool: Pool,
    rules: Rules,
    rng: np.random.Generator,
    share: float,
    kept: Index,
    rounds: int,
) -> tuple[Index, float, float]:
    """The best plan found, and what no plan's value and least log lambda exceed.

    It is led by the targets whose constants absorb most; others join while a plan shows
    them to be worse.
    """
    count = len(pool.rows)
    free = np.setdiff1d(np.arange(count), kept)
    aims, inner = _hardest(pool, np.arange(count)), rules.subset(free)
    for _ in range(JOINS):
        found = pool.separation(aims, share, kept).subset(free)
        lead = _relaxed(found, inner)
        judge = SeparationJudge(found)
        starts = [select_greedily(judge, inner, 0.0, rung) for rung in (0, 1)]
        runs = free[
            search(
                judge,
                inner,
                lead.weights,
                np.maximum(lead.slopes, 0.0),
                starts,
                rng,
                rounds,
            )
        ]
        more = sorted(set(aims) | set(_hardest(pool, np.concatenate([runs, kept]))))
        if more == aims:
            break
        aims = more
    return (
        runs,
        lead.bound,
        _relaxed(pool.separation(aims, 0.0, kept).subset(free), inner).bound,
    )


def _hardest(pool: Pool, runs: Index) -> list[int]:
    """For each combination and rival the target whose constants absorb most in a plan."""
    lam = pool.lambdas(runs)
    found: dict[tuple[str, str, str], int] = {}
    for k, aim in enumerate(pool.aims):
        key = (aim.effect, aim.rival, aim.words)
        if key not in found or lam[k] < lam[found[key]]:
            found[key] = k
    return sorted(found.values())


def _relaxed(found: Separation, rules: Rules) -> Relaxation:
    """The relaxation's weights and bound, under the number of runs or the budget,
    whichever is tighter.
    """
    best: Relaxation | None = None
    for total, cost in rules.totals(found.count):
        per = np.ones(found.count) if cost is None else cost
        scaled = dataclasses.replace(found, grams=found.grams / per[:, None, None])
        told: Relaxation | None = None
        for sharp in SHARP:
            step = dataclasses.replace(scaled, sharp=sharp)
            slack = (
                GAP + math.log(max(len(found.targets), 1)) / sharp
            )  # the smoothed minimum is off by as much
            again = relaxation.solve(
                step, total, per, slack, None if told is None else told.weights
            )
            told = (
                again
                if told is None
                else dataclasses.replace(again, bound=min(again.bound, told.bound))
            )
        assert told is not None
        told = dataclasses.replace(told, weights=told.weights / per)
        best = told if best is None or told.bound < best.bound else best
    assert best is not None
    return best


def _signatures(problem: GapProblem, effect: Effect) -> list[Signature]:
    """The effect's forms, at most `FORMS` of its grid. Raises ValueError where no
    candidate can test it.
    """
    reason = untestable(effect, problem.states)
    grid = effect.grid()
    if len(grid) > FORMS:
        grid = [
            grid[k]
            for k in np.unique(np.linspace(0, len(grid) - 1, FORMS).round().astype(int))
        ]
    made = [] if reason is not None else [
        problem.signature(effect, point)
        for point in grid
    ]  # fmt: skip
    kept = [s for s in made if s.names]
    if not kept:
        why = reason or "it changes none of the candidate readings"
        raise ValueError(f"{effect.name} cannot be tested by these candidates: {why}")
    return kept


def _combinations(made: Signature) -> list[dict[str, float]]:
    """All legs alike, for each kind of textbook coefficient; and each textbook
    coefficient by itself.
    """
    kinds: dict[str, dict[str, float]] = {}
    for name, label, shape in zip(made.names, made.labels, made.shape, strict=True):
        if not shape:
            kinds.setdefault(name.removeprefix(label) if label else name, {})[name] = (
                1.0
            )
    alike = [k for k in kinds.values() if len(k) > 1]
    return alike + [{name: 1.0} for k in kinds.values() for name in k]


def _white(
    problem: GapProblem, law: NoiseLaw, rows: Index, slopes: Array, columns: Array
) -> Array:
    """Slopes and columns of a run, whitened by its noise: only the triangle of their
    QR, which has the same Gram.
    """
    for k, members in enumerate(problem.blocks):
        if members[0] == rows[0]:
            factor = linalg.cholesky(law.block(problem, k), lower=True)
            white = linalg.solve_triangular(
                factor, np.hstack([slopes, columns])[members], lower=True
            )
            return np.asarray(white)
    raise ValueError("a run's rows are not one of the problem's blocks")
