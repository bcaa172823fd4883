"""What else to record: what each covariate or choice is worth to the readings of a plan."""

import dataclasses
from collections.abc import Iterator, Mapping, Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.base import Array
from oed.effect_model import Effect
from oed.effects import Course, ExpectedColumns, PlannedEffects, SessionStates
from oed.gap import GapProblem
from oed.measurement import Measurement, Series
from oed.recording import RecordedCase
from oed.result import RecordedChoice, RecordingSection
from pkm_studies.resolve import GapRequest, PredictionRequest

#: readings of a reference run that is repeated at the end, at most
MAX_REFERENCE_READINGS = 8
TEMPERATURE, TIME = "temp_", "time"  #: how a need names a temperature, and the time
#: covariates that cost nothing, in words
COVARIATES = {
    "direction": "the direction of travel, with readings from both sides",
    TIME: "the time of each reading",
}


@dataclasses.dataclass(frozen=True, kw_only=True)
class PlanToRecord:
    """The readings of a plan on a machine with effects."""

    measurement: Measurement
    series: tuple[Series, ...]  #: in working order
    planned: PlannedEffects  #: the effects in the candidates of which these are some
    effects: Sequence[Effect]  #: those that are tried
    request: GapRequest
    prediction: PredictionRequest
    information: Array  #: of the prior of the machine's free parameters
    seed: Sequence[int]
    seconds: float | None = None  #: that the session lasts; None where nothing says it
    #: other measurements that could be added: readings by name
    further: Mapping[str, tuple[Measurement, tuple[Series, ...]]]


def recording_section(plan: PlanToRecord) -> RecordingSection | None:
    """What each covariate or choice is worth; None where no effect depends on any."""
    case = _case(plan, plan.measurement, plan.series)
    if not case.effects.of_course.any():
        return None
    (without,) = case.predict(case.nothing)
    count = sum(map(len, plan.series))
    choices = []
    for choice in (*_covariates(plan, case), *_further(plan)):
        times = without.equal_times(choice.reached)
        choices.append(
            RecordedChoice(
                name=choice.name,
                words=choice.words,
                effects=list(choice.effects),
                accuracy=_accuracy(plan, choice.reached),
                gain=without.gain(choice.reached),
                readings=None if np.isinf(times) else round((times - 1.0) * count),
            )
        )
    choices.sort(key=lambda choice: -choice.gain)
    return RecordingSection(
        readings=count,
        accuracy=_accuracy(plan, without.after(1.0)),
        floor=_accuracy(plan, without.after(np.inf)),
        choices=choices,
    )


class _Choice(NamedTuple):
    """A covariate or choice, and the mean squares (c,) that are left with it, SI."""

    name: str
    words: str
    effects: Sequence[str]
    reached: Array


def _case(
    plan: PlanToRecord,
    measurement: Measurement,
    series: Sequence[Series],
    last: int = 0,
) -> RecordedCase:
    """Readings in some courses, the `last` of which repeat the first ones."""
    problem, courses = _courses(plan, measurement, series, (), last)
    columns, session = plan.planned.columns, plan.planned.session
    return _recorded(plan, problem, courses, columns, session)


def _measured(
    plan: PlanToRecord, effect: Effect, bodies: Sequence[str]
) -> RecordedCase | None:
    """An effect with thermometers on bodies; None where it changes nothing."""
    problem, courses = _courses(plan, plan.measurement, plan.series, bodies, 0)
    columns = ExpectedColumns.of(problem, [effect], unknown=False)
    if columns is None:
        return None
    return _recorded(plan, problem, courses, columns, SessionStates.of(problem))


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


def _recorded(
    plan: PlanToRecord,
    problem: GapProblem,
    courses: list[Course],
    columns: ExpectedColumns,
    session: SessionStates,
) -> RecordedCase:
    where = plan.prediction
    rng = np.random.default_rng(plan.seed)
    reference, known = where.table.reference, plan.information
    return RecordedCase.of(
        problem, courses, columns, session, where.command, reference, rng, known
    )


def _covariates(plan: PlanToRecord, case: RecordedCase) -> Iterator[_Choice]:
    """Direction, time, a repeated reference, and thermometers, as far as effects need them."""
    for name, phrase in COVARIATES.items():
        mask = case.needing(name)
        if mask.any():
            yield _Choice(name, phrase, case.names(mask), case.reached(mask))
    timed = case.needing(TIME)
    if timed.any():
        first = plan.series[0].take(
            np.arange(min(MAX_REFERENCE_READINGS, len(plan.series[0])))
        )
        more = _case(plan, plan.measurement, [*plan.series, first], len(first))
        words = f"the time, and the first {len(first)} readings once more at the end"
        yield _Choice(
            "reference run", words, case.names(timed), more.reached(more.needing(TIME))
        )
    for effect in plan.effects:
        yield from _thermometers(plan, case, effect)


def _thermometers(
    plan: PlanToRecord, case: RecordedCase, effect: Effect
) -> Iterator[_Choice]:
    """Thermometers on each body that an effect depends on; on all legs together."""
    needs = [part.strip() for need in effect.needs for part in need.split(" or ")]
    named = [n.removeprefix(TEMPERATURE) for n in needs if n.startswith(TEMPERATURE)]
    parts = [[body] for body in named]
    if "leg1" in named:
        legs = [f"leg{k + 1}" for k in range(len(plan.measurement.machine.joints))]
        parts = [*([leg] for leg in legs), legs]
    if not parts:
        return
    warm = _measured(plan, effect, parts[-1])
    for bodies in parts:
        hidden = case.restrict_to_bodies(effect.name, bodies)
        if warm is not None and hidden.any():
            reached = case.reached_with(warm, hidden, effect.name, bodies)
            name = ", ".join(f"{TEMPERATURE}{body}_C" for body in bodies)
            yield _Choice(name, _bodies_text(bodies), [effect.name], reached)


def _bodies_text(bodies: Sequence[str]) -> str:
    if len(bodies) > 1:
        return f"thermometers on all {len(bodies)} legs"
    (body,) = bodies
    location = (
        f"leg {body.removeprefix('leg')}" if body != "leg" and "leg" in body else body
    )
    return f"a thermometer on {location if location != body else 'the ' + body}"


def _further(plan: PlanToRecord) -> Iterator[_Choice]:
    """Measurements that the plan leaves out, beside its own."""
    for name, (measurement, series) in plan.further.items():
        more = _case(plan, measurement, [*plan.series, *series])
        phrase = f"{sum(map(len, series))} readings of {name} as well"
        yield _Choice(name, phrase, [], more.reached(more.nothing))


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
