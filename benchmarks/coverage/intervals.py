"""Which intervals of virtual machines hold the truth, by machine and noise.

    PYTHONPATH=. oed campaign --allow-code benchmarks/coverage.campaign.toml
    python -m benchmarks.harness coverage

A machine is read by the oracle, identified, and compared with the truth. A combination's
true value is the one that gives the oracle's readings without noise, with the lost
directions at nominal: what readings can say of it. (A lost direction of a millimetre
moves a combination by micrometres, to second order.)
"""

from __future__ import annotations

import dataclasses
import zlib
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.coverage.machines import Bench, configuration
from benchmarks.coverage.noise import draw as draw_noise
from benchmarks.harness import tables
from benchmarks.harness.statistics import half_width
from oed import posterior
from oed.accuracy import driven_errors
from oed.estimation import Estimate, identify

#: posterior draws for intervals, those for bands, share that an interval holds
DRAWS, BAND_DRAWS, LEVEL = 2000, 200, 0.95
#: numbers nearer than this are one: straight up the axis of a delta no error changes
ROUNDING = 1e-12


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What holds the truth."""

    combinations: np.ndarray  #: (r,) whether each interval does
    nees: float  #: squared error of all combinations together, over their number
    bands: np.ndarray  #: (n * k,) whether each pose component's interval does

    def as_json(self) -> dict[str, Any]:
        """Masks as texts of 0 and 1."""
        return {
            "combinations": _text(self.combinations),
            "nees": self.nees,
            "bands": _text(self.bands),
        }


def _text(mask: np.ndarray) -> str:
    return "".join("1" if value else "0" for value in mask.ravel())


def generator(seed: int, *labels: str | int) -> np.random.Generator:
    """A stream of its own for each configuration, law and machine."""
    numbers = [v if isinstance(v, int) else zlib.crc32(v.encode()) for v in labels]
    return np.random.default_rng([seed, *numbers])


def one_machine(
    bench: Bench, law: str, number: int, seed: int, *, estimate_noise: bool = True
) -> Outcome:
    """Machine `number` of a configuration, read under a law of `noise.LAWS`.

    The fit estimates the noise law, or takes the stated noise.
    """
    m = bench.measurement
    truth_rng = generator(seed, bench.name, number)
    truth = m.nominal + m.tolerance * truth_rng.standard_normal(len(m.nominal))
    rng = generator(seed, bench.name, law, number)
    exact = bench.read(truth)
    y = exact + draw_noise(law, bench.layout, rng)
    estimate = identify(
        m, bench.series, y, stages=bench.stages, estimate_noise=estimate_noise
    )
    z, _, _ = posterior.draw_coordinates(estimate, rng, DRAWS)
    inside, nees = _combinations(bench, estimate, z, exact)
    density = posterior.LogDensity(m, bench.series, y, estimate)
    theta = density.draw_theta(rng, z[:BAND_DRAWS])
    return Outcome(inside, nees, _bands(bench, estimate, theta, truth))


def _combinations(
    bench: Bench, estimate: Estimate, z: np.ndarray, exact: np.ndarray
) -> tuple[np.ndarray, float]:
    """Which combinations' intervals hold the truth (r,), and the joint error."""
    # In coordinates that are the same for every machine.
    turn = bench.coordinates.dual @ estimate.coordinates.basis
    true = turn @ true_coordinates(bench, estimate, exact)
    draws = z @ turn.T
    mean = turn @ estimate.z
    error = true - mean
    covariance = np.cov(draws.T)
    nees = error @ np.linalg.solve(covariance, error) / len(error)
    return _holds(draws, true), float(nees)


def true_coordinates(bench: Bench, estimate: Estimate, exact: np.ndarray) -> np.ndarray:
    """Coordinates (r,) whose readings are the exact ones (N,)."""
    return estimate.coordinates.match_readings(
        bench.measurement, bench.series, exact, estimate.z
    )


def _bands(
    bench: Bench, estimate: Estimate, theta: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """Which pose components' intervals (n, k) hold the compensated machine's error."""
    keep = len(bench.measurement.machine.parameters)
    identified = estimate.theta[:keep]
    errors = driven_errors(
        bench.measurement.kinematics,
        bench.command,
        theta[:, :keep],
        "home",
        believed=identified,
    )
    return _holds(errors, bench.errors(identified, truth[:keep]))


def _holds(draws: np.ndarray, true: np.ndarray) -> np.ndarray:
    """Whether the central interval of draws (m, ...) holds the true values (...)."""
    tail = 0.5 * (1.0 - LEVEL)
    # So that intervals of few draws hold the share that they promise.
    low, high = np.quantile(draws, [tail, 1.0 - tail], axis=0, method="weibull")
    return (low - ROUNDING <= true) & (true <= high + ROUNDING)


# -- the case and its table ------------------------------------------------------------
WORST_BAND = 0.999  #: of the band of the worst share
HEAD = ("readings", "noise", "machines", "combinations: mean", "worst")


def intervals(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Which intervals hold the truth of machine `seed`, see `Outcome`.

    setting  configuration, law of the noise, and stream, the seed of all machines
    """
    bench = configuration(setting["configuration"])
    outcome = one_machine(bench, setting["law"], seed, setting["stream"])
    return outcome.as_json()


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One row a configuration and law: shares that hold the truth, and the joint error.

    A mean share is over machines and quantities; a worst one is of one quantity, with the
    lower end of the 99.9 % band of a share that is truly 0.95.
    """
    groups: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault((row["configuration"], row["law"]), []).append(row)
    lines = [tables.head(*HEAD, "pose bands: mean", "worst", "NEES/n")]
    for key, machines in groups.items():
        nees = [row["nees"] for row in machines]
        cells = [
            *share_cells([row["combinations"] for row in machines]),
            *share_cells([row["bands"] for row in machines]),
            f"{np.mean(nees):.2f} ± {half_width(nees):.2f}",
        ]
        lines.append(tables.row(*key, len(machines), *cells))
    return "\n".join(lines)


def share_cells(texts: Sequence[str]) -> list[str]:
    """Mean share of intervals that hold the truth, and that of the worst quantity."""
    inside = np.array([[mark == "1" for mark in text] for text in texts])
    # machines are independent, quantities are not
    half = half_width(inside.mean(axis=1))
    worst = inside.mean(axis=0).min()
    count = len(inside)
    lowest = stats.binom.ppf(0.5 * (1.0 - WORST_BAND), count, LEVEL) / count
    return [f"{inside.mean():.3f} ± {half:.3f}", f"{worst:.2f} ({lowest:.2f})"]
