"""Every machine and every machine x instrument under test: list a new one here, and the conformance suite takes it."""

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np
from pkm_models.instruments import ball_bar, calliper, height_probe
from pkm_models.machines import a3_head, linear_delta

from oed.instrument import Setup, mount
from oed.machine import Machine
from oed.measurement import Measurement, Series


@dataclasses.dataclass(frozen=True)
class Case:
    """A machine, random commands (n, n_dof) over its workspace, commands out of reach, and set-ups that can read it."""

    machine: Machine
    commands: Callable[[np.random.Generator, int], np.ndarray]
    out_of_reach: np.ndarray
    setups: Mapping[str, Setup]


def _a3_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    """Whole stroke, all psi, theta up to 40 deg; among them the upright pose."""
    c = np.column_stack([rng.uniform(1.066, 1.266, n), rng.uniform(-np.pi, np.pi, n), np.deg2rad(rng.uniform(0, 40, n))])
    c[0, 1:] = 0.0
    return c


def _delta_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    """A cylinder of 140 mm radius."""
    r, angle = 0.140 * np.sqrt(rng.uniform(size=n)), rng.uniform(-np.pi, np.pi, n)
    return np.column_stack([r * np.cos(angle), r * np.sin(angle), rng.uniform(0.0, 0.400, n)])


def _setups(cup: tuple[float, float, float], teach: tuple[float, float, float]) -> dict[str, Setup]:
    at = dict(zip(("at_x", "at_y", "at_z"), cup, strict=True))
    tool = (0.01, -0.02, 0.05)
    setups = (
        mount(ball_bar.instrument, "ball_bar", teach=teach),
        mount(ball_bar.free_cup, "ball_bar_free_cup", tool=tool, **at),
        mount(height_probe.instrument, "height_probe", tool=tool),
        mount(calliper.instrument, "calliper"),
    )
    return {s.name: s for s in setups}


CASES = {
    "a3_head": Case(
        machine=a3_head.machine,
        commands=_a3_commands,
        out_of_reach=np.array([[0.526, 0.0, 0.0]]),  # strut length 0
        setups=_setups((0.0, 0.0, 1.40), (1.40, 0.0, 0.0)),
    ),
    "linear_delta": Case(
        machine=linear_delta.machine,
        commands=_delta_commands,
        out_of_reach=np.array([[0.5, 0.0, 0.02]]),
        setups=_setups((0.02, 0.01, -0.08), (0.02, 0.01, -0.08)),
    ),
}
PAIRS = [(name, setup) for name, case in CASES.items() for setup in case.setups]


def reading_series(case: Case, setup: str, rng: np.random.Generator, n: int) -> tuple[Measurement, Series]:
    """A measurement of one set-up and a series of n readings at random poses; runs of five where runs have a reference."""
    measurement = Measurement(case.machine, [case.setups[setup]])
    per_run = 5
    extra = n // per_run if case.setups[setup].instrument.reference == "run" else 0
    runs = [str(i // (per_run + 1)) for i in range(n + extra)] if extra else None
    return measurement, measurement.series(setup, case.commands(rng, n + extra), run=runs)
