"""Readings of a bar, for tests of feasibility."""

import numpy as np

from oed.measurement.measurement import Measurement, Series
from oed.model.instrument import mount
from pkm_models.instruments import ball_bar
from pkm_models.machines import planar_2dof

CUP = np.array([0.1, 0.2, -0.4])


LENGTH = 0.9


def bar(length: float = LENGTH) -> Measurement:
    """A bar from a cup set by hand to the platform of the planar machine."""
    at = dict(zip(("at_x", "at_y", "at_z"), CUP, strict=True))
    return Measurement(
        planar_2dof.machine, [mount(ball_bar.free_cup, "bar", length=length, **at)]
    )


def places(rng: np.random.Generator, n: int = 200) -> np.ndarray:
    return rng.uniform([-1.5, 0.0], [1.5, 1.5], (n, 2))


def tips(command: np.ndarray) -> np.ndarray:
    """Tool points (n, 3) of the planar machine."""
    return np.column_stack([np.zeros(len(command)), command])


def planar_series(
    rng: np.random.Generator, n: int = 200
) -> tuple[Measurement, np.ndarray, Series]:
    m, command = bar(), places(rng, n)
    return m, command, m.series("bar", command)
