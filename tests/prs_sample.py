"""The 3-PRS spindle head of Wang and Fan (2004): machines, set-ups, poses."""

from collections.abc import Mapping

import numpy as np
from oracles import prs_geometry as oracle

from oed.measurement.measurement import Measurement, Series
from oed.model.instrument import Instrument, mount
from oed.model.machine import Machine
from pkm_models.machines import prs_spindle, prs_spindle_struts

FULL, STRUTS = prs_spindle.machine, prs_spindle_struts.machine
GIMBAL = np.array([0.0, -0.7, 0.1])
BASELINE = 0.1
AT = {"at_x": GIMBAL[0], "at_y": GIMBAL[1], "at_z": GIMBAL[2]}
#: a known frame: the registration is held
KNOWN = {f"{kind}_{n}": 0.0 for kind in ("shift", "turn") for n in "xyz"}
NOISE = np.array([0.3e-6, *[np.deg2rad(1.15 / 3600)] * 2])
PAPER = 1e-3 * oracle.TABLE_4


def poses(z: float | np.ndarray = 0.2) -> np.ndarray:
    """Commands (22, 3) of Table 2, which gives no heights."""
    return np.column_stack([np.broadcast_to(z, 22), np.deg2rad(oracle.TABLE_2)])


def measured(
    machine: Machine,
    instrument: Instrument,
    tolerances: Mapping[str, float] = KNOWN,
    z: float | np.ndarray = 0.2,
) -> tuple[Measurement, Series]:
    settings = AT if instrument.settings else {}
    m = Measurement(
        machine, [mount(instrument, "read", tolerances=tolerances, **settings)]
    )
    return m, m.series("read", poses(z))


def random_commands(rng: np.random.Generator, n: int) -> np.ndarray:
    tilt, around = (
        np.deg2rad(35) * np.sqrt(rng.uniform(size=n)),
        rng.uniform(-np.pi, np.pi, n),
    )
    return np.column_stack(
        [rng.uniform(0.0, 0.4, n), tilt * np.cos(around), tilt * np.sin(around)]
    )
