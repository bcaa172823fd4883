"""Identifiability of readings, as a section of the result."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from oed import explain, result
from oed.information import Scaling
from oed.measurement import Measurement, Series

Readings = tuple[Measurement, Sequence[Series]]


def section(
    seen: explain.Seen, scaling: Scaling, others: Mapping[str, Readings]
) -> result.IdentifiabilitySection:
    """The verdict, its singular values and its words."""
    verdict = seen.verdict
    return result.IdentifiabilitySection(
        parameters=list(verdict.names),
        n=len(verdict.names),
        rank=verdict.rank,
        tolerance=verdict.tolerance,
        scaling=scaling,
        singular_values=[float(v) for v in verdict.singular_values],
        combinations=verdict.named(verdict.combinations),
        lost=verdict.named(verdict.lost),
        words=[
            result.IdentifiabilityFinding(f.kind, f.text, list(f.remedies))
            for f in explain.explain(seen, others)
        ],
    )


def variants(
    measurement: Measurement,
    series: Sequence[Series],
    references: Mapping[str, Readings],
    scaling: Scaling,
) -> dict[str, result.IdentifiabilitySection]:
    """Verdicts beside the main one: each reference plan, and each instrument of the
    plan alone.
    """
    found = {
        name: section(explain.look(m, s, scaling), scaling, {})
        for name, (m, s) in references.items()
    }
    setups = list(dict.fromkeys(s.setup for s in series))
    if len(setups) > 1:
        for name in setups:
            mine = [s for s in series if s.setup == name]
            rest = {
                n: (measurement, [s for s in series if s.setup == n])
                for n in setups
                if n != name
            }
            found[f"{name} alone"] = section(
                explain.look(measurement, mine, scaling), scaling, rest
            )
    return found
