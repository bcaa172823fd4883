"""Plans an acceptance test from a result: poses, limits and power."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence

import msgspec
import numpy as np

from oed import csv_text, units
from oed.acceptance import AcceptancePlan, Promise, plan_acceptance, state_limits
from oed.base import Array, Index
from oed.dataset import commented
from oed.model import Component, Machine
from oed.result import AcceptanceSection, PromiseRecord, StudyResult, finite_or_none
from pkm_studies import describe
from pkm_studies.acceptance.promise import FurtherPromise, PromisedAccuracy
from pkm_studies.base import InputError
from pkm_studies.resolve import readings_comments

#: share of the range of a coordinate by which a pose differs from a calibration pose
APART = 0.02
#: column of an error to fill in, by component and unit
ERROR = "error_{}_{}"
#: column that says whether additional axes took the known errors back: 1, or 0 or empty
AXES = "further_axes"


def plan_section(
    result: StudyResult,
    accuracy: PromisedAccuracy,
    rng: np.random.Generator,
    *,
    power: float,
    most: int,
) -> AcceptanceSection:
    """The acceptance plan. Raises InputError where no other poses are left."""
    candidates = _other_poses(result, accuracy)
    if not len(candidates):
        raise InputError(
            "every workspace pose is one of the calibration",
            "give more poses in [prediction] of the study",
        )
    plan = plan_acceptance(accuracy.promise, candidates, rng, power=power, most=most)
    further = accuracy.further
    return AcceptanceSection(
        poses=[
            describe.displayed_command(accuracy.machine, accuracy.command[k])
            for k in plan.poses
        ],
        components=_demands(accuracy.components, accuracy.promise, plan),
        reference=accuracy.reference,
        miss=plan.miss,
        false_alarm=plan.false_alarm,
        conditions=list(accuracy.conditions),
        further={} if further is None else _further_demands(further, plan, rng),
        offsets=[] if further is None else _offsets(further, plan),
    )


def _demands(
    components: Sequence[Component], promise: Promise, plan: AcceptancePlan
) -> dict[str, PromiseRecord]:
    demands = {}
    for k, component in enumerate(components):
        unit = units.FINE[component.unit]
        demands[component.name] = PromiseRecord(
            promised=units.number(promise.rms[k], unit),
            limit=units.number(plan.limits[k], unit),
            confirms=finite_or_none(units.number(plan.confirms[k], unit)),
            power=float(plan.power[k]),
            uncertainty=units.number(promise.uncertainty[k], unit),
            unit=unit,
        )
    return demands


def _further_demands(
    further: FurtherPromise, plan: AcceptancePlan, rng: np.random.Generator
) -> dict[str, PromiseRecord]:
    """Demands at the same poses on what no drive corrects, with additional axes."""
    stated = state_limits(further.promise, plan.poses, rng, miss=plan.miss)
    demands = _demands(further.components, further.promise, stated)
    return {
        name: msgspec.structs.replace(demand, without=units.number(rms, demand.unit))
        for (name, demand), rms in zip(demands.items(), further.without, strict=True)
    }


def _offsets(further: FurtherPromise, plan: AcceptancePlan) -> list[dict[str, float]]:
    """Known errors at each pose without additional axes, in the components' fine units."""
    return [
        {
            c.name: units.number(value, units.FINE[c.unit])
            for c, value in zip(further.components, further.known[k], strict=True)
        }
        for k in plan.poses
    ]


def _other_poses(result: StudyResult, accuracy: PromisedAccuracy) -> Index:
    """Numbers of the workspace poses that the calibration did not read."""
    command = accuracy.command
    used = _calibration_commands(result, accuracy)
    if not len(used):
        return np.arange(len(command))
    size = np.ptp(np.vstack([command, used]), axis=0)
    scaled = np.where(size > 0.0, size, 1.0)
    distance = np.abs(command[:, None] - used[None]) / scaled
    return np.flatnonzero(distance.max(axis=2).min(axis=1) > APART)


def _calibration_commands(result: StudyResult, accuracy: PromisedAccuracy) -> Array:
    """Commands (n, n_dof), SI, that the calibration read, as far as they are known."""
    names = list(describe.displayed_command(accuracy.machine, accuracy.command[0]))
    commands = [] if result.estimate is None else result.estimate.commands
    rows = [
        [float(units.to_si(c[n], units.split(n)[1])) for n in names] for c in commands
    ]
    return np.array(rows).reshape(len(rows), len(names))


def error_columns(components: Mapping[str, PromiseRecord]) -> dict[str, str]:
    """{component: its column in the file to fill in}."""
    return {n: ERROR.format(n, demand.unit) for n, demand in components.items()}


#: what an error zeroed at home is
ZEROED = (
    "home: of the place, the error at home is subtracted; of the orientation R, the turn"
    " from home R R_home^T is compared with the commanded one, in the base frame"
)


def _comments(section: AcceptanceSection, machine: Machine) -> Iterator[str]:
    """Lines above the header: the frames, and what each column means."""
    yield from readings_comments(machine, {}, list(section.poses[0]))
    about = {c.name: c.about for c in machine.components}
    for name, column in error_columns(
        {**section.components, **section.further}
    ).items():
        yield f"{column}: {about[name]}; reference: {section.reference}"
    if section.reference == "home":
        yield ZEROED
    if section.further:
        yield f"{AXES}: 1 where additional axes took the known errors back, else 0 or empty"


def acceptance_form(section: AcceptanceSection, machine: Machine) -> str:
    """CSV of the poses, with empty columns for the measured errors."""
    columns = list(error_columns(section.components).values())
    if section.further:
        columns += [*error_columns(section.further).values(), AXES]
    rows = [[*section.poses[0], "direction", *columns]]
    for pose in section.poses:
        values = [f"{value:.10g}" for value in pose.values()]
        rows.append([*values, "", *[""] * len(columns)])
    return commented(_comments(section, machine)) + csv_text.of_rows(rows)
