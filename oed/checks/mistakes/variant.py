"""A session with one mistake undone."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from oed.arrays import Array
from oed.checks.session import SessionReadings
from oed.kinematics import AssemblyError
from oed.machine import RANGE_SLACK, Machine
from oed.measurement import Measurement, Series

#: a full turn, rad
TURN = 2.0 * np.pi


@dataclasses.dataclass(frozen=True)
class Alternatives:
    """What else a session could have been.

    measurement  the machine with all set-ups of the study
    """

    measurement: Measurement


@dataclasses.dataclass(frozen=True)
class Variant:
    """A session with a mistake undone.

    kind     of mistake: the module that makes the variant
    what     the mistake as a sentence, without a full stop
    session  the readings without it
    log_scale  sum over the values of the log of the factor on them: a variant that makes
             all readings small fits them easily, and their density pays for it
    """

    kind: str
    what: str
    session: SessionReadings
    log_scale: float = 0.0


@dataclasses.dataclass(frozen=True)
class VariantOfAmount:
    """A session with a mistake undone by an unknown amount.

    kind    of mistake
    shift   the session without the mistake of an amount, SI
    step    amount for differences, SI
    what    the mistake of an amount, with its standard deviation, as a sentence
    linear  whether the readings are linear in the amount
    """

    kind: str
    shift: Callable[[float], SessionReadings]
    step: float
    what: Callable[[float, float], str]
    linear: bool


def read_indices(series: Series) -> Array:
    """Mask (m,) of the poses that are commanded in the file; a teach pose is not."""
    mask = np.zeros(len(series.command), dtype=bool)
    mask[series.index[:, 0]] = True
    return mask


def recommanded(
    session: SessionReadings, setup: str, change: Callable[[Array], Array]
) -> SessionReadings | None:
    """The session with the commands (n, n_dof) of a set-up's rows changed.

    None where no command was recorded, or the machine cannot reach one. Commands
    outside the workspace were never given: a readings file with them is refused.
    """
    measurement = session.measurement
    machine = measurement.machine
    tool = np.array(measurement.setups[setup].tool)
    taught = measurement.setups[setup].teach is not None

    def changed(series: Series) -> Series:
        if series.setup != setup:
            return series
        rows = read_indices(series) if taught else np.ones(len(series.command), bool)
        command = series.command.copy()
        command[rows] = wrapped(change(command[rows]), machine)
        if machine.out_of_range(command[rows], measurement.setups[setup].tool):
            raise AssemblyError("outside the workspace", np.flatnonzero(rows))
        x, q = measurement.kinematics.inverse(command, None, tool)
        return dataclasses.replace(series, q=q, start=x, command=command)

    if not _commanded(session, setup):
        return None
    try:
        return session.map_series(changed)
    except (AssemblyError, ArithmeticError, ValueError):
        return None


def wrapped(command: Array, machine: Machine) -> Array:
    """Commands (n, n_dof) with angles that turn freely brought into their range."""
    turned = command.copy()
    for k, coordinate in enumerate(machine.command):
        if coordinate.unit != "rad":
            continue
        span = coordinate.upper - coordinate.lower
        if np.isfinite(span) and span >= TURN * (1.0 - RANGE_SLACK):
            turned[:, k] -= TURN * np.floor((turned[:, k] - coordinate.lower) / TURN)
    return turned


def _commanded(session: SessionReadings, setup: str) -> bool:
    series = [s for s in session.series if s.setup == setup]
    return all(bool(np.isfinite(s.command).all()) for s in series)


def channel_sets(session: SessionReadings) -> Iterator[tuple[str, list[str]]]:
    """Each channel of the session with the set-ups that read it."""
    setups = dict.fromkeys(s.setup for s in session.series)
    by_channel: dict[str, list[str]] = {}
    for setup in setups:
        instrument = session.measurement.setups[setup].instrument
        for channel in instrument.channels:
            by_channel.setdefault(channel.name, []).append(setup)
    yield from by_channel.items()
