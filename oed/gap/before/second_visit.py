"""Chooses the runs of a second visit, which separate the answers of a diagnosis best.

What may act has the form and size that suit the readings taken best, and the columns that
this form has in the readings of both visits. Of the two likeliest answers that all
candidates together separate further, each is a target to be separated from the other, with
the readings taken, their noise law and the parameters' priors in the model
(`oed.gap.before.separation`): the least lambda_{k|j} is maximised.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import linalg, special

from oed import units
from oed.base import Array, Index
from oed.design import Rules
from oed.effect_model import Effect
from oed.gap.before import choose
from oed.gap.before.choose import CONDITIONS, Run, lay_out, rows_of_runs, separation
from oed.gap.before.detect import ColumnSet
from oed.gap.before.separation import Separation, Target
from oed.gap.cause.answers import is_sure
from oed.gap.cause.search import PRIOR, Search
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.data.problem import GapProblem, Metric, assemble
from oed.gap.forms import discrepancy
from oed.gap.forms import library as libraries
from oed.measurement import Series
from oed.noise import NoiseLaw
from oed.result import UNKNOWN, SeparationRecord

# Candidate runs of a second visit: the runs of the first under other conditions.
#
# Each path that was read is a candidate, at all of its poses and at every second one, in
# both directions, at the least and the largest feed and payload that were used, as far as
# the readings state them. Further values of these can be given, and further runs. All
# start a pause after the last reading.

VISIT_DELAY = 600.0  #: from the last reading to a second visit, s
STEPS = (1, 2)  #: a path is read at each pose, or at every second one


def candidate_runs(
    problem: GapProblem,
    further_values: Mapping[str, Sequence[float]] | None = None,
    further_runs: Sequence[Run] = (),
) -> list[Run]:
    """Paths of a problem that recorded commands, under each condition and further
    values, and the further runs under known conditions and set-ups.
    """
    table = problem.covariates.reset_index(drop=True)
    clock = {}
    if _is_known(table, "time"):
        clock = {"time": float(table["time"].max()) + VISIT_DELAY}
    conditions = list(_conditions(table, further_values or {}))
    runs = []
    for run in further_runs:
        stated = {name: v for name, v in run.condition.items() if name != "time"}
        is_mounted = run.setup in problem.measurement.setups
        if is_mounted and stated.keys() == conditions[0].keys():
            runs.append(dataclasses.replace(run, condition=stated | clock))
    for path in _paths(problem, table):
        for stated, step in itertools.product(conditions, STEPS):
            poses = path.command[::step]
            if len(poses) >= 5 or step == 1:
                parts = [f"{path.name} again", *_words(stated)]
                parts += ["every second pose"] if step > 1 else []
                name = ", ".join(parts)
                condition = stated | clock
                runs.append(
                    dataclasses.replace(
                        path, name=name, command=poses, condition=condition
                    )
                )
    return runs


def _is_known(table: pd.DataFrame, name: str) -> bool:
    return name in table and bool(table[name].notna().any())


def _conditions(
    table: pd.DataFrame, further: Mapping[str, Sequence[float]]
) -> Iterator[dict[str, float]]:
    """Conditions of the readings taken: all combinations of extreme values."""
    values: dict[str, list[float]] = {}
    if _is_known(table, "direction"):
        values["direction"] = [1.0, -1.0]
    for name in ("feed", "payload"):
        if _is_known(table, name):
            stated = [*table[name].dropna(), *further.get(name, ())]
            values[name] = sorted({float(min(stated)), float(max(stated))})
    for chosen in itertools.product(*values.values()):
        yield dict(zip(values, chosen, strict=True))


def _paths(problem: GapProblem, table: pd.DataFrame) -> list[Run]:
    """The distinct paths, with commands in forward order; the first run of each counts."""
    forward: list[Run] = []
    backward: list[Run] = []
    start = 0
    for series in problem.series:
        rows = table.iloc[start : start + len(series)]
        start += len(series)
        for label in dict.fromkeys(str(r) for r in series.run):
            members = np.flatnonzero(series.run == label)
            command = series.command[_poses(problem, series, members)]
            if len(command) < 2 or np.isnan(command).any():
                continue
            of_run = rows.iloc[members]
            reverse = "direction" in of_run and (of_run["direction"] == -1).all()
            seconds = 0.0
            if _is_known(of_run, "time"):
                seconds = float(of_run["time"].max() - of_run["time"].min())
            run = Run(
                name=label,
                setup=series.setup,
                command=command[::-1] if reverse else command,
                seconds=seconds,
            )
            (backward if reverse else forward).append(run)
    distinct: dict[tuple[str, bytes], Run] = {}
    for run in [*forward, *backward]:
        places = np.unique(np.round(run.command, 7), axis=0)
        distinct.setdefault((run.setup, places.tobytes()), run)
    return list(distinct.values())


def _poses(problem: GapProblem, series: Series, members: Index) -> Array:
    """Poses of a run in order, its reference first where readings refer to that."""
    poses = series.index[members, 0]
    if problem.measurement.setups[series.setup].instrument.reference == "run":
        poses = np.concatenate([series.index[members[:1], 1], poses])
    return np.asarray(poses)


def _words(condition: Mapping[str, float]) -> Iterator[str]:
    """A condition as parts of a run's name."""
    if "payload" in condition:
        yield f"{condition['payload']:g} N"
    if "feed" in condition:
        yield f"{condition['feed'] / units.MM_PER_MIN:g} mm/min"
    if "direction" in condition:
        yield f"{condition['direction']:+.0f}"


# Expected probability of the right answer after planned readings, by simulation.
#
# AnswerForm k of the readings has the columns G_k, coefficients beta ~ N(0, 1), and the
# probability p_k after the readings r taken. With the parameters' slopes H and readings
# whitened by the noise, its coefficients (theta, beta) given r are normal, and so are the
# readings to come,
#
# A_k = 1 + X_k^T X_k,    m_k = A_k^-1 X_k^T r,    X_k = [H, G_k],
# r' | k, r ~ N(X'_k m_k, 1 + X'_k A_k^-1 X'_k^T),
#
# X'_k of the readings to come. Draws of r' under each explanation by its probability are
# answered as a diagnosis would: the answer with the most posterior probability is right
# with that probability. Its mean over the draws is the expected probability of the right
# answer (the preposterior analysis of Raiffa and Schlaifer 1961, chapter 4).

READING_DRAWS = 600  #: draws of the readings to come


@dataclasses.dataclass(frozen=True, eq=False)
class AnswerForm:
    """An answer of a diagnosis in one of its forms."""

    effects: tuple[str, ...]  #: names of what acts; none: nothing
    probability: float  #: after the readings taken
    #: (N, k) of all readings, taken and to come, per standard deviation of each
    #: coefficient, in units of the stated noise
    columns: Array
    #: probability that the answer is right where this explanation is best: less than 1
    #: for nothing at all, beside which what is too small to be seen acts
    share_right: float = 1.0


def coefficients(white: Array, residual: Array) -> tuple[Array, Array]:
    """Mean (m,) of coefficients N(0, 1), and a Cholesky factor of their precision."""
    precision = np.eye(white.shape[1]) + white.T @ white
    factor = linalg.cholesky(precision, lower=True, check_finite=False)
    mean = linalg.cho_solve((factor, True), white.T @ residual, check_finite=False)
    return np.asarray(mean), np.asarray(factor)


def probability_now(explanations: Sequence[AnswerForm]) -> float:
    """Probability of the likeliest answer."""
    probability = np.array([e.probability for e in explanations])
    log_density = np.zeros((len(explanations), 1))
    return float(_right(explanations, probability, log_density)[0])


def expected_probability(
    explanations: Sequence[AnswerForm],
    taken: Sequence[Array],
    residual: Array,
    to_come: Sequence[Array],
    rng: np.random.Generator,
) -> float:
    """Expected probability that the likeliest answer is right after readings to come,
    by [H, G_k] (N, m) of both visits and a residual (N,), whitened.
    """
    probability = np.array([e.probability for e in explanations])
    from scipy import stats  # takes half a second to import

    predictions = []
    for x, y in zip(taken, to_come, strict=True):
        mean, factor = coefficients(x, residual)
        spread = linalg.solve_triangular(factor, y.T, lower=True, check_finite=False)
        covariance = np.eye(len(y)) + spread.T @ spread
        predictions.append(stats.multivariate_normal(y @ mean, covariance))
    truth = rng.choice(
        len(predictions), READING_DRAWS, p=probability / probability.sum()
    )
    draws = np.empty((READING_DRAWS, len(to_come[0])))
    for k, prediction in enumerate(predictions):
        of_k = truth == k
        drawn = prediction.rvs(READING_DRAWS, random_state=rng).reshape(draws.shape)
        draws[of_k] = drawn[of_k]
    log_density = np.array([prediction.logpdf(draws) for prediction in predictions])
    return float(_right(explanations, probability, log_density).mean())


def _right(
    explanations: Sequence[AnswerForm], probability: Array, log_density: Array
) -> Array:
    """Probability (d,) of the likeliest answer for each draw; answers alike join."""
    shares = special.softmax(np.log(probability)[:, None] + log_density, axis=0)
    answers: dict[tuple[str, ...], Index] = {}
    for k, explanation in enumerate(explanations):
        same_effects = answers.get(explanation.effects, np.empty(0, dtype=np.intp))
        answers[explanation.effects] = np.append(same_effects, k)
    right = np.array([e.share_right for e in explanations])[:, None] * shares
    joined = np.array([right[numbers].sum(axis=0) for numbers in answers.values()])
    return np.asarray(probability.sum() * joined.max(axis=0))


MAX_PAIRS = 12  #: ordered pairs of the likeliest answers that are tried
#: pairs that a plan is for, of those that the candidates separate: with more the likeliest
#: are less well separated
N_TARGETS = 2


@dataclasses.dataclass(frozen=True, kw_only=True)
class SecondVisit:
    """A second visit."""

    runs: tuple[Run, ...]  #: in the order in which they are to be taken
    series: tuple[Series, ...]  #: their readings, with one row of `covariates` each
    covariates: pd.DataFrame
    probability_now: float  #: of the likeliest set of effects
    #: expected probability that the likeliest is right after the visit
    probability_after: float
    pairs: tuple[SeparationRecord, ...]  #: what the runs separate, ascending
    #: pairs of answers that no candidate separates
    inseparable: tuple[tuple[str, str], ...]


def needs_second_visit(diagnosis: Diagnosis) -> bool:
    """Whether the first answer is a class or unknown, or not sure beside another that shows."""
    return (
        diagnosis.verdict in ("class", "scatter", "unknown")
        or any(len(c) > 1 for c in diagnosis.answers[0].classes)
        or not is_sure(diagnosis.answers)
    )


def propose_second_visit(
    diagnosis: Diagnosis,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    further_values: Mapping[str, Sequence[float]] | None = None,
    further_runs: Sequence[Run] = (),
) -> SecondVisit | None:
    """The second visit that a diagnosis calls for; None where none helps.

    further_values  feeds and payloads, SI, that are possible beside those of the readings
    further_runs    runs that are possible beside those that were read
    """
    if not needs_second_visit(diagnosis):
        return None
    candidates = candidate_runs(diagnosis.problem, further_values, further_runs)
    return propose(diagnosis, effects, candidates, rng)


def propose(
    diagnosis: Diagnosis,
    effects: Sequence[Effect],
    candidates: Sequence[Run],
    rng: np.random.Generator,
) -> SecondVisit | None:
    """The runs that separate the answers of a diagnosis best; None where none does.

    They have at most a quarter of the readings that the diagnosis rests on.
    """
    taken = diagnosis.problem if diagnosis.clean is None else diagnosis.clean
    budget = 0.25 * sum(len(s) for s in taken.series)
    possible = [run for run in candidates if len(run.command) <= budget]
    if not possible:
        return None
    both, rows = both_visits(taken, possible)
    # new channels are as the first
    more = len(both.structure.names) - len(taken.structure.names)
    laws = diagnosis.law.law
    scale = np.pad(laws.scale, ((0, 0), (0, more)), constant_values=1.0)
    law = dataclasses.replace(diagnosis.law, law=dataclasses.replace(laws, scale=scale))
    forms = answer_forms(diagnosis, taken, both, law, effects)
    first = np.arange(len(taken))
    pool, inseparable = _pool(both, law, rows, forms, first)
    if pool is None:
        return None
    cost = np.array([len(run.command) for run in possible], dtype=float)
    rules = Rules.build(seconds=cost, budget=budget)
    plan = choose.choose(pool, rules, rng, share=0.02, rounds=4)
    runs = tuple(possible[k] for k in plan.runs)
    series, covariates = lay_out(taken.measurement, runs)
    columns = [np.hstack([both.slopes, form.columns]) for form in forms]
    taken_readings = law.factor(both.structure, first)
    to_come = law.factor(both.structure, np.concatenate([rows[k] for k in plan.runs]))
    after = expected_probability(
        forms,
        [taken_readings.whiten(values) for values in columns],
        taken_readings.whiten(both.residual[:, None])[:, 0],
        [to_come.whiten(values) for values in columns],
        rng,
    )
    return SecondVisit(
        runs=runs,
        series=series,
        covariates=covariates.drop(columns="time", errors="ignore"),
        probability_now=probability_now(forms),
        probability_after=after,
        pairs=tuple(plan.pairs),
        inseparable=tuple(inseparable),
    )


# -- both visits as one problem --------------------------------------------------------
def both_visits(
    taken: GapProblem, candidates: Sequence[Run]
) -> tuple[GapProblem, tuple[Index, ...]]:
    """The readings taken and all candidates as one problem, and each run's rows in it."""
    series, covariates = lay_out(taken.measurement, candidates)
    # temperatures and tensions as read last
    stated = (*covariates, *CONDITIONS, "repeat")
    others = [c for c in taken.covariates if c not in stated]
    last = {c: taken.covariates[c].dropna() for c in others}
    rows = covariates.assign(
        **{c: v.iloc[-1] if len(v) else np.nan for c, v in last.items()}
    )
    both = assemble(
        taken.measurement,
        [*taken.series, *series],
        pd.concat([taken.covariates, rows], ignore_index=True),
        taken.theta,
        gravity=taken.gravity,
    )
    unread = np.zeros(len(both) - len(taken))
    both = both.with_residual(np.concatenate([taken.residual, unread]))
    return both, rows_of_runs(both, candidates, len(taken))


def answer_forms(
    diagnosis: Diagnosis,
    taken: GapProblem,
    both: GapProblem,
    law: NoiseLaw,
    effects: Sequence[Effect],
) -> list[AnswerForm]:
    """The likely sets of effects in their likely forms, with columns of both visits."""
    likely = sorted(diagnosis.shares.items(), key=lambda item: -item[1])[:8]
    likely = [(key, share) for key, share in likely if share >= 0.01]
    names = {name for (named, _), _ in likely for name in named}
    involved = [effect for effect in effects if effect.name in names]
    first, single = np.arange(len(taken)), dataclasses.replace(law, level=1.0)
    library = libraries.build(both, involved, Metric(both, single, first))
    processes = discrepancy.build(both)
    search = Search(
        taken,
        dataclasses.replace(library, columns=library.columns.first_rows(len(taken))),
        dataclasses.replace(
            processes, columns=processes.columns.first_rows(len(taken))
        ),
        dataclasses.replace(diagnosis.law, level=1.0),
        0.0,
    )
    by_key = {h.key: h for h in search.run()}
    answers: list[AnswerForm] = []
    for key, share in likely:
        best = by_key.get(key)
        if best is None:
            continue
        forms = search.forms(best, 0)[:3] if best.is_gap else [(1.0, best)]
        total = sum(part for part, _ in forms)
        # a remainder beside named effects is the same answer
        named = tuple(sorted(best.effects)) or (UNKNOWN,) * best.unknown
        right = PRIOR["none"] / (PRIOR["none"] + PRIOR["unseen"])
        answers += [
            AnswerForm(
                effects=named,
                probability=share * part / total,
                columns=form.columns(library, processes, law.level),
                share_right=1.0 if best.is_gap else right,
            )
            for part, form in forms
        ]
    return answers


# -- targets ---------------------------------------------------------------------------
def _pool(
    both: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    forms: Sequence[AnswerForm],
    first: Index,
) -> tuple[Separation | None, list[tuple[str, str]]]:
    """The separation of the likely answers by the candidates, and pairs that none separates."""
    columns, parts = _parts(both, law, forms, first)
    pairs = [
        (p * q, Target(answer, size, "", rival))
        for (answer, size, p), (rival, _, q) in itertools.permutations(parts, 2)
        if len(size)
    ]
    pairs.sort(key=lambda pair: -pair[0])
    targets = [target for _, target in pairs[:MAX_PAIRS]]
    if not targets:
        return None, []
    pool = separation(both, law, rows, columns, targets, first)
    gain = pool.lambdas(pool.of(np.arange(pool.count))) - pool.lambdas(pool.base)
    open_targets = np.flatnonzero(gain > 1.0).tolist()
    separable = {frozenset(targets[k].key[:2]) for k in open_targets}
    every = dict.fromkeys(tuple(sorted(target.key[:2])) for target in targets)
    closed = [(a, b) for a, b in every if frozenset((a, b)) not in separable]
    if not open_targets:
        return None, closed
    return pool.with_targets(open_targets[:N_TARGETS]), closed


def _parts(
    both: GapProblem, law: NoiseLaw, forms: Sequence[AnswerForm], first: Index
) -> tuple[Array, list[tuple[ColumnSet, Array, float]]]:
    """Columns (N, K) of the answers, each in its likeliest form.

    Then of each its columns, of prior N(0, 1), their coefficients as the readings taken
    give them, and its probability.
    """
    likeliest: dict[tuple[str, ...], AnswerForm] = {}
    for form in sorted(forms, key=lambda form: -form.probability):
        likeliest.setdefault(form.effects, form)
    whiten = law.factor(both.structure, first).whiten
    residual = whiten(both.residual[:, None])[:, 0]
    start = 0
    parts = []
    for form in likeliest.values():
        numbers = np.arange(start, start + form.columns.shape[1])
        start += len(numbers)
        white = whiten(np.hstack([both.slopes, form.columns]))
        size = coefficients(white, residual)[0][both.slopes.shape[1] :]
        name = " + ".join(form.effects) or "nothing"
        columns = ColumnSet(name, numbers, np.ones(len(numbers)))
        parts.append((columns, size, form.probability))
    blocks = [form.columns for form in likeliest.values()]
    return np.hstack([np.zeros((len(both), 0)), *blocks]), parts
