"""Two ways that a diagnosis has to beat, on the same residuals after calibration and
the same covariates.

harmonic  as ball-bar software does: harmonics of each run, what changes in them with
          direction, feed, payload and time, and rules on which of these symptoms stands
          out of the noise (level and repeatability told from the readings)
stepwise  forward selection by BIC over the library's own signatures, by least squares
          beside the parameters, noise as stated to within a common level

Both answer with a set of effects; neither has a class or an unknown. Sources: ISO 230-4
and the manuals of circular tests for the symptoms; Schwarz 1978, Ann. Stat. 6, 461-464,
for BIC.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Sequence

import numpy as np
from scipy import stats

from oed.arrays import Array, Index
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms.library import Library
from oed.noise.law import stated_law

#: effects that the stepwise selection may take, and the share of a column's size that
#: calibration must leave
MOST, LEAST = 5, 1e-5
#: false alarm that the harmonic rules are set for, over all their symptoms
ALARM = 0.01
#: a second symptom is named as well where its energy is this share of the first one's
SECOND = 0.4
#: highest harmonic of a run, and readings there must be for each
HIGHEST, PER_HARMONIC = 6, 3


def stepwise(problem: GapProblem, library: Library) -> list[str]:
    """Effects of a library that forward selection by BIC takes, in its order.

    BIC = N log(RSS / N) + k log N; k counts a form's columns and its effect's
    constants.
    """
    metric = Metric(problem, stated_law(problem))
    white, absorbed = metric.parts(np.column_stack([problem.residual, library.columns]))
    full = white.T @ white - absorbed.T @ absorbed
    raw = np.sqrt((library.columns**2).sum(axis=0))
    seen = np.sqrt(np.maximum(np.diag(full)[1:], 0.0))
    scale = np.where(seen > LEAST * raw, 1.0 / np.maximum(seen, 1e-300), 0.0)
    gram, b, rest = (
        full[1:, 1:] * np.outer(scale, scale),
        full[1:, 0] * scale,
        float(full[0, 0]),
    )
    size, chosen = len(problem), []
    for _ in range(MOST):
        left = [a for a in library.atoms if a.effect not in chosen]
        if not left:
            break
        gains = _gains(gram, b, [a.columns for a in left])
        cost = np.array([len(a.columns) + len(a.constants) for a in left]) * math.log(
            size
        )
        told = size * np.log1p(-np.minimum(gains / rest, 1.0 - 1e-12)) + cost
        best = int(np.argmin(told))
        if told[best] >= 0.0:
            break
        chosen.append(left[best].effect)
        gram, b, rest = _after(gram, b, rest, left[best].columns)
    return chosen


def _gains(gram: Array, b: Array, choices: Sequence[Index]) -> Array:
    """What each choice of columns takes off the residual sum of squares."""
    found = np.zeros(len(choices))
    counts = np.array([len(c) for c in choices])
    for count in np.unique(counts):
        at = np.flatnonzero(counts == count)
        rows = np.array([choices[int(k)] for k in at])
        values, vectors = np.linalg.eigh(gram[rows[:, :, None], rows[:, None, :]])
        told = np.einsum("akj,ak->aj", vectors, b[rows]) ** 2
        kept = values > 1e-6
        found[at] = np.where(kept, told / np.where(kept, values, 1.0), 0.0).sum(axis=1)
    return found


def _after(
    gram: Array, b: Array, rest: float, columns: Index
) -> tuple[Array, Array, float]:
    """Gram matrix, projections and residual sum of squares with some columns taken out."""
    values, vectors = np.linalg.eigh(gram[np.ix_(columns, columns)])
    kept = values > 1e-6
    root = vectors[:, kept] / np.sqrt(values[kept])
    half, told = root.T @ gram[columns], root.T @ b[columns]
    return gram - half.T @ half, b - half.T @ told, rest - float(told @ told)


# -- harmonics -------------------------------------------------------------------------


@dataclasses.dataclass(frozen=True)
class Runs:
    """Harmonics of R runs (of one channel each), every coefficient in units of its
    noise's standard deviation.

    parts (R, 1 + 2 HIGHEST)  offset, cosines and sines by turns; 0 beyond `order` (R,)
    path (R,)                 number of the path that a run follows
    about {covariate: (R,)}   mean over the run, NaN where unknown
    legs                      joints of the machine
    """

    parts: Array
    order: Index
    path: Index
    about: dict[str, Array]
    legs: int


@dataclasses.dataclass(frozen=True, slots=True)
class Symptom:
    """Energy of a symptom over what noise makes of it (its degrees of freedom), and
    whether it stands out.
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
    """Effects among `names`, those that the readings can test, that the rules come to;
    strongest first, at most two.
    """
    runs = runs_of(problem)
    found = sorted((s for s in symptoms(runs) if s.clear), key=lambda s: -s.excess)
    called: list[str] = []
    for s in found:
        if s.excess < SECOND * found[0].excess:
            break
        name = next((n for n in _causes(s.name, runs) if n in names), None)
        if name is not None and name not in called:
            called.append(name)
    return called[:2]


def runs_of(problem: GapProblem) -> Runs:
    """Harmonics of the residuals after calibration, run by run; noise is told by what
    they leave, and by repeats.
    """
    metric = Metric(problem, stated_law(problem))
    left = problem.residual - problem.slopes @ metric.fit(problem.residual)
    rows, phase = problem.rows, problem.rows["phase"].to_numpy(dtype=float)
    names = [
        c
        for c in rows.columns
        if c in ("time", "direction", "feed", "payload") or str(c).startswith("temp_")
    ]
    paths: dict[tuple[object, ...], int] = {}
    parts, orders, path, rest, about = [], [], [], [], []
    joints = np.concatenate([
        np.repeat(state.joints[s.index[:, 0]], r.nuisances.shape[1], axis=0)
        for s, state, r in zip(problem.series, problem.states, problem.responses, strict=True)
    ])  # fmt: skip
    for members in problem.members:
        for channel in np.unique(problem.channel[members]):
            at = members[problem.channel[members] == channel]
            order = int(np.clip((len(at) - 1) // (2 * PER_HARMONIC), 0, HIGHEST))
            told, error = _harmonics(phase[at], left[at], order)
            key = (
                rows["setup"].iloc[at[0]],
                int(channel),
                np.sort(np.round(joints[at].sum(axis=1), 6)).tobytes(),
            )
            parts.append(np.pad(told, (0, 1 + 2 * HIGHEST - len(told))))
            orders.append(order)
            path.append(paths.setdefault(key, len(paths)))
            rest.append(error)
            about.append([float(rows[n].iloc[at].astype(float).mean()) for n in names])
    level = 1.4826 * float(np.median(np.abs(np.concatenate(rest))))
    table = np.array(about).reshape(len(parts), len(names))
    made = Runs(
        np.array(parts) / max(level, 1e-12),
        np.array(orders, dtype=np.intp),
        np.array(path, dtype=np.intp),
        {n: table[:, k] for k, n in enumerate(names)},
        joints.shape[1],
    )
    return _repeatable(made)


def _harmonics(phase: Array, values: Array, order: int) -> tuple[Array, Array]:
    """Coefficients in units of their own standard deviation per noise, and what is
    left, per its degrees of freedom.
    """
    waves = [np.ones(len(phase))]
    for k in range(1, order + 1):
        waves += [np.cos(k * phase), np.sin(k * phase)]
    q, r = np.linalg.qr(np.column_stack(waves))
    told = np.sign(np.diag(r)) * (q.T @ values)
    left = values - q @ (q.T @ values)
    return told, left * math.sqrt(len(values) / max(len(values) - len(waves), 1))


def _repeatable(runs: Runs) -> Runs:
    """With the noise of offsets and of harmonics as large as repeats of the same run
    under the same conditions show.
    """
    conditions = [
        runs.path,
        *(runs.about[n] for n in ("direction", "feed", "payload") if n in runs.about),
    ]
    label = np.unique(
        np.nan_to_num(np.column_stack(conditions), nan=-1e9).round(9),
        axis=0,
        return_inverse=True,
    )[1]
    label = np.ravel(label)
    steps = []
    for k in np.unique(label):
        at = np.flatnonzero(label == k)
        if "time" in runs.about and np.isfinite(runs.about["time"][at]).all():
            at = at[np.argsort(runs.about["time"][at], kind="stable")]
        steps.append(
            np.diff(runs.parts[at], axis=0) / math.sqrt(2.0)
        )  # of neighbours in time: a drift hardly counts
    moved = np.vstack(steps)
    if len(moved) < 2:
        return runs
    shape = moved[:, 1:][:, np.any(moved[:, 1:] != 0.0, axis=0)]
    wide = np.ones(runs.parts.shape[1])
    wide[0] = max(1.0, 1.4826 * float(np.median(np.abs(moved[:, 0]))))
    if shape.size:
        wide[1:] = max(1.0, 1.4826 * float(np.median(np.abs(shape))))
    return dataclasses.replace(runs, parts=runs.parts / wide)


def symptoms(runs: Runs) -> list[Symptom]:
    """Every symptom that the runs can show, with its energy."""
    base = np.equal.outer(runs.path, np.unique(runs.path)).astype(float)
    moved = runs.parts - _fit(base, runs.parts)
    shown: list[tuple[str, float, int]] = []
    for name in ("direction", "payload", "feed", "lag"):
        column = _covariate(runs, name)
        if column is not None:
            # offsets aside: how well a run repeats as a whole is no matter of its
            # direction or load
            shown.append(
                (name, *_explained(base, column[:, None] * base, moved[:, 1:]))
            )
    time = _covariate(runs, "time")
    if time is not None:
        share = (time - time.min()) / max(float(np.ptp(time)), 1e-12)
        warm = np.column_stack([share, 1.0 - np.exp(-4.0 * share)])
        shown.append(("trend", *_explained(base, warm, moved[:, :1])))
        shown.append(("wandering centre", *_explained(base, warm, moved[:, 1:3])))
        cuts = [(share >= c).astype(float)[:, None] for c in np.linspace(0.1, 0.9, 17)]
        shown.append(
            (
                "jump",
                *max(
                    (_explained(base, c, moved[:, :1]) for c in cuts),
                    key=lambda e: e[0],
                ),
            )
        )
    static = runs.parts - moved
    counts = np.bincount(runs.path)[runs.path]
    for low, high in ((0, 0), (1, 1), (2, 2), (3, 4), (5, HIGHEST)):
        columns = slice(max(2 * low - 1, 0), 2 * high + 1)
        there = (np.minimum(2 * runs.order + 1, columns.stop) - columns.start).clip(0)
        freedom = round(float((there / counts).sum()))
        shown.append(
            (f"harmonics {low}-{high}", float((static[:, columns] ** 2).sum()), freedom)
        )
    told = [s for s in shown if s[2] > 0]
    alarm = ALARM / max(len(told), 1)
    tries = {"jump": 17}
    return [
        Symptom(n, e, f, e > stats.chi2.isf(alarm / tries.get(n, 1), f))
        for n, e, f in told
    ]


def _covariate(runs: Runs, name: str) -> Array | None:
    """A covariate (R,), centred; None where it is not known or does not change. `lag`:
    direction times feed.
    """
    parts = ("direction", "feed") if name == "lag" else (name,)
    if any(p not in runs.about or not np.isfinite(runs.about[p]).all() for p in parts):
        return None
    value = np.prod([runs.about[p] for p in parts], axis=0)
    if name == "lag" and (
        np.ptp(runs.about["feed"]) <= 0.0 or np.ptp(runs.about["direction"]) <= 0.0
    ):
        return None
    return (
        None
        if np.ptp(value) <= 1e-12 * max(float(np.abs(value).max()), 1.0)
        else value - value.mean()
    )


def _fit(columns: Array, values: Array) -> Array:
    """Least-squares fit of values (R, h) by columns (R, k)."""
    q, s, _ = np.linalg.svd(columns, full_matrices=False)
    q = q[:, s > 1e-9 * max(float(s.max(initial=0.0)), 1e-300)]
    return np.asarray(q @ (q.T @ values))


def _explained(base: Array, columns: Array, moved: Array) -> tuple[float, int]:
    """Energy that columns beside each path's mean explain, and its degrees of freedom."""
    left = columns - _fit(base, columns)
    rank = int(
        np.linalg.matrix_rank(
            left, tol=1e-9 * max(float(np.abs(columns).max(initial=0.0)), 1e-300)
        )
    )
    if not rank:
        return 0.0, 0
    there = int((np.abs(moved) > 0).any(axis=0).sum())
    return float((_fit(left, moved) ** 2).sum()), rank * there


def _causes(symptom: str, runs: Runs) -> list[str]:
    """Effects that a symptom stands for, the likeliest first."""
    if symptom in ("direction", "lag"):
        energy = {s.name: s.excess for s in symptoms(runs)}
        if energy.get("lag", -np.inf) > energy.get("direction", -np.inf):
            return ["servo_lag", "backlash"]
        sign = _covariate(runs, "direction")
        odd = runs.parts if sign is None else runs.parts * np.sign(sign)[:, None]
        mean = np.vstack(
            [odd[runs.path == k].mean(axis=0) for k in np.unique(runs.path)]
        )
        high, low = float((mean[:, 5:] ** 2).sum()), float((mean[:, 1:5] ** 2).sum())
        return (
            ["backlash", "friction"] if high > 0.15 * low else ["friction", "backlash"]
        )
    if symptom in ("trend", "wandering centre"):
        return _drift(symptom, runs)
    legs = runs.legs
    three = slice(5, 9)
    common = (
        runs.parts[:, 2 * legs - 1 : 2 * legs + 1]
        if legs in (3, 4)
        else np.zeros((1, 1))
    )
    together = float((common**2).sum()) > 0.7 * float((runs.parts[:, three] ** 2).sum())
    rules = {
        "payload": ["gravity"],
        "feed": ["servo_lag"],
        "jump": ["step"],
        "harmonics 0-0": ["bar_length", "encoder_scale"],
        "harmonics 1-1": ["guideway", "frame_bending"],
        "harmonics 2-2": ["encoder_scale", "frame_bending"],
        # as many waves as legs, in all of them: what the legs have in common
        "harmonics 3-4": (
            ["bar_length", "encoder_scale"]
            if together
            else ["guideway", "pitch_accumulation"]
        ),
        f"harmonics 5-{HIGHEST}": ["screw_cyclic", "encoder_subdivision"],
    }
    return rules[symptom]


def _drift(symptom: str, runs: Runs) -> list[str]:
    """What drifts: the body whose temperature goes with the runs' offsets, else the
    mount where the centre moves.
    """
    if symptom == "wandering centre":
        return ["mount_drift", "frame_thermal"]
    base = np.equal.outer(runs.path, np.unique(runs.path)).astype(float)
    offset = runs.parts[:, :1] - _fit(base, runs.parts[:, :1])
    gain = {}
    for body in ("leg", "frame", "bar"):
        column = _covariate(runs, f"temp_{body}")
        if column is not None:
            gain[body] = _explained(base, column[:, None], offset)[0]
    order = sorted(gain, key=lambda b: -gain[b])
    return [f"{b}_thermal" for b in order] + ["leg_thermal"]
