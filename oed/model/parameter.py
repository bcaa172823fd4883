"""A calibration parameter, what moves it, and what tolerances of several share."""

import dataclasses
import math

import numpy as np

from oed import units


@dataclasses.dataclass(frozen=True, slots=True)
class Adjustment:
    """A motion that a fitter makes, and how exactly."""

    by: str  #: what to turn, shift or shim, in words
    step: float = 0.0  #: smallest amount, SI; 0 where it is turned continuously
    #: standard deviation of the amount as the fitter sets it, SI; that of an error
    #: anywhere within a step where it is not stated
    sd: float | None = None
    #: largest amount to either side, SI; 0: four tolerances of the parameter
    most: float = 0.0

    @property
    def error(self) -> float:
        """Standard deviation of the fitter's error, SI."""
        return self.step / math.sqrt(12.0) if self.sd is None else self.sd


@dataclasses.dataclass(frozen=True, slots=True)
class Parameter:
    """A calibration parameter.

    name       unique within a machine or an instrument
    nominal    value from the drawing, SI
    tolerance  prior standard deviation, SI
    unit       SI unit: m, rad, s, N, K or 1
    about      what it is, for tables
    bounds     least and largest value that it can have, SI
    adjust     what moves it at the machine; None where nothing does
    expected   prior mean, SI, where an earlier session knows better than the drawing

    >>> from oed import Parameter
    >>> Parameter("l1", nominal=3.350, tolerance=0.5e-3, unit="m").tolerance
    0.0005
    """

    name: str
    nominal: float
    tolerance: float
    unit: str
    about: str = ""
    bounds: tuple[float, float] = (-np.inf, np.inf)
    adjust: Adjustment | None = None
    expected: float | None = None

    def __post_init__(self) -> None:
        if self.unit not in units.DISPLAY:
            raise ValueError(
                f"parameter {self.name}: unit {self.unit!r} is not SI (m, rad, s, N, K or 1)"
            )
        finite = np.isfinite(self.nominal) and np.isfinite(self.tolerance)
        if not finite or self.tolerance < 0.0:
            raise ValueError(
                f"parameter {self.name}: nominal and tolerance must be finite, tolerance >= 0"
            )
        if not self.bounds[0] <= self.nominal <= self.bounds[1]:
            raise ValueError(f"parameter {self.name}: nominal is out of its bounds")

    @property
    def mean(self) -> float:
        """Prior mean, SI: nominal without an earlier session."""
        return self.nominal if self.expected is None else self.expected


@dataclasses.dataclass(frozen=True, slots=True)
class CommonTolerance:
    """Parameters whose errors are correlated: parts of one batch, holes of one jig."""

    names: tuple[str, ...]  #: of the k parameters
    #: between each two of them, below 1; or all of them, (k, k)
    correlation: float | tuple[tuple[float, ...], ...]
