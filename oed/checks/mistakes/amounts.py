"""Mistakes of an unknown amount: bar length, tool length, offset of one run or pose."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator

import numpy as np

from oed import units
from oed.arrays import Mask
from oed.checks.mistakes.order import run_members, run_names
from oed.checks.mistakes.variant import VariantOfAmount, channel_sets
from oed.checks.session import SessionReadings

#: amount for differences of the tool's length, m
STEP = 1e-4


def variants(session: SessionReadings) -> Iterator[VariantOfAmount]:
    """Offsets of a channel and of a run, and another tool."""
    for channel, setups in channel_sets(session):
        groups = [setups] if len(setups) == 1 else [setups, *([s] for s in setups)]
        for names in groups:
            members = np.any([session.mask(n, channel) for n in names], axis=0)
            where = f" in {names[0]}" if len(names) < len(setups) else ""
            yield _offset(session, channel, members, where, "offset")
    runs = run_members(session)
    if len(runs) > 1:
        reading = session.reading_of_value
        channels = session.values["channel"].to_numpy()
        for name, rows in zip(run_names(session), runs, strict=True):
            of_run = np.isin(reading, rows)
            for channel in dict.fromkeys(channels[of_run]):
                members = of_run & (channels == channel)
                where = f" in run {name}"
                yield _offset(session, str(channel), members, where, "run")
    yield from _tools(session)


def _offset(
    session: SessionReadings, channel: str, members: Mask, where: str, kind: str
) -> VariantOfAmount:
    column = session.column(channel).name
    cause = "the bar length or the zero of the instrument is wrong"
    if kind == "run":
        cause = "the set-up moved or was zeroed again for this run"

    def what(amount: float, sd: float) -> str:
        size, error = (session.fine(channel, v) for v in (amount, sd))
        return (
            f"all readings of {column}{where} are off by {size} (sd {error}): {cause}"
        )

    return VariantOfAmount(
        kind=kind,
        shift=lambda amount: session.with_y(session.y - amount * members),
        step=STEP,
        what=what,
        linear=True,
    )


def _tools(session: SessionReadings) -> Iterator[VariantOfAmount]:
    """Each set-up with a tool of another length, and all of them."""
    setups = list(dict.fromkeys(s.setup for s in session.series))
    machine = session.measurement.machine
    if not any(c.unit == "rad" for c in machine.command):
        return  # without rotation, the tool moves every reading alike
    groups = [setups] if len(setups) == 1 else [setups, *([s] for s in setups)]
    for names in groups:
        of = f" of {names[0]}" if len(names) < len(setups) or len(setups) == 1 else ""

        def what(amount: float, sd: float, of: str = of) -> str:
            size, error = (units.number(v, "mm") for v in (amount, sd))
            return (
                f"the tool{of} is {abs(size):.4g} mm (sd {error:.2g} mm)"
                f" {'longer' if size > 0.0 else 'shorter'} than stated"
            )

        yield VariantOfAmount(
            kind="tool",
            shift=_with_tool(session, names),
            step=STEP,
            what=what,
            linear=False,
        )


def _with_tool(
    session: SessionReadings, names: list[str]
) -> Callable[[float], SessionReadings]:
    """The session with tools of these set-ups longer by an amount, m."""

    def shift(amount: float) -> SessionReadings:
        setups = []
        for name, setup in session.measurement.setups.items():
            x, y, z = setup.tool
            longer = dataclasses.replace(setup, tool=(x, y, z + amount))
            setups.append(longer if name in names else setup)
        measurement = session.measurement.with_setups(setups)
        return dataclasses.replace(session, measurement=measurement)

    return shift
