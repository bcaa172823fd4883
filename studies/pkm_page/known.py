"""What the readings so far say, as tables: accuracy, parameters, combinations, next ones."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import Final

import numpy as np

from oed import units
from oed.base import Array
from oed.design import Candidates
from oed.estimation import Estimate
from pkm_page.session import MachineSession, SessionState
from pkm_reports import text
from pkm_studies import describe
from pkm_studies.sessions import Advice, Adviser, FittedReadings, reading_of
from pkm_studies.stages import estimate_section

#: probability beyond each end of an interval
TAIL: Final = 0.025
#: next readings and combinations that are shown, and parameters of a combination
SHOWN: Final = 5
TERMS: Final = 4


@dataclasses.dataclass(frozen=True)
class ComponentRow:
    """One component: rms error over the workspace, unknown part, in `unit`.

    low, high  where the rms error of this machine lies with 95 %
    wanted     empty where nothing is wanted, as is the verdict on it
    course     polyline of the rms after each reading, in a box of 100 x 30
    """

    name: str
    unit: str
    now: str
    low: str
    high: str
    after: str
    wanted: str
    verdict: str
    course: str


def accuracies(session: MachineSession, state: SessionState) -> list[ComponentRow]:
    """A row for each component of the pose error."""
    advice = state.advice
    if advice is None:
        return []
    machine = session.adviser.base.resolved.machine
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    low, high = np.quantile(advice.outlook.drawn_rms, [TAIL, 1.0 - TAIL], axis=0)
    course = _course(session.adviser, state.fitted, advice)
    rows = []
    for k, name in enumerate(advice.names):
        unit = fine[name]

        def shown(value: float, unit: str = unit) -> str:
            return text.number(units.number(value, unit))

        wanted = float(advice.limits[k])
        is_wanted = bool(np.isfinite(wanted))
        rows.append(
            ComponentRow(
                name=name,
                unit=text.unit_symbol(unit),
                now=shown(float(advice.known[k])),
                low=shown(float(low[k])),
                high=shown(float(high[k])),
                after=shown(float(advice.after[k])),
                wanted=shown(wanted) if is_wanted else "",
                verdict=advice.judgement(k) if is_wanted else "",
                course=_polyline(course[:, k], wanted),
            )
        )
    return rows


def _course(adviser: Adviser, fitted: FittedReadings | None, advice: Advice) -> Array:
    """Rms (n + 1, K) before the first and after each reading, in the file's order."""
    if fitted is None:
        return advice.known[None]
    measurement, taken = fitted.state.measurement, fitted.state.readings
    outlook = advice.outlook
    pool, belief = outlook.pool, outlook.before
    if not outlook.taken:  # without effects, the pool has no readings taken
        theta = fitted.estimate.theta
        pool = Candidates.build(measurement, taken.series, theta, "tolerance")
        belief = adviser.prior(measurement, pool)
    order = np.arange(advice.readings)
    if taken.covariates is not None:
        order = np.argsort(taken.covariates["row"].to_numpy(), kind="stable")
    course = [outlook.accuracy(belief)]
    for k in order:
        belief = belief.after(pool.blocks[k])
        course.append(outlook.accuracy(belief))
    return np.array(course)


def _polyline(values: Array, wanted: float) -> str:
    """Points of a log-scaled curve in a box of 100 x 30, the first value at its top."""
    logs = np.log10(np.maximum(values, 1e-300))
    floor = min(logs.min(), np.log10(wanted) if np.isfinite(wanted) else np.inf)
    span = max(logs.max() - floor, 1e-9)
    x = np.linspace(0.0, 100.0, max(len(logs), 2))
    y = 28.0 - 26.0 * (logs - floor) / span
    y = np.resize(y, len(x))
    return " ".join(f"{a:.1f},{b:.1f}" for a, b in zip(x, y, strict=True))


@dataclasses.dataclass(frozen=True)
class ParameterRow:
    """A parameter as identified, in its display unit; `share` of its tolerance, %."""

    name: str
    unit: str
    nominal: str
    value: str
    sd: str
    share: int


def parameters(state: SessionState) -> list[ParameterRow]:
    """A row for each parameter, as the report has them."""
    if state.fitted is None:
        return []
    measured, estimate, _ = state.fitted
    series = measured.readings.series
    section = estimate_section(measured.measurement, series, estimate, None)
    shares = _shares(state.fitted)
    rows = []
    for name, p in section.parameters.items():
        share = shares.get(name)
        if share is None:
            continue
        value = text.drawn(p.value, p.sd)
        rows.append(
            ParameterRow(
                name,
                text.unit_symbol(p.unit),
                text.trimmed(p.nominal, 7),
                value,
                text.number(p.sd, 2),
                round(100.0 * share),
            )
        )
    return rows


def _shares(fitted: FittedReadings) -> dict[str, float]:
    """Posterior over prior standard deviation of the free parameters, by name."""
    measurement, estimate = fitted.state.measurement, fitted.estimate
    sd = np.sqrt(np.diag(estimate.covariance))
    free = np.flatnonzero(measurement.free)
    return {measurement.names[k]: float(sd[k] / measurement.tolerance[k]) for k in free}


def open_combinations(state: SessionState) -> tuple[int, int, list[str]]:
    """How many combinations are known, of how many, and the least known ones."""
    if state.fitted is None:
        return 0, 0, []
    measurement, estimate = state.fitted.state.measurement, state.fitted.estimate
    free = np.flatnonzero(measurement.free)
    scale = measurement.tolerance[free]
    covariance = estimate.covariance[np.ix_(free, free)] / np.outer(scale, scale)
    variances, vectors = np.linalg.eigh(covariance)
    count = int((np.sqrt(np.maximum(variances, 0.0)) < Estimate.AT_PRIOR).sum())
    names = [measurement.names[k] for k in free]
    least = range(len(names) - 1, max(count, len(names) - SHOWN) - 1, -1)
    phrases = []
    for k in least:
        vector = vectors[:, k]
        chosen = np.argsort(-np.abs(vector))[:TERMS]
        sign = np.sign(vector[chosen[0]])
        terms = {
            names[j]: float(sign * vector[j]) for j in chosen if abs(vector[j]) > 0.1
        }
        phrases.append(text.linear_combination(terms))
    return count, len(names), phrases


@dataclasses.dataclass(frozen=True)
class NextOne:
    """A reading that would help: where, and by how much it lowers the errors, %."""

    setup: str
    command: str
    gain: str
    components: str


def best_next(session: MachineSession, state: SessionState) -> list[NextOne]:
    """The readings that gain most by themselves, the best first, the advised one on top."""
    advice = state.advice
    if advice is None:
        return []
    machine = session.adviser.base.resolved.machine
    outlook = advice.outlook
    variances = outlook.now.variances_after(outlook.blocks) + outlook.others
    variance_now = np.maximum(advice.known, 1e-150)
    ratios = np.sqrt(variances) / variance_now
    gains = 1.0 - np.exp(np.mean(np.log(np.maximum(ratios, 1e-300)), axis=1))
    listed = {advice.candidate, *advice.skipped}
    rest = [int(k) for k in np.argsort(-gains, kind="stable") if k not in listed]
    rows = []
    for k in [advice.candidate, *rest][:SHOWN]:
        series, row = reading_of(outlook.pool, outlook.taken + k)
        command = describe.displayed_command(machine, series.reading_commands()[row])
        falls = _largest_falls(advice.names, ratios[k])
        rows.append(
            NextOne(
                series.setup,
                text.named_quantities(command, 6),
                text.percent(gains[k]),
                falls,
            )
        )
    return rows


def _largest_falls(names: Sequence[str], ratios: Array) -> str:
    """The components that a reading makes more accurate most."""
    order = np.argsort(ratios)[:2]
    return ", ".join(f"{names[k]} {text.percent(1.0 - ratios[k])}" for k in order)


def pace(times: Array) -> float | None:
    """Usual time from one reading to the next, s; None before the third."""
    steps = np.diff(times)
    return float(np.median(steps)) if len(steps) >= 2 else None


def remaining(advice: Advice) -> int | None:
    """Readings until the session ends, as the advice counts: 0 at its end.

    None where the advice cannot say.
    """
    if advice.is_reached:
        return 0
    if advice.is_reached_by_geometry:
        return None
    if np.isfinite(advice.limits).any():
        return advice.more
    if advice.planned is None:
        return None
    return max(advice.planned - advice.readings, 0)
