"""Harmonic rules, a baseline: what ball-bar software concludes from circles.

Harmonics of each run, what changes in them with direction, feed, payload and time, and
rules on which of these symptoms exceeds the noise (level and repeatability as the
readings show them). It answers with effects, without a class or an unknown. Sources:
ISO 230-4 and the manuals of circular tests for the symptoms.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from oed.base import Array, Index
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem

#: false alarm that the harmonic rules are set for, over all their symptoms
ALARM = 0.01
#: share of the first symptom's excess from which on a second one is named as well
SECOND = 0.4
#: highest harmonic of a run, and readings that each needs
HIGHEST, PER_HARMONIC = 6, 3
#: covariates of a run
COVARIATES = ("time", "direction", "feed", "payload")
#: standard deviation of a normal variable over its median absolute deviation
MAD = 1.4826
#: shares of the session at which a jump is tried
CUTS = np.linspace(0.1, 0.9, 17)
#: bands of harmonics, each a symptom
BANDS = ((0, 0), (1, 1), (2, 2), (3, 4), (5, HIGHEST))


@dataclasses.dataclass(frozen=True)
class HarmonicRuns:
    """Harmonics of R runs (of one channel each), in units of their noise.

    parts         (R, 1 + 2 HIGHEST) offset, cosines and sines by turns; 0 beyond order
    order         (R,) highest harmonic of each run
    path          (R,) number of the path that a run follows
    covariates    {covariate: (R,)} mean over the run, NaN where unknown
    legs          number of joints of the machine
    """

    parts: Array
    order: Index
    path: Index
    covariates: dict[str, Array]
    legs: int


@dataclasses.dataclass(frozen=True, slots=True)
class Symptom:
    """A symptom of the runs.

    name       of the symptom
    energy     in units of the noise
    freedom    degrees of freedom: what noise alone makes of the energy
    clear      whether it exceeds the noise
    """

    name: str
    energy: float
    freedom: int
    clear: bool

    @property
    def excess(self) -> float:
        """Energy beyond what noise makes, in standard deviations of that."""
        return (self.energy - self.freedom) / math.sqrt(2.0 * self.freedom)


def harmonic(problem: GapProblem, names: Sequence[str]) -> list[str]:
    """Effects that the rules come to, strongest first, at most two.

    `names` are the effects that the readings can test.
    """
    runs = harmonic_runs(problem)
    clear = [s for s in symptoms(runs) if s.clear]
    clear.sort(key=lambda s: -s.excess)
    called: list[str] = []
    for symptom in clear:
        if symptom.excess < SECOND * clear[0].excess:
            break
        causes = (n for n in _causes(symptom.name, runs) if n in names)
        name = next(causes, None)
        if name is not None and name not in called:
            called.append(name)
    return called[:2]


def harmonic_runs(problem: GapProblem) -> HarmonicRuns:
    """Harmonics of the residuals after calibration, run by run.

    What they do not explain shows the noise, and so do repeats.
    """
    metric = Metric(problem, problem.stated_law)
    residual = problem.residual - problem.slopes @ metric.fit(problem.residual)
    rows, phase = problem.rows, problem.rows["phase"].to_numpy(dtype=float)
    names = [c for c in map(str, rows.columns) if _is_covariate(c)]
    joints = _joints(problem)
    paths: dict[tuple[object, ...], int] = {}
    parts, orders, path, errors, means = [], [], [], [], []
    for members in problem.members:
        for channel in np.unique(problem.channel[members]):
            at = members[problem.channel[members] == channel]
            order = int(np.clip((len(at) - 1) // (2 * PER_HARMONIC), 0, HIGHEST))
            coefficients, error = _harmonics(phase[at], residual[at], order)
            padding = 1 + 2 * HIGHEST - len(coefficients)
            poses = np.sort(np.round(joints[at].sum(axis=1), 6)).tobytes()
            key = (rows["setup"].iloc[at[0]], int(channel), poses)
            parts.append(np.pad(coefficients, (0, padding)))
            orders.append(order)
            path.append(paths.setdefault(key, len(paths)))
            errors.append(error)
            means.append([float(rows[n].iloc[at].astype(float).mean()) for n in names])
    level = MAD * float(np.median(np.abs(np.concatenate(errors))))
    table = np.array(means).reshape(len(parts), len(names))
    runs = HarmonicRuns(
        parts=np.array(parts) / max(level, 1e-12),
        order=np.array(orders, dtype=np.intp),
        path=np.array(path, dtype=np.intp),
        covariates={name: table[:, k] for k, name in enumerate(names)},
        legs=joints.shape[1],
    )
    return _in_repeatability_units(runs)


def _is_covariate(column: str) -> bool:
    return column in COVARIATES or column.startswith("temp_")


def _joints(problem: GapProblem) -> Array:
    """Joints (N, nq) at the pose that each reading reads."""
    parts = []
    sources = zip(problem.series, problem.states, problem.responses, strict=True)
    for series, state, response in sources:
        read = state.joints[series.index[:, 0]]
        parts.append(np.repeat(read, response.nuisances.shape[1], axis=0))
    return np.concatenate(parts)


def _harmonics(phase: Array, values: Array, order: int) -> tuple[Array, Array]:
    """Harmonic coefficients in units of their standard deviation per noise.

    The second result is the residual, scaled by its degrees of freedom.
    """
    waves = [np.ones(len(phase))]
    for k in range(1, order + 1):
        waves += [np.cos(k * phase), np.sin(k * phase)]
    q, r = np.linalg.qr(np.column_stack(waves))
    coefficients = np.sign(np.diag(r)) * (q.T @ values)
    residual = values - q @ (q.T @ values)
    freedom = max(len(values) - len(waves), 1)
    return coefficients, residual * math.sqrt(len(values) / freedom)


def _in_repeatability_units(runs: HarmonicRuns) -> HarmonicRuns:
    """Runs in units of how well offsets and harmonics repeat.

    Repeats are passes of the same path under the same conditions.
    """
    steps = [_steps_between_repeats(runs, at) for at in _repeats(runs)]
    change = np.vstack(steps)
    if len(change) < 2:
        return runs
    offsets, harmonics = change[:, 0], change[:, 1:]
    harmonics = harmonics[:, np.any(harmonics != 0.0, axis=0)]
    unit = np.ones(runs.parts.shape[1])
    unit[0] = max(1.0, MAD * float(np.median(np.abs(offsets))))
    if harmonics.size:
        unit[1:] = max(1.0, MAD * float(np.median(np.abs(harmonics))))
    return dataclasses.replace(runs, parts=runs.parts / unit)


def _repeats(runs: HarmonicRuns) -> list[Index]:
    """Groups of runs of the same path under the same conditions."""
    conditions = [runs.path.astype(float)]
    for name in ("direction", "feed", "payload"):
        if name in runs.covariates:
            conditions.append(runs.covariates[name])
    table = np.nan_to_num(np.column_stack(conditions), nan=-1e9).round(9)
    label = np.ravel(np.unique(table, axis=0, return_inverse=True)[1])
    return [np.flatnonzero(label == k) for k in np.unique(label)]


def _steps_between_repeats(runs: HarmonicRuns, at: Index) -> Array:
    """Differences of neighbours in time, which hardly contain a drift."""
    times = runs.covariates.get("time")
    if times is not None and np.isfinite(times[at]).all():
        at = at[np.argsort(times[at], kind="stable")]
    return np.diff(runs.parts[at], axis=0) / math.sqrt(2.0)


def symptoms(runs: HarmonicRuns) -> list[Symptom]:
    """Every symptom that the runs can show, with its energy."""
    base = _path_means(runs)
    change = runs.parts - _fit(base, runs.parts)
    energies = [
        *_covariate_energies(runs, base, change),
        *_time_energies(runs, base, change),
        *_band_energies(runs, runs.parts - change),
    ]
    testable = [e for e in energies if e[2] > 0]
    alarm = ALARM / max(len(testable), 1)
    tries = {"jump": len(CUTS)}
    tested = []
    for name, energy, freedom in testable:
        level = stats.chi2.isf(alarm / tries.get(name, 1), freedom)
        tested.append(Symptom(name, energy, freedom, energy > level))
    return tested


#: name, energy and degrees of freedom of a symptom
Energy = tuple[str, float, int]


def _path_means(runs: HarmonicRuns) -> Array:
    """Columns (R, paths) of the mean of each path."""
    return np.equal.outer(runs.path, np.unique(runs.path)).astype(float)


def _covariate_energies(
    runs: HarmonicRuns,
    base: Array,
    change: Array,
) -> list[Energy]:
    """What the conditions of the runs explain of their harmonics.

    Offsets do not count: how well a run repeats as a whole is no matter of its
    direction or load.
    """
    energies = []
    for name in ("direction", "payload", "feed", "lag"):
        column = _covariate(runs, name)
        if column is not None:
            by_path = column[:, None] * base
            energies.append((name, *_explained(base, by_path, change[:, 1:])))
    return energies


def _time_energies(
    runs: HarmonicRuns,
    base: Array,
    change: Array,
) -> list[Energy]:
    """What time explains: trends of offsets, a wandering centre, a jump."""
    time = _covariate(runs, "time")
    if time is None:
        return []
    share = (time - time.min()) / max(float(np.ptp(time)), 1e-12)
    warm = np.column_stack([share, 1.0 - np.exp(-4.0 * share)])
    offsets, centre = change[:, :1], change[:, 1:3]
    jumps = []
    for cut in CUTS:
        after = (share >= cut).astype(float)[:, None]
        jumps.append(_explained(base, after, offsets))
    return [
        ("trend", *_explained(base, warm, offsets)),
        ("wandering centre", *_explained(base, warm, centre)),
        ("jump", *max(jumps, key=lambda e: e[0])),
    ]


def _band_energies(runs: HarmonicRuns, static: Array) -> list[Energy]:
    """Energy of each band of harmonics in the means of the paths."""
    passes = np.bincount(runs.path)[runs.path]
    energies = []
    for low, high in BANDS:
        first, last = max(2 * low - 1, 0), 2 * high + 1
        columns = np.minimum(2 * runs.order + 1, last) - first
        freedom = round(float((columns.clip(0) / passes).sum()))
        energy = float((static[:, first:last] ** 2).sum())
        energies.append((f"harmonics {low}-{high}", energy, freedom))
    return energies


def _covariate(runs: HarmonicRuns, name: str) -> Array | None:
    """A covariate (R,), centred; None where it is not known or does not change.

    `lag` is direction times feed.
    """
    parts = ("direction", "feed") if name == "lag" else (name,)
    values = []
    for part in parts:
        value = runs.covariates.get(part)
        if value is None or not np.isfinite(value).all():
            return None
        values.append(value)
    if name == "lag" and any(np.ptp(value) <= 0.0 for value in values):
        return None
    product = np.prod(values, axis=0)
    least = 1e-12 * max(float(np.abs(product).max()), 1.0)
    return None if np.ptp(product) <= least else product - product.mean()


def _fit(columns: Array, values: Array) -> Array:
    """Least-squares fit of values (R, h) by columns (R, k)."""
    q, s, _ = np.linalg.svd(columns, full_matrices=False)
    largest = max(float(s.max(initial=0.0)), 1e-300)
    q = q[:, s > 1e-9 * largest]
    return np.asarray(q @ (q.T @ values))


def _explained(base: Array, columns: Array, change: Array) -> tuple[float, int]:
    """Energy that columns explain beyond the paths' means, and degrees of freedom."""
    free = columns - _fit(base, columns)
    largest = max(float(np.abs(columns).max(initial=0.0)), 1e-300)
    rank = int(np.linalg.matrix_rank(free, tol=1e-9 * largest))
    if not rank:
        return 0.0, 0
    harmonics = int((np.abs(change) > 0).any(axis=0).sum())
    return float((_fit(free, change) ** 2).sum()), rank * harmonics


def _causes(symptom: str, runs: HarmonicRuns) -> list[str]:
    """Effects that a symptom stands for, the likeliest first."""
    if symptom in ("direction", "lag"):
        return _causes_of_direction(runs)
    if symptom in ("trend", "wandering centre"):
        return _causes_of_drift(symptom, runs)
    causes = {
        "payload": ["gravity"],
        "feed": ["servo_lag"],
        "jump": ["step"],
        "harmonics 0-0": ["bar_length", "encoder_scale"],
        "harmonics 1-1": ["guideway", "frame_bending"],
        "harmonics 2-2": ["encoder_scale", "frame_bending"],
        "harmonics 3-4": ["guideway", "pitch_accumulation"],
        f"harmonics 5-{HIGHEST}": ["screw_cyclic", "encoder_subdivision"],
    }
    if symptom == "harmonics 3-4" and _legs_in_common(runs):
        return ["bar_length", "encoder_scale"]
    return causes[symptom]


def _legs_in_common(runs: HarmonicRuns) -> bool:
    """Whether the third and fourth harmonics have as many waves as there are legs.

    Such waves are what the legs have in common.
    """
    legs = runs.legs
    if legs not in (3, 4):
        return False
    common = runs.parts[:, 2 * legs - 1 : 2 * legs + 1]
    both = runs.parts[:, 5:9]
    return float((common**2).sum()) > 0.7 * float((both**2).sum())


def _causes_of_direction(runs: HarmonicRuns) -> list[str]:
    """Lag where the feed matters; else play or friction, by the order of the waves."""
    excess = {s.name: s.excess for s in symptoms(runs)}
    if excess.get("lag", -np.inf) > excess.get("direction", -np.inf):
        return ["servo_lag", "backlash"]
    sign = _covariate(runs, "direction")
    odd = runs.parts
    if sign is not None:
        odd = runs.parts * np.sign(sign)[:, None]
    means = [odd[runs.path == k].mean(axis=0) for k in np.unique(runs.path)]
    mean = np.vstack(means)
    high, low = float((mean[:, 5:] ** 2).sum()), float((mean[:, 1:5] ** 2).sum())
    if high > 0.15 * low:
        return ["backlash", "friction"]
    return ["friction", "backlash"]


def _causes_of_drift(symptom: str, runs: HarmonicRuns) -> list[str]:
    """The body whose temperature goes with the runs' offsets, the likeliest first.

    The mount where the centre moves.
    """
    if symptom == "wandering centre":
        return ["mount_drift", "frame_thermal"]
    base = _path_means(runs)
    offset = runs.parts[:, :1] - _fit(base, runs.parts[:, :1])
    gain = {}
    for body in ("leg", "frame", "bar"):
        column = _covariate(runs, f"temp_{body}")
        if column is not None:
            gain[body] = _explained(base, column[:, None], offset)[0]
    order = sorted(gain, key=lambda body: -gain[body])
    return [f"{body}_thermal" for body in order] + ["leg_thermal"]
