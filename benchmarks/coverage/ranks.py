"""Simulation-based calibration: ranks of the truth among posterior draws.

    PYTHONPATH=. oed campaign --allow-code benchmarks/ranks.campaign.toml
    python -m benchmarks.harness ranks

Parameters are drawn from the tolerances and a noise law from its prior; the oracle
reads the machine and the law disturbs the readings. Then the rank of each truth among
draws from the posterior is uniform (Talts et al. 2018, arXiv 1804.06788): of every
identifiable combination, and of every coordinate of the noise law.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from scipy import stats

from benchmarks.coverage.intervals import generator, true_coordinates
from benchmarks.coverage.machines import Bench, configuration
from oed import posterior
from oed.estimation import identify
from oed.measurement import reading_structure
from oed.noise_law import NoisePrior

if TYPE_CHECKING:
    import pandas as pd

#: columns of a row that are no ranks
NO_RANKS = ("configuration", "stream", "seed", "error", "cpu_s")
#: draws that a rank is among
DRAWS = 99
BINS = 10
#: probability below which ranks count as not uniform
MIN_PROBABILITY = 0.01


@dataclasses.dataclass(frozen=True)
class Calibration:
    """Ranks of q quantities over machines.

    names          of the quantities
    ranks          (machines, q) from 0 to DRAWS
    probabilities  (q,) of ranks as far from uniform, by Kolmogorov and Smirnov
    """

    names: tuple[str, ...]
    ranks: np.ndarray
    probabilities: np.ndarray

    @property
    def joint(self) -> float:
        """Probability of the farthest, for all quantities together (Bonferroni)."""
        return min(1.0, len(self.names) * float(self.probabilities.min()))

    @property
    def counts(self) -> np.ndarray:
        """Ranks of all quantities in bins of equal width (BINS,)."""
        edges = np.linspace(0.0, DRAWS + 1.0, BINS + 1)
        return np.histogram(self.ranks, edges)[0]


def calibration(names: Sequence[str], ranks: np.ndarray, seed: int) -> Calibration:
    """Test of ranks (machines, q). Each rank stands for its bin, evenly."""
    rng = np.random.default_rng(seed)
    even = (ranks + rng.uniform(size=ranks.shape)) / (DRAWS + 1.0)
    probabilities = [stats.kstest(values, "uniform").pvalue for values in even.T]
    return Calibration(tuple(names), ranks, np.array(probabilities))


def one_machine(bench: Bench, number: int, seed: int) -> dict[str, int]:
    """Rank of each combination and of each coordinate of the noise law."""
    m = bench.measurement
    structure = reading_structure(m, bench.series, m.nominal)
    # as the fit has it: with few readings beyond the unknowns no course is in the model
    prior = NoisePrior.of(structure, len(structure) - bench.coordinates.basis.shape[1])
    rng = generator(seed, "ranks", bench.name, number)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    law = rng.standard_normal(prior.dimensions)
    errors = prior.laws(law[None]).whitening(structure).draw(rng)[0]
    exact = bench.read(truth)
    y = exact + structure.restore(errors)
    estimate = identify(m, bench.series, y, stages=bench.stages, estimate_noise=True)
    fitted = estimate.noise_posterior
    assert fitted is not None
    z, _, _ = posterior.draw_coordinates(estimate, rng, DRAWS)
    laws = fitted.draws[rng.choice(len(fitted.weights), size=DRAWS, p=fitted.weights)]
    turn = bench.coordinates.dual @ estimate.coordinates.basis
    true = turn @ true_coordinates(bench, estimate, exact)
    below = (z @ turn.T < true).sum(axis=0)
    ranks = {f"combination {k + 1}": int(v) for k, v in enumerate(below)}
    of_law = (laws < law).sum(axis=0)
    return ranks | {n: int(v) for n, v in zip(prior.names, of_law, strict=True)}


def truth_ranks(setting: Mapping[str, Any], seed: int) -> dict[str, int]:
    """Rank of each truth of machine `seed` among posterior draws.

    setting  configuration, and stream, the seed of all machines
    """
    bench = configuration(setting["configuration"])
    return one_machine(bench, seed, setting["stream"])


def calibration_of_rows(rows: Sequence[Mapping[str, Any]]) -> Calibration:
    """The test of the ranks of one configuration's machines."""
    names = [n for n, v in rows[0].items() if n not in NO_RANKS and v is not None]
    values = np.array([[int(row[n]) for n in names] for row in rows])
    return calibration(names, values, rows[0]["stream"])


def uniformity(cases: pd.DataFrame, setting: Mapping[str, Any]) -> dict[str, Any]:
    """Probability that all ranks are uniform, and their counts in bins."""
    ranks = cases.dropna(axis="columns").to_dict("records")
    result = calibration_of_rows([{**setting, **row} for row in ranks])
    row: dict[str, Any] = {"quantities": len(result.names), "joint p": result.joint}
    return row | {f"bin {k + 1}": int(n) for k, n in enumerate(result.counts)}


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One row a configuration: what the ranks are of, and how uniform they are."""
    machines: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        machines.setdefault(row["configuration"], []).append(row)
    bins = " | ".join(str(k + 1) for k in range(BINS))
    lines = [f"| readings | machines | quantities | joint p | {bins} |"]
    lines.append(f"| --- | --: | --: | --: |{' --: |' * BINS}")
    for name, some in machines.items():
        result = calibration_of_rows(some)
        joint = f"{result.joint:.2g}"
        if result.joint < MIN_PROBABILITY:
            joint = f"**{joint}**"
        count, quantities = result.ranks.shape
        counts = " | ".join(str(number) for number in result.counts)
        lines.append(f"| {name} | {count} | {quantities} | {joint} | {counts} |")
    return "\n".join(lines)
