"""What the instruments read, in plain NumPy: from tool points, references and the state
of the set-up.

Every set-up has six state columns s; which of them a calibration knows as unknowns,
with what tolerance, is in `nuisances`. Complex input passes through.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping

import numpy as np

from benchmarks.blind.generator.machine import Array, cayley, norm

STATE = 6  # columns of s


@dataclasses.dataclass(frozen=True, kw_only=True)
class Instrument:
    """An instrument.

    read       (tip, reference tip, s, reference s, settings) -> (n, channels); m
    channels   column stems, and noise sigma of each, m
    nuisances  {state column: tolerance}
    drifts     state columns that move when the mount creeps
    reference  "teach", "run" or None
    """

    name: str
    channels: tuple[tuple[str, float], ...]
    read: Callable[[Array, Array, Array, Array, Mapping[str, float]], Array]
    nuisances: Mapping[int, float]
    drifts: tuple[int, ...]
    reference: str | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class Setup:
    """An instrument as mounted; tool: length added along the tool's axis, m; teach:
    command, SI.
    """

    name: str
    instrument: Instrument
    tool: float = 0.0
    settings: Mapping[str, float] = dataclasses.field(default_factory=dict)
    teach: tuple[float, ...] | None = None


def _taught(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    return norm(tip - ref - s[:, :3])[:, None]


def _free(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    return norm(tip - s[:, :3] - np.array([k["at_x"], k["at_y"], k["at_z"]]))[:, None]


def _rm4(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    d = tip - ref
    return (d[:, 1] - s[:, 0] * d[:, 2] + s[:, 1] - sref[:, 1])[:, None]


def _rm5(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    d = tip - ref
    across = d[:, 2] - s[:, 0] * d[:, 1] + s[:, 2] - sref[:, 2]
    return np.stack([d[:, 1] + s[:, 1] - sref[:, 1], across], -1)


def _probe(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    return (tip[:, 2] + s[:, 0])[:, None]


def _tracker(
    tip: Array, ref: Array, s: Array, sref: Array, k: Mapping[str, float]
) -> Array:
    flat = np.array([0.5, 0.5, 0.0])  # half the angle: the Gibbs vector of a small turn
    turn = cayley(s[:, 3:6] * flat) @ cayley(s[:, 3:6] * np.array([0.0, 0.0, 0.5]))
    return np.einsum("nij,nj->ni", turn, tip) + s[:, :3]


_CUP = (0, 1, 2)
BAR = Instrument(
    name="ball_bar",
    channels=(("length", 0.5e-6),),
    read=_taught,
    nuisances=dict.fromkeys(_CUP, 0.02e-3),
    drifts=_CUP,
    reference="teach",
)
FREE_BAR = Instrument(
    name="ball_bar_free_cup",
    channels=(("length", 0.5e-6),),
    read=_free,
    nuisances=dict.fromkeys(_CUP, 1.0e-3),
    drifts=_CUP,
)
RM4 = Instrument(
    name="rm4",
    channels=(("dy", 3e-6),),
    read=_rm4,
    nuisances={0: 0.02e-3},
    drifts=(1,),
    reference="run",
)
RM5 = Instrument(
    name="rm5",
    channels=(("dy", 1e-6), ("dz", 3e-6)),
    read=_rm5,
    nuisances={0: 0.02e-3},
    drifts=(1, 2),
    reference="run",
)
PROBE = Instrument(
    name="height_probe",
    channels=(("height", 20e-6),),
    read=_probe,
    nuisances={0: 0.05e-3},
    drifts=(0,),
)
TRACKER = Instrument(
    name="pose_tracker_position",
    channels=tuple((f"read_{n}", 10e-6) for n in "xyz"),
    read=_tracker,
    nuisances=dict.fromkeys(range(6), 0.05e-3),
    drifts=(0, 1, 2),
)
BARS = ("ball_bar", "ball_bar_free_cup")
