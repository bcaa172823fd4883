"""One stage of a plan: its readings, its time, and the knowledge that it leaves.

Before a stage, the machine's parameters have the information L = S^-1. Captured
readings (`travel`) add the information M, and the set-ups' parameters s are profiled
out of machine parameters m:

    L' = L + M_mm - M_ms (1 + M_ss)^-1 M_sm.

A machine that is far off loses nearly all readings, and will lose those of the next
stage as well. Where readings can be lost, machines are drawn (`drawn_machines`), and
each carries its own covariance and error. The linearisation residual is estimated from
the exact model (`linearisation`) and profiled out too.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.base import Array, Index
from oed.design.forms.protocol import inverse
from oed.design.stages.option import Option
from oed.design.stages.stage import linearisation
from oed.design.stages.stage.drawn_machines import DrawnMachines, draw_machines
from oed.design.stages.stage.knowledge import Knowledge, Prior, as_knowledge
from oed.design.stages.stage.profiled import profile
from oed.measurement import Series

#: machines drawn where readings can be lost: usually, and for a first look
DRAWS, FIRST_LOOK_DRAWS = 48, 12
#: machines drawn for the linearisation residual: at most in all, at least a pattern
RESIDUAL_DRAWS, LEAST_RESIDUAL_DRAWS = 96, 3


@dataclasses.dataclass(frozen=True, eq=False)
class PlanStage:
    """One stage.

    option             the measurement
    chosen             (N,) chosen candidates, ascending
    seconds            time for mounting and reading
    probability        (N,) that each chosen candidate is captured
    linearisation_rms  (readings,) residual after the stage, SI; empty: not estimated
    posterior          knowledge of the machine after the stage
    information        (n, n) that the stage adds
    """

    option: Option
    chosen: Index
    seconds: float
    probability: Array
    linearisation_rms: Array
    posterior: Knowledge
    information: Array

    @property
    def covariance(self) -> Array:
        """Mean square errors (n, n) of the parameters after it, in tolerance units."""
        return self.posterior.mean_square_error

    @property
    def series(self) -> tuple[Series, ...]:
        """The readings to take."""
        return self.option.series_of(self.chosen)

    @property
    def lost_share(self) -> float:
        """Expected share of the chosen candidates that are lost."""
        return float(1.0 - self.probability.mean())


def predict_stage(
    option: Option,
    chosen: Index,
    prior: Prior,
    probability: Array,
    rng: np.random.Generator,
    exact: bool = True,
    draws: int | None = None,
) -> PlanStage:
    """Predict what a stage with the chosen candidates leaves.

    probability  (C,) that each candidate of the option is captured, given the prior
    exact        False: a first look, with few machines and no linearisation residual
    draws        machines drawn where readings can be lost; half as many are drawn for
                 the linearisation residual
    """
    chosen = np.sort(chosen)
    knowledge = as_knowledge(prior)
    chosen_probability = probability[chosen]
    draws = (draws or DRAWS) if exact else FIRST_LOOK_DRAWS
    machines = draw_machines(option, chosen, knowledge, chosen_probability, draws, rng)
    information = _information(option, chosen, machines.patterns)
    rms = np.zeros(0)
    if exact:
        residual = _residual(option, chosen, machines, information, draws, rng)
        rms = residual.rms
        if residual.columns is not None:
            information = _information_with_residual(
                option, chosen, machines.patterns, rms, residual.columns
            )
    profiled = profile(information, knowledge.columns, option.unknowns)
    posterior = machines.update(profiled, rng)
    after = inverse(posterior.mean_square_error)
    before = inverse(knowledge.mean_square_error)
    return PlanStage(
        option=option,
        chosen=chosen,
        seconds=option.mounting_seconds + float(option.candidate_seconds[chosen].sum()),
        probability=chosen_probability,
        linearisation_rms=rms,
        posterior=posterior,
        information=_positive_part(after - before),
    )


def _positive_part(matrix: Array) -> Array:
    """The nearest positive semidefinite matrix.

    Machines that lose readings can be farther off after a stage than all machines were
    before. A difference of information would then be negative in some directions.
    """
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, 0.0)) @ vectors.T)


def profiled_information(blocks: Array, weights: Array, columns: int) -> Array:
    """Information (n, n) about the machine, set-ups' parameters profiled out.

    blocks   (N, k, n + s) whitened rows;  weights (N,) of the blocks
    columns  n
    """
    rows = (blocks * np.sqrt(weights)[:, None, None]).reshape(-1, blocks.shape[2])
    joint = rows.T @ rows
    setup_columns = blocks.shape[2] - columns
    if not setup_columns:
        return joint
    of_setups = joint[columns:, columns:] + np.eye(setup_columns)
    mixed = joint[columns:, :columns]
    profiled = mixed.T @ np.linalg.solve(of_setups, mixed)
    return joint[:columns, :columns] - profiled


def _information(option: Option, chosen: Index, patterns: Array) -> Array:
    """Information (G, w, w) about all unknowns of each pattern (G, N) of captures."""
    blocks = option.candidates.blocks[chosen]
    rows = blocks.reshape(-1, blocks.shape[2])
    candidate_of = np.repeat(np.arange(len(chosen)), blocks.shape[1])
    captured = patterns[:, candidate_of] > 0.0
    return np.array([_gram(rows[mask]) for mask in captured])


def _residual(
    option: Option,
    chosen: Index,
    machines: DrawnMachines,
    information: Array,
    draws: int,
    rng: np.random.Generator,
) -> linearisation.LinearisationResidual:
    """Linearisation residual with half of the draws, shared among the patterns."""
    per_pattern = min(draws // 2, RESIDUAL_DRAWS) // len(machines.patterns)
    count = max(per_pattern, LEAST_RESIDUAL_DRAWS)
    drawn = [
        np.resize(np.flatnonzero(machines.pattern_of == pattern), count)
        for pattern in range(len(machines.patterns))
    ]
    groups = machines.group_of[np.concatenate(drawn)]
    needed, posterior_of = np.unique(groups, return_inverse=True)
    return linearisation.estimate_residual(
        option,
        chosen,
        machines.joint_posterior(information, needed),
        posterior_of,
        machines.patterns,
        rng,
    )


def _information_with_residual(
    option: Option,
    chosen: Index,
    patterns: Array,
    rms: Array,
    columns: Array,
) -> Array:
    """Information (G, w + m, w + m) with the residual's columns (G, readings, m).

    rms  (readings,) of the residual, SI

    Readings which no machine reaches carry no information.
    """
    rows = linearisation.whitened_rows(option, chosen)
    counts = linearisation.reading_counts(option, chosen)
    candidate_of = np.repeat(np.arange(len(chosen)), counts)
    reachable = np.isfinite(rms)
    grams = []
    for pattern, of_pattern in zip(patterns, columns, strict=True):
        captured = (pattern[candidate_of] > 0.0) & reachable
        grams.append(_gram(np.hstack([rows, of_pattern])[captured]))
    return np.array(grams)


def _gram(rows: Array) -> Array:
    return rows.T @ rows
