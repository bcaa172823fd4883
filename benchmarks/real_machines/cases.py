"""Accuracy that is predicted and reached on machines with small effects.

    PYTHONPATH=. oed campaign --allow-code benchmarks/real_machines.campaign.toml --seeds 20
    python -m benchmarks.harness real_machines
    PYTHONPATH=. oed campaign --allow-code benchmarks/real_answers.campaign.toml --seeds 20
    python -m benchmarks.harness real_answers

Machines are drawn by an independent generator (`benchmarks.second`). Judged is the error
of the tool point at the session's poses, free of its best rigid motion: by the parameters
alone, and with the effects corrected as well; in the second campaign by the best answer
of a diagnosis, and by the mixture over all hypotheses.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np

from benchmarks.harness import tables
from benchmarks.real_machines import world
from oed import posterior
from oed.accuracy import ErrorMaps
from oed.base import Array
from oed.corrected import AnswerFits, CorrectedEstimate, EffectReadings
from oed.effects import ExpectedColumns, absorbing_shift
from oed.estimation import Discrepancy, Estimate, identify
from oed.gap import Diagnosis, GapProblem, assemble, explain_residuals, prepare

#: draws of an estimate that are judged, and of an answer
DRAWS, ANSWER_DRAWS = 200, 400
INTERVAL = (0.025, 0.975)
#: what is compared in each campaign: its words, and what its error and width are over
FITS = {
    "law": ("geometry alone", "law"),
    "geometry": ("effects allowed", "law"),
    "corrected": ("effects corrected", "law"),
}
ANSWERS = {
    "best": ("best answer, geometry alone", "best"),
    "mixture": ("mixture, geometry alone", "best"),
}
COLUMNS = ("machine", "n", "compensation", "hold", "ratio", "error", "largest", "width")
GROUPS = ("machine", "level", "size")  #: columns of a setting that the table groups by


class Known(NamedTuple):
    """Draws of a machine: parameters (m, n), displacements (m, rows, 3) by effects."""

    theta: Array
    shifts: Array


# -- one fit with all effects ----------------------------------------------------------
def accuracy(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Errors of one machine of a kind, level and size: without effects, and with them."""
    bench = world.draw(setting["machine"], setting["size"], setting["level"], seed)
    record: dict[str, Any] = dict(bench.case)
    rng = np.random.default_rng(seed)
    law = identify(bench.measurement, bench.series, bench.y, estimate_noise=True)
    record["law"] = judge(bench, law.theta, _normal_draws(law, rng))
    plain = identify(bench.measurement, bench.series, bench.y)
    problem = assemble(
        bench.measurement,
        bench.series,
        bench.covariates,
        plain.theta,
        bench.y,
        gravity=bench.gravity,
    )
    columns = ExpectedColumns.of(problem, bench.effects)
    estimate = identify(
        bench.measurement,
        problem.series,
        bench.y,
        estimate_noise=True,
        discrepancy=columns.of_sizes(
            np.concatenate([Discrepancy.SMALL, Discrepancy.LARGE])
        ).discrepancy,
        rng=rng,
    )
    shifts = tool_shifts(bench, problem, columns)
    sampled = estimate.effects
    null = estimate.coordinates.null_basis
    lost = rng.standard_normal((len(sampled.theta), null.shape[1])) @ null.T
    drawn = np.einsum("pik,dk->dpi", shifts, sampled.coefficients)
    mean = sampled.theta.mean(axis=0)
    record["geometry"] = judge(bench, mean, sampled.theta + lost, drawn)
    record["corrected"] = judge(
        bench, mean, sampled.theta + lost, drawn, drawn.mean(axis=0)
    )
    return record


def slopes(bench: world.Bench, theta: Array) -> ErrorMaps:
    """Displacements (rows, 3, n) of the tool per parameter at the session's rows."""
    machine = bench.measurement.machine
    count = len(machine.parameters)
    steps = 1e-3 * bench.measurement.tolerance[:count]
    moved = world.displacement(
        bench, np.vstack([theta[None, :count], theta[:count] + np.diag(steps)])
    )
    change = np.zeros((*moved.shape[1:], len(theta)))
    free = np.flatnonzero(steps)
    for k in free:
        change[:, :, k] = (moved[1 + k] - moved[0]) / steps[k]
    return ErrorMaps(bench.command, ("x", "y", "z"), change, np.zeros_like(change))


def _normal_draws(estimate: Estimate, rng: np.random.Generator) -> Array:
    values, vectors = np.linalg.eigh(estimate.covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    return estimate.theta + rng.standard_normal((DRAWS, len(root))) @ root.T


def tool_shifts(
    bench: world.Bench, problem: GapProblem, columns: ExpectedColumns
) -> Array:
    """Displacements (n, 3, k) of the tool at the session's rows per unit of each column."""
    machine = bench.measurement.machine
    count = len(machine.parameters)
    row_of = {
        (setup, round(float(t), 6)): i
        for i, (setup, t) in enumerate(zip(bench.setup_names, bench.times, strict=True))
    }
    at = {}
    for number, form in enumerate(columns.forms):
        for name in form.names:
            at[number, name] = len(at)
    table = np.zeros((len(bench.command), 3, len(at)))
    for series, state in zip(problem.series, problem.states, strict=True):
        kinematics = bench.measurement.kinematics
        tool = np.array(bench.measurement.setups[series.setup].tool)
        slopes = kinematics.slopes.pose_by_parameter(
            state.pose, state.joints, problem.theta[:count]
        )
        frames = kinematics.frames(state.pose, tool)[2]
        by_parameter = np.einsum("mij,mjk->mik", frames[:, :3], slopes)
        rows = np.array(
            [row_of.get((series.setup, round(float(t), 6)), -1) for t in state.time]
        )
        seen = rows >= 0
        for number, form in enumerate(columns.forms):
            for column in form.effect.columns(state, **form.constants):
                if (number, column.name) not in at:
                    continue
                moved = np.zeros((len(state), 3))
                for joint, change in column.joints.items():
                    moved += state.twist[:, :3, joint] * change[:, None]
                for name, change in column.parameters.items():
                    if name in {p.name for p in machine.parameters}:
                        moved += (
                            by_parameter[:, :, machine.index(name)] * change[:, None]
                        )
                table[rows[seen], :, at[number, column.name]] = (
                    moved[seen] * column.scale
                )
    return table @ columns.mixing


def judge(
    bench: world.Bench,
    theta: Array,
    draws: Array,
    effects: Array | None = None,
    corrected: Array | float = 0.0,
) -> dict[str, float]:
    """Error of the tool point that is left, beside its intervals.

    draws    (m, n) of the parameters;  effects (m, rows, 3) displacements by effects
    corrected  (rows, 3) displacement that is corrected beside the parameters
    """
    machine = bench.measurement.machine
    axes = np.array([1, 2]) if machine.name.startswith("planar") else np.arange(3)
    count = len(machine.parameters)
    kinematics = bench.measurement.kinematics
    points = np.zeros_like(bench.shift)
    for tool in np.unique(bench.tool, axis=0):
        rows = np.flatnonzero((bench.tool == tool).all(axis=1))
        pose, _ = kinematics.inverse(bench.command[rows], machine.nominal, tool)
        points[rows] = kinematics.frames(pose, tool)[1]
    moved = world.displacement(
        bench, np.vstack([theta[None, :count], draws[:, :count]])
    )
    stated = moved[0] + corrected
    machines = moved[1:] if effects is None else moved[1:] + effects
    error = world.free_of_frame(points, (bench.shift - stated)[None], axes)[0]
    drawn = world.free_of_frame(points, machines - stated, axes)
    low, high = np.quantile(drawn, INTERVAL, axis=0)
    rms = np.sqrt((drawn**2).mean(axis=1))
    return {
        "coverage": float(((error > low) & (error < high)).mean()),
        "rms_um": 1e6 * float(np.sqrt((error**2).mean())),
        "predicted_um": 1e6 * float(np.median(rms)),
    }


# -- the answers of a diagnosis --------------------------------------------------------
def answers(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """One machine: diagnosed, fitted by each answer, and judged."""
    bench = world.draw(setting["machine"], setting["size"], "healthy", seed)
    record: dict[str, Any] = dict(bench.case)
    rng = np.random.default_rng([seed, round(setting["size"])])
    problem = prepare(
        bench.measurement,
        bench.series,
        bench.y,
        bench.covariates,
        gravity=bench.gravity,
    )
    diagnosis = explain_residuals(problem, bench.effects)
    alone = identify(bench.measurement, problem.series, bench.y, estimate_noise=True)
    given = EffectReadings(
        bench.measurement, problem.series, bench.y, bench.covariates, bench.gravity
    )
    corrected = _corrected(bench, given, diagnosis, alone.theta)
    fits = AnswerFits(
        readings=given,
        effects=bench.effects,
        allowed=ExpectedColumns.of(problem, bench.effects),
        estimate_noise=True,
        rng=rng,
        corrected=corrected,
    )
    mixture = fits.fit(diagnosis.answers, diagnosis.contents, alone)
    assert mixture is not None  # some answer is likely enough, and is fitted
    nothing = posterior.draw_approximation(
        bench.measurement, problem.series, bench.y, alone, rng, ANSWER_DRAWS
    )
    still = np.zeros((len(nothing.theta), *bench.shift.shape))
    geometry = Known(nothing.theta, still)
    drawn = mixture.draw(rng, ANSWER_DRAWS)
    mixed = Known(
        drawn.theta, _shifts(bench, problem, drawn.columns, drawn.coefficients)
    )
    best, best_mean = geometry, alone.theta
    if corrected is not None:
        best_mean = corrected.estimate.theta[: corrected.parameters]
        best = _of_best(bench, problem, corrected, rng)
    record["best"] = judge(bench, best_mean, *best)
    record["mixture"] = judge(bench, _absorbing(bench, mixture.mean, mixed), *mixed)
    return record


def _corrected(
    bench: world.Bench, given: EffectReadings, diagnosis: Diagnosis, theta: Array
) -> CorrectedEstimate | None:
    """The fit with the effects that the diagnosis decides for, as in `oed diagnose`."""
    by_name = {effect.name: effect for effect in bench.effects}
    effects = [
        by_name[name].with_constants(diagnosis.constants[name])
        for name in diagnosis.answers[0].effects
        if name in diagnosis.constants
    ]
    if diagnosis.verdict in ("none", "scatter") or not effects:
        return None
    return given.estimate(effects, theta)


def _of_best(
    bench: world.Bench,
    problem: GapProblem,
    corrected: CorrectedEstimate,
    rng: np.random.Generator,
) -> Known:
    drawn = posterior.draw_approximation(
        corrected.measurement,
        corrected.series,
        bench.y,
        corrected.estimate,
        rng,
        ANSWER_DRAWS,
    )
    count = corrected.parameters
    columns = corrected.columns
    shifts = _shifts(bench, problem, columns, drawn.theta[:, count:])
    return Known(drawn.theta[:, :count], shifts)


def _shifts(
    bench: world.Bench,
    problem: GapProblem,
    columns: ExpectedColumns | None,
    coefficients: Array,
) -> Array:
    """Displacements (m, rows, 3) of the tool by drawn effects (m, k)."""
    if columns is None:
        return np.zeros((len(coefficients), *bench.shift.shape))
    unit = tool_shifts(bench, problem, columns)
    return np.einsum("pik,dk->dpi", unit, coefficients)


def _absorbing(bench: world.Bench, mean: Array, known: Known) -> Array:
    """Parameters sent: the mean, shifted so that it takes up what effects are known to do."""
    tolerance = bench.measurement.tolerance[: len(mean)]
    error = known.shifts.mean(axis=0)
    return mean + absorbing_shift(slopes(bench, mean), error, tolerance)


# -- table -----------------------------------------------------------------------------
def accuracy_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A row for each machine, level, size and fit."""
    return _table(rows, FITS)


def answers_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """A row for each machine, size and kind of compensation."""
    return _table(rows, ANSWERS)


def _table(
    rows: Sequence[Mapping[str, Any]], kinds: Mapping[str, tuple[str, str]]
) -> str:
    groups: dict[tuple[Any, ...], list[Mapping[str, Any]]] = {}
    for row in rows:
        key = tuple(row[name] for name in GROUPS if name in row)
        groups.setdefault(key, []).append(row)
    lines = [tables.head(*COLUMNS)]
    for key, group in groups.items():
        words = ", ".join(f"{v:g}" if isinstance(v, float) else str(v) for v in key)
        for kind, (title, base) in kinds.items():
            cells = _cells(group, kind, base)
            lines.append(tables.row(words, len(group), title, *cells))
    return "\n".join(lines)


def _cells(rows: Sequence[Mapping[str, Any]], kind: str, base: str) -> list[str]:
    """Share of intervals that hold, realised over predicted error (median and 90th
    percentile), error and width over those of what it is compared with.
    """
    error = np.array([r[kind]["rms_um"] for r in rows])
    over = error / [r[base]["rms_um"] for r in rows]
    predicted = np.array([r[kind]["predicted_um"] for r in rows])
    width = predicted / [r[base]["predicted_um"] for r in rows]
    hold = np.mean([r[kind]["coverage"] for r in rows])
    median, most = np.quantile(error / predicted, [0.5, 0.9])
    mean = float(np.exp(np.mean(np.log(over))))
    figures = (f"{mean:.2f}", f"{over.max():.2f}", f"{np.median(width):.2f}")
    return [f"{hold:.2f}", f"{median:.1f}, {most:.1f}", *figures]
