"""Turns a study into the kernel's objects: machine, set-ups, grids, readings, requests.

All numbers are SI from here on. A *table* is what the user wrote; a *request* is what
it means to the kernel. Every misfit raises InputError, which names file and field.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterable, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Self

from oed.dataset import reading_digests
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.mechanism import Kinematics
from oed.model import Machine
from pkm_studies.resolve import candidates, roles, setups, tolerances
from pkm_studies.resolve.controller import hold_parameters
from pkm_studies.resolve.counted import doubtful_sessions
from pkm_studies.resolve.design import DesignRequest, design_request
from pkm_studies.resolve.gap import GapRequest, gap_request, stated_request
from pkm_studies.resolve.gap_design import GapDesignRequest, gap_design_request
from pkm_studies.resolve.grids import Circles, ReferencePlan
from pkm_studies.resolve.machine import study_kinematics
from pkm_studies.resolve.plan import PlanRequest, plan_request
from pkm_studies.resolve.planned_effects import ALL_EFFECTS, named_effects
from pkm_studies.resolve.prediction import (
    PredictionRequest,
    check_reach,
    check_states,
    prediction_request,
    wanted_accuracy,
)
from pkm_studies.study import Study

if TYPE_CHECKING:
    from oed.dataset import Dataset


@dataclasses.dataclass(frozen=True, kw_only=True)
class ResolvedStudy:
    """A study as the kernel's objects.

    machine                 the model with the study's numbers and tolerances
    setups                  every set-up of the study, by name
    measurement             machine with the set-ups that candidates and readings use;
                            without both, those of the reference plans, or all
    measurement_with        the measurement with the set-ups of these names
    candidates              one series for each [[design.candidates]], within its limits
    refusals                candidates outside the limits, counted by reason
    design, plan            what [design] and [plan] request
    gap, gap_design         what [gap] and [gap.design] request
    reference_plans         the plans that the study gives
    kappa_circles           circles of each [[kappa]] map
    true_parameters         parameters of the virtual machine, SI, by name; those not
                            named are nominal
    dataset                 the recorded readings, if any
    fitted_setups           set-ups whose readings are fitted; None: all others
    held_out_setups         set-ups whose readings are predicted, not fitted
    identification_stages   patterns of the parameters freed in turn
    prediction              what [prediction] requests: where accuracy is predicted
    wanted_accuracy         rms error to reach by component, SI
    warnings                sentences about candidates that were dropped, and readings
    """

    study: Study
    machine: Machine
    setups: Mapping[str, Setup]
    measurement: Measurement
    measurement_with: Callable[[Iterable[str]], Measurement]
    candidates: tuple[Series, ...]
    refusals: Mapping[str, int]
    design: DesignRequest | None
    plan: PlanRequest | None
    reference_plans: tuple[ReferencePlan, ...]
    kappa_circles: tuple[Circles, ...]
    true_parameters: Mapping[str, float]
    dataset: Dataset | None
    fitted_setups: tuple[str, ...] | None
    held_out_setups: tuple[str, ...]
    identification_stages: tuple[tuple[str, ...], ...]
    prediction: PredictionRequest | None
    wanted_accuracy: Mapping[str, float]
    gap: GapRequest | None
    gap_design: GapDesignRequest | None
    warnings: tuple[str, ...]

    @property
    def gap_or_default(self) -> GapRequest:
        """What [gap] requests, or its defaults without the table. Raises InputError."""
        return self.gap or gap_request(self.study, self.machine)

    @property
    def diagnosed(self) -> GapRequest:
        """The same for a diagnosis, with the effects that [identify] names alone, if any.

        Raises InputError for a name that is no effect of the study.
        """
        request, names = self.gap_or_default, self.study.identify.effects
        location = self.study.location.key("identify").key("effects")
        named = named_effects(request, names or ALL_EFFECTS, location)
        return dataclasses.replace(request, effects=tuple(named))

    def with_dataset(self, dataset: Dataset | None) -> Self:
        """The study with these readings. Raises InputError where its prior has them."""
        warnings = self.warnings
        if dataset is not None:
            fitted = self.fitted(dataset)
            check_states(self.study, fitted.covariates)
            new = reading_digests(fitted.series, fitted.y, self.setups)
            warnings = (*warnings, *doubtful_sessions(self.study, new))
        return dataclasses.replace(self, dataset=dataset, warnings=warnings)

    def fitted(self, dataset: Dataset) -> Dataset:
        """The readings that are fitted."""
        fitted, held_out = self.fitted_setups, self.held_out_setups
        names = [name for name in dataset.setups if name not in held_out]
        return dataset.take([n for n in names if fitted is None or n in fitted])


def resolve(study: Study, *, readings: Sequence[Path] | None = None) -> ResolvedStudy:
    """The objects of a study.

    `readings` replaces the files of [readings]; with an empty list, none are read.
    """
    nominal = hold_parameters(study, study_kinematics(study))
    mounted = setups.mounted_setups(study, nominal)
    machine, mounted = tolerances.replace_tolerances(study, nominal.machine, mounted)
    kinematics = nominal.with_priors_of(machine)
    measurement_with = measurement_factory(kinematics, mounted)
    everything = measurement_with(mounted)
    pool, refusals, warnings = candidates.candidates(study, everything)
    references = candidates.references(study, everything)
    design = design_request(study, everything, references, pool)
    circles = [
        candidates.circles(study, table, i, measurement_with, references)
        for i, table in enumerate(study.kappa)
    ]
    fitted, held_out = roles.reading_roles(study, mounted)
    roles.check_stages(study, everything)
    _check_free(study, everything)
    prediction = prediction_request(study, machine)
    if prediction is not None:
        check_reach(study, prediction, kinematics)
    used = roles.used_setups(study, pool, design, references, mounted)
    resolved = ResolvedStudy(
        study=study,
        machine=machine,
        setups=mounted,
        measurement=measurement_with(used),
        measurement_with=measurement_with,
        candidates=pool,
        refusals=refusals,
        design=design,
        plan=plan_request(study, measurement_with, mounted, prediction),
        reference_plans=references,
        kappa_circles=tuple(circles),
        true_parameters=roles.true_parameters(study, everything),
        dataset=None,
        fitted_setups=fitted,
        held_out_setups=held_out,
        identification_stages=tuple(tuple(s) for s in study.identify.stages),
        prediction=prediction,
        wanted_accuracy=wanted_accuracy(study, machine),
        gap=stated_request(study, machine),
        gap_design=gap_design_request(study, references, everything),
        warnings=warnings,
    )
    return resolved.with_dataset(roles.readings_dataset(study, everything, readings))


def _check_free(study: Study, everything: Measurement) -> None:
    """Raises InputError where no parameter of machine and set-ups is free."""
    if not everything.free.any():
        raise (
            study.location.key("machine")
            .key("fixed")
            .error(
                "every parameter is fixed: nothing is left to identify",
                "leave the ones that the readings are to say",
                study.machine.fixed,
            )
        )


def with_readings(resolved: ResolvedStudy) -> ResolvedStudy:
    """A study that was resolved without readings, with those that its file names."""
    everything = resolved.measurement_with(resolved.setups)
    dataset = roles.readings_dataset(resolved.study, everything, None)
    return resolved.with_dataset(dataset)


def measurement_factory(
    kinematics: Kinematics, mounted: Mapping[str, Setup]
) -> Callable[[Iterable[str]], Measurement]:
    """A function that gives the measurement with the set-ups of some names, once each."""
    cache: dict[tuple[str, ...], Measurement] = {}

    def measurement_with(names: Iterable[str]) -> Measurement:
        """The measurement with these set-ups, in the study's order."""
        wanted = set(names)
        key = tuple(name for name in mounted if name in wanted)
        if key not in cache:
            chosen = [mounted[name] for name in key]
            cache[key] = Measurement(kinematics.machine, chosen, kinematics)
        return cache[key]

    return measurement_with
