"""Fits of readings whose misfit may be large: with noise as large as what remains.

With the stated noise, readings that do not fit take the parameters to where the model
says nothing any more.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TypeVar

from oed.base.arrays import Array
from oed.checks.fit import Fit, fit
from oed.checks.session import SessionReadings

#: rounds of fit and noise, and residuals over the noise that ask for no further one
ROUNDS, LITTLE = 4, 2.0
#: factor on the noise up to which the stated noise is tried as well
MAY_BE_NOISE = 100.0

Fitted = TypeVar("Fitted")


def fit_of_any_misfit(session: SessionReadings, scale: float) -> Fit | None:
    """Fit a session whose misfit may be large; None where it cannot be read.

    scale  guess of what remains, over the stated noise
    """
    return at_scale_of_misfit(
        lambda factor, before: fit(session, _theta_of(before), factor),
        lambda solution: solution,
        scale,
    )


def _theta_of(solution: Fit | None) -> Array | None:
    return None if solution is None else solution.theta


def at_scale_of_misfit(
    at_scale: Callable[[float, Fitted | None], Fitted | None],
    solution_of: Callable[[Fitted], Fit],
    scale: float,
) -> Fitted | None:
    """A fit with the noise as large as what remains, or with the stated one where little
    remains then.

    at_scale     fits with a factor on the noise, from where another fit ended
    solution_of  the solution of such a fit
    scale        guess of what remains, over the stated noise
    """
    fitted = at_scale(max(scale, 1.0), None)
    for _ in range(ROUNDS):
        if fitted is None:
            return None
        remains, factor = solution_of(fitted).remaining(), solution_of(fitted).scale
        if factor == 1.0 and remains <= LITTLE:
            return fitted
        if factor / LITTLE <= remains <= factor * LITTLE:
            break
        fitted = at_scale(max(remains, 1.0), fitted if remains < factor else None)
    if fitted is None or solution_of(fitted).scale > MAY_BE_NOISE:
        return fitted
    stated = at_scale(1.0, fitted)
    if stated is None or solution_of(stated).remaining() > LITTLE:
        return fitted
    return stated
