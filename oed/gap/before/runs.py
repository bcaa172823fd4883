"""Candidate runs as readings, and as a pool with the targets that they are to separate.

A run is a circle or a line under one condition.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
import pandas as pd
from scipy import linalg

from oed.base import Array, Index
from oed.effect_model import Effect
from oed.gap.before.confusion import in_words
from oed.gap.before.forms import Form, effect_forms
from oed.gap.before.separation import Separation, Target
from oed.gap.data import state
from oed.gap.data.problem import GapProblem, assemble
from oed.measurement import Measurement, Series
from oed.noise import NoiseLaw

#: covariates that a condition may state
CONDITIONS = ("time", "direction", "feed", "payload")
#: forms of an effect (values of its constants) that stand for its grid
FORMS = 6


@dataclasses.dataclass(frozen=True, kw_only=True)
class Run:
    """A run that could be taken: poses in order, under one condition.

    name         unique in its set-up
    setup        name of the set-up
    command      (n, n_dof) poses, SI, in the order of direction +1; with direction -1
                 they are taken in reverse
    condition    {covariate: value}, SI: `direction`, `feed`, `payload`, and `time` at
                 which it starts
    seconds      that it takes
    """

    name: str
    setup: str
    command: Array
    condition: Mapping[str, float] = dataclasses.field(default_factory=dict)
    seconds: float = 0.0

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
                f"run {self.name}: direction is +1 or -1, not"
                f" {self.condition['direction']:g}"
            )
        if len(self.command) < 2:
            raise ValueError(
                f"run {self.name}: a run has at least 2 poses, not {len(self.command)}"
            )


def lay_out(
    measurement: Measurement, runs: Sequence[Run]
) -> tuple[tuple[Series, ...], pd.DataFrame]:
    """Series of all runs, one a set-up, and one row of covariates a reading.

    Raises ValueError for runs of one name in a set-up, AssemblyError for poses out of
    reach.
    """
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
    """One row a reading.

    `skipped` poses at the start are a reference and not a reading.
    """
    order = np.arange(skipped, len(run.command))
    stated = {c: v for c, v in run.condition.items() if c != "time"}
    table = pd.DataFrame(
        {"setup": run.setup, "run": run.name, "order": order, **stated}
    )
    if "time" in run.condition:
        since_start = order * run.seconds / len(run.command)
        table["time"] = run.condition["time"] + since_start
    return table


def prepare(
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
    at = later.groupby(["setup", "run"], sort=False).indices
    return tuple(np.asarray(at[r.setup, r.name], dtype=np.intp) + first for r in runs)


def pool_runs(
    problem: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    wanted: Sequence[Effect],
    rivals: Sequence[Effect] = (),
) -> Separation:
    """The separation of effects by candidate runs, as a function of their weights.

    problem    holds all candidates (`oed.gap.before.runs.prepare`)
    rows       (C,) readings of each run
    wanted     effects that are separated from each other and from the rivals
    rivals     further effects

    Of each wanted effect the coefficients of all legs alike, and each alone, are
    separated from each form of a rival. Its own constants are the middle ones of its
    grid. Raises ValueError for effects that no candidate can test.
    """
    effects = list({e.name: e for e in (*wanted, *rivals)}.values())
    forms = effect_forms(problem, effects, FORMS)
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
    """The separation of targets among columns (N, K) by candidate runs.

    rows   (C,) readings of each run
    taken  readings that any plan has
    """
    n, values = problem.slopes.shape[1], np.hstack([problem.slopes, columns])
    prior = np.eye(n, values.shape[1])
    white = [law.factor(problem.structure, at).whiten(values) for at in rows]
    known = prior
    if taken is not None:
        known = np.vstack([prior, law.factor(problem.structure, taken).whiten(values)])
    change, log_scale = _convenient_coordinates(np.vstack([*white, known]), n)
    changed = [x @ change for x in white]
    return Separation(
        grams=np.array([x.T @ x for x in changed]),
        base=(known @ change).T @ (known @ change),
        size=n,
        targets=tuple(targets),
        log_scale=log_scale,
    )


def _convenient_coordinates(whole: Array, n: int) -> tuple[Array, float]:
    """Change (m, m) to coordinates in which rounding does little harm.

    In these all rows (., m) together have unit information on the n parameters, and
    what the parameters can absorb of the effects is taken out. The second result is the
    log determinant that the parameters' information loses.
    """
    count = whole.shape[1] - n
    root = np.linalg.qr(whole[:, :n], mode="r")
    turned = linalg.solve_triangular(root, np.eye(n))
    absorbed = turned @ (turned.T @ (whole[:, :n].T @ whole[:, n:]))
    change = np.block([[turned, -absorbed], [np.zeros((count, n)), np.eye(count)]])
    return change, 2.0 * float(np.log(np.abs(np.diag(root))).sum())


def _targets(forms: Sequence[Form], rivals: Sequence[Form]) -> list[Target]:
    """Combinations of an effect's coefficients, each from each form of a rival."""
    middle, targets = forms[len(forms) // 2], []
    signature = middle.signature
    kinds: dict[str, list[str]] = {}
    for k in np.flatnonzero(~signature.shape):
        name = signature.names[k]
        kind = name.removeprefix(signature.labels[k])
        kinds.setdefault(kind, []).append(name)
    # all legs alike, for each kind of textbook coefficient, and each one alone
    alike = [kind for kind in kinds.values() if len(kind) > 1]
    for members in alike + [[name] for kind in kinds.values() for name in kind]:
        shares = np.isin(signature.names, members).astype(float)
        words = in_words(dict.fromkeys(members, 1.0))
        targets += [Target(middle, shares, words, rival) for rival in rivals]
    return targets
