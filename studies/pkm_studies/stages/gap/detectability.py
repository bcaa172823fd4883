"""Predicts which effects planned readings could find: the section `gap_before`."""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from oed import units
from oed.effect import Effect
from oed.gap.before import detect
from oed.gap.before.detection import Detectability, EffectRival
from oed.gap.data import problem
from oed.gap.data.problem import GapProblem
from oed.measurement import Measurement, Series
from oed.noise.law import stated_law
from oed.result.gap_before import (
    DetectabilityRecord,
    DetectabilityTable,
    GapBeforeSection,
    RivalRecord,
    SharedRecord,
)
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.resolve.gap_design import GapDesignRequest
from pkm_studies.stages.gap import chosen_runs, detectability_sentences

if TYPE_CHECKING:
    import pandas as pd

#: sizes from here on are not given: nothing physical is so large
UNBOUNDED = 1e6


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
    design: tuple[Measurement, GapDesignRequest] | None,
) -> GapPreview:
    """What readings as planned could find, and the runs that [gap.design] chooses.

    `design` comes with a measurement of its set-ups. The noise is the stated one: what
    real runs add to it is unknown before they are read.
    """
    planned = problem.assemble(measurement, series, covariates, gravity=request.gravity)
    fine = _fine_units(measurement)
    chosen, csv = None, None
    if design is not None:
        fine |= _fine_units(design[0])
        choice = chosen_runs.choose_runs(*design, planned, request.gravity, rng)
        chosen_table = detectability_table(choice.problem, request.effects, rng, fine)
        chosen = choice.record(chosen_table)
        csv = choice.poses_csv
    table = detectability_table(planned, request.effects, rng, fine)
    section = GapBeforeSection(table, fine, chosen, [])
    words = detectability_sentences.sentences(section)
    return GapPreview(msgspec.structs.replace(section, words=words), csv)


def _fine_units(measurement: Measurement) -> dict[str, str]:
    """Fine unit of each channel."""
    fine: dict[str, str] = {}
    for setup in measurement.setups.values():
        fine |= {c.name: units.FINE[c.unit] for c in setup.instrument.channels}
    return fine


def detectability_table(
    planned: GapProblem,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    fine: Mapping[str, str],
) -> DetectabilityTable:
    """Detectability of every effect in planned readings, sizes in fine units."""
    detection = detect.detect(planned, stated_law(planned), effects, rng)
    about = {e.name: e.about for e in effects}
    return DetectabilityTable(
        readings=len(planned),
        effects=[_effect(entry, about, fine) for entry in detection.effects],
        names=list(detection.names),
        separation=detection.separation.tolist(),
        angles_deg=detection.angles.tolist(),
        classes=[list(c) for c in detection.classes],
        absorbed=[list(pair) for pair in detection.absorbed],
        exact=[list(pair) for pair in detection.exact],
    )


def _effect(
    entry: Detectability, about: Mapping[str, str], fine: Mapping[str, str]
) -> DetectabilityRecord:
    def in_fine_units(rms: Mapping[str, float]) -> dict[str, float]:
        """Rms values, SI, by channel in its fine unit."""
        return {name: v / units.factor(fine[name]) for name, v in rms.items()}

    return DetectabilityRecord(
        name=entry.effect,
        about=about[entry.effect],
        columns=entry.columns,
        detectability=entry.detectability,
        low=entry.low,
        high=entry.high,
        power=entry.power,
        visible=entry.visible,
        signature=in_fine_units(entry.signature),
        absorbed=entry.absorbed,
        least=_bounded(in_fine_units(entry.least)),
        median=_bounded(in_fine_units(entry.median)),
        sizes=_bounded(entry.sizes),
        rivals=[_rival(rival) for rival in entry.rivals],
        not_testable=entry.not_testable,
    )


def _rival(rival: EffectRival) -> RivalRecord:
    shared = [
        SharedRecord(
            words=s.words,
            combination=dict(s.combination),
            detectability=s.detectability,
            separation=s.separation,
            angle_deg=s.angle,
        )
        for s in rival.shared
    ]
    return RivalRecord(rival.name, rival.separation, rival.angle, shared)


def _bounded(sizes: Mapping[str, float]) -> dict[str, float | None]:
    """Sizes, with None for those that no reading could bound."""
    return {
        name: float(size) if math.isfinite(size) and size < UNBOUNDED else None
        for name, size in sizes.items()
    }
