"""Random streams of a plan search: one for each question that drawn machines answer.

Most streams start anew at each use (common random numbers). Two plans then differ by
their readings, and not by the machines that are drawn for them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

# Seeds of the streams that all searches share. They mean nothing; other ones would change
# the last digits of published plans.
CAPTURE_SEED = 0
REFINEMENT_SEED = 17
VERIFICATION_SEED = 18
BOUND_SEED = 19


@dataclasses.dataclass(frozen=True, eq=False)
class PlanStreams:
    """Generators which the caller of a plan search provides.

    first_look    machines of partial plans; drawn on and on during the search
    bound         machines for the bound over all plans; drawn once
    capture       () starts the stream that estimates how often runs are captured
    refinement    (k) starts the stream of stage k while plans are refined
    verification  (k) starts the stream of stage k by which refined plans are judged
    """

    first_look: np.random.Generator
    bound: np.random.Generator
    capture: Callable[[], np.random.Generator]
    refinement: Callable[[int], np.random.Generator]
    verification: Callable[[int], np.random.Generator]

    @classmethod
    def seeded(cls, seed: int | Sequence[int]) -> PlanStreams:
        """The streams of one search; the seed is for the first look at partial plans.

        The others do not follow it. All searches of a study (other budgets, other stages,
        without a measurement) then judge their plans by the same drawn machines, and so
        do studies with other seeds: their values can be compared.
        """
        return cls(
            first_look=np.random.default_rng(seed),
            bound=np.random.default_rng(BOUND_SEED),
            capture=lambda: np.random.default_rng(CAPTURE_SEED),
            refinement=lambda stage: np.random.default_rng([REFINEMENT_SEED, stage]),
            verification=lambda k: np.random.default_rng([VERIFICATION_SEED, k]),
        )
