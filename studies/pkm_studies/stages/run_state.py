"""The immutable states of a run, one type a stage: each step takes one, returns the next.

`RunState` is planned, `Scheduled` has readings, `Measured` their values, `Fitted` an
estimate.
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple, Self, TypeVar

import msgspec
import numpy as np

from oed import noise_law
from oed.base import Array, Mask
from oed.measurement import Measurement, Series
from oed.result import EstimateSection, GoodnessSection, StudyResult
from pkm_studies import describe
from pkm_studies.base import Progress, Stream
from pkm_studies.resolve import ResolvedStudy, resolve
from pkm_studies.study import Study

if TYPE_CHECKING:
    import pandas as pd

    from oed.checks import CheckedSession
    from oed.corrected import AnswerMixture, CorrectedEstimate
    from oed.estimation import Estimate, IdentificationError
    from oed.gap import Diagnosis
    from oed.identifiability import Assessment
    from oed.posterior import Checkpoint, Posterior
    from pkm_studies.stages.design.select import ChosenDesign
    from pkm_studies.stages.plan.plan import PlanOutcome


class HeldOut(NamedTuple):
    """Readings y (N,), SI, that are not fitted; covariates have one row a reading."""

    series: tuple[Series, ...]
    y: Array
    covariates: pd.DataFrame


@dataclasses.dataclass(frozen=True, kw_only=True)
class Readings:
    """Readings that a run works on; these are only planned."""

    series: tuple[Series, ...]  #: their poses
    covariates: pd.DataFrame | None = None  #: one row a reading, if known


@dataclasses.dataclass(frozen=True, kw_only=True)
class MeasuredReadings(Readings):
    """Readings with their values."""

    y: Array  #: (N,) values, SI
    #: (n,) parameters of the virtual machine that gave them, SI
    truth: Array | None = None
    #: effects that act on it, as its truth file has them
    effects: Sequence[Mapping[str, Any]] = ()
    held_out: HeldOut | None = None  #: readings that are predicted, not fitted


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunState:
    """A run before its readings are known: what was asked for, and what is planned.

    study, seed, progress, started    what was asked for, and when
    """

    study: Study
    seed: int
    progress: Progress
    started: float
    resolved: ResolvedStudy  #: the study's objects
    readings_given: bool  #: whether readings came with the command
    measurement: Measurement  #: machine with the set-ups that are used, as planned
    result: StudyResult  #: the result so far: sections that the steps have written
    design: ChosenDesign | None = None  #: the chosen design
    plan: PlanOutcome | None = None  #: the plan of stages
    gap_poses: str | None = None  #: readings of the runs of [gap.design], as CSV
    visit_poses: str | None = None  #: readings of a second visit, as CSV
    #: nodes to measure, and the table of measured ones, as CSV by name
    forecast_files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    #: text of the readings files that are diagnosed, by name
    session_files: Mapping[str, str] = dataclasses.field(default_factory=dict)
    #: readings to write down as poses, in working order
    planned: tuple[Series, ...] = ()
    #: names of effects to estimate together with the parameters
    with_effects: tuple[str, ...] = ()
    #: where an unfinished chain of draws is saved, if anywhere
    checkpoint: Checkpoint | None = None
    warnings: tuple[str, ...] = ()  #: sentences that a user must know
    #: why steps left out sections of the result, by the section's name
    withheld: Mapping[str, str] = dataclasses.field(default_factory=dict)

    def rng(self, stream: Stream) -> np.random.Generator:
        """Random numbers of one stream."""
        return stream.rng(self.seed)

    def replace(self, **changes: Any) -> Self:
        """The state with other values of some fields."""
        return dataclasses.replace(self, **changes)

    def add_sections(self, **sections: Any) -> Self:
        """The state with further sections of the result."""
        return self.replace(result=msgspec.structs.replace(self.result, **sections))

    def add_warnings(self, *warnings: str) -> Self:
        """The state with further warnings."""
        return self.replace(warnings=(*self.warnings, *warnings))

    def withhold_section(self, name: str, reason: str) -> Self:
        """The state after a step that leaves out a section of the result, for a reason."""
        return self.replace(withheld={**self.withheld, name: reason})

    @staticmethod
    def start(
        study: Study,
        seed: int | None,
        progress: Progress,
        readings: Sequence[Path] | None,
    ) -> RunState:
        """The state before the first step, with given readings. Raises InputError."""
        started = time.perf_counter()
        progress.stage("set-up")
        resolved = resolve(study, readings=readings)
        state = state_of(resolved, study.seed if seed is None else seed, progress)
        return state.replace(started=started, readings_given=bool(readings))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Scheduled(RunState):
    """A run whose readings are known, planned or taken."""

    readings: Readings  #: what is fitted, held out or only planned
    #: verdict on them, where it was asked for
    identifiability: Assessment | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Measured(Scheduled):
    """A run whose readings have values."""

    readings: MeasuredReadings
    checked: CheckedSession | None = None  #: what a check of recorded readings says

    @property
    def fit_is_bad(self) -> bool:
        """Whether nothing fitted to the readings can be trusted."""
        return self.checked is not None and self.checked.bad_fit

    def explained(self, error: IdentificationError) -> IdentificationError:
        """An error of the fit, opened by what the check of the readings found."""
        if self.checked is None or not self.checked.findings:
            return error
        return type(error)(f"{self.checked.findings[0].sentence} {error}")

    @property
    def noise_is_a_guess(self) -> bool:
        """Whether the stated noise is one that the readings correct."""
        count = len(self.readings.y)
        return self.resolved.noise_is_a_guess(self.measurement, count)

    @property
    def goodness(self) -> GoodnessSection:
        """How well the readings are fitted, in the result."""
        return written(self.result.goodness, "goodness")

    @property
    def doubtful_values(self) -> Mask | None:
        """Mask (N,) of fitted values that may be gross errors; None without a check."""
        return None if self.checked is None else self.checked.doubtful_values

    @property
    def estimates_noise(self) -> bool:
        """Whether the noise law is estimated from the readings.

        As [noise] says; by default for recorded readings that leave at least
        `MIN_FREEDOM` degrees of freedom, or `MIN_FREEDOM_OF_SCALE` where an assumed noise
        leaves but its scale to estimate. The noise of a virtual machine is known.
        """
        stated = self.study.noise.estimate
        if stated is not None or self.resolved.dataset is None:
            return bool(stated)
        determined = int(self.measurement.free.sum())
        if self.identifiability is not None:
            determined = self.identifiability.identifiability.rank
        freedom = len(self.readings.y) - determined
        assumed = self.study.noise.assumed
        if assumed:
            return freedom >= self.resolved.MIN_FREEDOM_OF_SCALE
        return freedom >= noise_law.MIN_FREEDOM


@dataclasses.dataclass(frozen=True, kw_only=True)
class Fitted(Measured):
    """A run whose readings are fitted."""

    estimate: Estimate  #: identified parameters
    #: draws about the estimate, where the study asks for them
    posterior: Posterior | None = None
    #: parameters and effects, estimated together
    corrected: CorrectedEstimate | None = None
    diagnosis: Diagnosis | None = None  #: of what the fit leaves, where there is one
    #: what is known of the machine over all hypotheses of the diagnosis
    mixture: AnswerMixture | None = None

    @property
    def fit(self) -> tuple[Measurement, tuple[Series, ...], Array, Estimate]:
        """What is fitted, its poses and values, and the estimate."""
        return self.measurement, self.readings.series, self.readings.y, self.estimate

    @property
    def estimate_section(self) -> EstimateSection:
        """The estimate in the result."""
        return written(self.result.estimate, "estimate")


T = TypeVar("T")
StateT = TypeVar("StateT", bound=RunState)
ScheduledT = TypeVar("ScheduledT", bound=Scheduled)


class WithheldError(LookupError):
    """A section of the result that a step left out, and why."""


def written(
    section: T | None, name: str, withheld: Mapping[str, str] | None = None
) -> T:
    """A section of the result. Raises WithheldError with the reason in `withheld`."""
    if section is None:
        reason = (withheld or {}).get(name, "its step has not run")
        raise WithheldError(f"the result has no section {name}: {reason}")
    return section


def promote(stage: type[StateT], state: RunState, **values: Any) -> StateT:
    """The state at a later stage: with the values that this stage adds or replaces."""
    fields = {f.name: getattr(state, f.name) for f in dataclasses.fields(state)}
    return stage(**{**fields, **values})


def state_of(resolved: ResolvedStudy, seed: int, progress: Progress) -> RunState:
    """The state of a resolved study before the first step."""
    study = resolved.study
    return RunState(
        study=study,
        seed=seed,
        progress=progress,
        started=time.perf_counter(),
        resolved=resolved,
        readings_given=False,
        measurement=resolved.measurement,
        result=describe.first_result(study, resolved.machine, seed),
        warnings=tuple(resolved.warnings),
    )
