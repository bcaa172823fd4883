"""What to plan: options, goal, time and prior knowledge, and the search with them."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import result, units
from oed.base import Array
from oed.planning import Option, PlanningTask, StagePlan
from oed.result import StudyResult
from pkm_studies.base import Location
from pkm_studies.earlier_result import known_parameters
from pkm_studies.quantities import fine_units
from pkm_studies.resolve import PlanRequest, ResolvedStudy
from pkm_studies.stages.forecast import EstimatedParameters
from pkm_studies.tables import PlanTable

ANY_LOSS = 1e6  #: a loss that any plan keeps: its bound is a single line


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class PlanTask(PlanningTask):
    """The planning task of a study; `request` is what its [plan] requests."""

    resolved: ResolvedStudy
    request: PlanRequest

    @property
    def table(self) -> PlanTable:
        """The study's [plan]."""
        return self.request.table

    @property
    def location(self) -> Location:
        """The table [plan], for errors."""
        return self.resolved.study.location.key("plan")

    def accuracy(self, covariance: Array) -> dict[str, float]:
        """Root mean square of each component over the workspace, in its fine unit."""
        goal = self.all_components
        values = (goal.accuracy(covariance) * goal.unit).tolist()
        rms = dict(zip(goal.names, values, strict=True))
        return fine_units(rms, self.resolved.machine)

    def accuracy_after(self, plan: StagePlan) -> dict[str, float]:
        """Accuracy of each component after a plan, in its fine unit."""
        return self.accuracy(self.covariance_after(plan))

    def record(self, plan: StagePlan, why: str = "") -> result.AlternativePlan:
        """A plan in short."""
        return result.AlternativePlan(
            names=list(plan.names),
            readings=[len(stage.chosen) for stage in plan.stages],
            minutes=units.number(plan.seconds, "min"),
            value=plan.value,
            accuracy=self.accuracy_after(plan),
            why=why,
        )


def build_task(
    resolved: ResolvedStudy,
    request: PlanRequest,
    seed: Sequence[int],
    earlier: EarlierSession | None,
) -> PlanTask:
    """The task of a study, after an earlier session where there is one."""
    where = request.prediction
    known = None
    budget = request.budget
    if earlier is not None:
        known = earlier.covariance
        budget -= earlier.seconds
    return PlanTask(
        resolved=resolved,
        request=request,
        measurement=resolved.measurement_with(()),
        command=where.command,
        reference=where.table.reference,
        options=request.options,
        targets=request.targets,
        budget=budget,
        stages=request.table.stages,
        seed=seed,
        effects=request.effects,
        known=known,
    )


# Knowledge from an earlier session: identified machine, covariance, time spent.
@dataclasses.dataclass(frozen=True, kw_only=True)
class EarlierSession:
    """What an earlier session tells a plan."""

    #: the study about the machine as identified, without measurements done
    resolved: ResolvedStudy
    #: (n, n) of the machine's free parameters, in units of their tolerances
    covariance: Array
    seconds: float  #: time that the session took
    words: str  #: the same as a sentence


def read_earlier_session(
    resolved: ResolvedStudy, folder: Path, stored: StudyResult
) -> EarlierSession:
    """What a result in `folder` tells about the machine. Raises InputError."""
    machine = resolved.machine
    measurement = resolved.measurement_with(())
    free = measurement.free_names
    value, covariance, source = known_parameters(stored, machine.name, free, folder)
    identified = dict(zip(free, value, strict=True))
    parameters = [
        dataclasses.replace(p, nominal=float(identified.get(p.name, p.nominal)))
        for p in machine.parameters
    ]
    done = Counter(stored.drawing.reading_of if stored.drawing else [])
    # the time follows the measurement that mounts the set-up, else its instrument
    options = () if resolved.plan is None else resolved.plan.options
    seconds = sum(_option_seconds(option, done) for option in options)
    planned = {name for option in options for name in option.candidates.setups}
    for name in sorted(set(done) - planned):
        if name in resolved.setups:
            mounting = resolved.setups[name].instrument.cost.setup
            reading = resolved.measurement_with([name]).reading_seconds(name)
            seconds += mounting + reading * done[name]
    tolerance = measurement.tolerance[measurement.free]
    phrase = (
        f"Planned after {', '.join(done) or 'no readings'} ({sum(done.values())}"
        f" readings, {units.number(seconds, 'min'):.0f} min), with the machine as"
        f" identified from them ({source})."
    )
    identified_machine = machine.with_parameters(parameters)
    return EarlierSession(
        resolved=resolved.resume_plan(identified_machine, done),
        covariance=covariance / np.outer(tolerance, tolerance),
        seconds=seconds,
        words=phrase,
    )


def stored_knowledge(
    resolved: ResolvedStudy, stored: StudyResult, folder: Path
) -> EstimatedParameters | None:
    """The machine's parameters as identified in a folder, if any. Raises InputError."""
    if stored.final_estimate is None:
        return None
    machine = resolved.machine
    free = resolved.measurement_with(()).free_names
    value, covariance, _ = known_parameters(stored, machine.name, free, folder)
    indices = [machine.index(name) for name in free]
    values = machine.nominal.copy()
    values[indices] = value
    whole = np.zeros((len(values), len(values)))
    whole[np.ix_(indices, indices)] = covariance
    return EstimatedParameters(values, whole)


def _option_seconds(option: Option, done: Mapping[str, int]) -> float:
    """Time (s) of the readings that were taken with an option's set-ups."""
    candidates = option.candidates
    mounted = [name for name in candidates.setups if done.get(name)]
    total = option.mounting_seconds if mounted else 0.0
    for name in mounted:
        rows = np.flatnonzero(candidates.setup == candidates.setups.index(name))
        readings = candidates.members[rows, 1].sum()
        each = option.candidate_seconds[rows].sum() / readings
        total += float(each) * done[name]
    return total
