"""Reports which parameters the readings identify: the section `identifiability`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np

from oed.design import CRITERIA
from oed.identifiability import Assessment, Scaling, assess, explain
from oed.measurement import Measurement, Series
from oed.result import IdentifiabilitySection

SeriesWithMeasurement = tuple[Measurement, Sequence[Series]]


def identifiability_section(
    identifiability: Assessment,
    scaling: Scaling,
    others: Mapping[str, SeriesWithMeasurement],
    indices: Sequence[str] = (),
) -> IdentifiabilitySection:
    """Rank, singular values, null directions, sentences and the named indices.

    `others` are readings that the sentences may recommend as a remedy.
    """
    verdict = identifiability.identifiability
    return IdentifiabilitySection(
        parameters=list(verdict.names),
        n=len(verdict.names),
        rank=verdict.rank,
        tolerance=verdict.tolerance,
        scaling=scaling,
        singular_values=[float(v) for v in verdict.singular_values],
        combinations=verdict.coefficients_by_name(verdict.combinations),
        lost=verdict.coefficients_by_name(verdict.lost),
        words=explain(identifiability, others),
        indices={n: _index(identifiability, n) for n in indices if verdict.rank},
    )


def _index(assessment: Assessment, name: str) -> float:
    """An observability index over the directions that the readings determine."""
    s = assessment.identifiability.identifiable_singular_values
    count_of = _poses if CRITERIA[name].index_of_poses else _readings
    return CRITERIA.index(
        name, s, sum(count_of(assessment, x) for x in assessment.series)
    )


def _readings(assessment: Assessment, series: Series) -> int:
    """Number of readings."""
    return len(series)


def _poses(assessment: Assessment, series: Series) -> int:
    """Number of poses on the runs, references included, a teach pose not."""
    taught = assessment.measurement.setups[series.setup].teach is not None
    poses = series.index[:, 0] if taught else series.index
    return len(np.unique(poses))


def variants(
    measurement: Measurement,
    series: Sequence[Series],
    references: Mapping[str, SeriesWithMeasurement],
    scaling: Scaling,
    indices: Sequence[str] = (),
) -> dict[str, IdentifiabilitySection]:
    """Sections for each reference plan, and for each set-up of the plan alone."""
    sections = {}
    for name, (reference_measurement, reference_series) in references.items():
        identifiability = assess(reference_measurement, reference_series, scaling)
        sections[name] = identifiability_section(identifiability, scaling, {}, indices)
    by_setup: dict[str, list[Series]] = {}
    for s in series:
        by_setup.setdefault(s.setup, []).append(s)
    if len(by_setup) < 2:
        return sections
    for name, alone in by_setup.items():
        others = {n: (measurement, s) for n, s in by_setup.items() if n != name}
        identifiability = assess(measurement, alone, scaling)
        sections[f"{name} alone"] = identifiability_section(
            identifiability, scaling, others, indices
        )
    return sections
