"""The state of a session as the page shows it: texts, tables and the view to turn.

Rows of tables are texts by the names that the templates read.
"""

import dataclasses
from collections.abc import Sequence
from typing import Any, Final

import msgspec
import numpy as np

from oed import units
from oed.base import Array
from oed.dataset import ReadingsColumn, written
from oed.design import Candidates
from oed.estimation import Estimate
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from pkm_page import approach, doubts, rows
from pkm_page.readings_log import REMARK, FileContent
from pkm_page.session import MachineSession, Pose, SessionState
from pkm_reports import text
from pkm_reports.view import PageView, Values, residuals_of_readings
from pkm_studies import describe
from pkm_studies.sessions import Advice, Adviser, FittedReadings
from pkm_studies.stages import estimate_section

# What the readings so far say, as tables: accuracy, parameters, combinations, next ones.

TAIL_PROBABILITY: Final = 0.025  #: probability beyond each end of an interval
#: next readings and combinations that are shown, and parameters of a combination
MAX_SHOWN: Final = 5
MAX_TERMS: Final = 4


def accuracies(session: MachineSession, state: SessionState) -> list[dict[str, str]]:
    """A row for each component: rms error over the workspace, unknown part, in `unit`.

    low, high        where the rms error of this machine lies with 95 %
    wanted, verdict  empty where nothing is wanted
    course           polyline of the rms after each reading, in a box of 100 x 30
    """
    advice = state.advice
    if advice is None:
        return []
    machine = session.adviser.base.resolved.machine
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    low, high = np.quantile(
        advice.outlook.drawn_rms, [TAIL_PROBABILITY, 1.0 - TAIL_PROBABILITY], axis=0
    )
    course = _course(session.adviser, state.fitted, advice)
    rows = []
    for k, name in enumerate(advice.names):
        unit = fine[name]

        def shown(value: float, unit: str = unit) -> str:
            return text.number(units.number(value, unit))

        wanted = float(advice.limits[k])
        is_wanted = bool(np.isfinite(wanted))
        rows.append(
            {
                "name": name,
                "unit": text.unit_symbol(unit),
                "now": shown(float(advice.known[k])),
                "low": shown(float(low[k])),
                "high": shown(float(high[k])),
                "after": shown(float(advice.after[k])),
                "wanted": shown(wanted) if is_wanted else "",
                "verdict": advice.judgement(k) if is_wanted else "",
                "course": _polyline(course[:, k], wanted),
            }
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


def parameters(state: SessionState) -> list[dict[str, Any]]:
    """A row for each parameter in its unit, as the report has them; `share` of its tolerance, %."""
    if state.fitted is None:
        return []
    measured, estimate, _ = state.fitted
    series = measured.readings.series
    section = estimate_section(measured.measurement, series, estimate, None)
    shares = _shares(state.fitted)
    rows: list[dict[str, Any]] = []
    for name, p in section.parameters.items():
        share = shares.get(name)
        if share is None:
            continue
        rows.append(
            {
                "name": name,
                "unit": text.unit_symbol(p.unit),
                "nominal": text.trimmed(p.nominal, 7),
                "value": text.drawn(p.value, p.sd),
                "sd": text.number(p.sd, 2),
                "share": round(100.0 * share),
            }
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
    least = range(len(names) - 1, max(count, len(names) - MAX_SHOWN) - 1, -1)
    phrases = []
    for k in least:
        vector = vectors[:, k]
        chosen = np.argsort(-np.abs(vector))[:MAX_TERMS]
        sign = np.sign(vector[chosen[0]])
        terms = {
            names[j]: float(sign * vector[j]) for j in chosen if abs(vector[j]) > 0.1
        }
        phrases.append(text.linear_combination(terms))
    return count, len(names), phrases


def best_next(session: MachineSession, state: SessionState) -> list[dict[str, str]]:
    """The readings that lower the errors most, the best first, the advised one on top."""
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
    for k in [advice.candidate, *rest][:MAX_SHOWN]:
        series, row = outlook.pool.reading(outlook.taken + k)
        command = describe.displayed_command(machine, series.reading_commands()[row])
        rows.append(
            {
                "setup": series.setup,
                "command": text.named_quantities(command, 6),
                "gain": text.percent(gains[k]),
                "components": _largest_falls(advice.names, ratios[k]),
            }
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
    """Readings until the session ends, 0 at its end; None where the advice cannot say."""
    if advice.is_reached:
        return 0
    if advice.is_reached_by_geometry:
        return None
    if np.isfinite(advice.limits).any():
        return advice.more
    if advice.planned is None:
        return None
    return max(advice.planned - advice.readings, 0)


# The state of a session as the page shows it: texts, tables and the view to turn.

MAX_LISTED_READINGS: Final = 4  #: last readings that are listed beside the entry


def page_values(session: MachineSession, state: SessionState) -> dict[str, Any]:
    """Everything that the page's template names."""
    advice, pose = state.advice, state.pose
    values: dict[str, Any] = {
        "version": state.content.version,
        "problem": state.problem,
        "file": session.log.path.name,
        "study": session.adviser.base.study.name,
        "advice": advice,
        "last": _last_readings(session, state.content),
        "skipped": len(rows.skipped(state.content, session.measurement)),
        "accuracies": accuracies(session, state),
        "parameters": parameters(state),
        "combinations": open_combinations(state),
        "best": best_next(session, state),
    }
    if advice is None or pose is None:
        return values
    is_wanted = bool(np.isfinite(advice.limits).any())
    return values | {
        "number": 1 + (values["last"][0]["number"] if values["last"] else 0),
        "stop": advice.stop_sentences(),
        "finished": remaining(advice) == 0 and not advice.objections,
        "time_left": _time_left(state),
        "is_wanted": is_wanted,
        "repeated": pose.repeated,
        **_pose_values(session, state, pose),
    }


def _pose_values(
    session: MachineSession, state: SessionState, pose: Pose
) -> dict[str, Any]:
    """Command, joints, entries and steps of the next reading."""
    machine, series = session.measurement.machine, pose.series
    command = describe.displayed_command(machine, series.reading_commands()[0])
    joints = describe.displayed_joints(machine, series.q[series.index[0, 0]])
    return {
        "setup": series.setup,
        "command": _numbers(command),
        "joints": _numbers(joints),
        "approach": session.next_approach(state.content, pose),
        "fields": _fields(session, state, pose),
        "steps": _steps(session, state, pose),
    }


def _numbers(columns: dict[str, float]) -> list[tuple[str, str, str]]:
    """Name, number as a controller takes it, and unit."""
    shown = []
    for name, value in columns.items():
        stem, unit = text.split_unit(name)
        number = f"{value:.{rows.COMMAND_DECIMALS}f}".rstrip("0").rstrip(".")
        shown.append(
            (stem, "0" if number == "-0" else number.replace("-", "\u2212"), unit)
        )
    return shown


def _fields(
    session: MachineSession, state: SessionState, pose: Pose
) -> list[dict[str, str]]:
    """Numbers to enter: name, unit, what each should be, and its ends or empty texts."""
    measurement, series = session.measurement, pose.series
    columns = rows.entry_columns(measurement, series.setup)
    names = [text.split_unit(ReadingsColumn.of(c.name, c.unit).name) for c in columns]
    if measurement.setups[series.setup].instrument.implied is not None:
        q = series.q[series.index[0, 0]]
        shown = [written(float(v), c.unit)[0] for v, c in zip(q, columns, strict=True)]
        return [
            _field(stem, unit, f"{value:.7g}", "", "")
            for (stem, unit), value in zip(names, shown, strict=True)
        ]
    expected = doubts.interval(session.adviser, state.fitted, series)
    fields = []
    for k, ((stem, unit), c) in enumerate(zip(names, columns, strict=True)):
        middle, half = float(expected.middle[k]), float(expected.half[k])
        ends = [written(middle + side * half, c.unit)[0] for side in (-1, 0, 1)]
        low, now, high = text.aligned(ends, most=4)
        fields.append(_field(stem, unit, now, low, high))
    return fields


def _field(name: str, unit: str, expected: str, low: str, high: str) -> dict[str, str]:
    return {"name": name, "unit": unit, "expected": expected, "low": low, "high": high}


def _steps(session: MachineSession, state: SessionState, pose: Pose) -> list[str]:
    """What to do before the reading: set-up, zero, passes."""
    measurement, setup = (
        session.measurement,
        session.measurement.setups[pose.series.setup],
    )
    steps = []
    row = rows.last_reading(state.content, session.measurement)
    before = None if row is None else state.content.cells(row).get("setup", "").strip()
    if before != setup.name:
        steps += _mounting(measurement, setup, change=before is not None)
    if rows.needs_reference(state.content, pose.series, measurement):
        reference = pose.series.command[pose.series.index[0, 1]]
        command = describe.displayed_command(measurement.machine, reference)
        steps.append(
            f"Drive to {text.named_quantities(command, 7)} and zero the instrument there."
        )
    passes = setup.protocol.pass_names
    if len(passes) > 1 and setup.protocol.average:
        steps.append(f"Read {', '.join(passes)}, and enter the mean.")
    return steps


def _mounting(measurement: Measurement, setup: Setup, *, change: bool) -> list[str]:
    info = describe.setup_info(measurement.machine, setup)
    verb = "Change to" if change else "Mount"
    numbers = {
        name: value
        for name, value in info.numbers.items()
        if not name.startswith("teach_") and (value or not name.startswith("tool_"))
    }
    phrase = f": {text.named_quantities(numbers, 7)}" if numbers else ""
    about = text.cleaned(setup.instrument.about)
    steps = [f"{verb} set-up {setup.name} ({about}){phrase}."]
    if setup.teach is not None:
        taught = describe.displayed_command(measurement.machine, np.array(setup.teach))
        steps.append(
            f"Drive to {text.named_quantities(taught, 7)} and seat the cup there."
        )
    return steps


def _last_readings(
    session: MachineSession, content: FileContent
) -> list[dict[str, Any]]:
    """The last readings of the file, the newest first."""
    measurement = session.measurement
    listed: list[dict[str, Any]] = []
    number = 0
    for k in range(1, len(content.rows)):
        values = rows.reading_cells(content, k, measurement)
        if not values:
            continue
        number += 1
        cells = content.cells(k)
        poses = [
            f"{stem} {cells[name]} {unit}"
            for name in content.header
            if name not in ("setup", "run", "order")
            and name not in values
            and cells[name]
            for stem, unit in [text.split_unit(name)]
            if unit and not name.startswith(("time_", "sigma_", "temp_"))
        ]
        poses += filter(None, [approach.shown(cells)])
        shown = [f"{cell} {text.split_unit(name)[1]}" for name, cell in values.items()]
        listed.append(
            {
                "number": number,
                "words": ", ".join(poses),
                "read": ", ".join(shown),
                "remark": cells.get(REMARK, ""),
            }
        )
    return listed[: -MAX_LISTED_READINGS - 1 : -1]


def _time_left(state: SessionState) -> str:
    """How long the readings that remain will take at the usual pace."""
    if state.advice is None:
        return ""
    count = remaining(state.advice)
    per_reading = pace(rows.times(state.content))
    if not count or per_reading is None:
        return ""
    minutes = count * per_reading / units.MINUTE
    return "Under a minute" if minutes < 1.0 else f"About {text.number(minutes, 2)} min"


def view(session: MachineSession, state: SessionState) -> PageView | None:
    """Machine, readings with their residuals, and the next reading as the last one."""
    measurement = session.measurement
    series: tuple[Series, ...] = ()
    sections: dict[str, Any] = {}
    if state.fitted is not None:
        measured, estimate, _ = state.fitted
        series = measured.readings.series
        sections["estimate"] = estimate_section(
            measured.measurement, series, estimate, None
        )
    if state.pose is not None:
        series = (*series, state.pose.series)
    drawing = describe.drawing(measurement, series)
    setups = [
        describe.setup_info(measurement.machine, setup)
        for setup in measurement.setups.values()
    ]
    result = msgspec.structs.replace(
        session.adviser.base.result, drawing=drawing, setups=setups
    )
    shown = PageView.from_result(result)
    if shown is None or state.fitted is None or state.pose is None:
        return shown
    return dataclasses.replace(shown, readings=_add_residuals(result, sections, shown))


def _add_residuals(
    result: Any, sections: dict[str, Any], shown: PageView
) -> list[Values]:
    """The readings with their residuals; the last one is not taken yet."""
    drawing = result.drawing
    taken = msgspec.structs.replace(
        drawing,
        tool_points=drawing.tool_points[:-1],
        reading_of=drawing.reading_of[:-1],
    )
    fitted = residuals_of_readings(msgspec.structs.replace(result, **sections), taken)
    readings = [
        one | {"residuals": residuals}
        for one, residuals in zip(shown.readings, fitted, strict=False)
    ]
    return [*readings, shown.readings[-1]]
