"""Knowledge from an earlier session: identified machine, covariance, time spent."""

from __future__ import annotations

import dataclasses
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from oed.model import Machine
from oed.planning import Option
from oed.result import StudyResult
from pkm_studies.earlier_result import known_parameters
from pkm_studies.resolve import (
    PlanRequest,
    ResolvedStudy,
    measurement_factory,
    request_of_table,
)
from pkm_studies.stages.forecast.task import EstimatedParameters


@dataclasses.dataclass(frozen=True, kw_only=True)
class EarlierSession:
    """What an earlier session tells a plan.

    resolved    the study about the machine as identified, without measurements done
    plan        what [plan] then requests
    covariance  (n, n) of the machine's free parameters, in units of their tolerances
    seconds     time that the session took
    words       the same as a sentence
    """

    resolved: ResolvedStudy
    plan: PlanRequest
    covariance: Array
    seconds: float
    words: str


def read_earlier_session(
    resolved: ResolvedStudy, request: PlanRequest, folder: Path, stored: StudyResult
) -> EarlierSession:
    """What the result `stored` in `folder` tells about the study's machine.

    Raises InputError where the result does not fit the study.
    """
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
    seconds = _session_seconds(resolved, request.options, done)
    tolerance = measurement.tolerance[measurement.free]
    phrase = (
        f"Planned after {', '.join(done) or 'no readings'} ({sum(done.values())}"
        f" readings, {units.number(seconds, 'min'):.0f} min), with the machine as"
        f" identified from them ({source})."
    )
    others = machine.with_parameters(parameters)
    resolved, plan = _drop_done(resolved, request, others, done)
    return EarlierSession(
        resolved=resolved,
        plan=plan,
        covariance=covariance / np.outer(tolerance, tolerance),
        seconds=seconds,
        words=phrase,
    )


def stored_knowledge(
    resolved: ResolvedStudy, stored: StudyResult, folder: Path
) -> EstimatedParameters | None:
    """The machine's parameters as identified in a folder; None where none were.

    Raises InputError where the result is about another machine.
    """
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


def _drop_done(
    resolved: ResolvedStudy,
    request: PlanRequest,
    machine: Machine,
    done: Mapping[str, int],
) -> tuple[ResolvedStudy, PlanRequest]:
    """The study about another machine, without the measurements that are done."""
    measurement_with = measurement_factory(
        Kinematics(machine).with_controller(resolved.measurement.kinematics.controller),
        resolved.setups,
    )
    plan = request_of_table(
        request.table,
        resolved.study,
        measurement_with,
        resolved.setups,
        request.prediction,
        done,
    )
    changed = dataclasses.replace(
        resolved,
        machine=machine,
        measurement_with=measurement_with,
        measurement=measurement_with(resolved.measurement.setups),
        plan=plan,
    )
    return changed, plan


def _session_seconds(
    resolved: ResolvedStudy, options: Sequence[Option], done: Mapping[str, int]
) -> float:
    """Time (s) that the readings {set-up: number} took.

    It follows the measurement that mounts the set-up, else the set-up's instrument.
    """
    total = 0.0
    for option in options:
        total += _option_seconds(option, done)
    planned = {name for option in options for name in option.candidates.setups}
    for name in sorted(set(done) - planned):
        if name in resolved.setups:
            mounting = resolved.setups[name].instrument.cost.setup
            reading = resolved.measurement_with([name]).reading_seconds(name)
            total += mounting + reading * done[name]
    return total


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
