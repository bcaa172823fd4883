"""Sessions of a planar machine read along straight lines, with a ruler that may be bent."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pandas as pd

from kernel.dense_noise import law_covariance
from kernel.laws import STATED_LAW
from oed.gap.data import problem as problems
from oed.gap.data.problem import GapProblem
from oed.measurement.measurement import Measurement
from oed.model.instrument import mount
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof

#: points of a line, heights of the lines, m, passes of all lines both ways
POINTS, HEIGHTS, PASSES = 11, (0.0, 0.7, 1.4), 2
#: half the length of the ruler, m
RULER = 1.5


def ruler_session(
    setups: Sequence[str], bow: float, seed: int, *, interleaved: bool
) -> GapProblem:
    """Lines along y by rm2 and rm5; the ruler of the first set-up sags by `bow`, m.

    interleaved  passes take turns between the set-ups; otherwise one follows the other
    """
    instruments = [mount(getattr(relative, name), name) for name in setups]
    measurement = Measurement(planar_2dof.machine, instruments)
    y = np.linspace(-1.4, 1.4, POINTS)
    turns = [(name, k) for name in setups for k in range(PASSES)]
    if interleaved:
        turns = [(name, k) for k in range(PASSES) for name in setups]
    lines: dict[str, list[tuple[np.ndarray, pd.DataFrame]]] = {s: [] for s in setups}
    clock = 0.0
    for name, k in turns:
        for height in HEIGHTS:
            for way in (1, -1):
                command = np.column_stack([y[::way], np.full(POINTS, height)])
                rows = pd.DataFrame(
                    {
                        "setup": name,
                        "run": f"{name} {k} {height} {way}",
                        "order": np.arange(1, POINTS + 1),
                        "time": clock + 20.0 * np.arange(POINTS),
                        "direction": float(way),
                    }
                )
                lines[name].append((command, rows))
                clock += 20.0 * POINTS + 60.0
    series, covariates, sag = [], [], []
    for name in setups:
        command = np.vstack([c for c, _ in lines[name]])
        rows = pd.concat([r for _, r in lines[name]], ignore_index=True)
        series.append(measurement.series(name, command, rows["run"].tolist()))
        first = rows["order"] == 1  # what the others of its line are read against
        covariates.append(rows[~first])
        shape = bow * (1.0 - (command[:, 0] / RULER) ** 2)
        reference = shape[first.to_numpy()].repeat(POINTS - 1)
        change = shape[~first.to_numpy()] - reference
        channels = [c.name for c in measurement.setups[name].instrument.channels]
        bent = [float(name == setups[0] and c == "dz") for c in channels]
        sag.append(np.outer(change, bent).ravel())
    table = pd.concat(covariates, ignore_index=True)
    return _with_noise(measurement, series, table, np.concatenate(sag), seed)


def _with_noise(
    measurement: Measurement,
    series: Sequence,
    covariates: pd.DataFrame,
    change: np.ndarray,
    seed: int,
) -> GapProblem:
    """The problem of readings of a drawn machine, changed (N,), with stated noise."""
    rng = np.random.default_rng(seed)
    root = measurement.prior_root()
    theta = measurement.nominal + root @ rng.standard_normal(len(root))
    planned = problems.assemble(measurement, series, covariates)
    noise = np.zeros(len(planned))
    for k, members in enumerate(planned.members):
        block = np.linalg.cholesky(
            law_covariance(STATED_LAW, planned, planned.members[k])
        )
        noise[members] = block @ rng.standard_normal(len(members))
    y = measurement.readings(planned.series, theta) + change + noise * planned.sigma
    return problems.prepare(measurement, planned.series, y, covariates)
