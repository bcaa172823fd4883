"""What is known of the parameters when accuracy is predicted: from a plan or from a fit."""

from __future__ import annotations

import copy
import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.accuracy import (
    BudgetModel,
    ErrorMaps,
    Prediction,
    Reference,
    driven_errors,
    predict,
    variance_over_machines,
)
from oed.base import Array
from oed.effects import ExpectedColumns, SessionStates, absorbing_shift
from oed.estimation import Estimate
from oed.identifiability import parameter_covariance
from oed.measurement import Measurement, Series
from oed.mechanism import NO_TOOL, AssemblyError
from oed.noise import LawNoise
from oed.posterior import ApproximateDraws


@dataclasses.dataclass(frozen=True, eq=False)
class ParameterKnowledge:
    """Knowledge of the machine's np parameters, SI.

    measurement, series  what is read
    """

    measurement: Measurement
    series: tuple[Series, ...]
    model: BudgetModel  #: of the readings, for the budget
    covariance: Array  #: (np, np) of the parameters after identification
    mean: Array | None = None  #: (np,) identified errors; None before any reading
    #: (m, np) draws of the posterior, or of its approximation, about the estimate; None
    #: before any reading
    draws: Array | None = None
    #: number of independent draws that these are worth; None: all
    worth: float | None = None
    #: (np, np) of the estimate, where it holds more than the model
    estimated: Array | None = None
    #: what acts beside the parameters; None where nothing is allowed to
    effects: ActingEffects | None = None
    #: (np,) parameters of the controller, SI; the identified ones by default
    sent: Array | None = None
    #: (k,) coefficients of the effects that the controller corrects beside them; none
    #: by default
    corrected: Array | None = None

    @property
    def centre(self) -> Array:
        """Errors (np,) that are expected: identified ones, else those of the prior."""
        measurement = self.measurement
        expected = (measurement.nominal - measurement.drawn)[: len(self.covariance)]
        return expected if self.mean is None else self.mean

    def controller_errors(
        self, command: Array, reference: Reference, tool: Array
    ) -> Array | None:
        """Exact errors (n, k) under the controller as it is, SI; None: a nominal one."""
        kinematics = self.measurement.kinematics
        if kinematics.controller is None:
            return None
        expected = kinematics.machine.nominal + self.centre
        return driven_errors(kinematics, command, expected, reference, tool=tool)


@dataclasses.dataclass(frozen=True, eq=False)
class ActingEffects:
    """Effects that act on the machine beside its parameters."""

    columns: ExpectedColumns  #: what they do per unit of each coefficient
    session: SessionStates  #: the states in which they acted
    theta: Array  #: (n,) parameters about which their maps hold, SI
    draws: Array  #: (m, k) of the coefficients, one for each draw of the parameters
    #: maps that several predictions share; drawn anew by default
    known: ErrorMaps | None = None

    def maps(
        self,
        command: Array,
        reference: Reference,
        rng: np.random.Generator,
        tool: Array = NO_TOOL,
    ) -> ErrorMaps:
        """Pose errors per unit of each coefficient at commands (n, n_dof) of a tool."""
        if self.known is not None:
            return self.known
        return self.columns.workspace_maps(
            self.session, self.theta, command, reference, rng, tool
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Accuracy:
    """A prediction, and the maps that it rests on."""

    prediction: Prediction
    maps: ErrorMaps

    @property
    def variance(self) -> Array:
        """Its mean variances (k,), SI."""
        spreads = self.prediction.fully_corrected
        return np.array([spreads[name].rms ** 2 for name in self.prediction.names])


def planned(measurement: Measurement, series: Sequence[Series]) -> ParameterKnowledge:
    """Before any reading: tolerances and planned readings."""
    count = len(measurement.machine.parameters)
    nominal = measurement.nominal
    covariance = parameter_covariance(measurement, series, nominal)
    return ParameterKnowledge(
        measurement,
        tuple(series),
        BudgetModel.of(measurement, series, nominal),
        covariance[:count, :count],
    )


def identified(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: Estimate,
    approximate_draws: ApproximateDraws,
) -> ParameterKnowledge:
    """After a fit: the estimate, and draws of what is known of the parameters."""
    count = len(measurement.machine.parameters)
    noise = estimate.noise
    laws = noise.law if isinstance(noise, LawNoise) else None
    estimated = estimate.covariance[:count, :count]
    draws = approximate_draws.theta[:, :count] - estimate.theta[:count]
    return ParameterKnowledge(
        measurement,
        tuple(series),
        BudgetModel.of(measurement, series, estimate.theta, laws=laws),
        draws.T @ draws / len(draws),
        mean=(estimate.theta - measurement.drawn)[:count],
        draws=draws,
        worth=approximate_draws.worth,
        estimated=estimated,
    )


def accuracy(
    knowledge: ParameterKnowledge,
    command: Array,
    references: Sequence[Reference],
    rng: np.random.Generator,
    tool: Array = NO_TOOL,
) -> dict[Reference, Accuracy]:
    """Accuracy at commands (n, n_dof) against each reference.

    Before any reading the variance is the mean over machines as they may be built.
    """
    measurement = knowledge.measurement
    variances: dict[Reference, Array] = {}
    if knowledge.mean is None:
        variances = variance_over_machines(
            measurement, knowledge.series, command, references, rng, tool
        )
    count = len(measurement.machine.parameters)
    result = {}
    for reference in references:
        maps = ErrorMaps.of(measurement.kinematics, command, reference, tool)
        remaining = _remaining(knowledge, command, reference, tool)
        before = knowledge.controller_errors(command, reference, tool)
        judged, mean, draws = maps, knowledge.mean, knowledge.draws
        prior = measurement.prior_covariance[:count, :count]
        covariance, effects = knowledge.covariance, knowledge.effects
        if effects is not None and mean is not None and draws is not None:
            # effects act beside the parameters, and stay as they are
            acting = effects.maps(command, reference, rng, tool)
            of_effects = effects.draws.mean(axis=0)
            judged = _joined_maps(maps, acting)
            if remaining is None:
                remaining = _remaining_to_first_order(knowledge, mean, maps)
            remaining = remaining + acting.raw @ of_effects
            if knowledge.corrected is not None:  # as far as drives can
                by_drives = acting.raw - acting.remaining
                remaining = remaining - by_drives @ knowledge.corrected
            if before is not None:
                before = before + acting.raw @ of_effects
            mean = np.concatenate([mean, of_effects])
            draws = np.hstack([draws, effects.draws - of_effects])
            prior = covariance = draws.T @ draws / len(draws)
        predicted = predict(
            judged,
            prior,
            covariance,
            rng,
            mean=mean,
            centre=knowledge.centre,
            known=remaining,
            before=before,
            draws=draws,
            worth=knowledge.worth,
            reference=reference,
            variance=variances.get(reference),
        )
        result[reference] = Accuracy(predicted, maps)
    return result


def _joined_maps(maps: ErrorMaps, acting: ErrorMaps) -> ErrorMaps:
    """Maps of parameters and effects; compensation of the first leaves the others."""
    return dataclasses.replace(
        maps,
        raw=np.concatenate([maps.raw, acting.raw], axis=2),
        remaining=np.concatenate([maps.remaining, acting.raw], axis=2),
    )


def _remaining_to_first_order(
    knowledge: ParameterKnowledge, mean: Array, maps: ErrorMaps
) -> Array:
    """Errors (n, k) that compensation of the parameters leaves if the estimate is right."""
    remaining = maps.remaining @ mean
    if knowledge.sent is None:
        return np.asarray(remaining)
    shift = knowledge.sent - knowledge.measurement.machine.nominal - mean
    return np.asarray(remaining - (maps.raw - maps.remaining) @ shift)


def compared(
    candidates: Mapping[str, ParameterKnowledge],
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
) -> dict[str, Accuracy]:
    """Accuracy of each candidate at commands (n, n_dof), all by the same draws.

    The candidates differ in what is sent and corrected, and not in what acts.
    """
    rng, effects = copy.deepcopy(rng), next(iter(candidates.values())).effects
    if effects is not None:
        effect_maps = effects.maps(command, reference, rng)
        effects = dataclasses.replace(effects, known=effect_maps)
    result = {}
    for name, candidate in candidates.items():
        candidate = dataclasses.replace(candidate, effects=effects)
        drawn = accuracy(candidate, command, [reference], copy.deepcopy(rng))
        result[name] = drawn[reference]
    return result


def absorb_effects(
    knowledge: ParameterKnowledge,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
) -> ParameterKnowledge:
    """With the controller's parameters that take up what is known of the effects.

    At commands (n, n_dof) of the workspace, against a reference. The same knowledge
    where there are no effects.
    """
    effects, mean = knowledge.effects, knowledge.mean
    if effects is None or mean is None:
        return knowledge
    machine = knowledge.measurement.machine
    maps = ErrorMaps.of(knowledge.measurement.kinematics, command, reference)
    acting = effects.maps(command, reference, rng)
    error = acting.raw @ effects.draws.mean(axis=0)
    tolerance = knowledge.measurement.tolerance[: len(machine.parameters)]
    shift = absorbing_shift(maps, error, tolerance)
    return dataclasses.replace(knowledge, sent=machine.nominal + mean + shift)


def _remaining(
    knowledge: ParameterKnowledge, command: Array, reference: Reference, tool: Array
) -> Array | None:
    """Exact errors (n, k) that compensation leaves if the estimate is right.

    None where they are taken to first order: before any reading, for another reference,
    and where an estimate is so far off that the machine cannot reach a pose.
    """
    if knowledge.mean is None or reference != "home":
        return None
    kinematics = knowledge.measurement.kinematics
    identified = kinematics.machine.nominal + knowledge.mean
    sent = identified if knowledge.sent is None else knowledge.sent
    try:
        return driven_errors(
            kinematics, command, identified, reference, believed=sent, tool=tool
        )
    except AssemblyError:
        return None
