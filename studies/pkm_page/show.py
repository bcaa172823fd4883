"""The state of a session as the page shows it: texts, tables and the view to turn."""

from __future__ import annotations

import dataclasses
from typing import Any, Final

import msgspec
import numpy as np

from oed import units
from oed.dataset import ReadingsColumn, written
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from pkm_page import approach, doubts, known, rows
from pkm_page.readings_log import REMARK, FileContent
from pkm_page.session import MachineSession, Pose, SessionState
from pkm_reports import text
from pkm_reports.view import PageView, ViewReading, build_view, residuals_of_readings
from pkm_studies import describe
from pkm_studies.stages import estimate_section

#: last readings that are listed beside the entry
LISTED: Final = 4


@dataclasses.dataclass(frozen=True)
class EntryField:
    """A number to enter: column, unit, what it should be and where it should lie."""

    name: str
    unit: str
    expected: str
    low: str
    high: str


@dataclasses.dataclass(frozen=True)
class LastReading:
    """A reading of the file, in words; `undone` where it was taken back."""

    number: int
    words: str
    values: str
    remark: str


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
        "accuracies": known.accuracies(session, state),
        "parameters": known.parameters(state),
        "combinations": known.open_combinations(state),
        "best": known.best_next(session, state),
    }
    if advice is None or pose is None:
        return values
    is_wanted = bool(np.isfinite(advice.limits).any())
    return values | {
        "number": 1 + (values["last"][0].number if values["last"] else 0),
        "stop": advice.stop_sentences(),
        "finished": known.remaining(advice) == 0 and not advice.objections,
        "time_left": _time_left(state),
        "is_wanted": is_wanted,
        "repeated": pose.repeated,
        **_pose_values(session, state, pose),
    }


def _pose_values(
    session: MachineSession, state: SessionState, pose: Pose
) -> dict[str, Any]:
    """Command, joints, entries and steps of the next reading."""
    measurement, series, row = session.measurement, pose.series, pose.row
    machine = measurement.machine
    command = describe.displayed_command(machine, series.reading_commands()[row])
    joints = describe.displayed_joints(machine, series.q[series.index[row, 0]])
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
        number = f"{value:.{rows.DECIMALS}f}".rstrip("0").rstrip(".")
        shown.append(
            (stem, "0" if number == "-0" else number.replace("-", "\u2212"), unit)
        )
    return shown


def _fields(
    session: MachineSession, state: SessionState, pose: Pose
) -> list[EntryField]:
    measurement, series, row = session.measurement, pose.series, pose.row
    columns = rows.entry_columns(measurement, series.setup)
    names = [text.split_unit(ReadingsColumn.of(c.name, c.unit).name) for c in columns]
    if measurement.setups[series.setup].instrument.implied is not None:
        q = series.q[series.index[row, 0]]
        shown = [written(float(v), c.unit)[0] for v, c in zip(q, columns, strict=True)]
        return [
            EntryField(stem, unit, f"{value:.7g}", "", "")
            for (stem, unit), value in zip(names, shown, strict=True)
        ]
    expected = doubts.interval(session.adviser, state.fitted, series, row)
    fields = []
    for k, ((stem, unit), c) in enumerate(zip(names, columns, strict=True)):
        middle, half = float(expected.middle[k]), float(expected.half[k])
        ends = [written(middle + side * half, c.unit)[0] for side in (-1, 0, 1)]
        low, now, high = text.aligned(ends, most=4)
        fields.append(EntryField(stem, unit, now, low, high))
    return fields


def _steps(session: MachineSession, state: SessionState, pose: Pose) -> list[str]:
    """What to do before the reading: set-up, zero, passes."""
    measurement, setup = (
        session.measurement,
        session.measurement.setups[pose.series.setup],
    )
    steps = []
    before = _last_setup(session, state.content)
    if before != setup.name:
        steps += _mounting(measurement, setup, change=before is not None)
    if rows.needs_reference(state.content, pose.series, pose.row, measurement):
        reference = pose.series.command[pose.series.index[pose.row, 1]]
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


def _last_setup(session: MachineSession, content: FileContent) -> str | None:
    row = rows.last_reading(content, session.measurement)
    return None if row is None else content.cells(row).get("setup", "").strip()


def _last_readings(session: MachineSession, content: FileContent) -> list[LastReading]:
    """The last readings of the file, the latest first."""
    measurement = session.measurement
    listed, number = [], 0
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
            LastReading(
                number, ", ".join(poses), ", ".join(shown), cells.get(REMARK, "")
            )
        )
    return listed[: -LISTED - 1 : -1]


def _time_left(state: SessionState) -> str:
    """How long the readings that remain will take at the usual pace."""
    if state.advice is None:
        return ""
    count = known.remaining(state.advice)
    pace = known.pace(rows.times(state.content))
    if not count or pace is None:
        return ""
    minutes = count * pace / units.MINUTE
    return "Under a minute" if minutes < 1.0 else f"About {text.number(minutes, 2)} min"


# -- the view --------------------------------------------------------------------------


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
        series = (*series, state.pose.series.take(np.array([state.pose.row])))
    drawing = describe.drawing(measurement, series)
    setups = [
        describe.setup_info(measurement.machine, setup)
        for setup in measurement.setups.values()
    ]
    result = msgspec.structs.replace(
        session.adviser.base.result, drawing=drawing, setups=setups
    )
    shown = build_view(result)
    if shown is None or state.fitted is None or state.pose is None:
        return shown
    return dataclasses.replace(shown, readings=_add_residuals(result, sections, shown))


def _add_residuals(
    result: Any, sections: dict[str, Any], shown: PageView
) -> list[ViewReading]:
    """The readings with their residuals; the last one is not taken yet."""
    drawing = result.drawing
    taken = msgspec.structs.replace(
        drawing,
        tool_points=drawing.tool_points[:-1],
        reading_of=drawing.reading_of[:-1],
    )
    fitted = residuals_of_readings(msgspec.structs.replace(result, **sections), taken)
    readings = [
        dataclasses.replace(one, residuals=residuals)
        for one, residuals in zip(shown.readings, fitted, strict=False)
    ]
    return [*readings, shown.readings[-1]]
