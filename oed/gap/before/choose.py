"""Choice of runs that separate wanted effects: payload, direction, feed, tool, time.

Each ordered pair of a wanted effect and a rival gives targets: combinations of the
effect's coefficients at their prior sizes, to be separated from the rival with the
parameters profiled out. The least lambda_{k|j} over all targets is maximised,
compounded with D so that the parameters stay identifiable
(`oed.gap.before.separation`). Candidates are whole runs, each under one condition and
at a cost. The plan comes from greedy starts and exchanges (`oed.design.search`), and a
relaxation to weights between 0 and 1 bounds every plan (`oed.design.relaxation`).
"""

import dataclasses
import functools
import itertools
import math
from collections.abc import Mapping, Sequence

import msgspec
import numpy as np
import pandas as pd
from scipy import linalg

from oed.base import Array, Index
from oed.design import Rules
from oed.effect_model import Effect
from oed.gap.before.detect import Form, combination_words, effect_forms
from oed.gap.before.separation import (
    SMOOTHING_LEVELS,
    Separation,
    SeparationEvaluator,
    Target,
)
from oed.gap.data import state
from oed.gap.data.problem import GapProblem, assemble
from oed.measurement import Measurement, Series
from oed.noise import NoiseLaw
from oed.result import SeparationRecord

# Candidate runs as readings, and as a pool with the targets that they are to separate.
#
# A run is a circle or a line under one condition.

#: covariates that a condition may state
CONDITIONS = ("time", "direction", "feed", "payload")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """A run that could be taken: poses in order, under one condition."""

    name: str  #: unique in its set-up
    setup: str  #: name of the set-up
    #: (n, n_dof) poses, SI, in the order of direction +1; with direction -1 they are
    #: taken in reverse
    command: Array
    #: {covariate: value}, SI: `direction`, `feed`, `payload`, and `time` at which it
    #: starts
    condition: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0  #: that it takes

    @property
    def direction(self) -> int:
        """+1, or -1 where the poses are taken in reverse."""
        return int(self.condition.get("direction", 1.0))

    def __post_init__(self) -> None:
        unknown = sorted(set(self.condition) - set(CONDITIONS))
        if unknown:
            raise ValueError(
                f"run {self.name}: no condition {unknown}; there are {list(CONDITIONS)}"
            )
        if self.condition.get("direction", 1.0) not in (-1.0, 1.0):
            raise ValueError(
                f"run {self.name}: direction is +1 or -1, not {self.condition['direction']:g}"
            )
        if len(self.command) < 2:
            raise ValueError(
                f"run {self.name}: a run has at least 2 poses, not {len(self.command)}"
            )


def lay_out(
    measurement: Measurement, runs: Sequence[Run]
) -> tuple[tuple[Series, ...], pd.DataFrame]:
    """Series a set-up, a row of covariates a reading. ValueError, AssemblyError."""
    keys = [(r.setup, r.name) for r in runs]
    if len(set(keys)) < len(keys):
        twice = sorted({key[1] for key in keys if keys.count(key) > 1})
        raise ValueError(
            f"runs need names of their own in a set-up: {twice} are used twice"
        )
    series, rows = [], []
    for setup in dict.fromkeys(r.setup for r in runs):
        of_setup = [r for r in runs if r.setup == setup]
        labels = [r.name for r in of_setup for _ in range(len(r.command))]
        command = np.vstack([r.command[:: r.direction] for r in of_setup])
        series.append(measurement.series(setup, command, labels))
        instrument = measurement.setups[setup].instrument
        skipped = 1 if instrument.reference == "run" else 0
        rows += [_covariates(r, skipped) for r in of_setup]
    return tuple(series), pd.concat(rows, ignore_index=True)


def _covariates(run: Run, skipped: int) -> pd.DataFrame:
    """One row a reading; the first `skipped` poses are references."""
    order = np.arange(skipped, len(run.command))
    stated = {c: v for c, v in run.condition.items() if c != "time"}
    table = pd.DataFrame(
        {"setup": run.setup, "run": run.name, "order": order, **stated}
    )
    if "time" in run.condition:
        since_start = order * run.seconds / len(run.command)
        table["time"] = run.condition["time"] + since_start
    return table


def problem_of_runs(
    measurement: Measurement,
    runs: Sequence[Run],
    *,
    gravity: tuple[float, float, float] = state.DOWN,
) -> tuple[GapProblem, tuple[Index, ...]]:
    """The problem of all candidate runs as if taken, and each run's rows in it."""
    series, covariates = lay_out(measurement, runs)
    problem = assemble(measurement, series, covariates, gravity=gravity)
    return problem, rows_of_runs(problem, runs)


def rows_of_runs(
    problem: GapProblem, runs: Sequence[Run], first: int = 0
) -> tuple[Index, ...]:
    """Readings of each run of a problem, of which they are those from `first` on."""
    later = problem.rows.iloc[first:].reset_index(drop=True)
    rows = later.groupby(["setup", "run"], sort=False).indices
    return tuple(np.asarray(rows[r.setup, r.name], dtype=np.intp) + first for r in runs)


def pool_runs(
    problem: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    wanted: Sequence[Effect],
    rivals: Sequence[Effect] = (),
) -> Separation:
    """The separation of `wanted` effects from each other and from the rivals by
    candidate runs, as a function of their weights.

    rows  (C,) readings of each run

    Raises ValueError for effects that no candidate can test.
    """
    effects = list({e.name: e for e in (*wanted, *rivals)}.values())
    forms = effect_forms(problem, effects, most=6)
    for name, why in forms.reasons.items():
        raise ValueError(f"{name} cannot be tested by these candidates: {why}")
    targets: list[Target] = []
    for effect in wanted:
        for name, rival_forms in forms.by_effect.items():
            if name != effect.name:
                targets += _targets(forms.by_effect[effect.name], rival_forms)
    if not targets:
        raise ValueError("there is nothing to tell apart: give two effects at least")
    return separation(problem, law, rows, forms.columns, targets)


def separation(
    problem: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    columns: Array,
    targets: Sequence[Target],
    taken: Index | None = None,
) -> Separation:
    """The separation of targets in columns (N, K) by runs of readings `rows` (C,)."""
    n = problem.slopes.shape[1]
    values = np.hstack([problem.slopes, columns])
    prior = np.eye(n, values.shape[1])
    white = [law.factor(problem.structure, members).whiten(values) for members in rows]
    base_rows = prior
    if taken is not None:
        base_rows = np.vstack(
            [prior, law.factor(problem.structure, taken).whiten(values)]
        )
    change, log_scale = _convenient_coordinates(np.vstack([*white, base_rows]), n)
    changed = [x @ change for x in white]
    return Separation(
        grams=np.array([x.T @ x for x in changed]),
        base=(base_rows @ change).T @ (base_rows @ change),
        size=n,
        targets=tuple(targets),
        log_scale=log_scale,
    )


def _convenient_coordinates(whole: Array, n: int) -> tuple[Array, float]:
    """Change (m, m) to coordinates of unit information, less what n parameters absorb,
    and the log determinant that their information loses.
    """
    count = whole.shape[1] - n
    root = np.linalg.qr(whole[:, :n], mode="r")
    turned = linalg.solve_triangular(root, np.eye(n))
    absorbed = turned @ (turned.T @ (whole[:, :n].T @ whole[:, n:]))
    change = np.block([[turned, -absorbed], [np.zeros((count, n)), np.eye(count)]])
    return change, 2.0 * float(np.log(np.abs(np.diag(root))).sum())


def _targets(forms: Sequence[Form], rivals: Sequence[Form]) -> list[Target]:
    """Combinations of an effect's coefficients, each from each form of a rival."""
    middle = forms[len(forms) // 2]
    targets = []
    signature = middle.signature
    kinds = [
        [signature.names[k] for k in columns if not signature.shape[k]]
        for columns in signature.kinds.values()
    ]
    # all legs alike, for each kind of textbook coefficient, and each one alone
    alike = [kind for kind in kinds if len(kind) > 1]
    for members in alike + [[name] for kind in kinds for name in kind]:
        shares = np.isin(signature.names, members).astype(float)
        phrase = combination_words(dict.fromkeys(members, 1.0))
        targets += [Target(middle, shares, phrase, rival) for rival in rivals]
    return targets


VOLUME_SHARE = 0.1  #: share of D in the compound
#: plans up to which all of them are tried, so that the best is proven
MAX_ENUMERATED = 20_000
BOUND_TOLERANCE = 1e-3  #: gap of the relaxation that is good enough, in log lambda


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunChoice:
    """Chosen runs."""

    runs: Index  #: (n,) numbers of the candidates, ascending
    separation: float  #: least sqrt(lambda_k|j) over all targets
    bound: float  #: of the separation: no plan under the rules exceeds it
    #: every pair and combination, ascending by separation
    pairs: list[SeparationRecord]
    value: float  #: of the compound, in logs
    above: float  #: bound of the value: no plan's exceeds it
    volume: float  #: log det of the parameters' information with their prior
    seconds: float  #: that the runs take, set-ups included, where costs are known
    proven: bool  #: all plans were tried: separation and value belong to the best

    @property
    def before(self) -> float | None:
        """The least separation before; None where one of them is not known."""
        separations = [pair.before for pair in self.pairs if pair.before is not None]
        return min(separations) if len(separations) == len(self.pairs) else None

    @property
    def efficiency(self) -> float:
        """exp(value - above), at most 1."""
        return float(np.exp(min(self.value - self.above, 0.0)))


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunsWanted:
    """What runs are to be chosen for."""

    runs: Sequence[Run]  #: candidates, all in set-ups of one measurement
    retained: Sequence[int]  #: numbers of those that any plan has
    #: effects that are separated from each other and from the rivals
    wanted: Sequence[Effect]
    rivals: Sequence[Effect]  #: further effects
    share: float  #: of D in the compound
    rounds: int  #: of the search

    def pool(self, problem: GapProblem, rows: Sequence[Index]) -> Separation:
        """The separation of the effects in a problem by its runs, of some rows each."""
        law = problem.stated_law
        return pool_runs(problem, law, rows, self.wanted, self.rivals)


def choose_runs(
    measurement: Measurement,
    request: RunsWanted,
    rules: Rules,
    planned: GapProblem,
    rng: np.random.Generator,
) -> tuple[RunChoice, tuple[Series, ...], pd.DataFrame]:
    """The runs that separate wanted effects best, retained ones among them.

    planned  other planned readings, whose separation is that before

    The further results are the series of these runs, and one row of covariates a reading.

    Raises ValueError where no run shows the effects or the rules allow no plan,
    AssemblyError for poses out of reach.
    """
    candidates, rows = problem_of_runs(
        measurement, request.runs, gravity=planned.gravity
    )
    choice = choose(
        request.pool(candidates, rows),
        rules,
        rng,
        share=request.share,
        fixed=np.array(request.retained, dtype=np.intp),
        rounds=request.rounds,
    )
    choice = dataclasses.replace(choice, pairs=_add_earlier(choice, planned, request))
    selected = [request.runs[k] for k in choice.runs]
    return choice, *lay_out(measurement, selected)


def _add_earlier(
    choice: RunChoice, planned: GapProblem, request: RunsWanted
) -> list[SeparationRecord]:
    """Pairs with their separation in other planned readings, where these test it."""
    try:
        pool = request.pool(planned, planned.members)
    except ValueError:
        return choice.pairs
    earlier = {
        (pair.effect, pair.rival, pair.words): pair.separation
        for pair in pool.pairs(np.arange(pool.count))
    }
    return [
        msgspec.structs.replace(
            pair, before=earlier.get((pair.effect, pair.rival, pair.words))
        )
        for pair in choice.pairs
    ]


def choose(
    everything: Separation,
    rules: Rules,
    rng: np.random.Generator,
    *,
    share: float = VOLUME_SHARE,
    fixed: Index | None = None,
    rounds: int = 12,
) -> RunChoice:
    """Choose runs of a pool (`oed.gap.before.choose`) in addition to the `fixed` ones.

    rules     number of runs, or a budget; set-ups
    share     of D in the compound: 0 only separates effects, 1 is D alone
    fixed     runs that are part of any plan
    rounds    of the search

    Raises ValueError where the rules allow no run, or the share is not from 0 to 1.
    """
    if not 0.0 <= share <= 1.0:
        raise ValueError(f"the share of D must lie between 0 and 1, not {share:g}")
    fixed = np.empty(0, dtype=np.intp) if fixed is None else fixed
    count = everything.count
    free = np.setdiff1d(np.arange(count), fixed)
    if rules.size is not None and not 0 < rules.size <= len(free):
        raise ValueError(
            f"cannot choose {rules.size} different runs out of {len(free)} candidates"
        )
    if not rules.additions(np.empty(0, dtype=np.intp), count).any():
        raise ValueError(
            "the rules allow no run at all: raise the number of runs or the budget"
        )
    everything = dataclasses.replace(everything, share=share)
    rest = dataclasses.replace(everything, base=everything.of(fixed)).subset(free)
    size = rules.sole_size
    proven = size is not None and math.comb(len(free), size) <= MAX_ENUMERATED
    if size is not None and proven:
        selected, above, log_least = _enumerate(rest, size)
    else:
        selected, above, log_least = _search(rest, rules.subset(free), rng, rounds)
    runs = np.sort(np.concatenate([free[selected], fixed]))
    m, pairs = everything.of(runs), everything.pairs(runs)
    least = pairs[0].separation
    shift = share * everything.log_scale / everything.size
    return RunChoice(
        runs=runs,
        separation=least,
        bound=max(float(np.exp(0.5 * log_least)), least),
        pairs=pairs,
        value=float(everything.worth(m)) + shift,
        above=above + shift,
        volume=float(everything.log_det(m)) + everything.log_scale,
        seconds=rules.time_of(free[selected]),
        proven=proven,
    )


def _enumerate(separation: Separation, size: int) -> tuple[Index, float, float]:
    """The best of all plans, its compound, and the largest least log lambda of all."""
    places = itertools.combinations(range(separation.count), size)
    plans = np.array(list(places), dtype=np.intp)
    values, log_least = [], []
    for chunk in np.array_split(plans, -(-len(plans) // 256)):
        m = separation.base + separation.grams[chunk].sum(axis=1)
        values.append(separation.worth(m))
        log_least.append(np.log(separation.lambdas(m).min(axis=0)))
    value = np.concatenate(values)
    best = int(np.argmax(value))
    return plans[best], float(value[best]), float(np.concatenate(log_least).max())


def _search(
    everything: Separation, rules: Rules, rng: np.random.Generator, rounds: int
) -> tuple[Index, float, float]:
    """The best plan that the search reaches, and bounds of every plan.

    The bounds are those of the compound and of the least log lambda. The targets whose
    constants absorb most lead the search; others join while a plan shows them to be
    worse.
    """
    count = everything.count
    numbers = everything.hardest(np.arange(count))
    for _ in range(4):
        separation = everything.with_targets(numbers)
        slack = functools.partial(_slack, separation)
        relaxed = rules.relax(count, separation.smoothed, SMOOTHING_LEVELS, slack)
        evaluator = SeparationEvaluator(separation)
        runs = rules.search(evaluator, relaxed, rng, rounds)
        joined = sorted({*numbers, *everything.hardest(runs)})
        if joined == numbers:
            break
        numbers = joined
    alone = dataclasses.replace(everything.with_targets(numbers), share=0.0)
    slack = functools.partial(_slack, alone)
    bound = rules.relax(count, alone.smoothed, SMOOTHING_LEVELS, slack).bound
    return runs, relaxed.bound, bound


def _slack(separation: Separation, sharp: float) -> float:
    """Gap that is good enough: the smoothed minimum is off by the second part."""
    return BOUND_TOLERANCE + math.log(len(separation.targets)) / sharp
