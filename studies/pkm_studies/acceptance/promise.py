"""What a result promises of the compensated machine, for an acceptance test."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path

import numpy as np

from oed import units
from oed.acceptance import Promise, smooth_functions
from oed.accuracy import ErrorMaps, Reference, driven_errors
from oed.base import Array
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Component, Machine
from oed.result import StudyResult
from pkm_studies.compensation import identified_parameters
from pkm_studies.earlier_result import si_estimates
from pkm_studies.resolve import StudyWorkspace, study_kinematics
from pkm_studies.results import Estimated, estimated_section
from pkm_studies.study import Study

#: standard uncertainty of the acceptance measurement, as a share of the promise, where
#: none is given and no set-up of the study reads the component
UNCERTAINTY_SHARE = 0.2
#: poses between those of the workspace that may be measured, at most
MAX_POSES_BETWEEN = 200
READ = "read_{}"  #: channel that reads a component of the pose


@dataclasses.dataclass(frozen=True)
class FurtherPromise:
    """What additional axes promise of k components that no drive corrects, SI."""

    promise: Promise  #: with the axes
    components: tuple[Component, ...]  #: (k,)
    #: (m, k) errors without the axes that are known in advance, at the commands
    known: Array

    @property
    def without(self) -> Array:
        """Rms errors (k,) without the axes."""
        remaining = self.known[: self.promise.workspace]
        return np.hypot(np.sqrt(np.mean(remaining**2, axis=0)), self.promise.rms)


@dataclasses.dataclass(frozen=True)
class PromisedAccuracy:
    """A promise over commands (m, n_dof), SI, and what it rests on."""

    machine: Machine
    command: Array
    promise: Promise
    components: tuple[Component, ...]
    reference: Reference
    conditions: tuple[str, ...]
    #: what holds with additional axes, where the machine could use some
    further: FurtherPromise | None = None

    @classmethod
    def from_result(
        cls,
        result: StudyResult,
        study: Study,
        folder: Path,
        promised: Mapping[str, float],
        uncertainty: Mapping[str, float],
    ) -> PromisedAccuracy:
        """The promise of a result for the components that the controller corrects.

        folder       of the result, for errors
        promised     rms errors by component, SI, in place of the predicted ones
        uncertainty  of one measured error by component, SI

        Raises InputError where the result has no estimate with its covariance.
        """
        section = estimated_section(result, folder)
        kinematics = study_kinematics(study)
        machine = kinematics.machine
        used = StudyWorkspace(study, kinematics)
        workspace, reference = used.regular, used.reference
        command = _poses(used)
        maps = ErrorMaps.of(kinematics, command, reference)
        covariance, tolerance = covariances(machine, section)
        raw = maps.raw
        variance = np.einsum("mkp,pq,mkq->k", raw, covariance, raw, optimize=True)
        varying = np.flatnonzero(variance > 0.0).tolist()
        driven = [k for k in varying if machine.components[k].compensatable]
        uncertainty_by_name = _instrument_uncertainty(result, machine, reference)
        uncertainty_by_name |= uncertainty
        zeroed = reference == "home"
        smooth = smooth_functions(command, machine.home_command if zeroed else None)

        def promise(chosen: list[int]) -> Promise:
            """The promise for some components."""
            names = tuple(machine.components[k].name for k in chosen)
            slope = raw[:, chosen]
            rms = promised_rms(
                result, machine, slope[: len(workspace)], chosen, covariance
            )
            pairs = zip(names, rms, strict=True)
            rms = np.array([promised.get(n, r) for n, r in pairs])
            shares = zip(names, UNCERTAINTY_SHARE * rms, strict=True)
            sds = [uncertainty_by_name.get(name, share) for name, share in shares]
            return Promise(
                names,
                slope,
                [covariance, tolerance],
                rms,
                np.array(sds),
                zeroed=zeroed,
                smooth=smooth,
                workspace=len(workspace),
            )

        others = [k for k in varying if k not in driven]
        components = tuple(machine.components[k] for k in driven)
        every = [machine.components[k].name for k in varying]
        assumed = [name for name in every if name not in uncertainty_by_name]
        return cls(
            machine=machine,
            command=command,
            promise=promise(driven),
            components=components,
            reference=reference,
            conditions=(*_conditions(result), *_assumed_uncertainty(assumed)),
            further=_further(result, kinematics, maps, reference, others, promise),
        )


def _poses(used: StudyWorkspace) -> Array:
    """Commands (n, n_dof) of the workspace, and between them but for a best fit."""
    if used.reference == "best_fit":
        return used.regular
    return np.vstack([used.regular, used.intermediate_commands(MAX_POSES_BETWEEN)])


def _conditions(result: StudyResult) -> tuple[str, ...]:
    if result.corrected is None:
        if result.judged_prediction is None or not result.judged_prediction.states:
            return ()
        parts = [
            f"{column} {' and '.join(f'{value:g}' for value in values)}"
            for column, values in result.judged_prediction.states.items()
        ]
        return (f"the machine is measured over the states in use: {', '.join(parts)}",)
    return (*result.corrected.conditions, *without_effects(result))


def _instrument_uncertainty(
    result: StudyResult, machine: Machine, reference: Reference
) -> dict[str, float]:
    """Standard uncertainty, SI, of an error that a set-up reads; doubled variance at home."""
    readings = 1.0 if reference == "absolute" else math.sqrt(2.0)
    component_of = {READ.format(c.name): c.name for c in machine.components}
    sizes: dict[str, float] = {}
    for setup in result.setups:
        for column, sigma in setup.sigma.items():
            stem, unit = units.split(column)
            if stem in component_of:
                name = component_of[stem]
                size = readings * float(units.to_si(sigma, unit))
                sizes[name] = min(size, sizes.get(name, size))
    return sizes


def _assumed_uncertainty(names: Sequence[str]) -> tuple[str, ...]:
    """What is assumed of components that no set-up reads by itself."""
    if not names:
        return ()
    share = f"{100.0 * UNCERTAINTY_SHARE:.0f} %"
    return (
        f"no set-up of the study reads {', '.join(names)} by itself: a measured error of"
        f" it is taken to be uncertain by {share} of the promise, unless --uncertainty"
        " states it",
    )


def without_effects(result: StudyResult) -> tuple[str, ...]:
    """What to promise of a controller that corrects no effect."""
    mixture = result.controller_mixture
    if mixture is None or mixture.prediction is None:
        return ()
    driven = {
        name: component.after
        for name, component in mixture.prediction.components.items()
        if component.compensatable
    }
    rms = ", ".join(f"{name} {s.rms:.3g} {s.unit}" for name, s in driven.items())
    option = ",".join(f"{name}_{s.unit}={s.rms:.3g}" for name, s in driven.items())
    return (
        f"a controller that corrects the geometry alone is predicted to reach {rms} rms,"
        f" over all hypotheses of the diagnosis: promise that by `--promise {option}`",
    )


def _further(
    result: StudyResult,
    kinematics: Kinematics,
    maps: ErrorMaps,
    reference: Reference,
    chosen: list[int],
    promise: Callable[[list[int]], Promise],
) -> FurtherPromise | None:
    """The promise for components that no drive corrects; None where there are none."""
    machine = kinematics.machine
    parameters = identified_parameters(result, machine, tables=True)
    if not chosen or parameters is None:
        return None
    try:
        values = parameters.values
        correctable = driven_errors(
            kinematics, maps.command, values, reference, believed=values
        )
    except AssemblyError:
        return None
    components = tuple(machine.components[k] for k in chosen)
    return FurtherPromise(promise(chosen), components, correctable[:, chosen])


def covariances(machine: Machine, section: Estimated) -> tuple[Array, Array]:
    """Covariance (np, np) of the identified parameters, and of the tolerances, SI."""
    size = len(machine.parameters)
    covariance, tolerance = np.zeros((size, size)), np.zeros((size, size))
    of_machine = {p.name for p in machine.parameters}
    names = [name for name in section.parameters if name in of_machine]
    indices = [machine.index(name) for name in names]
    covariance[np.ix_(indices, indices)] = si_estimates(section, names)[1]
    rows = [section.parameters[name] for name in names]
    prior = np.array([row.prior_sd * units.factor(row.unit) for row in rows])
    tolerance[indices, indices] = prior**2
    return covariance, tolerance


def promised_rms(
    result: StudyResult,
    machine: Machine,
    slope: Array,
    chosen: list[int],
    covariance: Array,
) -> Array:
    """Predicted rms (k,), SI: as it is judged, over all hypotheses where there are any.

    Of what no drive corrects, the part that stays unknown. A prediction made before the
    measurement promises nothing of this machine.
    """
    prediction = result.judged_prediction
    if prediction is not None and prediction.mode != "plan":
        spreads = [
            prediction.components[machine.components[k].name].judged for k in chosen
        ]
        return np.array([s.rms * units.factor(s.unit) for s in spreads])
    variance = np.einsum("mkp,pq,mkq->mk", slope, covariance, slope, optimize=True)
    return np.asarray(np.sqrt(variance.mean(axis=0)))
