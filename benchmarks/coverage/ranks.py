"""Simulation-based calibration: ranks of the truth among posterior draws.

    PYTHONPATH=. oed campaign --allow-code benchmarks/ranks.campaign.toml
    python -m benchmarks.harness ranks

Parameters are drawn from the tolerances and a noise law from its prior; the oracle
reads the machine and the law disturbs the readings. Then the rank of each truth among
draws from the posterior is uniform (Talts et al. 2018, arXiv 1804.06788): of every
identifiable combination, and of every coordinate of the noise law.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from scipy import stats

from benchmarks.coverage.intervals import generator, true_coordinates
from benchmarks.coverage.machines import Bench, configuration
from benchmarks.harness import tables
from oed import posterior
from oed.estimation import identify
from oed.measurement import reading_structure
from oed.noise_law import NoisePrior

#: columns of a row that are no ranks
NO_RANKS = ("configuration", "stream", "seed", "error", "cpu_s")
DRAWS = 99  #: draws that a rank is among


def joint_probability(ranks: np.ndarray, seed: int) -> float:
    """Probability of the farthest from uniform of ranks (machines, q), from 0 to DRAWS.

    By Kolmogorov and Smirnov, for all q quantities together (Bonferroni). Each rank stands
    for its bin, evenly.
    """
    rng = np.random.default_rng(seed)
    even = (ranks + rng.uniform(size=ranks.shape)) / (DRAWS + 1.0)
    probabilities = [stats.kstest(values, "uniform").pvalue for values in even.T]
    return min(1.0, len(probabilities) * float(min(probabilities)))


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


def table(rows: Sequence[Mapping[str, Any]]) -> str:
    """One row a configuration: what the ranks are of, and how uniform they are."""
    groups: dict[str, list[Mapping[str, Any]]] = {}
    for row in rows:
        groups.setdefault(row["configuration"], []).append(row)
    lines = [tables.head("readings", "machines", "quantities", "joint p")]
    for name, some in groups.items():
        names = [n for n, v in some[0].items() if n not in NO_RANKS and v is not None]
        ranks = np.array([[int(row[n]) for n in names] for row in some])
        joint = joint_probability(ranks, some[0]["stream"])
        lines.append(tables.row(name, *ranks.shape, f"{joint:.2g}"))
    return "\n".join(lines)
