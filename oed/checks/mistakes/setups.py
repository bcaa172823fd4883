"""Readings of another set-up of the study than the one that their rows name."""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Iterator, Mapping
from functools import partial

import numpy as np

from oed.checks.mistakes.given import Given
from oed.checks.mistakes.moved import Moved, on_moved, pose_table
from oed.checks.mistakes.scope import Scope
from oed.checks.mistakes.trial import MistakeTrial, PoseTable, in_scopes
from oed.measurement.measurement import Measurement, Series


def trials(given: Given) -> Iterator[MistakeTrial]:
    """Each set-up, or run, taken for each other one with the same channels."""
    measurement = given.session.measurement
    used = list(dict.fromkeys(s.setup for s in given.session.series))
    for name, other in itertools.product(used, measurement.setups):
        if name == other or not _alike(measurement, name, other):
            continue
        moved = in_other_setup(measurement, {name: other})
        table = pose_table(given, moved)
        if table is not None:
            yield from in_scopes(
                given.scopes, partial(_renamed, given, name, other, moved, table)
            )
    for name, other in itertools.combinations(used, 2):
        if _alike(measurement, name, other):
            sentence = f"the set-ups {name} and {other} are exchanged"
            moved = in_other_setup(measurement, {name: other, other: name})
            table = pose_table(given, moved)
            if table is not None:
                on = on_moved(given, "setups", sentence, moved, table)
                yield from in_scopes([given.file], on)


def _renamed(
    given: Given, name: str, other: str, moved: Moved, table: PoseTable, scope: Scope
) -> MistakeTrial | None:
    if not _is_of(given, scope, name):
        return None
    whose = scope.of if scope.is_part else f" of {name}"
    sentence = f"the readings{whose} are of set-up {other}"
    return on_moved(given, "setups", sentence, moved, table)(scope)


def _is_of(given: Given, scope: Scope, setup: str) -> bool:
    """Whether a scope is a set-up, or one of its runs; the file where it is alone."""
    values = scope.values(given.session)
    return bool((given.session.values["setup"][values] == setup).all())


def _alike(measurement: Measurement, name: str, other: str) -> bool:
    """Whether two set-ups read the same channels in the same manner."""
    first, second = measurement.setups[name], measurement.setups[other]
    channels = [[c.name for c in s.instrument.channels] for s in (first, second)]
    return (
        channels[0] == channels[1]
        and first.instrument.reference == second.instrument.reference
    )


def in_other_setup(measurement: Measurement, names: Mapping[str, str]) -> Moved:
    """The poses of a series as commanded in the set-up of another name."""

    def moved(series: Series) -> Series:
        if series.setup not in names:
            return series
        other = names[series.setup]
        mounted = measurement.setups[other]
        command = series.command.copy()
        if mounted.teach is not None:
            command[-1] = mounted.teach
        if not np.isfinite(command).all():
            return dataclasses.replace(series, setup=other)
        tool = np.array(mounted.tool)
        x, q = measurement.kinematics.sent(command, tool)
        return dataclasses.replace(series, setup=other, q=q, start=x, command=command)

    return moved
