"""Readings of another set-up than the one that their rows name, or differences from another
pose of their run than its first.
"""

import dataclasses
import itertools
from collections.abc import Callable, Iterator, Mapping

import numpy as np

from oed.base import Index
from oed.checks.mistakes.moved import Moved, moved_trials, readings_by_run
from oed.checks.mistakes.suspect import Suspect
from oed.checks.mistakes.trial import MistakeTrial
from oed.measurement import Measurement, Series

#: readings of a run whose pose may be the reference, of so many
REFERENCE_POSES: dict[str, Callable[[int], int]] = {
    "last": lambda count: count - 1,
    "middle": lambda count: (count - 1) // 2,
    "second": lambda count: 0,
}


def trials(data: Suspect) -> Iterator[MistakeTrial]:
    """Each set-up, or run, taken for each other one with the same channels, and the last,
    middle and second pose of each run as its reference.
    """
    measurement = data.session.measurement
    used = list(dict.fromkeys(s.setup for s in data.session.series))
    for name, other in itertools.product(used, measurement.setups):
        if name != other and _alike(measurement, name, other):
            moved = poses_of_other_setup(measurement, {name: other})
            is_of = data.session.mask(name)
            scopes = [scope for scope in data.scopes if is_of[scope.values].all()]
            sentence = f"the readings{{of}} are of set-up {other}"
            yield from moved_trials(data, "setups", sentence, moved, scopes=scopes)
    for name, other in itertools.combinations(used, 2):
        if _alike(measurement, name, other):
            sentence = f"the set-ups {name} and {other} are exchanged"
            moved = poses_of_other_setup(measurement, {name: other, other: name})
            yield from moved_trials(data, "setups", sentence, moved, scopes=[data.file])

    setups = measurement.setups
    if any(setups[name].instrument.reference == "run" for name in used):
        for name, reference in REFERENCE_POSES.items():
            moved = _differences_from(data, reference)
            sentence = (
                f"the readings{{of}} are differences from the {name} pose of each run"
            )
            yield from moved_trials(data, "reference", sentence, moved)


def _alike(measurement: Measurement, name: str, other: str) -> bool:
    """Whether two set-ups read the same channels in the same manner."""
    first, second = measurement.setups[name], measurement.setups[other]
    channels = [[c.name for c in s.instrument.channels] for s in (first, second)]
    return (
        channels[0] == channels[1]
        and first.instrument.reference == second.instrument.reference
    )


def poses_of_other_setup(measurement: Measurement, names: Mapping[str, str]) -> Moved:
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


def _differences_from(data: Suspect, reference: Callable[[int], int]) -> Moved:
    setups = data.session.measurement.setups

    def moved(series: Series) -> Series | None:
        if setups[series.setup].instrument.reference != "run":
            return series
        index: Index = series.index.copy()
        for rows in readings_by_run(series):
            index[rows, 1] = series.index[rows[reference(len(rows))], 0]
        if np.array_equal(index, series.index):
            return None
        return dataclasses.replace(series, index=index)

    return moved
