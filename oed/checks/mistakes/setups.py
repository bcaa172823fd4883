"""Readings of another set-up of the study than the one that their rows name."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping

import numpy as np

from oed.checks.mistakes.variant import Alternatives, Variant
from oed.checks.session import SessionReadings
from oed.kinematics import AssemblyError
from oed.measurement import Measurement, Series


def variants(session: SessionReadings, alternatives: Alternatives) -> Iterator[Variant]:
    """Each set-up taken for each other one with the same channels, and exchanged."""
    setups = alternatives.measurement.setups
    used = list(dict.fromkeys(s.setup for s in session.series))
    for name, other in itertools.product(used, setups):
        if name == other or not _alike(alternatives.measurement, name, other):
            continue
        what = f"the readings of {name} are of set-up {other}"
        yield from _renamed(session, alternatives, {name: other}, what)
    for name, other in itertools.combinations(used, 2):
        if _alike(alternatives.measurement, name, other):
            what = f"the set-ups {name} and {other} are exchanged"
            names = {name: other, other: name}
            yield from _renamed(session, alternatives, names, what)


def _alike(measurement: Measurement, name: str, other: str) -> bool:
    """Whether two set-ups read the same channels in the same manner."""
    first, second = measurement.setups[name], measurement.setups[other]
    channels = [[c.name for c in s.instrument.channels] for s in (first, second)]
    return (
        channels[0] == channels[1]
        and first.instrument.reference == second.instrument.reference
    )


def _renamed(
    session: SessionReadings,
    alternatives: Alternatives,
    names: Mapping[str, str],
    what: str,
) -> Iterator[Variant]:
    measurement = alternatives.measurement
    try:
        series = [_in_setup(measurement, s, names.get(s.setup)) for s in session.series]
    except (AssemblyError, ArithmeticError, ValueError):
        return
    values = session.values.assign(setup=session.values["setup"].replace(dict(names)))
    changed = dataclasses.replace(
        session, measurement=measurement, series=tuple(series), values=values
    )
    yield Variant("setups", what, changed)


def _in_setup(measurement: Measurement, series: Series, setup: str | None) -> Series:
    """The poses of a series as commanded in another set-up."""
    if setup is None:
        return series
    mounted, tool = measurement.setups[setup], np.array(measurement.setups[setup].tool)
    command = series.command.copy()
    if mounted.teach is not None:
        command[-1] = mounted.teach
    if not np.isfinite(command).all():
        return dataclasses.replace(series, setup=setup)
    x, q = measurement.kinematics.inverse(command, None, tool)
    return dataclasses.replace(series, setup=setup, q=q, start=x, command=command)
