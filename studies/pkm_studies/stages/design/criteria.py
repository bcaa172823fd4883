"""The study's criteria over a measurement's parameters, and predicted accuracy.

Columns are the free parameters in the design's scaling. I and G take the referenced
pose error e = A dp over the workspace of [prediction], each component over its wanted
accuracy: F = A T / wanted / sqrt(poses), T the tolerances.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import accuracy
from oed.base import Array
from oed.design import CRITERIA, compound
from oed.identifiability import (
    column_scale,
    parameter_covariance,
    prior_information,
    scaled,
)
from oed.measurement import Measurement, Series
from pkm_studies.quantities import fine_units
from pkm_studies.resolve import DesignRequest, ResolvedStudy
from pkm_studies.tables import DesignTable

if TYPE_CHECKING:
    from oed.design import Candidates, Criterion
    from oed.effects import PlannedEffects


class StudyCriteria:
    """The criteria of one study with a design, for a machine with effects or without."""

    def __init__(
        self, resolved: ResolvedStudy, effects: PlannedEffects | None = None
    ) -> None:
        table, request = resolved.study.design, resolved.design
        if table is None or request is None:
            raise LookupError("criteria need [design]")
        self.table: DesignTable = table
        self.request: DesignRequest = request
        self.resolved, self.effects = resolved, effects
        self.location = resolved.study.location.key("design")

    @functools.cached_property
    def error_maps(self) -> accuracy.ErrorMaps | None:
        """Pose error over the workspace of [prediction]; None without one."""
        request = self.resolved.prediction
        if request is None:
            return None
        kinematics = self.resolved.measurement.kinematics
        return accuracy.ErrorMaps.of(
            kinematics, request.command, request.table.reference
        )

    @property
    def needed_maps(self) -> accuracy.ErrorMaps:
        """The same. Raises LookupError without [prediction]."""
        if self.error_maps is None:
            raise LookupError("accuracy over the workspace needs [prediction]")
        return self.error_maps

    # -- criteria ----------------------------------------------------------------------
    def candidates_criterion(self, name: str, candidates: Candidates) -> Criterion:
        """The criterion over the candidates' columns; "compound" is the study's own."""
        if name == "compound":
            shares = self.table.compound
            return compound(
                {self.candidates_criterion(n, candidates): shares[n] for n in shares}
            )
        ingredient = self.ingredient(name, candidates.measurement, self.effects)
        return candidates.criterion(name, ingredient)

    def parameters_criterion(self, name: str, measurement: Measurement) -> Criterion:
        """The criterion over a measurement's free parameters."""
        if name == "compound":
            shares = self.table.compound
            return compound(
                {self.parameters_criterion(n, measurement): shares[n] for n in shares}
            )
        count = int(measurement.free.sum())
        return CRITERIA.build(name, count, self.ingredient(name, measurement))

    def ingredient(
        self, name: str, measurement: Measurement, effects: PlannedEffects | None = None
    ) -> Array | None:
        """What the criterion needs besides its name, over the free parameters.

        Criteria of accuracy judge what the effects do to the tool as well.
        """
        needs = CRITERIA[name].needs
        if needs == "interest":
            names = measurement.free_names
            wanted = [k for k, n in enumerate(names) if n in self.request.interest]
            return np.eye(int(measurement.free.sum()))[:, wanted]
        if needs == "combination":
            coefficients = self.request.combination
            row = [coefficients.get(n, 0.0) for n in measurement.free_names]
            return (np.array(row) * self._scale(measurement))[None]
        if needs == "accuracy":
            return self._accuracy_gradients(measurement, effects)
        return None

    def _scale(self, measurement: Measurement) -> Array:
        scale = column_scale(measurement, self.table.scaling)
        return scale[measurement.free]

    def _accuracy_gradients(
        self, measurement: Measurement, effects: PlannedEffects | None
    ) -> Array:
        """Gradients (poses, components, n, or n + u with effects) over wanted accuracy."""
        maps, accuracy = self.needed_maps, self.request.accuracy
        columns = [k for k, name in enumerate(maps.names) if name in accuracy]
        wanted = np.array([accuracy[maps.names[k]] for k in columns])
        poses, _, machine_parameters = maps.raw.shape
        gradients = np.zeros((poses, len(columns), len(measurement.names)))
        gradients[:, :, :machine_parameters] = maps.raw[:, columns] / wanted[:, None]
        of_parameters = gradients[:, :, measurement.free] * self._scale(measurement)
        if effects is None:
            return of_parameters
        of_effects = effects.tool[:, columns] / wanted[:, None]
        return np.concatenate([of_parameters, of_effects], axis=2)

    # -- plans -------------------------------------------------------------------------
    def _rows(self, measurement: Measurement, series: Sequence[Series]) -> Array:
        """Whitened Jacobian (N, n) of readings over the scaled free parameters."""
        theta, scaling = measurement.nominal, self.table.scaling
        rows = scaled(measurement, series, theta, scaling)
        return rows[:, measurement.free]

    def information(self, measurement: Measurement, series: Sequence[Series]) -> Array:
        """Information (n, n) of readings, with the tolerances where they count."""
        rows = self._rows(measurement, series)
        prior = prior_information(measurement) if self.table.prior else 0.0
        return rows.T @ rows + prior

    def score(
        self, name: str, measurement: Measurement, series: Sequence[Series]
    ) -> tuple[float, float]:
        """log phi of a plan, and the number that users know.

        Without tolerances, a plan is judged over the directions that it sees itself.
        """
        m = self.information(measurement, series)
        criterion = self.parameters_criterion(name, measurement)
        if not self.table.prior:
            criterion, basis = criterion.restrict_to_rows(
                self._rows(measurement, series)
            )
            m = basis.T @ m @ basis
        log_phi = criterion.value(m)
        return log_phi, criterion.conventional_value(log_phi, sum(map(len, series)))

    def predicted_accuracy(
        self, measurement: Measurement, series: Sequence[Series]
    ) -> dict[str, float]:
        """Predicted rms of each pose component, fully corrected, by fine unit (`z_um`)."""
        maps = self.error_maps
        if maps is None:
            return {}
        count = len(measurement.machine.parameters)
        nominal = measurement.nominal
        whole = parameter_covariance(measurement, series, nominal)
        covariance = whole[:count, :count]
        total = np.einsum(
            "nkp,pq,nkq->k", maps.raw, covariance, maps.raw, optimize=True
        )
        values = np.sqrt(np.maximum(total / len(maps.raw), 0.0)).tolist()
        rms = dict(zip(maps.names, values, strict=True))
        return fine_units(rms, measurement.machine)


def improvement_factors(
    before: Mapping[str, float], after: Mapping[str, float]
) -> dict[str, float]:
    """Factor by which each component of one prediction is better than of another."""
    return {n: before[n] / value for n, value in after.items() if value > 0.0}
