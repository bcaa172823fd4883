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
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from benchmarks.coverage.machines import Bench, configuration
from benchmarks.coverage.noise import draw as draw_noise
from benchmarks.harness.statistics import half_width
from oed import posterior
from oed.accuracy import driven_errors
from oed.estimation import Estimate, identify

if TYPE_CHECKING:
    import pandas as pd

#: posterior draws for intervals, those for bands, share that an interval holds
DRAWS, BAND_DRAWS, LEVEL = 2000, 200, 0.95
#: numbers nearer than this are one: straight up the axis of a delta no error changes
ROUNDING = 1e-12


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What holds the truth.

    combinations  (r,) whether each interval does
    nees          squared error of all combinations together, over their number
    bands         (n * k,) whether each pose component's interval does
    """

    combinations: np.ndarray
    nees: float
    bands: np.ndarray

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


# -- cells of the table ----------------------------------------------------------------

#: what the intervals promise, and the limits of the targets
PROMISE = 0.95
MEAN_LIMITS, NEES_LIMITS = (0.93, 0.97), (0.9, 1.15)
#: of the band of the worst share
WORST_BAND = 0.999


@dataclasses.dataclass(frozen=True)
class Share:
    """Share of intervals that hold the truth.

    mean    over machines and quantities
    half    half its 95 % interval; machines are independent, quantities are not
    worst   of one quantity over machines
    lowest  lower end of the 99.9 % band of a share that is truly 0.95
    """

    mean: float
    half: float
    worst: float
    lowest: float

    @property
    def mean_holds(self) -> bool:
        """Whether the mean is within its limits."""
        return MEAN_LIMITS[0] <= self.mean <= MEAN_LIMITS[1]

    @property
    def mean_may_hold(self) -> bool:
        """Whether the mean's interval reaches into its limits."""
        return _reaches(self.mean, self.half, MEAN_LIMITS)

    @property
    def worst_holds(self) -> bool:
        """Whether the worst share is within its band."""
        return self.worst >= self.lowest


@dataclasses.dataclass(frozen=True)
class Cell:
    """Figures of the machines of one cell.

    machines      how many
    combinations  of identifiable parameters
    bands         of pose components over the workspace
    nees          mean squared error over all combinations, over their number
    nees_half     half its 95 % interval
    """

    machines: int
    combinations: Share
    bands: Share
    nees: float
    nees_half: float

    @property
    def nees_holds(self) -> bool:
        """Whether the joint error is within its limits."""
        return NEES_LIMITS[0] <= self.nees <= NEES_LIMITS[1]

    @property
    def nees_may_hold(self) -> bool:
        """Whether the joint error's interval reaches into its limits."""
        return _reaches(self.nees, self.nees_half, NEES_LIMITS)


def _reaches(value: float, half: float, limits: tuple[float, float]) -> bool:
    return value - half <= limits[1] and value + half >= limits[0]


def summarise(results: Sequence[Mapping[str, Any]]) -> Cell:
    """The figures of machines' results."""
    nees = np.array([r["nees"] for r in results])
    return Cell(
        machines=len(results),
        combinations=_share([r["combinations"] for r in results]),
        bands=_share([r["bands"] for r in results]),
        nees=float(nees.mean()),
        nees_half=half_width(nees),
    )


def _share(texts: Sequence[str]) -> Share:
    inside = np.array([[mark == "1" for mark in text] for text in texts])
    count = len(inside)
    tail = 0.5 * (1.0 - WORST_BAND)
    return Share(
        mean=float(inside.mean()),
        half=half_width(inside.mean(axis=1)),
        worst=float(inside.mean(axis=0).min()),
        lowest=float(stats.binom.ppf(tail, count, PROMISE)) / count,
    )


def intervals(setting: Mapping[str, Any], seed: int) -> dict[str, Any]:
    """Which intervals hold the truth of machine `seed`, see `Outcome`.

    setting  configuration, law of the noise, and stream, the seed of all machines
    """
    bench = configuration(setting["configuration"])
    outcome = one_machine(bench, setting["law"], seed, setting["stream"])
    return outcome.as_json()


def coverage(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """Shares of intervals that hold the truth, of one cell of the table."""
    figures = summarise(cases.to_dict("records"))
    shares = {"combinations": figures.combinations, "bands": figures.bands}
    row: dict[str, Any] = {}
    for name, share in shares.items():
        row |= {f"{name} mean": share.mean, f"{name} half": share.half}
        row |= {f"{name} worst": share.worst, f"{name} lowest": share.lowest}
    return {**row, "nees": figures.nees, "nees half": figures.nees_half}


HEAD = (
    "| readings | noise | machines | combinations: mean | worst | pose bands: mean |"
    " worst | NEES/n |"
)


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One row a configuration and law.

    What misses its target is bold, or italic where it may hold.
    """
    cells: dict[tuple[str, str], list[Mapping[str, Any]]] = {}
    for row in rows:
        cells.setdefault((row["configuration"], row["law"]), []).append(row)
    lines = [HEAD, "| --- | --- | --: | --: | --: | --: | --: | --: |"]
    lines += [_row(*key, summarise(machines)) for key, machines in cells.items()]
    return "\n".join(lines)


def _row(name: str, law: str, cell: Cell) -> str:
    nees = _mark(
        f"{cell.nees:.2f} ± {cell.nees_half:.2f}", cell.nees_holds, cell.nees_may_hold
    )
    columns = [
        name,
        law,
        str(cell.machines),
        *_columns(cell.combinations),
        *_columns(cell.bands),
        nees,
    ]
    return f"| {' | '.join(columns)} |"


def _columns(share: Share) -> list[str]:
    mean = _mark(
        f"{share.mean:.3f} ± {share.half:.3f}", share.mean_holds, share.mean_may_hold
    )
    worst = _mark(f"{share.worst:.2f} ({share.lowest:.2f})", share.worst_holds, False)
    return [mean, worst]


def _mark(text: str, holds: bool, may_hold: bool) -> str:
    if holds:
        return text
    return f"*{text}*" if may_hold else f"**{text}**"
