"""Predicts which effects planned readings could find: the section `gap_before`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from oed import gap, units
from oed.design import Rules
from oed.measurement import Measurement, Series
from oed.result import ChosenRuns, DetectabilityTable, GapBeforeSection
from oed.text import capitalised, join_words
from pkm_studies.resolve import GapDesignRequest, GapRequest
from pkm_studies.stages.gap import chosen_runs
from pkm_studies.stages.gap.words import plain_name

if TYPE_CHECKING:
    import pandas as pd


#: most effects and pairs in one sentence
MOST = 6


@dataclasses.dataclass(frozen=True)
class GapPreview:
    """The section, and the chosen runs as a readings file to fill in, if any."""

    section: GapBeforeSection
    poses_csv: str | None


def preview(
    measurement: Measurement,
    series: Sequence[Series],
    covariates: pd.DataFrame,
    request: GapRequest,
    rng: np.random.Generator,
    design: tuple[Measurement, GapDesignRequest, Rules] | None,
) -> GapPreview:
    """What readings as planned could find, and the runs that [gap.design] chooses.

    `design` comes with a measurement of its set-ups, and the rules of the choice. The noise is the stated one: what
    real runs add to it is unknown before they are read.
    """
    planned = gap.assemble(measurement, series, covariates, gravity=request.gravity)
    fine = _fine_units(measurement)
    chosen, csv = None, None
    if design is not None:
        fine |= _fine_units(design[0])
        chosen, csv = chosen_runs.choose_runs(*design, planned, request, rng)
    table = gap.detect(planned, planned.stated_law, request.effects, rng)
    section = GapBeforeSection(table, fine, chosen, [])
    lines = sentences(section)
    return GapPreview(msgspec.structs.replace(section, words=lines), csv)


def _fine_units(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel, in which the sizes of readings are given."""
    setups = measurement.setups.values()
    channels = [c for setup in setups for c in setup.instrument.channels]
    return {c.name: units.FINE[c.unit] for c in channels}


# -- sentences -------------------------------------------------------------------------


def sentences(section: GapBeforeSection) -> list[str]:
    """The gain of the chosen runs, and what they or the planned readings can find."""
    if section.chosen is None:
        return _findings("The planned readings", section.table)
    return [
        _gain(section.chosen),
        *_findings("The chosen runs", section.chosen.table),
    ]


def _gain(chosen: ChosenRuns) -> str:
    pairs = set()
    for s in chosen.separations:
        pairs.add(" and ".join(sorted((plain_name(s.effect), plain_name(s.rival)))))
    named = "; ".join(sorted(pairs)[:MOST])
    bound = f"no plan exceeds {chosen.bound:.1f}"
    if chosen.proven:
        bound = "no plan is better"
    before = "" if chosen.before is None else f" from {chosen.before:.1f}"
    added = f"{len(chosen.runs) - chosen.retained} of {chosen.candidates}"
    retained = f", added to {chosen.retained} retained runs," if chosen.retained else ""
    return (
        f"{added} candidate runs{retained} raise the least distinguishability of"
        f" {named}{before} to {chosen.separation:.1f} ({bound})."
    )


def _findings(readings: str, table: DetectabilityTable) -> list[str]:
    visible = [e for e in table.effects if e.visible]
    testable = [e for e in table.effects if e.not_testable is None]
    too_weak = [plain_name(e.name) for e in testable if not e.visible]
    missed = f"; too weak for them: {join_words(too_weak)}" if too_weak else ""
    sentences = [
        f"{readings} find {len(visible)} of the {len(table.names)} effects that they"
        " can test, at the expected sizes (90 % chance at 1 % false alarm)"
        f"{missed}."
    ]
    absorbed = dict.fromkeys(effect for effect, _ in table.absorbed)
    for name in list(absorbed)[:MOST]:
        rivals = [
            plain_name(rival) for effect, rival in table.absorbed if effect == name
        ]
        subject = capitalised(plain_name(name))
        sentences.append(
            f"{subject} could also be explained by {join_words(rivals, 'or')}."
        )
    for first, second in table.exact[:MOST]:
        sentences.append(
            f"Some forms of {plain_name(first)} and {plain_name(second)} are identical"
            " in these readings, whatever their size."
        )
    untestable = [
        plain_name(e.name) for e in table.effects if e.not_testable is not None
    ]
    if untestable:
        sentences.append(f"They cannot test {join_words(untestable)}.")
    return sentences
