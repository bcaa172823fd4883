"""Reports the combinations of parameters that the readings determine, with value and sd."""

from __future__ import annotations

import numpy as np

from oed.base import units
from oed.estimation.estimate import Estimate
from oed.identifiability.identifiability import Identifiability
from oed.measurement.measurement import Measurement
from oed.result import CombinationEstimate


def combination_estimates(
    measurement: Measurement, estimate: Estimate, verdict: Identifiability
) -> list[CombinationEstimate]:
    """Each combination's departure from nominal, in the unit of its pivot."""
    places = [measurement.names.index(name) for name in verdict.names]
    departure = (estimate.theta - measurement.nominal)[places]
    covariance = estimate.covariance[np.ix_(places, places)]
    prior_root = measurement.prior_root(estimate.prior_sd > 0.0)[places]
    terms = verdict.coefficients_by_name(verdict.combinations)
    records = []
    for named, row in zip(terms, verdict.combinations, strict=True):
        pivot = int(np.flatnonzero(np.abs(row - 1.0) < 1e-9)[0])
        unit = units.display(measurement.parameters[places[pivot]].unit)
        records.append(
            CombinationEstimate(
                terms=named,
                value=units.number(float(row @ departure), unit),
                sd=units.number(float(np.sqrt(row @ covariance @ row)), unit),
                tolerance=units.number(float(np.linalg.norm(row @ prior_root)), unit),
                unit=unit,
            )
        )
    return records
