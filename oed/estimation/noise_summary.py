"""The noise law as estimated: its numbers with standard deviations, over all laws.

A number departs from the stated noise where a difference that matters has the
probability `P_DEPARTURE`: single readings that scatter by a fifth more or less, an error of a
run or of a seat that is half the stated noise, a quarter of the variance correlated.
"""

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from oed import units
from oed.base import Array, Mask
from oed.instrument import Setup
from oed.noise import Laws
from oed.noise_law import NoisePosterior
from oed.result import NoiseRecord

#: probability from which on a departure from the stated noise is reported
P_DEPARTURE = 0.95
#: kinds of numbers that are standard deviations
ERRORS = ("reading", "run", "seat", "course")
MIN_RATIO = 1.2  #: factor on the stated noise beyond which single readings depart
#: size, over the stated noise, beyond which an error that a run shares departs
SHARED_SIZE = 0.5
#: share of the variance that is correlated beyond which it departs from the stated one
CORRELATED_SHARE = 0.25


def noise_numbers(
    posterior: NoisePosterior, setups: Mapping[str, Setup]
) -> list[NoiseRecord]:
    """An estimated law's numbers, in fine units; its reach at most a run's length."""
    prior, structure, weights = posterior.prior, posterior.structure, posterior.weights
    laws = prior.laws(posterior.draws)
    # channels with common sources have part of the noise of each
    variances = structure.variances.sum(axis=1)
    of_channels = structure.variances.T / variances
    scales = np.sqrt(laws.scale**2 @ of_channels)
    within = laws.scale * _scatter_within_run(laws, structure.longest)[:, None]
    scatter = np.sqrt(within**2 @ of_channels)
    records: list[NoiseRecord] = []
    seated: dict[str, NoiseRecord] = {}
    for g, name in enumerate(structure.names):
        setup_name, _, channel = name.rpartition(".")
        setup = setups[setup_name]
        stated = _stated(setup, channel, float(np.sqrt(variances[g])))
        records += _channel_numbers(
            name, stated, scales[:, g], scatter[:, g], laws, posterior
        )
        if setup.instrument.renewed and setup.statement.seating != 0.0:
            seat, expected = _seats(setup, stated.sigma, scales[:, g], laws)
            far = seat - expected > SHARED_SIZE * stated.sigma
            seated[setup.name] = _record(
                weights, "seat", setup.name, stated.unit, seat, expected, far
            )
    records += seated.values()
    if prior.CORRELATED in prior.names:
        statement = structure.statement
        share, stated_share = laws.correlated, statement.correlated_share
        far = share - stated_share > CORRELATED_SHARE
        records.append(_record(weights, "carried", "", "1", share, stated_share, far))
        never = np.zeros(len(laws), dtype=bool)
        # beyond the longest run, readings cannot tell how far it goes
        reach = np.minimum(laws.reach, structure.longest)
        records.append(
            _record(weights, "reach", "", "readings", reach, statement.reach, never)
        )
    return records


def _record(
    weights: Array,
    kind: str,
    of: str,
    unit: str,
    values: Array,
    stated: float | None,
    far: Mask,
) -> NoiseRecord:
    """A number with its values (L,) by the weights of laws, and where they depart."""
    fine = units.FINE.get(unit, unit) if kind in ERRORS else unit
    factor = units.factor(fine) if kind in ERRORS else 1.0
    mean = float(weights @ values)
    sd = float(np.sqrt(weights @ (values - mean) ** 2))
    # roots of mean squares are as stated but for their rounding
    rounded = None if stated is None else float(f"{stated / factor:.12g}")
    departs = bool(weights @ far > P_DEPARTURE)
    return NoiseRecord(kind, of, mean / factor, sd / factor, fine, rounded, departs)


def _channel_numbers(
    name: str,
    stated: "_StatedChannel",
    scale: Array,
    scatter: Array,
    laws: Laws,
    posterior: NoisePosterior,
) -> Iterator[NoiseRecord]:
    """Scatter of single readings, error of a run and course of a channel."""
    prior, weights = posterior.prior, posterior.weights
    sigma, unit = stated.sigma, stated.unit
    is_larger = weights @ scatter > 1.0
    far = (scatter > MIN_RATIO) if is_larger else (scatter < 1.0 / MIN_RATIO)
    yield _record(weights, "reading", name, unit, sigma * scatter, sigma, far)
    level, stated_level = _run_errors(stated, scale, laws)
    has_level = stated.shared > 0.0 if stated.is_level else prior.RUN in prior.names
    if has_level:
        whole = sigma * np.hypot(level, stated_level)
        excess = stated_level - stated.shared if stated.is_level else level
        expected = sigma * stated.shared
        far = excess > SHARED_SIZE
        yield _record(weights, "run", name, unit, whole, expected, far)
    if prior.COURSE in prior.names:
        course = scale * laws.course
        far = course > SHARED_SIZE
        yield _record(weights, "course", name, unit, sigma * course, 0.0, far)


def _scatter_within_run(laws: Laws, longest: int) -> Array:
    """Scatter (L,) about the mean of the longest run, over that of a single reading.

    With decay d, the mean correlation of two of n readings is 2 d (n (1 - d) - (1 -
    d^n)) / (n (n - 1) (1 - d)^2).
    """
    fresh = -np.expm1(-1.0 / laws.reach)
    whole = -np.expm1(-longest / laws.reach)
    pairs = max(longest * (longest - 1), 1)
    related = 2.0 * (1.0 - fresh) * (longest * fresh - whole) / (pairs * fresh**2)
    return np.asarray(np.sqrt(1.0 - laws.correlated * related))


@dataclasses.dataclass(frozen=True, slots=True)
class _StatedChannel:
    """What is stated of a channel: sd (rms over readings), SI, error of a run over it."""

    sigma: float
    shared: float
    unit: str
    is_level: bool  #: whether that error is all that the level of a run moves by


def _stated(setup: Setup, channel: str, sigma: float) -> _StatedChannel:
    names = [c.name for c in setup.instrument.channels]
    k = names.index(channel)
    stated = setup.instrument.channels[k]
    is_level = channel in setup.statement.levels
    return _StatedChannel(sigma, stated.shared, stated.unit, is_level)


def _run_errors(
    stated: _StatedChannel, scale: Array, laws: Laws
) -> tuple[Array, Array]:
    """Errors (L,) of a run's level, of unknown and of known size, over the stated noise."""
    if stated.is_level:
        return np.zeros(len(laws)), scale * stated.shared * laws.stated_level
    return scale * laws.level, scale * stated.shared


def _seats(setup: Setup, sigma: float, scale: Array, laws: Laws) -> tuple[Array, float]:
    """Errors (L,) of what a run seats anew, SI, and what is stated of them."""
    seating = setup.statement.seating
    if seating is None:
        return sigma * scale * laws.seat, 0.0
    return scale * laws.stated_seat * seating, seating
