"""Reports which parameters the readings identify: the section `identifiability`."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from oed.identifiability import explain
from oed.identifiability.assessment import Assessment, assess
from oed.identifiability.information import Scaling
from oed.measurement.measurement import Measurement, Series
from oed.result import IdentifiabilitySection

SeriesWithMeasurement = tuple[Measurement, Sequence[Series]]


def identifiability_section(
    identifiability: Assessment,
    scaling: Scaling,
    others: Mapping[str, SeriesWithMeasurement],
) -> IdentifiabilitySection:
    """Rank, singular values, null directions and sentences.

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
        words=explain.explain(identifiability, others),
    )


def variants(
    measurement: Measurement,
    series: Sequence[Series],
    references: Mapping[str, SeriesWithMeasurement],
    scaling: Scaling,
) -> dict[str, IdentifiabilitySection]:
    """Sections for each reference plan, and for each set-up of the plan alone."""
    sections = {}
    for name, (reference_measurement, reference_series) in references.items():
        identifiability = assess(reference_measurement, reference_series, scaling)
        sections[name] = identifiability_section(identifiability, scaling, {})
    by_setup: dict[str, list[Series]] = {}
    for s in series:
        by_setup.setdefault(s.setup, []).append(s)
    if len(by_setup) < 2:
        return sections
    for name, alone in by_setup.items():
        others = {n: (measurement, s) for n, s in by_setup.items() if n != name}
        identifiability = assess(measurement, alone, scaling)
        sections[f"{name} alone"] = identifiability_section(
            identifiability, scaling, others
        )
    return sections
