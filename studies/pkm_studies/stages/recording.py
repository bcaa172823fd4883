"""What else to record: what each covariate or choice is worth to the readings of a plan."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.accuracy import error_maps
from oed.base import Array, Mask
from oed.effect_model import Effect
from oed.effects import (
    Course,
    CourseColumns,
    ExpectedColumns,
    PlannedEffects,
    SessionStates,
    course_changes,
    expected_columns,
)
from oed.gap import GapProblem
from oed.measurement import Measurement, Series
from oed.recording import (
    PlannedReadings,
    RemainingError,
    mean_after_once,
    relative,
    thermometer_scatter,
)
from oed.result import RecordedChoice, RecordingSection
from pkm_studies.resolve import GapRequest, PredictionRequest

#: readings of a reference run that is repeated at the end, at most
MAX_REFERENCE_READINGS = 8
#: how a need names a temperature, and the time
TEMPERATURE, TIME = "temp_", "time"
#: covariates that cost nothing, in words
COVARIATES = {
    "direction": "the direction of travel, with readings from both sides",
    TIME: "the time of each reading",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanToRecord:
    """The readings of a plan on a machine with effects.

    series       in working order
    planned      the effects in the candidates of which these are some
    effects      those that are tried
    information  of the prior of the machine's free parameters
    further      other measurements that could be added: readings by name
    """

    measurement: Measurement
    series: tuple[Series, ...]
    planned: PlannedEffects
    effects: Sequence[Effect]
    request: GapRequest
    prediction: PredictionRequest
    information: Array
    seed: Sequence[int]
    seconds: float | None = None
    further: Mapping[str, tuple[Measurement, tuple[Series, ...]]]


@dataclasses.dataclass(frozen=True, eq=False)
class _Case:
    """Readings with the effects in some courses."""

    readings: PlannedReadings
    courses: list[Course]
    columns: ExpectedColumns
    effects: CourseColumns

    @property
    def nothing(self) -> Mask:
        """No column (k,)."""
        return np.zeros(len(self.effects.of_course), dtype=bool)

    def needing(self, covariate: str) -> Mask:
        """Columns (k,) of effects that need a covariate."""
        names = {
            form.effect.name
            for form in self.columns.forms
            if any(covariate in need for need in form.effect.needs)
        }
        groups = [name.split(": ")[0] in names for name in self._groups]
        return np.array(groups)[self.columns.discrepancy.group]

    def restrict_to_bodies(self, effect: str, bodies: Sequence[str]) -> Mask:
        """Columns (k,) of an effect in bodies, or in all where it has no blocks."""
        groups = []
        for name in self._groups:
            named, _, label = name.partition(": ")
            groups.append(named == effect and label.replace(" ", "") in ("", *bodies))
        return np.array(groups)[self.columns.discrepancy.group]

    def names(self, mask: Mask) -> list[str]:
        """Effects of known form of some columns (k,)."""
        discrepancy = self.columns.discrepancy
        groups = np.unique(discrepancy.group[mask])
        group_names = [self._groups[g] for g in groups if not discrepancy.unknown[g]]
        return list(dict.fromkeys(name.split(": ")[0] for name in group_names))

    def predict(self, recorded: Mask) -> list[RemainingError]:
        """Errors with the covariates of some columns (k,) recorded."""
        return self.readings.predict(self.effects, recorded, np.zeros(1))

    @property
    def _groups(self) -> tuple[str, ...]:
        return self.columns.discrepancy.names


def recording_section(plan: PlanToRecord) -> RecordingSection | None:
    """What each covariate or choice is worth; None where no effect depends on any."""
    case = _case(plan, plan.measurement, plan.series)
    if not case.effects.of_course.any():
        return None
    (without,) = case.predict(case.nothing)
    unit, count = without.after(1.0), sum(map(len, plan.series))
    choices = []
    for choice in (*_covariates(plan, case), *_further(plan)):
        reached = mean_after_once(choice.errors)
        times = without.equal_times(reached)
        choices.append(
            RecordedChoice(
                name=choice.name,
                words=choice.words,
                effects=list(choice.effects),
                accuracy=_accuracy(plan, reached),
                gain=max(1.0 - relative(reached, unit), 0.0),
                readings=None if np.isinf(times) else round((times - 1.0) * count),
            )
        )
    choices.sort(key=lambda choice: -choice.gain)
    return RecordingSection(
        readings=count,
        accuracy=_accuracy(plan, unit),
        floor=_accuracy(plan, without.after(np.inf)),
        choices=choices,
    )


class _Choice(NamedTuple):
    """A covariate or choice, and the errors that are left with it."""

    name: str
    words: str
    effects: Sequence[str]
    errors: Sequence[RemainingError]


def _case(
    plan: PlanToRecord,
    measurement: Measurement,
    series: Sequence[Series],
    last: int = 0,
) -> _Case:
    """Readings in some courses, the `last` of which repeat the first ones."""
    problem, courses = _courses(plan, measurement, series, (), last)
    columns, session = plan.planned.columns, plan.planned.session
    return _stated(plan, problem, courses, columns, session)


def _measured(
    plan: PlanToRecord, effect: Effect, bodies: Sequence[str]
) -> _Case | None:
    """An effect with thermometers on bodies; None where it changes nothing."""
    problem, courses = _courses(plan, plan.measurement, plan.series, bodies, 0)
    columns = expected_columns(problem, [effect], unknown=False)
    if columns is None:
        return None
    return _stated(plan, problem, courses, columns, SessionStates.of(problem))


def _courses(
    plan: PlanToRecord,
    measurement: Measurement,
    series: Sequence[Series],
    bodies: Sequence[str],
    last: int,
) -> tuple[GapProblem, list[Course]]:
    rng = np.random.default_rng(plan.seed)
    return plan.request.planned_courses(
        measurement, series, rng, plan.seconds, bodies, last
    )


def _stated(
    plan: PlanToRecord,
    problem: GapProblem,
    courses: list[Course],
    columns: ExpectedColumns,
    session: SessionStates,
) -> _Case:
    where, rng = plan.prediction, np.random.default_rng(plan.seed)
    over = course_changes(
        problem, courses, columns, session, where.command, where.table.reference, rng
    )
    return _Case(_readings(plan, problem), courses, columns, over)


def _readings(plan: PlanToRecord, problem: GapProblem) -> PlannedReadings:
    """The readings over the unknowns of machine and set-ups."""
    measurement = problem.measurement
    free = measurement.free
    slopes = measurement.jacobian(problem.series, measurement.nominal)
    white = measurement.noise(problem.series).whiten(slopes * measurement.tolerance)
    where, machine = plan.prediction, measurement.machine
    raw = error_maps(measurement.kinematics, where.command, where.table.reference).raw
    pose = np.zeros((*raw.shape[:2], len(free)))
    pose[:, :, : len(machine.parameters)] = raw
    unknowns, pieces = int(free.sum()), len(plan.information)
    information = np.eye(unknowns)
    information[:pieces, :pieces] = plan.information
    return PlannedReadings(
        white=white[:, free],
        sigma=problem.sigma,
        information=information,
        pose_gradients=(pose * measurement.tolerance)[:, :, free],
    )


def _covariates(plan: PlanToRecord, case: _Case) -> Iterator[_Choice]:
    """Direction, time, a repeated reference, and thermometers, as far as effects need them."""
    for name, phrase in COVARIATES.items():
        mask = case.needing(name)
        if mask.any():
            yield _Choice(name, phrase, case.names(mask), case.predict(mask))
    timed = case.needing(TIME)
    if timed.any():
        yield from _repeated_reference(plan, case.names(timed))
    for effect in plan.effects:
        yield from _thermometers(plan, case, effect)


def _repeated_reference(
    plan: PlanToRecord, effects: Sequence[str]
) -> Iterator[_Choice]:
    """The first readings once more at the end, with the time of all readings."""
    first = plan.series[0].take(
        np.arange(min(MAX_REFERENCE_READINGS, len(plan.series[0])))
    )
    more = _case(plan, plan.measurement, [*plan.series, first], len(first))
    phrase = f"the time, and the first {len(first)} readings once more at the end"
    yield _Choice("reference run", phrase, effects, more.predict(more.needing(TIME)))


def _thermometers(plan: PlanToRecord, case: _Case, effect: Effect) -> Iterator[_Choice]:
    """Thermometers on each body that an effect depends on; on all legs together."""
    parts = _bodies(effect, plan.measurement)
    every = parts[-1] if parts else []
    if not every:
        return
    warm = _measured(plan, effect, every)
    for bodies in parts:
        hidden = case.restrict_to_bodies(effect.name, bodies)
        if warm is not None and hidden.any():
            errors = _add_thermometers(case, hidden, warm, effect, bodies)
            name = ", ".join(f"{TEMPERATURE}{body}_C" for body in bodies)
            yield _Choice(name, _bodies_text(bodies), [effect.name], errors)


def _add_thermometers(
    case: _Case, hidden: Mask, warm: _Case, effect: Effect, bodies: Sequence[str]
) -> list[RemainingError]:
    """Errors where `warm` has what is hidden (k,) elsewhere, as large as it is there."""
    measured = warm.effects.take(warm.restrict_to_bodies(effect.name, bodies))
    names = [f"{TEMPERATURE}{body}" for body in bodies]
    kelvin = np.array([c.covariates[names] for c in warm.courses])
    extra = thermometer_scatter(measured, kelvin)
    size = case.effects.take(hidden).rms / measured.rms
    others = case.effects.take(~hidden)
    both = others.joined(measured.scaled(size))
    recorded = np.arange(both.changes.shape[2]) >= others.changes.shape[2]
    return case.readings.predict(both, recorded, extra)


def _bodies_text(bodies: Sequence[str]) -> str:
    """Thermometers in words: `a thermometer on leg 2`."""
    if len(bodies) > 1:
        return f"thermometers on all {len(bodies)} legs"
    (body,) = bodies
    location = (
        f"leg {body.removeprefix('leg')}" if body != "leg" and "leg" in body else body
    )
    return f"a thermometer on {location if location != body else 'the ' + body}"


def _bodies(effect: Effect, measurement: Measurement) -> list[list[str]]:
    """Bodies of which an effect needs the temperature: one by one, and all legs."""
    parts = [part.strip() for need in effect.needs for part in need.split(" or ")]
    named = [p.removeprefix(TEMPERATURE) for p in parts if p.startswith(TEMPERATURE)]
    if "leg1" not in named:
        return [[body] for body in named]
    legs = [f"leg{k + 1}" for k in range(len(measurement.machine.joints))]
    return [*([leg] for leg in legs), legs]


def _further(plan: PlanToRecord) -> Iterator[_Choice]:
    """Measurements that the plan leaves out, beside its own."""
    for name, (measurement, series) in plan.further.items():
        more = _case(plan, measurement, [*plan.series, *series])
        phrase = f"{sum(map(len, series))} readings of {name} as well"
        yield _Choice(name, phrase, [], more.predict(more.nothing))


def _accuracy(plan: PlanToRecord, mean_squares: Array) -> dict[str, float]:
    """Rms of each component that moves, in its fine unit."""
    components = plan.measurement.machine.components
    values = {}
    for component, square in zip(components, mean_squares, strict=True):
        unit = units.FINE[component.unit]
        if square > 0.0:
            value = units.number(float(np.sqrt(square)), unit)
            values[f"{component.name}_{unit}"] = value
    return values
