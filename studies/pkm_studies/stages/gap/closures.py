"""States how far the gap shrinks on held-out readings, or by how much it grows."""

from __future__ import annotations

import math

from oed.result.gap import LEAST_CLOSURE, ClosureRecord, GapSection
from pkm_studies.stages.gap.words import format_probability, join_words, plain_name

SPLITS = {
    "within": "on held-out stretches of runs",
    "whole": "on whole held-out runs",
}


def sentences(gap: GapSection) -> list[str]:
    """How far the gap shrinks on held-out readings, or by how much it grows there."""
    if not gap.effect_reported:
        return []
    known = [(c, c.value) for c in gap.closure if c.value is not None]
    shrinking = [_closure(c, value) for c, value in known if value >= 0.0]
    growing = [_growth(c, value) for c, value in known if value < 0.0]
    causes = join_words([plain_name(n) for n in gap.selected]) or "the remainder"
    lead = (
        f"With {causes} in the model, the mean square of what calibration leaves beyond"
        " the noise"
    )
    words = []
    if shrinking:
        words.append(f"{lead} shrinks by {join_words(shrinking)}.")
    if growing:
        words.append(
            f"{lead} grows by {join_words(growing)}: what was fitted to the other readings"
            " does not carry over to these."
        )
    return words


def may_grow(gap: GapSection) -> bool:
    """Whether the gap may grow in every way of holding readings out that is known."""
    lows = [closure.low for closure in gap.closure if closure.low is not None]
    return bool(lows) and max(lows) < 0.0


def unproven(gap: GapSection) -> str:
    """Advice where no held-out reading confirms what is named."""
    harms = [closure.p_worse for closure in gap.closure if closure.p_worse is not None]
    chance = f" (probability {format_probability(max(harms))})" if harms else ""
    return (
        "Measure before you exchange or correct anything: on held-out readings the"
        f" correction may do harm{chance}."
    )


def _closure(closure: ClosureRecord, value: float) -> str:
    """`80 % (60 to 90 %) on whole held-out runs`, of a closure that is no growth."""
    digits = _digits(closure.low)
    if value == 0.0:
        size = "nothing"
    elif value < 1.0:
        size = f"{_format_share(value, digits)} %"
    else:
        size = "all that exceeds the noise"
    interval = _interval(closure, digits)
    return f"{size}{interval} {SPLITS.get(closure.split, closure.split)}"


def _growth(closure: ClosureRecord, value: float) -> str:
    """`40 % (90 % more to 10 % less) on whole held-out runs`, of a closure below 0."""
    size = "over 100 %"
    if value >= LEAST_CLOSURE:
        size = f"{-100.0 * value:.0f} %{_interval(closure, 0)}"
    return f"{size} {SPLITS.get(closure.split, closure.split)}"


def _interval(closure: ClosureRecord, digits: int) -> str:
    """` (60 to 90 %)`, of which an end below 0 is growth; "" where it is not known."""
    low, high = closure.low, closure.high
    if low is None or high is None:
        return ""
    if low < 0.0:
        return f" ({_bound_in_words(low)} to {_bound_in_words(high)})"
    return f" ({_format_bound(low, digits)} to {_format_bound(high, digits)} %)"


def _bound_in_words(share: float) -> str:
    """`40 % more` or `10 % less`: an end of the interval of a share by which it shrinks."""
    if share < LEAST_CLOSURE:
        return "over 100 % more"
    return f"{abs(100.0 * min(share, 1.0)):.0f} % {'more' if share < 0.0 else 'less'}"


def _digits(low: float | None) -> int:
    """Decimals of a percentage: near 100 %, enough to show that something remains."""
    if low is None or low < 0.99:
        return 0
    return 1 if low < 0.999 else 2


def _format_share(value: float, digits: int) -> str:
    """A share in percent, never rounded up to the whole."""
    scaled, whole = value * 10 ** (digits + 2), 10 ** (digits + 2)
    rounded = round(scaled)
    if value < 1.0 and rounded >= whole:
        rounded = math.floor(scaled)
    return f"{rounded / 10**digits:.{digits}f}"


def _format_bound(value: float, digits: int) -> str:
    """An end of the interval of a share; no gap shrinks by more than 100 %."""
    return _format_share(min(value, 1.0), digits)
