"""A3 heads of the oracle, read by a ball bar whose runs have errors of their own.

The sources of the budget are switched off one by one, in the machines as in what the
estimate knows of them.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from oracles import a3_geometry as a3
from reference import tian_2016 as paper

from kernel import a3_plans
from oed import compensate
from oed.estimation.identification import identify
from oed.measurement.measurement import Measurement, Series
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar
from pkm_models.machines.a3_head import machine

SIGMA, CUP = 0.5e-6, 20e-6
#: error of a run, over the noise of single readings
SHARED = 2.0
STROKES = (0.04, 0.08, 0.12, 0.16, 0.20)
POINTS = 12


@dataclasses.dataclass(frozen=True)
class Sources:
    """How large each source is; 1 as it is, 0 without it."""

    noise: float = 1.0
    run: float = 1.0
    cup: float = 1.0


#: what the budget calls it, and which source that is
ALTERNATIVES: Mapping[str, tuple[str, Sources]] = {
    "halved": ("noise of ball_bar", Sources(noise=0.5)),
    "without run": ("error shared by a run", Sources(run=0.0)),
    "without cup": ("unknown set-up", Sources(cup=0.0)),
}


def measured(sources: Sources) -> tuple[Measurement, Series]:
    """Five circles, their levels errors of their runs."""
    sigma = SIGMA * sources.noise
    channel = dataclasses.replace(
        ball_bar.CHANNEL, sigma=sigma, shared=SHARED * sources.run / sources.noise
    )
    instrument = dataclasses.replace(ball_bar.instrument, channels=(channel,))
    tolerances = {f"cup_{n}": CUP * sources.cup for n in "xyz"}
    teach = (paper.TEACH_Z, 0.0, 0.0)
    setup = mount(instrument, "cup", teach=teach, tolerances=tolerances)
    m = Measurement(machine, [setup])
    psi = np.tile(2 * np.pi * np.arange(POINTS) / POINTS, len(STROKES))
    commands = a3_plans.bar_commands(m, np.repeat(STROKES, POINTS), psi)
    runs = [f"{1e3 * s:.0f}" for s in np.repeat(STROKES, POINTS)]
    return m, m.series("cup", commands, runs)


def height_errors(
    sources: Sources, command: np.ndarray, count: int, seed: int
) -> np.ndarray:
    """Errors (count, n) of z against home, of compensated machines of the oracle.

    The same seed gives the same machines, with other errors of their readings.
    """
    m, series = measured(sources)
    rng = np.random.default_rng(seed)
    home = machine.home_command[None]
    errors = []
    for _ in range(count):
        truth = machine.nominal + rng.standard_normal(24) * m.tolerance[:24]
        cup = CUP * sources.cup * rng.standard_normal(3)
        single = sources.noise * rng.standard_normal(len(series))
        level = np.repeat(rng.standard_normal(len(STROKES)), POINTS)
        read, taught = series.q[series.index[:, 0]], series.q[series.index[0, 1]]
        place = a3.forward(truth, taught).tip + cup
        y = a3.ball_bar_reading(truth, read, place)
        y = y + SIGMA * (single + SHARED * sources.run * level)
        believed = identify(m, [series], y).theta[:24]
        both = np.vstack([command, home])
        q = compensate.compensated_joints(m.kinematics, both, believed)
        off = a3.forward(truth, q).tip[:, 2] - both[:, 0]
        errors.append(off[:-1] - off[-1])
    return np.array(errors)
