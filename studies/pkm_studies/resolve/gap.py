"""What [gap] asks for, as objects: effects to try, effects that act on the virtual
machine, conditions of its readings.

Raises InputError, naming file and field, for effects, constants and directions that are
not there.
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Mapping, Sequence
from typing import TYPE_CHECKING

import numpy as np

from oed import units
from oed.effect import Effect
from oed.machine import Machine
from oed.measurement import Measurement, Series
from pkm_studies import catalogue
from pkm_studies.errors import InputError, Place, suggest
from pkm_studies.study import Study
from pkm_studies.study.tables import ActingTable, ConditionsTable, GapTable

if TYPE_CHECKING:
    import pandas as pd

ALL = "all"
#: the name that `Series.passes` gives a pass at the end of its run's
PASS = re.compile(r", (forward|backward) (\d+)$")
MINUTE = units.factor("min")
FEED = units.factor("mm") / units.factor("min")


@dataclasses.dataclass(frozen=True)
class ActingEffect:
    """An effect of the virtual machine; coefficients None: those of the textbook's
    form. `place`: for errors.
    """

    effect: Effect
    constants: Mapping[str, float]
    size: float
    draw: bool
    coefficients: Mapping[str, float] | None
    place: Place


@dataclasses.dataclass(frozen=True)
class GapRequest:
    """What [gap] asks for; gravity is its direction in the base frame."""

    effects: tuple[Effect, ...]
    gravity: tuple[float, float, float]
    acting: tuple[ActingEffect, ...]
    conditions: ConditionsTable


def gap_request(
    study: Study, machine: Machine, *, always: bool = False
) -> GapRequest | None:
    """What the study asks of a diagnosis; None where it has no [gap], unless one is
    wanted `always`.
    """
    said = study.gap
    if said is None:
        if not always:
            return None
        said = GapTable()
    place = study.place.key("gap")
    if not np.linalg.norm(said.gravity) > 0.0:
        raise place.key("gravity").error(
            "gravity has no direction", "give where it pulls: [0, 0, -1]"
        )
    return GapRequest(
        effects=_effects(study, said, place),
        gravity=said.gravity,
        acting=tuple(
            _acting(study, a, machine, place.key("acting").item(i))
            for i, a in enumerate(said.acting)
        ),
        conditions=said.conditions,
    )


def _effects(study: Study, said: GapTable, place: Place) -> tuple[Effect, ...]:
    """Effects in the order named; of two with one name, the later (a user's own in
    place of the library's).
    """
    found: dict[str, Effect] = {}
    for i, name in enumerate(said.effects):
        at = place.key("effects").item(i)
        names = (
            [e.name for e in catalogue.listing("effects")] if name == ALL else [name]
        )
        for one in names:
            effect = catalogue.effect(one, study.folder, at)
            found[effect.name] = effect
    for i, name in enumerate(said.without):
        if name not in found:
            raise (
                place.key("without")
                .item(i)
                .error("no such effect is tried", suggest(name, found), name)
            )
    kept = tuple(e for n, e in found.items() if n not in said.without)
    if not kept:
        raise place.key("effects").error(
            "no effect is left to try", 'name some, or "all"'
        )
    return kept


def _acting(
    study: Study, said: ActingTable, machine: Machine, place: Place
) -> ActingEffect:
    effect: Effect = catalogue.effect(said.effect, study.folder, place.key("effect"))
    reason = effect.unfit(machine)
    if reason is not None:
        raise place.key("effect").error(
            f"it cannot act on {machine.name}: {reason}", "take another", said.effect
        )
    for name in said.constants:
        if name not in effect.constants:
            raise (
                place.key("constants")
                .key(name)
                .error("no such constant", suggest(name, effect.constants))
            )
    usual = {
        n: v[len(v) // 2 if k == 0 else 0]
        for k, (n, v) in enumerate(effect.constants.items())
    }
    return ActingEffect(
        effect=effect,
        constants=usual | said.constants,
        size=said.size,
        draw=said.draw,
        coefficients=said.coefficients or None,
        place=place,
    )


# -- conditions ------------------------------------------------------------------------


def covariates(
    measurement: Measurement, series: Sequence[Series], said: ConditionsTable
) -> pd.DataFrame:
    """Time, direction, feed, payload, repeat and temperatures (SI) of planned readings,
    one row a reading.

    Runs follow one another in the order given; each takes the next of several feeds and
    payloads.
    """
    import pandas as pd

    frames, clock, number, mounted = [], said.start_min * MINUTE, 0, ""
    for s in series:
        setup = measurement.setups[s.setup]
        cost = setup.instrument.cost
        if s.setup != mounted:
            clock += cost.setup if said.setup_min is None else said.setup_min * MINUTE
            mounted = s.setup
        step = cost.reading if said.reading_s is None else said.reading_s
        step *= len(setup.protocol.passes) if setup.protocol.average else 1
        both = setup.protocol.both_directions and setup.protocol.average
        frame = pd.DataFrame(
            np.full((len(s), 5), np.nan),
            columns=["time", "direction", "feed", "payload", "repeat"],
        )
        for run in dict.fromkeys(s.run):
            members = np.flatnonzero(s.run == run)
            way = PASS.search(str(run))
            backward = way is not None and way.group(1) == "backward"
            frame.loc[members, "time"] = clock + step * np.arange(1, len(members) + 1)
            frame.loc[members, "direction"] = (
                np.nan if both else -1.0 if backward else 1.0
            )
            frame.loc[members, "feed"] = _turn(said.feed_mm_min, number) * FEED
            frame.loc[members, "payload"] = _turn(said.payload, number)
            frame.loc[members, "repeat"] = (
                float(way.group(2)) if way is not None else 1.0
            )
            clock += step * len(members) + said.pause_s
            number += 1
        frames.append(frame)
    told = pd.concat(frames, ignore_index=True).dropna(axis=1, how="all")
    for body, warming in said.temperature.items():
        told[f"temp_{body}"] = warming.rise * -np.expm1(
            -told["time"] / (warming.after_min * MINUTE)
        )
    return told


def _turn(said: float | list[float] | None, number: int) -> float:
    """The value of run `number`: the same for all, or those of a list in turn; NaN
    where none is given.
    """
    if said is None:
        return np.nan
    return said[number % len(said)] if isinstance(said, list) else said


def unknown_coefficient(place: Place, name: str, known: Sequence[str]) -> InputError:
    """The error for a coefficient that an effect does not have on this machine."""
    return (
        place.key("coefficients")
        .key(name)
        .error("the effect has no such coefficient here", suggest(name, known))
    )
