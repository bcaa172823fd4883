"""The immutable state of a run: each step takes one and returns the next."""

from __future__ import annotations

import dataclasses
import enum
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np

from oed.base.arrays import Array, Mask
from oed.checks import CheckedSession
from oed.estimation.identification import Estimate
from oed.identifiability.assessment import Assessment
from oed.measurement.measurement import Measurement, Series
from oed.noise.prior import LEAST_FREEDOM
from oed.posterior.checkpoint import Checkpoint
from oed.posterior.posterior import Posterior
from pkm_studies.base.progress import Progress
from pkm_studies.resolve.noise import LEAST_OF_SCALE, noise_is_a_guess
from pkm_studies.resolve.resolved import ResolvedStudy, resolve
from pkm_studies.stages.design.select import ChosenDesign
from pkm_studies.stages.plan.section import PlanOutcome
from pkm_studies.study import Study

if TYPE_CHECKING:
    import pandas as pd

    from oed.compensate.effects import CorrectedEstimate


class Stream(enum.IntEnum):
    """Independent random streams: more draws in one leave the others as they are."""

    DESIGN = 0
    TRUTH = 1
    NOISE = 2
    SAMPLER = 3
    PREDICT = 4
    MACHINES = 5
    HELD_OUT = 6
    PLAN = 7
    CAMPAIGN = 8
    EFFECTS = 9
    GAP = 10
    BEFORE = 11
    CHECKS = 12
    CORRECTED = 13
    ACCEPTANCE = 14
    HISTORY = 15
    PREDICTIVE = 16
    UNMODELLED = 17
    REFERENCES = 18
    TOOLS = 19
    LAPLACE = 20


class HeldOut(NamedTuple):
    """Readings y (N,), SI, that are not fitted."""

    series: tuple[Series, ...]
    y: Array


@dataclasses.dataclass(frozen=True, kw_only=True)
class Readings:
    """Readings that a run works on.

    series      planned or recorded readings
    y           (N,) values, SI; None where the readings are only planned
    truth       (n,) parameters of the virtual machine that gave them, SI
    covariates  one row a reading, if known
    held_out    readings that are predicted, not fitted
    """

    series: tuple[Series, ...]
    y: Array | None = None
    truth: Array | None = None
    covariates: pd.DataFrame | None = None
    held_out: HeldOut | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class RunState:
    """What a run knows after some of its steps.

    study, seed, progress, started    what was asked for, and when
    resolved         the study's objects
    readings_given   whether readings came with the command
    measurement      machine with the set-ups that are used, as planned
    design           the chosen design
    plan             the plan of stages
    gap_poses        readings of the runs of [gap.design], as CSV
    planned          readings to write down as poses, in working order
    readings         what is fitted, held out or only planned
    checked          what a check of recorded readings says
    identifiability  verdict on the readings
    estimate         identified parameters
    with_effects     names of effects to estimate together with the parameters
    corrected        parameters and effects, estimated together
    checkpoint       where an unfinished chain of draws is saved, if anywhere
    posterior        draws about the estimate
    sections         sections of the result so far
    warnings         sentences that a user must know
    """

    study: Study
    seed: int
    progress: Progress
    started: float
    resolved: ResolvedStudy
    readings_given: bool
    measurement: Measurement
    design: ChosenDesign | None = None
    plan: PlanOutcome | None = None
    gap_poses: str | None = None
    planned: tuple[Series, ...] = ()
    readings: Readings | None = None
    checked: CheckedSession | None = None
    identifiability: Assessment | None = None
    estimate: Estimate | None = None
    with_effects: tuple[str, ...] = ()
    corrected: CorrectedEstimate | None = None
    checkpoint: Checkpoint | None = None
    posterior: Posterior | None = None
    sections: Mapping[str, Any] = dataclasses.field(default_factory=dict)
    warnings: tuple[str, ...] = ()

    @property
    def fit_is_bad(self) -> bool:
        """Whether nothing fitted to the readings can be trusted."""
        return self.checked is not None and self.checked.bad_fit

    @property
    def noise_is_a_guess(self) -> bool:
        """Whether the stated noise is one that the readings correct."""
        readings = self.readings
        count = 0 if readings is None or readings.y is None else len(readings.y)
        return noise_is_a_guess(self.study, self.measurement, count)

    @property
    def doubtful_values(self) -> Mask | None:
        """Mask (N,) of fitted values that may be gross errors; None without a check."""
        return None if self.checked is None else self.checked.doubtful_values

    @property
    def estimates_noise(self) -> bool:
        """Whether the noise law is estimated from the readings.

        As [noise] says; by default for recorded readings that leave at least
        `LEAST_FREEDOM` degrees of freedom, or `LEAST_OF_SCALE` where an assumed noise
        leaves but its scale to estimate. The noise of a virtual machine is known.
        """
        stated = self.study.noise.estimate
        if stated is not None or self.resolved.dataset is None:
            return bool(stated)
        if self.readings is None or self.readings.y is None:
            return False
        determined = int(self.measurement.free.sum())
        if self.identifiability is not None:
            determined = self.identifiability.identifiability.rank
        freedom = len(self.readings.y) - determined
        assumed = self.study.noise.assumed
        return freedom >= (LEAST_OF_SCALE if assumed else LEAST_FREEDOM)

    def rng(self, stream: Stream) -> np.random.Generator:
        """Random numbers of one stream."""
        return np.random.default_rng([self.seed, int(stream)])

    def replace(self, **changes: Any) -> RunState:
        """The state with other values of some fields."""
        return dataclasses.replace(self, **changes)

    def with_sections(self, **sections: Any) -> RunState:
        """The state with further sections of the result."""
        return self.replace(sections={**self.sections, **sections})

    def with_warnings(self, *warnings: str) -> RunState:
        """The state with further warnings."""
        return self.replace(warnings=(*self.warnings, *warnings))


def start(
    study: Study,
    seed: int | None,
    progress: Progress,
    readings: Sequence[Path] | None,
) -> RunState:
    """The state before the first step. Raises InputError for what the study misstates.

    `readings` replace those that the study names; with an empty list, none are read.
    """
    started = time.perf_counter()
    progress.stage("set-up")
    resolved = resolve(study, readings=readings)
    return RunState(
        study=study,
        seed=study.seed if seed is None else seed,
        progress=progress,
        started=started,
        resolved=resolved,
        readings_given=bool(readings),
        measurement=resolved.measurement,
        warnings=tuple(resolved.warnings),
    )
