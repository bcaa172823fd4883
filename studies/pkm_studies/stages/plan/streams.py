"""Random streams of the plan stage, by name."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from oed.design.stages.streams import PlanStreams

# The streams by which plans are refined, judged and bounded do not follow the study's
# seed. All searches of a study (other budgets, other stages, without a measurement) then
# judge their plans by the same drawn machines, and so do studies with other seeds: their
# values can be compared. The numbers themselves mean nothing; other ones would change
# the last digits of published plans.
CAPTURE, REFINEMENT, VERIFICATION, BOUND = 0, 17, 18, 19


def plan_streams(seed: int | Sequence[int]) -> PlanStreams:
    """The streams of one search; the seed is for the first look at partial plans."""
    return PlanStreams(
        first_look=np.random.default_rng(seed),
        bound=np.random.default_rng(BOUND),
        capture=lambda: np.random.default_rng(CAPTURE),
        refinement=lambda stage: np.random.default_rng([REFINEMENT, stage]),
        verification=lambda stage: np.random.default_rng([VERIFICATION, stage]),
    )
