"""Advises at the machine: what is known now, the best next reading, when to stop."""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

import numpy as np

from oed import trust
from oed.accuracy import error_maps
from oed.base import Array
from oed.design import Candidates
from oed.effects import PlannedEffects
from oed.estimation import Estimate, IdentificationError, identify
from oed.measurement import Measurement, Series
from oed.poses import Belief
from pkm_studies import quantities
from pkm_studies.base import InputError, Silent, Stream
from pkm_studies.quantities import component_values
from pkm_studies.resolve import readings_dataset
from pkm_studies.sessions.next_effects import (
    Outlook,
    effects_at,
    noise_with_effects,
    outlook_with_effects,
)
from pkm_studies.sessions.next_sentences import MOST_AHEAD, Advice, advice_sentences
from pkm_studies.sessions.skipped_poses import SkippedPose, allowed, skipped_in_file
from pkm_studies.stages import (
    Measured,
    RunState,
    checked,
    estimate_section,
    explain_error,
    select_design,
    start,
)
from pkm_studies.study import Study

#: how a file is refused whose cells for readings are all empty
NO_READING = "no reading was taken"
#: what `wanted` is where a session should reach what the study's plan would
AS_PLANNED = "plan"
#: share by which a session with the plan's readings may miss the plan's accuracy
ROUNDING = 1e-6
#: time between two looks at the file, s
PAUSE = 0.5


class FittedReadings(NamedTuple):
    """Readings of a file, checked, their fit, and effects that it allows."""

    state: Measured
    estimate: Estimate
    effects: PlannedEffects | None


class Adviser:
    """A study whose candidates, workspace and set-ups are resolved once.

    wanted  rms errors as in "z_um=30"; AS_PLANNED: what the study's plan would reach on
            this machine, as far as it is known after each reading

    Raises InputError where the study has no candidates or no workspace.
    """

    def __init__(self, study: Study, wanted: str = "") -> None:
        self.base = start(study, None, Silent(), [])
        if not self.base.resolved.candidates:
            raise study.location.key("design").error(
                "the study has no candidates to choose the next reading from",
                "add [[design.candidates]]",
            )
        where = self.base.resolved.prediction
        if where is None:
            raise study.location.key("prediction").error(
                "the study does not say where accuracy counts",
                "add [prediction] with a workspace, see `oed schema study`",
            )
        resolved = self.base.resolved
        self.maps = error_maps(
            resolved.measurement.kinematics, where.command, where.table.reference
        )
        self.plan: Sequence[int] = ()
        if wanted == AS_PLANNED:
            self.plan = _planned_candidates(self.base)
            wanted = ""
        self.limits = _limits(study, self.base, self.maps.names, wanted)

    def advise(self, readings: Path) -> Advice:
        """The advice after the readings of a file. Raises InputError as they are read."""
        skipped = skipped_in_file(readings, self.everything)
        return self.advise_fitted(self.fit(readings), skipped)

    def watch(self, readings: Path) -> Iterator[list[str]]:
        """Lines of advice, now and after each readable change of the file; without end."""
        last: tuple[int, int] | None = None
        while True:
            status = readings.stat()
            stamp = (status.st_mtime_ns, status.st_size)
            if stamp != last:
                last = stamp
                try:
                    yield advice_sentences(self, self.advise(readings))
                except InputError as error:
                    yield [str(error)]
            time.sleep(PAUSE)

    @property
    def everything(self) -> Measurement:
        """The machine with all set-ups of the study."""
        return self.base.resolved.measurement_with(self.base.resolved.setups)

    def fit(self, readings: Path) -> FittedReadings | None:
        """The readings of a file with their fit; None where it has only poses.

        Raises InputError for readings that cannot be read or fitted.
        """
        state = self._state_with_readings(readings)
        if state is None:
            return None
        taken = state.readings
        try:
            effects = effects_at(self.base, state.measurement, taken.series)
            estimate = _fit(
                self.base, state.measurement, taken.series, taken.y, effects
            )
        except IdentificationError as error:
            raise explain_error(state, error) from error
        return FittedReadings(state, estimate, effects)

    def advise_fitted(
        self, fitted: FittedReadings | None, skipped: Sequence[SkippedPose] = ()
    ) -> Advice:
        """The advice after readings that are fitted; None: before the first one.

        skipped  poses that are not advised. Raises InputError where nothing else is.
        """
        if fitted is None:
            measurement = self.base.measurement
            effects = effects_at(self.base, measurement, ())
            return self._advise(measurement, (), None, effects, skipped)
        state, estimate, effects = fitted
        series = state.readings.series
        advice = self._advise(state.measurement, series, estimate, effects, skipped)
        checked = () if state.checked is None else state.checked.findings
        return dataclasses.replace(
            advice,
            findings=tuple(finding.sentence for finding in checked),
            objections=_objections(state, series, estimate),
        )

    def advise_after(
        self, measurement: Measurement, series: Sequence[Series], y: Array
    ) -> Advice:
        """The advice after readings y (N,), SI, unchecked. Raises IdentificationError."""
        effects = effects_at(self.base, measurement, series)
        estimate = None
        if len(y):
            estimate = _fit(self.base, measurement, series, y, effects)
        return self._advise(measurement, series, estimate, effects)

    def _advise(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        estimate: Estimate | None,
        effects: PlannedEffects | None,
        skipped: Sequence[SkippedPose] = (),
    ) -> Advice:
        theta = measurement.nominal if estimate is None else estimate.theta
        if effects is None:
            outlook = self._outlook(measurement, theta, estimate)
        else:
            outlook = outlook_with_effects(
                self.base, measurement, series, theta, self.maps.raw, effects
            )
        if self.plan:
            blocks = outlook.blocks
            planned = outlook.before.update_all(blocks, self.plan)
            self.limits = outlook.accuracy(planned) * (1.0 + ROUNDING)
        count = sum(map(len, series))
        return self._advice(measurement, outlook, theta, count, skipped)

    def _outlook(
        self, measurement: Measurement, theta: Array, estimate: Estimate | None
    ) -> Outlook:
        """The outlook of a machine without effects."""
        resolved = self.base.resolved
        pool = Candidates.build(measurement, resolved.candidates, theta, "tolerance")
        before = self.prior(measurement, pool)
        now = self._belief(measurement, pool, estimate)
        return Outlook(pool, 0, before, now, np.zeros(len(self.maps.names)))

    def accuracy(
        self, measurement: Measurement, pool: Candidates, indices: Sequence[int]
    ) -> Array:
        """Rms (K,) that candidates of a pool reach, without any other reading."""
        prior = self.prior(measurement, pool)
        after = prior.update_all(pool.blocks, indices)
        return np.sqrt(after.variances)

    def prior(self, measurement: Measurement, pool: Candidates) -> Belief:
        """What the tolerances alone say, before any reading."""
        return self._belief(measurement, pool, None)

    def _state_with_readings(self, path: Path) -> Measured | None:
        """The state with the readings of a file; None where it has only poses."""
        study, resolved = self.base.study, self.base.resolved
        everything = resolved.measurement_with(resolved.setups)
        try:
            data = readings_dataset(study, everything, [path])
        except InputError as error:
            if error.problem != NO_READING:
                raise
            return None
        if data is None:
            return None
        state = self.base.replace(
            resolved=resolved.with_dataset(data), readings_given=True
        )
        measured = checked(state, data)
        # Candidates may need set-ups that no reading has used yet.
        used = {*measured.measurement.setups, *self.base.measurement.setups}
        return measured.replace(measurement=resolved.measurement_with(used))

    def _belief(
        self, measurement: Measurement, pool: Candidates, estimate: Estimate | None
    ) -> Belief:
        """Covariance in tolerances; errors that runs share have variance 1."""
        free = measurement.free
        scale = measurement.tolerance[free]
        columns = len(scale) + pool.shared_errors
        covariance = np.eye(columns)
        correlation = measurement.correlation
        if correlation is not None:
            covariance[: len(scale), : len(scale)] = correlation[np.ix_(free, free)]
        if estimate is not None:
            identified = estimate.covariance[np.ix_(free, free)]
            covariance[: len(scale), : len(scale)] = identified / np.outer(scale, scale)
        count = len(measurement.machine.parameters)
        poses, components, _ = self.maps.raw.shape
        slopes = np.zeros((components, poses, len(free)))
        slopes[:, :, :count] = self.maps.raw.swapaxes(0, 1) / np.sqrt(poses)
        factors = np.zeros((components, poses, columns))
        factors[:, :, : len(scale)] = slopes[:, :, free] * scale
        return Belief.build(covariance, factors)

    def _advice(
        self,
        measurement: Measurement,
        outlook: Outlook,
        theta: Array,
        count: int,
        skipped: Sequence[SkippedPose],
    ) -> Advice:
        table = self.base.study.design
        planned = None if table is None else table.size
        remaining = 1 if planned is None else max(planned - count, 1)
        within, passing = outlook.within(self.limits)
        limits = outlook.limits(self.limits if self.plan else passing)
        pool, blocks = outlook.pool, outlook.blocks
        use = allowed(pool, outlook.taken, skipped, self.everything)
        places = np.flatnonzero(use)
        plan, more = _plan(outlook.now, blocks[places], remaining, limits)
        chosen = int(places[plan[0]])
        after = outlook.now.after(blocks[chosen])
        series, row = reading_of(pool, outlook.taken + chosen)
        return Advice(
            names=self.maps.names,
            readings=count,
            known=outlook.accuracy(outlook.now),
            after=outlook.accuracy(after),
            limits=self.limits,
            within=within,
            follows_plan=bool(self.plan),
            candidate=chosen,
            series=series,
            row=row,
            expected=measurement.readings([series.take(np.array([row]))], theta),
            more=more,
            planned=planned,
            outlook=outlook,
            skipped=tuple(np.flatnonzero(~use).tolist()),
        )


def _plan(
    belief: Belief, blocks: Array, remaining: int, limits: Array
) -> tuple[list[int], int | None]:
    """Readings to come, the next one first, and how many reach what is wanted.

    Where fewer than the remaining ones can, the plan is one for the fewest.
    """
    if np.isfinite(limits).any():
        fewest = belief.fewest_remaining(blocks, remaining, limits)
        if fewest is not None and fewest[0]:
            return fewest
        remaining = remaining if fewest is None else 1  # all is reached: no more plans
    plan = belief.best_remaining(blocks, remaining, limits)
    return plan, _more(belief, blocks, plan, limits)


def _more(belief: Belief, blocks: Array, plan: list[int], limits: Array) -> int | None:
    """Readings until every wanted accuracy is reached; None where too many are.

    Those of the plan count first, the best of them first, then single best ones.
    """
    if not np.isfinite(limits).any():
        return None
    rest = list(plan)
    for number in range(MOST_AHEAD + 1):
        if not belief.open_components(limits):
            return number
        pool = blocks[rest] if rest else blocks
        best = belief.best_candidate(pool, limits)
        belief = belief.after(pool[best])
        if rest:
            rest.pop(best)
    return None


def _planned_candidates(state: RunState) -> list[int]:
    """The candidates of the study's plan. Raises InputError where it chooses none."""
    chosen = select_design(state.resolved, Stream.DESIGN.rng(state.study.seed))
    if chosen is None:
        raise InputError(
            "the study chooses no plan to compare with",
            "add [design] with a number of readings, or state accuracies",
            field="--wanted",
            value=AS_PLANNED,
        )
    return [int(index) for index in chosen.choice.indices]


def _limits(
    study: Study, state: RunState, names: tuple[str, ...], wanted: str
) -> Array:
    """Wanted rms (K,), SI: of the option, else of the study; NaN where none is.

    Of one component, [prediction] goes before [design.how_many].
    """
    machine = state.resolved.machine
    values = component_values(wanted, "--wanted", machine)
    if not wanted:
        if study.design is not None and study.design.how_many is not None:
            table = study.design.how_many.wanted
            location = study.location.key("design").key("how_many").key("wanted")
            unit_of = {c.name: c.unit for c in machine.components}
            values = quantities.read_values(table, unit_of, location)
        values |= state.resolved.wanted_accuracy
    return np.array([values.get(name, np.nan) for name in names])


def _fit(
    state: RunState,
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    effects: PlannedEffects | None,
) -> Estimate:
    """The fit; all parameters at once where few readings fail to find a start."""
    noise = None
    if effects is not None:
        noise = noise_with_effects(measurement, series, effects)
    most = state.study.identify.max_iterations
    stages = state.resolved.identification_stages
    try:
        return identify(
            measurement, series, y, stages=stages, max_iterations=most, noise=noise
        )
    except IdentificationError:
        if len(stages) == 1:
            raise
        return identify(measurement, series, y, max_iterations=most, noise=noise)


def _objections(
    state: Measured, series: Sequence[Series], estimate: Estimate
) -> tuple[str, ...]:
    """The verdict on the fit of the readings so far."""
    section = estimate_section(state.measurement, series, estimate, None)
    return tuple(trust.section_objections(state.result.goodness, section))


def reading_of(pool: Candidates, index: int) -> tuple[Series, int]:
    """The series of a candidate, and its row there."""
    first = int(pool.members[index, 0])
    for series in pool.series:
        if first < len(series):
            return series, first
        first -= len(series)
    raise IndexError(f"candidate {index} of {len(pool)}")
