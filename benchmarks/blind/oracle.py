"""What whoever knows the truth could do: the yardstick of the scorer, which alone may
use this.

With the true noise covariance and the true slopes, M = (Sigma + J Lambda J^T)^-1, and
dy an effect's exact change of the readings,

    sqrt(lambda)      = |dy|_M
    sqrt(lambda_k|j)  = what is left of it once a rival j of the library has absorbed
                      all it can: its columns are held at RIVAL times their physical
                      prior scales, the most absorbing of its forms and constants
                      counts, and what other effects truly act in the case is taken out
                      of everything first.

`apart` is the least over rivals other than the effects that act; `own` what the
effect's own library form leaves; `beyond` the least over all of the library, for
effects that are in none; `legs` the least over all forms that act in one leg alone, leg
by leg. `tied` are legs of which an effect in another leg makes the same readings, so
that nothing tells where it is.
"""

from __future__ import annotations

import dataclasses
import json
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import loading, pool
from benchmarks.blind.generator import write as truth_of
from benchmarks.blind.generator.severity import Metric as TrueMetric
from benchmarks.blind.loading import Case
from benchmarks.blind.run import law_of
from oed.arrays import Array
from oed.gap.cause import closure as closure_of
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as library_of
from oed.gap.forms.library import Atom, Library
from oed.noise.law import NoiseLaw
from oed.noise.runs import RunBatch

#: size, against its physical prior scale, that a rival is granted
RIVAL = 3.0
#: readings of the truth and of the file may differ by the rounding of the file, m
ROUNDING = 1e-9
#: shares of an effect's sqrt(lambda): by which what two tied legs leave of it may
#: differ, and that they leave at most
TIED, HALF = 1e-3, 0.5
SPLITS: tuple[closure_of.Split, ...] = ("within", "whole")


@dataclasses.dataclass(frozen=True, slots=True)
class Job:
    """A case, the effects that act in it, and the folder of its result; the oracle's
    own go to `results/oracle`.
    """

    folder: Path
    results: Path
    case: Case
    effects: tuple[str, ...]

    @property
    def file(self) -> Path:
        """Where the oracle's figures are kept."""
        return self.results / "oracle" / f"{self.case.id}.json"


def run(
    folder: Path,
    results: Path,
    cases: Sequence[Case],
    acting: Mapping[str, Sequence[str]],
    *,
    workers: int = 0,
    again: bool = False,
    told: Callable[[str], None] = print,
) -> dict[str, dict[str, Any]]:
    """The oracle's figures of every case, by id; those that are older than a case's
    result are made anew.

    acting: names of the effects that act, by case, in the order of the truth's `dy_0`,
    `dy_1`, ...
    """
    jobs = [Job(folder, results, c, tuple(acting[c.id])) for c in cases]
    due = [j for j in jobs if again or _stale(j)]
    due.sort(key=lambda j: j.case.study)
    for number, (job, text) in enumerate(
        pool.results(work, due, workers=workers), start=1
    ):
        loading.write(job.file, text)
        if number % 50 == 0 or number == len(due):
            told(f"oracle: {number} of {len(due)} cases")
    return {j.case.id: json.loads(j.file.read_text(encoding="utf-8")) for j in jobs}


def _stale(job: Job) -> bool:
    result = job.results / f"{job.case.id}.json"
    if not job.file.is_file():
        return True
    return result.is_file() and result.stat().st_mtime > job.file.stat().st_mtime


def work(job: Job) -> str:
    """The oracle's figures of a case as JSON. Raises ValueError where readings and
    truth do not belong together.
    """
    problem, truth = _opened(job)
    said = _distances(job, problem, truth)
    sigma = truth_of.covariance(truth)
    said["closure"] = (
        _closures(problem, sigma, truth, _result(job)) if job.effects else []
    )
    return json.dumps(said, allow_nan=False)


def distances(job: Job) -> dict[str, Any]:
    """The figures of a case that need no result: all but `closure`. Raises ValueError
    as `work` does.
    """
    return _distances(job, *_opened(job))


def _opened(job: Job) -> tuple[GapProblem, dict[str, Array]]:
    with np.load(job.folder / "truth" / f"{job.case.id}.npz") as kept:
        truth = {name: kept[name] for name in kept.files}
    problem = loading.prepared(job.folder, job.case)
    _check(problem, truth, job)
    return problem, truth


def _distances(
    job: Job, problem: GapProblem, truth: dict[str, Array]
) -> dict[str, Any]:
    known = library_of.build(problem, loading.bench(job.case.study).effects)
    found = _effects(problem, known, truth_of.covariance(truth), truth, job.effects)
    return {"id": job.case.id, "testable": list(known.effects), "effects": found}


def _result(job: Job) -> dict[str, Any]:
    file = job.results / f"{job.case.id}.json"
    return dict(json.loads(file.read_text(encoding="utf-8"))) if file.is_file() else {}


def _check(problem: GapProblem, truth: dict[str, Array], job: Job) -> None:
    """The readings are those of the truth, in the same order."""
    measured = problem.measurement.readings(problem.series, problem.theta)
    left = problem.residual * problem.sigma
    slopes = problem.measurement.jacobian(problem.series, problem.theta)
    y = measured + left - slopes @ (problem.theta - problem.measurement.nominal)
    if y.shape != truth["y"].shape or float(np.abs(y - truth["y"]).max()) > ROUNDING:
        raise ValueError(
            f"{job.case.readings}: these are not the readings of"
            f" truth/{job.case.id}.npz; make the set anew"
        )


# -- distances -------------------------------------------------------------------------


def _effects(
    problem: GapProblem,
    known: Library,
    sigma: Array,
    truth: dict[str, Array],
    names: Sequence[str],
) -> list[dict[str, Any]]:
    if not names:
        return []
    metric = TrueMetric(sigma, truth["J"].astype(float), truth["prior"])
    changes = [truth[f"dy_{k}"] for k in range(len(names))]
    columns = metric.seen(known.columns * problem.sigma[:, None])
    seen = [metric.seen(c) for c in changes]
    found = []
    for k, name in enumerate(names):
        others = (
            np.array(seen[:k] + seen[k + 1 :]).reshape(len(names) - 1, len(problem)).T
        )
        mine, theirs = _without(seen[k], others), _without(columns, others)
        left = absorbed(mine, theirs, known)
        rivals = {n: v for n, v in left.items() if n not in names}
        nearest = min(rivals, key=lambda n: rivals[n]) if rivals else ""
        whole = float(np.linalg.norm(mine))
        found.append({
            "name": name,
            "sqrt_lambda": float(np.linalg.norm(seen[k])),
            "given_others": whole,
            "apart": rivals.get(nearest, whole),
            "nearest": nearest,
            "own": left.get(name, whole),
            "beyond": min(left.values(), default=whole),
            "left": {n: round(v, 4) for n, v in left.items()},
            "legs": {leg: round(v, 4) for leg, v in by_leg(mine, theirs, known).items()},
            "tied": tied(mine, theirs, known, name),
        })  # fmt: skip
    return found


def _without(values: Array, directions: Array) -> Array:
    """Values (N,) or (N, k) less what directions (N, m) explain of them."""
    if not directions.shape[1]:
        return values
    q, _ = np.linalg.qr(directions)
    return np.asarray(values - q @ (q.T @ values))


def absorbed(seen: Array, columns: Array, known: Library) -> dict[str, float]:
    """For each effect of a library what it leaves of `seen` (N,), in coordinates in
    which M is the identity.

    sqrt(v^T v - v^T C (C^T C + 1 / RIVAL^2)^-1 C^T v), least over the effect's forms:
    all limbs, textbook and adapted.
    """
    left: dict[str, float] = {}
    for atom, kept in zip(known.atoms, _kept(seen, columns, known.atoms), strict=True):
        left[atom.effect] = min(left.get(atom.effect, math.inf), kept)
    return left


def by_leg(
    seen: Array, columns: Array, known: Library, name: str = ""
) -> dict[str, float]:
    """What forms that act in one leg alone leave of `seen` (N,) at least, for each leg:
    of an effect, or of all.
    """
    some = [
        a
        for a in known.atoms
        if name in ("", a.effect) and len({known.labels[c] for c in a.columns}) == 1
    ]
    least: dict[str, float] = {}
    for atom, kept in zip(some, _kept(seen, columns, some), strict=True):
        leg = known.labels[atom.columns[0]]
        if leg.startswith("leg "):
            least[leg] = min(least.get(leg, math.inf), kept)
    return least


def tied(seen: Array, columns: Array, known: Library, name: str) -> list[list[str]]:
    """Groups of legs of which an effect in any one alone leaves the same of `seen`
    (N,), whatever its forms.
    """
    whole = float(np.linalg.norm(seen))
    groups: list[list[str]] = []
    least = by_leg(seen, columns, known, name)
    for leg, kept in least.items():
        if kept > HALF * whole:
            continue
        group = next(
            (g for g in groups if abs(least[g[0]] - kept) < TIED * whole), None
        )
        if group is None:
            groups.append([leg])
        else:
            group.append(leg)
    return [g for g in groups if len(g) > 1]


def _kept(seen: Array, columns: Array, atoms: Sequence[Atom]) -> list[float]:
    """What each form leaves of `seen` (N,)."""
    whole, kept = float(seen @ seen), []
    for form in (columns[:, a.columns] for a in atoms):
        told = form.T @ seen
        inner = form.T @ form + np.eye(len(told)) / RIVAL**2
        kept.append(
            math.sqrt(max(whole - float(told @ np.linalg.solve(inner, told)), 0.0))
        )
    return kept


# -- closure ---------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class TrueLaw(NoiseLaw):
    """The true covariance (N, N) of the readings, in units of their stated noise, in
    place of a law's.
    """

    covariance: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))

    def covariances(self, batch: RunBatch) -> Array:
        """As in `NoiseLaw`."""
        return np.asarray(
            self.covariance[batch.members[:, :, None], batch.members[:, None, :]]
        )


def true_law(problem: GapProblem, sigma: Array) -> TrueLaw:
    """The law of a covariance (N, N), SI. Raises ValueError where it relates readings
    of different runs.
    """
    told = sigma / np.outer(problem.sigma, problem.sigma)
    across = told.copy()
    for members in problem.members:
        across[np.ix_(members, members)] = 0.0
    if float(np.abs(across).max(initial=0.0)) > 1e-9:
        raise ValueError(
            "the true noise relates readings of different runs; the law of a diagnosis"
            " cannot"
        )
    return TrueLaw(0.0, 0.0, 1.0, np.ones(len(problem)), covariance=told)


def _closures(
    problem: GapProblem, sigma: Array, truth: dict[str, Array], result: dict[str, Any]
) -> list[dict[str, Any]]:
    """For each split: the gain to be expected, the oracle's closure under the true law
    and under the diagnosis's.
    """
    change = (truth["clean"] - truth["y0"]) / problem.sigma
    right = true_law(problem, sigma)
    taken = law_of(result["law"], len(problem)) if "law" in result else None
    found = []
    for split in SPLITS:
        best = _oracle(problem, right, change, split)
        said: dict[str, Any] = {"split": split, "n": best["n"], "true": best}
        said["expected_gain"] = closure_of.expected_gain(
            problem, right, change, np.random.default_rng(0), split=split
        )
        said["same_law"] = (
            None if taken is None else _oracle(problem, taken, change, split)
        )
        found.append(said)
    return found


def _oracle(
    problem: GapProblem, law: NoiseLaw, change: Array, split: closure_of.Split
) -> dict[str, Any]:
    made = closure_of.oracle_closure(
        problem, law, change, np.random.default_rng(0), split=split, draws=1
    )
    return {
        k: None if not math.isfinite(v := getattr(made, k)) else v
        for k in ("value", "s0", "s1", "n")
    }
