"""Virtual A3 heads of the oracle: read by it, moved at the toolkit's joints."""

import dataclasses
from collections.abc import Iterable

import numpy as np
from oracles import a3_geometry as a3

from kernel.a3_plans import workspace
from oed import compensate
from oed.accuracy import prediction
from oed.estimation.identification import Estimate, identify
from oed.measurement.measurement import Measurement, Series

NOISE = 0.5e-6


@dataclasses.dataclass(frozen=True)
class Realised:
    """Errors (machines, poses, 6) against home, of the oracle's machines."""

    before: np.ndarray
    after: np.ndarray
    fully_corrected: np.ndarray
    first: Estimate


def exact(series: Series, truth: np.ndarray) -> np.ndarray:
    """Bar lengths of the oracle's machine, theta (27,), without noise."""
    cup = a3.forward(truth[:24], series.q[series.index[:, 1]]).tip + truth[24:]
    return a3.ball_bar_reading(truth[:24], series.q[series.index[:, 0]], cup)


def measured(series: Series, truth: np.ndarray, rng: np.random.Generator) -> np.ndarray:
    """Bar lengths that the oracle's machine, theta (27,), shows."""
    return exact(series, truth) + NOISE * rng.standard_normal(len(series))


def against_home(
    m: Measurement, command: np.ndarray, believed: np.ndarray, truth: np.ndarray
) -> np.ndarray:
    """Errors (n, 6) in x, y, z, psi, theta, phi of the oracle's machine.

    Its controller uses the parameters `believed` (24,). Errors are zeroed at home: place
    in the base frame, orientation in the platform's axes, by exact rotations.
    """
    home = m.machine.home_command
    real = a3.forward(
        truth, compensate.compensated_joints(m.kinematics, command, believed)
    )
    at_home = a3.forward(
        truth, compensate.compensated_joints(m.kinematics, home[None], believed)[0]
    )
    tip, _ = a3.nominal_pose(*command.T)
    home_tip, home_rotation = a3.nominal_pose(*home)
    angles = np.column_stack(a3.euler(real.R @ at_home.R.T @ home_rotation))
    wanted = np.column_stack([command[:, 1], command[:, 2], -command[:, 1]])
    return np.hstack(
        [
            real.tip - tip - (at_home.tip - home_tip),
            np.angle(np.exp(1j * (angles - wanted))),
        ]
    )


def realise(
    m: Measurement, series: Series, truths: Iterable[np.ndarray], seed: int
) -> Realised:
    rng, command = np.random.default_rng(seed), workspace()
    maps = prediction.error_maps(m.kinematics, command, "home")
    before, after, known, estimates = [], [], [], []
    for truth in truths:
        estimate = identify(m, [series], measured(series, truth, rng))
        estimates.append(estimate)
        before.append(against_home(m, command, m.nominal[:24], truth[:24]))
        after.append(against_home(m, command, estimate.theta[:24], truth[:24]))
        known.append(after[-1] - maps.remaining @ estimate.theta[:24])
    return Realised(np.array(before), np.array(after), np.array(known), estimates[0])
