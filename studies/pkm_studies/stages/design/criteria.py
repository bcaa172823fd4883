"""The study's criteria over a measurement's parameters, and predicted accuracy.

Columns are the free parameters in the design's scaling. I and G take the referenced
pose error e = A dp over the workspace of [prediction], each component over its wanted
accuracy: F = A T / wanted / sqrt(poses), T the tolerances.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from oed.accuracy import prediction
from oed.base.arrays import Array
from oed.compensate.effects.planned_effects import PlannedEffects
from oed.design.blocks import project_on_estimable
from oed.design.candidates import Candidates
from oed.design.criterion import Compound, Criterion, named
from oed.identifiability import information
from oed.measurement.measurement import Measurement, Series
from pkm_studies.quantities import fine_units
from pkm_studies.resolve import DesignRequest, ResolvedStudy
from pkm_studies.tables import DesignTable

#: criteria to which a column that no reading touches is one more eigenvalue
EIGENVALUES = ("E", "kappa", "O2", "O3", "O4", "O5")


class Ingredients(TypedDict, total=False):
    """What a criterion needs besides its name; see `oed.design.criterion.named`.

    interest    (n, s) directions that Ds judges
    factor      (r, n) combination of c, or accuracy over the workspace of I
    factors     (J, r, n) accuracy at each workspace pose, for G
    """

    interest: Array
    factor: Array
    factors: Array


class StudyCriteria:
    """The criteria of one study."""

    def __init__(
        self,
        resolved: ResolvedStudy,
        table: DesignTable,
        request: DesignRequest,
        effects: PlannedEffects | None = None,
    ) -> None:
        self.resolved, self.table, self.request = resolved, table, request
        self.effects = effects

    @functools.cached_property
    def error_maps(self) -> prediction.ErrorMaps | None:
        """Pose error over the workspace of [prediction]; None without one."""
        request = self.resolved.prediction
        if request is None:
            return None
        kinematics = self.resolved.measurement.kinematics
        reference = request.table.reference
        return prediction.error_maps(kinematics, request.command, reference)

    @property
    def needed_maps(self) -> prediction.ErrorMaps:
        """The same. Raises LookupError without [prediction]."""
        if self.error_maps is None:
            raise LookupError("accuracy over the workspace needs [prediction]")
        return self.error_maps

    # -- criteria ----------------------------------------------------------------------

    def candidates_criterion(self, name: str, candidates: Candidates) -> Criterion:
        """The criterion over the candidates' columns; "compound" is the study's own."""
        if name == "compound":
            parts = [
                self.candidates_criterion(n, candidates) for n in self.table.compound
            ]
            return Compound(tuple(parts), self._shares())
        ingredients = self.ingredients(name, candidates.measurement, self.effects)
        return candidates.criterion(name, **ingredients)

    def parameters_criterion(self, name: str, measurement: Measurement) -> Criterion:
        """The criterion over a measurement's free parameters."""
        if name == "compound":
            parts = [
                self.parameters_criterion(n, measurement) for n in self.table.compound
            ]
            return Compound(tuple(parts), self._shares())
        count = int(measurement.free.sum())
        return named(name, count, **self.ingredients(name, measurement))

    def _shares(self) -> tuple[float, ...]:
        total = sum(self.table.compound.values())
        return tuple(share / total for share in self.table.compound.values())

    def ingredients(
        self,
        name: str,
        measurement: Measurement,
        effects: PlannedEffects | None = None,
    ) -> Ingredients:
        """What the criterion needs besides its name, over the free parameters.

        I and G judge what the effects do to the tool as well.
        """
        if name == "Ds":
            return {"interest": self._interest(measurement)}
        if name == "c":
            return {"factor": self._combination(measurement)}
        if name == "G":
            return {"factors": self._accuracy_slopes(measurement, effects)}
        if name == "I":
            return {"factor": self._mean_accuracy(measurement, effects)}
        return {}

    def _scale(self, measurement: Measurement) -> Array:
        scale = information.column_scale(measurement, self.table.scaling)
        return scale[measurement.free]

    def _interest(self, measurement: Measurement) -> Array:
        names = measurement.free_names
        wanted = [k for k, n in enumerate(names) if n in self.request.interest]
        return np.eye(int(measurement.free.sum()))[:, wanted]

    def _combination(self, measurement: Measurement) -> Array:
        coefficients = self.request.combination
        row = [coefficients.get(name, 0.0) for name in measurement.free_names]
        return (np.array(row) * self._scale(measurement))[None]

    def _mean_accuracy(
        self, measurement: Measurement, effects: PlannedEffects | None
    ) -> Array:
        """F (r, n) of criterion I. Only F^T F counts: its triangle is as good."""
        slopes = self._accuracy_slopes(measurement, effects)
        flat = slopes.reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes))
        if len(flat) <= flat.shape[1]:
            return np.asarray(flat)
        return np.asarray(np.linalg.qr(flat, mode="r"))

    def _accuracy_slopes(
        self, measurement: Measurement, effects: PlannedEffects | None
    ) -> Array:
        """Slopes (poses, components, n) of wanted components over wanted accuracy.

        With effects over n + u columns.
        """
        maps, accuracy = self.needed_maps, self.request.accuracy
        columns = [k for k, name in enumerate(maps.names) if name in accuracy]
        wanted = np.array([accuracy[maps.names[k]] for k in columns])
        poses, _, machine_parameters = maps.raw.shape
        slopes = np.zeros((poses, len(columns), len(measurement.names)))
        slopes[:, :, :machine_parameters] = maps.raw[:, columns] / wanted[:, None]
        of_parameters = slopes[:, :, measurement.free] * self._scale(measurement)
        if effects is None:
            return of_parameters
        of_effects = effects.tool[:, columns] / wanted[:, None]
        return np.concatenate([of_parameters, of_effects], axis=2)

    # -- plans -------------------------------------------------------------------------

    def _rows(self, measurement: Measurement, series: Sequence[Series]) -> Array:
        """Whitened slopes (N, n) of readings over the scaled free parameters."""
        theta, scaling = measurement.nominal, self.table.scaling
        rows = information.scaled(measurement, series, theta, scaling)
        return rows[:, measurement.free]

    def information(self, measurement: Measurement, series: Sequence[Series]) -> Array:
        """Information (n, n) of readings, with the tolerances where they count."""
        rows = self._rows(measurement, series)
        prior = information.prior_information(measurement) if self.table.prior else 0.0
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
            rows = self._rows(measurement, series)
            _, basis = project_on_estimable(rows[:, None], None)
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        log_phi = criterion.value(m)
        return log_phi, criterion.conventional_value(log_phi, sum(map(len, series)))

    def predicted_accuracy(
        self, measurement: Measurement, series: Sequence[Series]
    ) -> dict[str, float]:
        """Predicted rms of each pose component, once all that is known is corrected.

        By component and fine unit (`z_um`).
        """
        maps = self.error_maps
        if maps is None:
            return {}
        count, nominal = len(measurement.machine.parameters), measurement.nominal
        whole = information.parameter_covariance(measurement, series, nominal)
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
