"""Predicts which effects planned readings could find: the section `gap_before`."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING

import msgspec
import numpy as np

from oed.design.rules import Rules
from oed.gap.before import detect
from oed.gap.data import problem
from oed.measurement.measurement import Measurement, Series
from oed.noise.law import stated_law
from oed.result.gap_before import GapBeforeSection
from pkm_studies.resolve.gap import GapRequest
from pkm_studies.resolve.gap_design import GapDesignRequest
from pkm_studies.stages.gap import chosen_runs, detectability_sentences

if TYPE_CHECKING:
    import pandas as pd


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
    planned = problem.assemble(measurement, series, covariates, gravity=request.gravity)
    fine = detect.fine_units(measurement)
    chosen, csv = None, None
    if design is not None:
        fine |= detect.fine_units(design[0])
        chosen, csv = chosen_runs.choose_runs(*design, planned, request, rng)
    table = detect.detect(planned, stated_law(planned), request.effects, rng)
    section = GapBeforeSection(table, fine, chosen, [])
    words = detectability_sentences.sentences(section)
    return GapPreview(msgspec.structs.replace(section, words=words), csv)
