"""What moves a parameter of a machine, for a fitter."""

from __future__ import annotations

import dataclasses
import math


@dataclasses.dataclass(frozen=True, slots=True)
class Adjustment:
    """A motion that a fitter makes, and how exactly.

    by    what to turn, shift or shim, in words
    step  smallest amount, SI; 0 where it is turned continuously
    sd    standard deviation of the amount as the fitter sets it, SI; that of an error
          anywhere within a step where it is not stated
    most  largest amount to either side, SI; 0: four tolerances of the parameter
    """

    by: str
    step: float = 0.0
    sd: float | None = None
    most: float = 0.0

    @property
    def error(self) -> float:
        """Standard deviation of the fitter's error, SI."""
        return self.step / math.sqrt(12.0) if self.sd is None else self.sd
