"""Reports the predicted accuracy over the workspace: the section `prediction`."""

from __future__ import annotations

from collections.abc import Mapping

import msgspec
import numpy as np

from oed import units
from oed.accuracy import Budget, Prediction, Spread
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from oed.result import (
    ComponentAccuracy,
    MapPoint,
    PredictionSection,
    SpreadRecord,
    ToolAccuracy,
)
from pkm_studies import describe


def add_realised(
    section: PredictionSection, realised: Mapping[str, Spread] | None
) -> PredictionSection:
    """The section with the accuracy of virtual machines, by component, if any."""
    if realised is None:
        return section
    spreads = {n: spread_record(s, section.unit[n]) for n, s in realised.items()}
    shares = {n: s.rms / section.components[n].after.rms for n, s in spreads.items()}
    return msgspec.structs.replace(section, realised=spreads, realised_share=shares)


def accuracy_section(
    kinematics: Kinematics,
    prediction: Prediction,
    mode: str,
    budget: Budget | None = None,
) -> PredictionSection:
    """A prediction in the components' fine units; `mode` says what it rests on."""
    machine = kinematics.machine
    of_sources = {} if budget is None else budget.shares()
    fine = {c.name: units.FINE[c.unit] for c in machine.components}
    compensatable = {c.name: c.compensatable for c in machine.components}
    components = {
        name: ComponentAccuracy(
            compensatable=compensatable[name],
            before=spread_record(prediction.before[name], fine[name]),
            after=spread_record(prediction.after[name], fine[name]),
            known=spread_record(prediction.fully_corrected[name], fine[name]),
            budget=of_sources.get(name, {}),
        )
        for name in prediction.names
    }
    points = []
    poses = kinematics.inverse(prediction.command)[0]
    _, tips, _ = kinematics.frames(poses, np.zeros(3))
    for i, command in enumerate(prediction.command):
        before = _component_values(prediction, prediction.sd_before[i], fine)
        after = _component_values(prediction, prediction.sd_after[i], fine)
        tip = [float(v) for v in tips[i]]
        points.append(
            MapPoint(describe.displayed_command(machine, command), before, after, tip)
        )
    return PredictionSection(
        reference=prediction.reference,
        components=components,
        unit=fine,
        poses=len(prediction.command),
        map=points,
        mode=mode,
        worst={
            name: points[int(np.argmax(prediction.sd_after[:, k]))]
            for k, name in enumerate(prediction.names)
        },
    )


def add_wanted(
    section: PredictionSection, wanted: Mapping[str, float]
) -> PredictionSection:
    """The section with the rms errors to reach, given in SI by component."""
    fine = {name: units.number(v, section.unit[name]) for name, v in wanted.items()}
    return msgspec.structs.replace(section, wanted=fine)


def component_records(
    machine: Machine, prediction: Prediction
) -> dict[str, SpreadRecord]:
    """Spread after compensation by component, in its fine unit."""
    return {
        c.name: spread_record(prediction.after[c.name], units.FINE[c.unit])
        for c in machine.components
    }


def tool_accuracy(
    machine: Machine, prediction: Prediction, length: float
) -> ToolAccuracy:
    """Accuracy after compensation at a tool of a length, m."""
    unit = units.display("m")
    records = component_records(machine, prediction)
    return ToolAccuracy(units.number(length, unit), unit, records)


def _component_values(
    prediction: Prediction, values: Array, fine: Mapping[str, str]
) -> dict[str, float]:
    """Values (k,), SI, by component, in its fine unit."""
    pairs = zip(prediction.names, values, strict=True)
    return {name: units.number(value, fine[name]) for name, value in pairs}


def spread_record(spread: Spread, unit: str) -> SpreadRecord:
    """A spread, SI, in a unit."""

    def interval(ends: tuple[float, float]) -> tuple[float, float] | None:
        if not np.isfinite(ends).all():
            return None
        return units.number(ends[0], unit), units.number(ends[1], unit)

    return SpreadRecord(
        rms=units.number(spread.rms, unit),
        p95=units.number(spread.p95, unit),
        max=units.number(spread.largest, unit),
        unit=unit,
        rms_interval=interval(spread.rms_interval),
        p95_interval=interval(spread.p95_interval),
        max_interval=interval(spread.largest_interval),
        rms_quantiles=[units.number(q, unit) for q in spread.rms_quantiles],
        monte_carlo={
            name.replace("largest", "max"): [units.number(e, unit) for e in errors]
            for name, errors in spread.monte_carlo.items()
        },
    )
