"""The noise law, estimated: repeatability between runs, an error carried along a run.

The law is found where the evidence is largest for a given explanation, and weighed by
how much prior lies about it: of two laws that explain as much, one that had to be tuned
to the readings is less likely than one that holds anyhow. Readings far off are told
before (`strays`).
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from scipy import optimize, special

from oed.arrays import Array
from oed.noise.law import NoiseLaw, stated_law
from oed.noise.runs import Runs

#: prior of log(1 + share) of the run's and the carried error: of the size of the noise,
#: a factor of e either way
SPREAD = 1.0
#: prior of the log of the reach, in readings: about eight, a factor of e either way
REACH = np.log(8.0)
#: log of a share of the noise below which all are as likely
_LEAST = -2.0
#: log of the shares of a law that is said to be quiet, and of those from which on it
#: would be another
QUIET, LOUDER = -4.0, -3.0
#: coordinates of the shares: repeat, wander, sway; their bounds, those of the reach,
#: and of channels' ratios either way
_SHARES = [0, 1, 3]
_BOUNDS = ((-8.0, 5.0), (-8.0, 5.0), (0.4, 4.5), (-8.0, 5.0))
_RATIO = 4.0
#: ways from the best value of a coordinate at which a law's worth is looked at, and
#: worth behind that counts no more
STEPS, NOTHING = (0.1, 0.3, 0.7, 1.5, 3.0, 6.0), 6.0
#: where a search begins: white, runs that do not repeat, an error carried along
START_POINTS = tuple(
    np.array(v)
    for v in (
        (-2.0, -2.0, REACH, -2.0),
        (0.0, -2.0, REACH, -1.0),
        (-2.0, 0.5, REACH, -2.0),
    )
)


def fit(
    runs: Runs,
    log_evidence: Callable[[NoiseLaw], float],
    start: NoiseLaw | None = None,
) -> tuple[NoiseLaw, float]:
    """The law of largest evidence times prior, and the log of the prior mass about it.

    `log_evidence` is of the readings under a law, their level integrated out. The
    variances of single readings stay as in `start`; the level is 1.
    """
    given = start is not None
    start = stated_law(runs) if start is None else start
    groups = int(runs.channel.max()) + 1
    bounds = (*_BOUNDS, *[(-_RATIO, _RATIO)] * (groups - 1))

    def law(v: Array) -> NoiseLaw:
        ratio = None
        if groups > 1:
            ratio = np.exp(np.concatenate([[0.0], v[4:]]))[runs.channel]
        return dataclasses.replace(_law(start, v), level=1.0, channel_ratio=ratio)

    def cost(v: Array) -> float:
        inside = all(
            low < value < high for value, (low, high) in zip(v, bounds, strict=True)
        )
        if not inside:
            return 1e9
        return -(log_evidence(law(v)) + _prior(v))

    first = _first(runs, start)
    starts = (
        [first] if given else [np.concatenate([v, first[4:]]) for v in START_POINTS]
    )
    best = min((_descend(cost, v) for v in starts), key=lambda minimum: minimum[1])
    return law(best[0]), _prior(best[0]) + _about(cost, *best)


def _about(cost: Callable[[Array], float], v: Array, least: float) -> float:
    """Log volume, in the coordinates of shares and reach, of the laws about one at v
    that are as good: along each coordinate the integral of exp(least - cost), straight
    in the exponent between places.
    """
    unit = np.eye(len(v))

    def side(i: int, sign: float, end: float) -> float:
        return _side(lambda far: least - cost(v + sign * far * unit[i]), end)

    volume = [
        side(i, -1.0, v[i] - low) + side(i, 1.0, high - v[i])
        for i, (low, high) in enumerate(_BOUNDS)
    ]
    return float(np.log(volume).sum())


def _side(height: Callable[[float], float], end: float) -> float:
    """Integral of exp(height), height 0 at the start, to just before the end or to
    where it counts no more.
    """
    whole, at, before = 0.0, 0.0, 0.0
    for step in (*STEPS, np.inf):
        far = min(step, end * (1.0 - 1e-9))
        here = height(far)
        whole += (far - at) * np.exp(before) * special.exprel(here - before)
        at, before = far, here
        if here < -NOTHING or far < step:
            break
    return float(whole)


def _first(runs: Runs, law: NoiseLaw) -> Array:
    """Coordinates of a law."""
    groups = int(runs.channel.max()) + 1
    ratios = np.zeros(groups - 1)
    if law.channel_ratio is not None:
        ratios = np.log(
            [law.channel_ratio[runs.channel == g][0] for g in range(1, groups)]
        )
    return np.array(
        [
            _inverse(law.run_sd),
            _inverse(law.ar1_sd),
            np.log(law.ar1_length),
            _inverse(law.run_harmonic_sd),
            *ratios,
        ]
    )


def _law(start: NoiseLaw, v: Array) -> NoiseLaw:
    """The law at coordinates (4,) of its shares and its reach."""
    shares = [_size(s) for s in v[_SHARES]]
    return dataclasses.replace(
        start,
        run_sd=shares[0],
        ar1_sd=shares[1],
        ar1_length=float(np.exp(v[2])),
        run_harmonic_sd=shares[2],
    )


def _descend(cost: Callable[[Array], float], start: Array) -> tuple[Array, float]:
    simplex = np.vstack([start, *(start + 0.7 * e for e in np.eye(len(start)))])
    options = {
        "initial_simplex": simplex,
        "xatol": 0.1,
        "fatol": 0.1,
        "maxfev": 20 * len(start),
    }
    minimum = optimize.minimize(cost, start, method="Nelder-Mead", options=options)
    return minimum.x, float(minimum.fun)


def _size(v: float) -> float:
    """A share of the noise from its coordinate: the logarithm, smoothly ending at 0."""
    return float(np.exp(v)) if v > -6.0 else 0.0


def _inverse(size: float) -> float:
    return float(np.clip(np.log(max(size, 1e-3)), -4.0, 4.0))


def _prior(v: Array) -> float:
    """Log prior: each share about half the noise; small ones are all alike."""
    shares = np.maximum(v[_SHARES], _LEAST)
    penalty = ((shares + 1.0) / 1.5) ** 2
    return float(
        -0.5 * penalty.sum()
        - 0.5 * ((v[2] - REACH) / SPREAD) ** 2
        - 0.5 * (v[4:] ** 2).sum()
    )


def without_run_noise(law: NoiseLaw) -> tuple[NoiseLaw, float]:
    """The law without errors that a run or its readings share, and the log of the prior
    that lies about it: whatever is seen is then a gap.
    """
    v = np.array([QUIET, QUIET, REACH, QUIET])
    volume = [LOUDER - _BOUNDS[i][0] for i in _SHARES] + [SPREAD * np.sqrt(2.0 * np.pi)]
    return _law(law, v), _prior(v) + float(np.log(volume).sum())


def describe(runs: Runs, law: NoiseLaw) -> tuple[str, ...]:
    """A law as a person reads it."""
    sentences = [f"single readings scatter by {law.level:.2g} times the stated noise"]
    if law.run_sd > 0.2:
        sentences.append(
            f"a run repeats to {law.level * law.run_sd:.2g} times the stated noise"
        )
    if law.run_harmonic_sd > 0.2:
        sentences.append(
            f"a run's first harmonic repeats to {law.level * law.run_harmonic_sd:.2g} times the"
            " stated noise"
        )
    if law.ar1_sd > 0.2:
        sentences.append(
            f"an error of {law.level * law.ar1_sd:.2g} times the stated noise is"
            f" carried along over about {law.ar1_length:.0f} readings"
        )
    if np.isfinite(law.student_dof):
        sentences.append(
            f"readings far off are frequent (Student t with {law.student_dof:.2g} degrees of"
            " freedom)"
        )
    if law.outlier_share > 0.0:
        sentences.append(
            f"about {100.0 * law.outlier_share:.2g} % of the readings are far off"
        )
    return tuple(sentences)
