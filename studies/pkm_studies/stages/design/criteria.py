"""What plans are judged by: the study's criteria over the columns of a measurement, and
predicted accuracy.

Columns are the free parameters in the design's scaling. I and G take the referenced
pose error e = A dp over the workspace of [prediction], each component over its wanted
accuracy: F = A T / wanted / sqrt(poses), T the tolerances.
"""

from __future__ import annotations

import functools
from collections.abc import Mapping, Sequence
from typing import TypedDict

import numpy as np

from oed import information, predict, units
from oed.arrays import Array
from oed.design.blocks import project_on_estimable
from oed.design.candidates import Candidates
from oed.design.criterion import Compound, Criterion, named
from oed.measurement import Measurement, Series
from pkm_studies.resolve.resolved import ResolvedStudy
from pkm_studies.study.tables import DesignTable

#: criteria to which a column that no reading touches is one more eigenvalue
EIGENVALUES = ("E", "kappa", "O2", "O3", "O4", "O5")


class Pieces(TypedDict, total=False):
    """What a criterion needs besides its name, over the free columns; see
    `oed.design.criterion.named`.
    """

    interest: Array
    factor: Array
    factors: Array


class StudyCriteria:
    """The criteria of one study."""

    def __init__(self, resolved: ResolvedStudy, design: DesignTable) -> None:
        self.resolved, self.design = resolved, design

    @functools.cached_property
    def maps(self) -> predict.ErrorMaps | None:
        """Pose error over the workspace of [prediction]; None without one."""
        said, command = (
            self.resolved.study.prediction,
            self.resolved.prediction_commands,
        )
        if said is None or command is None:
            return None
        return predict.error_maps(
            self.resolved.measurement.kinematics, command, said.reference
        )

    def criterion(self, name: str, candidates: Candidates) -> Criterion:
        """The criterion of this name over the candidates' columns; "compound" is the
        study's own.
        """
        if name == "compound":
            parts = tuple(self.criterion(n, candidates) for n in self.design.compound)
            return Compound(parts, self._shares())
        return candidates.criterion(name, **self.pieces(name, candidates.measurement))

    def _shares(self) -> tuple[float, ...]:
        total = sum(self.design.compound.values())
        return tuple(v / total for v in self.design.compound.values())

    def pieces(self, name: str, measurement: Measurement) -> Pieces:
        """Directions of interest (n, s), combination (1, n), accuracy over the
        workspace (r, n) or (J, r, n).
        """
        if name == "Ds":
            return {"interest": self._interest(measurement)}
        if name == "c":
            return {"factor": self._combination(measurement)}
        if name in ("I", "G"):
            slopes = self._slopes(measurement)
            if name == "G":
                return {"factors": slopes}
            flat = slopes.reshape(-1, slopes.shape[2]) / np.sqrt(len(slopes))
            # F only counts as F^T F: its triangle is as good, and small
            return {
                "factor": (
                    np.asarray(np.linalg.qr(flat, mode="r"))
                    if len(flat) > flat.shape[1]
                    else flat
                )
            }
        return {}

    def _scale(self, measurement: Measurement) -> Array:
        return information.column_scale(measurement, self.design.scaling)[
            measurement.free
        ]

    def _free(self, measurement: Measurement) -> list[str]:
        return [
            n
            for n, free in zip(measurement.names, measurement.free, strict=True)
            if free
        ]

    def _interest(self, measurement: Measurement) -> Array:
        asked = self.resolved.design
        assert asked is not None
        wanted = [
            k for k, n in enumerate(self._free(measurement)) if n in asked.interest
        ]
        return np.eye(int(measurement.free.sum()))[:, wanted]

    def _combination(self, measurement: Measurement) -> Array:
        asked = self.resolved.design
        assert asked is not None
        row = np.array([asked.combination.get(n, 0.0) for n in self._free(measurement)])
        return (row * self._scale(measurement))[None]

    def _slopes(self, measurement: Measurement) -> Array:
        """Wanted pose components (poses, components, n) in units of their wanted
        accuracy.
        """
        asked, maps = self.resolved.design, self.maps
        assert asked is not None
        assert maps is not None
        kept = [k for k, n in enumerate(maps.names) if n in asked.accuracy]
        wanted = np.array([asked.accuracy[maps.names[k]] for k in kept])
        wide = np.zeros((len(maps.raw), len(kept), len(measurement.names)))
        wide[:, :, : maps.raw.shape[2]] = maps.raw[:, kept] / wanted[:, None]
        return wide[:, :, measurement.free] * self._scale(measurement)

    # -- plans -------------------------------------------------------------------------

    def information(self, measurement: Measurement, series: Sequence[Series]) -> Array:
        """Information (n, n) of readings, with the tolerances where they count."""
        rows = information.scaled(
            measurement, series, measurement.nominal, self.design.scaling
        )[:, measurement.free]
        return np.asarray(
            rows.T @ rows + (np.eye(rows.shape[1]) if self.design.prior else 0.0)
        )

    def judged(
        self, name: str, measurement: Measurement, series: Sequence[Series]
    ) -> tuple[float, float]:
        """log phi of a plan, and the number that users know; over the directions that
        it sees itself.
        """
        m = self.information(measurement, series)
        criterion = self._named(name, measurement)
        if not self.design.prior:
            rows = information.scaled(
                measurement, series, measurement.nominal, self.design.scaling
            )
            _, basis = project_on_estimable(rows[:, None, measurement.free], None)
            criterion, m = criterion.restrict(basis), basis.T @ m @ basis
        value = criterion.value(m)
        return value, criterion.conventional_value(value, sum(map(len, series)))

    def _named(self, name: str, measurement: Measurement) -> Criterion:
        if name == "compound":
            return Compound(
                tuple(self._named(n, measurement) for n in self.design.compound),
                self._shares(),
            )
        return named(
            name, int(measurement.free.sum()), **self.pieces(name, measurement)
        )

    def predicted(
        self, measurement: Measurement, series: Sequence[Series]
    ) -> dict[str, float]:
        """Predicted rms of each pose component, in its fine unit, once all that is
        known is corrected.
        """
        maps = self.maps
        if maps is None:
            return {}
        keep, tolerance = len(measurement.machine.parameters), measurement.tolerance
        h = information.scaled(measurement, series, measurement.nominal, "tolerance")
        covariance = information.posterior_covariance(h)[:keep, :keep] * np.outer(
            tolerance[:keep], tolerance[:keep]
        )
        variance = np.einsum(
            "nkp,pq,nkq->k", maps.raw, covariance, maps.raw, optimize=True
        ) / len(maps.raw)
        fine = {c.name: units.FINE[c.unit] for c in measurement.machine.components}
        return {
            f"{n}_{fine[n]}": units.number(float(np.sqrt(max(v, 0.0))), fine[n])
            for n, v in zip(maps.names, variance, strict=True)
        }


def improvement_factors(
    before: Mapping[str, float], after: Mapping[str, float]
) -> dict[str, float]:
    """By which factor each component of one prediction is better than of another."""
    return {n: before[n] / v for n, v in after.items() if v > 0.0}
