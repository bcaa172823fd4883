"""Random streams of a plan search: one for each question that drawn machines answer.

Most streams start anew at each use (common random numbers). Two plans then differ by
their readings, and not by the machines that are drawn for them.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np


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
