"""Oracle: figures of an observer who knows the truth, as the scorer's yardstick.

With the true noise covariance and the true slopes, M = (Sigma + J Lambda J^T)^-1, and
dy an effect's exact change of the readings,

    sqrt(lambda)      = |dy|_M
    sqrt(lambda_k|j)  = |what a rival j of the library cannot absorb of dy|_M.

The rival's columns have RIVAL times their physical prior scales; the most absorbing of
its forms and constants counts. What other effects truly act in the case is taken out of
everything first.

Keys of an effect's figures:

    apart     least sqrt(lambda_k|j) over rivals other than the effects that act
    own       what the effect's library form cannot absorb
    beyond    the least over all of the library, for effects that are in none
    legs      the least over all forms that act in one leg alone, leg by leg
    tied      legs in which an effect makes the same readings, so that nothing
              distinguishes them
"""

from __future__ import annotations

import dataclasses
import json
import math
import zlib
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.blind import loading
from benchmarks.blind.generator import write as truth_of
from benchmarks.blind.generator.severity import Metric as TrueMetric
from benchmarks.blind.loading import Case
from benchmarks.blind.results import Record
from benchmarks.blind.run import law_of
from benchmarks.blind.true_law import true_law
from oed.base import Array
from oed.gap.cause.closure import Split, closure
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as library_of
from oed.gap.forms.library import Atom, Library
from oed.noise import NoiseLaw
from pkm_campaign import Job, read_row, run_jobs

#: size of a rival against its physical prior scale
RIVAL = 3.0
#: readings of the truth and of the file may differ by the rounding of the file, m
ROUNDING = 1e-9
#: share of an effect's sqrt(lambda) by which what tied legs cannot absorb may differ
TIED = 1e-3
#: the same that they may at most not absorb
HALF = 0.5
SPLITS: tuple[Split, ...] = ("within", "whole")


@dataclasses.dataclass(frozen=True, slots=True)
class OracleJob:
    """A case with its truth.

    folder     of the set
    case       the case
    effects    that act in it
    law        of the noise, as its diagnosis records it; None without a diagnosis
    """

    folder: Path
    case: Case
    effects: tuple[str, ...]
    law: Mapping[str, Any] | None = None

    def file(self, store: Path) -> Path:
        """Where the oracle's figures are stored: they depend on the law."""
        digest = zlib.crc32(json.dumps(self.law, sort_keys=True).encode())
        return store / f"{self.case.id}-{digest:08x}.json"


def run(
    folder: Path,
    records: Mapping[str, Record],
    acting: Mapping[str, Sequence[str]],
    store: Path,
    *,
    workers: int = 0,
    report: Callable[[str], None] = print,
) -> dict[str, dict[str, Any]]:
    """The oracle's figures of the cases of a set that have a record, by id.

    `acting` names the effects that act, by case, in the order of the truth's `dy_0`,
    `dy_1`, ... Figures in the folder `store` are not computed again.
    """
    jobs = [
        OracleJob(folder, c, tuple(acting[c.id]), records[c.id].get("law"))
        for c in loading.manifest(folder)
        if c.id in records
    ]
    due = [job for job in jobs if not job.file(store).is_file()]
    due.sort(key=lambda j: j.case.study)
    files = [Job(job.file(store), job) for job in due]
    for number, _ in enumerate(run_jobs(work, files, workers=workers), start=1):
        if number % 50 == 0 or number == len(due):
            report(f"oracle: {number} of {len(due)} cases")
    return {job.case.id: read_row(job.file(store)) for job in jobs}


def work(job: OracleJob) -> dict[str, Any]:
    """The oracle's figures of a case, as JSON holds them.

    Raises ValueError where readings and truth do not belong together.
    """
    problem, truth = _load(job)
    figures = _distances(job, problem, truth)
    sigma = truth_of.covariance(truth)
    closures = []
    if job.effects:
        closures = _closures(problem, sigma, truth, job.law)
    text = json.dumps({**figures, "closure": closures}, allow_nan=False)
    return dict(json.loads(text))


def distances(job: OracleJob) -> dict[str, Any]:
    """The figures of a case that need no result: all but `closure`.

    Raises ValueError as `work` does.
    """
    return _distances(job, *_load(job))


def _load(job: OracleJob) -> tuple[GapProblem, dict[str, Array]]:
    with np.load(job.folder / "truth" / f"{job.case.id}.npz") as arrays:
        truth = {name: arrays[name] for name in arrays.files}
    problem = loading.prepare(job.folder, job.case)
    _check(problem, truth, job)
    return problem, truth


def _distances(
    job: OracleJob,
    problem: GapProblem,
    truth: dict[str, Array],
) -> dict[str, Any]:
    library = library_of.build(problem, loading.bench(job.case.study).effects)
    sigma = truth_of.covariance(truth)
    effects = _effects(problem, library, sigma, truth, job.effects)
    return {
        "id": job.case.id,
        "testable": list(library.effects),
        "effects": effects,
    }


def _check(problem: GapProblem, truth: dict[str, Array], job: OracleJob) -> None:
    """Raise ValueError unless the readings are those of the truth, in its order."""
    measurement, theta = problem.measurement, problem.theta
    predicted = measurement.readings(problem.series, theta)
    residual = problem.residual * problem.sigma
    slopes = measurement.jacobian(problem.series, theta)
    y = predicted + residual - slopes @ (theta - measurement.nominal)
    if y.shape != truth["y"].shape or float(np.abs(y - truth["y"]).max()) > ROUNDING:
        raise ValueError(
            f"{job.case.readings}: these are not the readings of"
            f" truth/{job.case.id}.npz; make the set again"
        )


# -- distances -------------------------------------------------------------------------


def _effects(
    problem: GapProblem,
    library: Library,
    sigma: Array,
    truth: dict[str, Array],
    names: Sequence[str],
) -> list[dict[str, Any]]:
    """Figures of each effect that acts."""
    if not names:
        return []
    metric = TrueMetric(sigma, truth["J"].astype(float), truth["prior"])
    columns = metric.embed(library.columns * problem.sigma[:, None])
    changes = [metric.embed(truth[f"dy_{k}"]) for k in range(len(names))]
    figures = []
    for k, name in enumerate(names):
        others = np.array(changes[:k] + changes[k + 1 :])
        others = others.reshape(len(names) - 1, len(problem)).T
        change = _project_out(changes[k], others)
        forms = _project_out(columns, others)
        distances = effect_distances(change, forms, library)
        rivals = {n: v for n, v in distances.items() if n not in names}
        nearest = min(rivals, key=lambda n: rivals[n]) if rivals else ""
        whole = float(np.linalg.norm(change))
        figures.append(
            {
                "name": name,
                "sqrt_lambda": float(np.linalg.norm(changes[k])),
                "given_others": whole,
                "apart": rivals.get(nearest, whole),
                "nearest": nearest,
                "own": distances.get(name, whole),
                "beyond": min(distances.values(), default=whole),
                "left": _rounded(distances),
                "legs": _rounded(leg_distances(change, forms, library)),
                "tied": tied_legs(change, forms, library, name),
            }
        )
    return figures


def _rounded(values: Mapping[str, float]) -> dict[str, float]:
    return {name: round(value, 4) for name, value in values.items()}


def _project_out(values: Array, directions: Array) -> Array:
    """Values (N,) or (N, k) less what directions (N, m) explain of them."""
    if not directions.shape[1]:
        return values
    q, _ = np.linalg.qr(directions)
    return np.asarray(values - q @ (q.T @ values))


def effect_distances(
    change: Array,
    columns: Array,
    library: Library,
) -> dict[str, float]:
    """What each effect of a library cannot absorb of a change (N,).

    In coordinates in which M is the identity: sqrt(v^T v - v^T C (C^T C + 1 /
    RIVAL^2)^-1 C^T v), least over the effect's forms: all limbs, textbook and adapted.
    """
    least: dict[str, float] = {}
    distances = _distances_of_forms(change, columns, library.atoms)
    for atom, distance in zip(library.atoms, distances, strict=True):
        least[atom.effect] = min(least.get(atom.effect, math.inf), distance)
    return least


def leg_distances(
    change: Array,
    columns: Array,
    library: Library,
    name: str = "",
) -> dict[str, float]:
    """What forms that act in one leg alone cannot absorb of a change (N,), by leg.

    The least over the forms of an effect, or of all effects.
    """
    single = [
        atom
        for atom in library.atoms
        if name in ("", atom.effect) and len(_blocks(atom, library)) == 1
    ]
    least: dict[str, float] = {}
    distances = _distances_of_forms(change, columns, single)
    for atom, distance in zip(single, distances, strict=True):
        leg = library.labels[atom.columns[0]]
        if leg.startswith("leg "):
            least[leg] = min(least.get(leg, math.inf), distance)
    return least


def _blocks(atom: Atom, library: Library) -> set[str]:
    """Blocks that a form's columns belong to."""
    return {library.labels[c] for c in atom.columns}


def tied_legs(
    change: Array,
    columns: Array,
    library: Library,
    name: str,
) -> list[list[str]]:
    """Groups of legs in any one of which an effect absorbs the same of a change (N,)."""
    whole = float(np.linalg.norm(change))
    groups: list[list[str]] = []
    least = leg_distances(change, columns, library, name)
    for leg, distance in least.items():
        if distance > HALF * whole:
            continue
        same = (g for g in groups if abs(least[g[0]] - distance) < TIED * whole)
        group = next(same, None)
        if group is None:
            groups.append([leg])
        else:
            group.append(leg)
    return [group for group in groups if len(group) > 1]


def _distances_of_forms(
    change: Array,
    columns: Array,
    atoms: Sequence[Atom],
) -> list[float]:
    """What each form cannot absorb of a change (N,)."""
    whole, distances = float(change @ change), []
    for atom in atoms:
        form = columns[:, atom.columns]
        b = form.T @ change
        inner = form.T @ form + np.eye(len(b)) / RIVAL**2
        absorbed = float(b @ np.linalg.solve(inner, b))
        distances.append(math.sqrt(max(whole - absorbed, 0.0)))
    return distances


# -- closure ---------------------------------------------------------------------------


def _closures(
    problem: GapProblem,
    sigma: Array,
    truth: dict[str, Array],
    estimate: Mapping[str, Any] | None,
) -> list[dict[str, Any]]:
    """For each split: the expected gain, and the oracle's closures.

    Under the true law, and under the diagnosis's law.
    """
    change = (truth["clean"] - truth["y0"]) / problem.sigma
    law = true_law(problem, sigma)
    estimated = None if estimate is None else law_of(dict(estimate))
    closures = []
    for split in SPLITS:
        best = _closure(problem, law, change, split)
        s0, count = _score(problem.with_residual(change), law, split)
        gain = count * s0 if count else 0.0
        same_law = None
        if estimated is not None:
            same_law = _closure(problem, estimated, change, split)
        closures.append(
            {
                "split": split,
                "n": best["n"],
                "true": best,
                "expected_gain": gain,
                "same_law": same_law,
            }
        )
    return closures


def _closure(
    problem: GapProblem,
    law: NoiseLaw,
    change: Array,
    split: Split,
) -> dict[str, Any]:
    """The closure of whoever takes the true change (N,) out, of training readings too."""
    s0, count = _score(problem, law, split)
    corrected = problem.with_residual(problem.residual - change)
    s1, _ = _score(corrected, law, split)
    value = (s0 - s1) / (s0 - 1.0) if s0 > 1.0 else math.nan
    figures = {"value": value, "s0": s0, "s1": s1, "n": count}
    return {key: v if math.isfinite(v) else None for key, v in figures.items()}


def _score(problem: GapProblem, law: NoiseLaw, split: Split) -> tuple[float, int]:
    """Score without effects, whatever the random stream; number of readings held out."""
    nothing, rng = np.zeros((len(problem), 0)), np.random.default_rng(0)
    scores = closure(problem, law, nothing, rng, split=split)
    return scores.s0 or math.nan, scores.n
