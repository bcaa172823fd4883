"""The noise law as estimated: its numbers with standard deviations, over all laws.

A number departs from the stated noise where a difference that matters has the
probability `SURE`: single readings that scatter by a fifth more or less, an error of a
run or of a seat that is half the stated noise, a quarter of the variance carried along.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np

from oed.arrays import Array, Mask
from oed.instrument import Setup
from oed.noise.marginal import NoisePosterior

#: probability from which on a departure is reported
SURE = 0.95
#: factor on the stated noise, share of it that a run shares, and share of the variance
#: carried along, beyond which a law is another than the stated one
SCATTER, SHARED, CARRIED = 1.2, 0.5, 0.25


@dataclasses.dataclass(frozen=True, slots=True)
class NoiseNumber:
    """One number of the noise law.

    kind     reading, run, seat (standard deviations), carried (share of the variance) or
             reach (in readings)
    of       set-up and channel, `cup.length`; set-up for a seat; "" for all readings
    unit     SI unit of a standard deviation; 1 for a share, `readings` for the reach
    value    posterior mean, SI
    sd       posterior standard deviation, SI
    stated   what the stated noise has, SI; None for the reach
    departs  whether it surely differs from that by more than matters
    """

    kind: str
    of: str
    unit: str
    value: float
    sd: float
    stated: float | None
    departs: bool


def noise_numbers(
    posterior: NoisePosterior, setups: Mapping[str, Setup]
) -> list[NoiseNumber]:
    """The numbers of an estimated law, for readings of these set-ups."""
    return list(_numbers(posterior, setups))


def _numbers(
    posterior: NoisePosterior, setups: Mapping[str, Setup]
) -> Iterator[NoiseNumber]:
    laws, weights = posterior.prior.laws(posterior.draws), posterior.weights

    def number(
        kind: str, of: str, unit: str, values: Array, stated: float | None, far: Mask
    ) -> NoiseNumber:
        mean = float(weights @ values)
        sd = float(np.sqrt(weights @ (values - mean) ** 2))
        departs = bool(weights @ far > SURE)
        return NoiseNumber(kind, of, unit, mean, sd, stated, departs)

    seated: dict[str, NoiseNumber] = {}
    for g, name in enumerate(posterior.structure.names):
        setup = setups[name.rpartition(".")[0]]
        sigma, shared, unit = _stated(setup, name.rpartition(".")[2])
        scale = laws.scale[:, g]
        far = (scale > SCATTER) if weights @ scale > 1.0 else (scale < 1.0 / SCATTER)
        yield number("reading", name, unit, sigma * scale, sigma, far)
        level = scale * laws.level
        whole = sigma * np.hypot(level, shared * scale)
        yield number("run", name, unit, whole, sigma * shared, level > SHARED)
        if setup.instrument.renewed and posterior.prior.has_seat:
            seat = scale * laws.seat
            seated[setup.name] = number(
                "seat", setup.name, unit, sigma * seat, 0.0, seat > SHARED
            )
    yield from seated.values()
    yield number("carried", "", "1", laws.carried, 0.0, laws.carried > CARRIED)
    never = np.zeros(len(laws), dtype=bool)
    yield number("reach", "", "readings", laws.reach, None, never)


def _stated(setup: Setup, channel: str) -> tuple[float, float, str]:
    """Stated standard deviation, SI, error of a run over it, and SI unit of a channel."""
    names = [c.name for c in setup.instrument.channels]
    k = names.index(channel)
    stated = setup.instrument.channels[k]
    return setup.sigma[k], stated.shared, stated.unit
