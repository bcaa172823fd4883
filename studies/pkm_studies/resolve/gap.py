"""What [gap] requests: effects to try, effects of the virtual machine, conditions."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.effect_model import Effect
from oed.model import Machine
from oed.text import suggest
from pkm_studies import catalogue
from pkm_studies.base import InputError, Location
from pkm_studies.resolve.effect_sizes import check_sizes, effect_with_sizes
from pkm_studies.study import Study
from pkm_studies.tables import ActingTable, ConditionsTable, GapTable

ALL = "all"


@dataclasses.dataclass(frozen=True)
class ActingEffect:
    """An effect of the virtual machine.

    constants     its nonlinear constants, SI
    size          factor of all coefficients, in prior standard deviations
    draw          whether coefficients are drawn from the prior
    coefficients  by name, in prior standard deviations; None: the textbook's form
    location      its table, for errors
    """

    effect: Effect
    constants: Mapping[str, float]
    size: float
    draw: bool
    coefficients: Mapping[str, float] | None
    location: Location


@dataclasses.dataclass(frozen=True)
class GapRequest:
    """What [gap] means to the kernel.

    effects     effects that the diagnosis tries, with the sizes expected of them
    gravity     direction of gravity in the base frame
    acting      effects that the virtual machine has
    conditions  how the virtual machine is read
    """

    effects: tuple[Effect, ...]
    gravity: tuple[float, float, float]
    acting: tuple[ActingEffect, ...]
    conditions: ConditionsTable


def stated_request(study: Study, machine: Machine) -> GapRequest | None:
    """What [gap] requests; None without the table. Raises InputError as `gap_request`."""
    if study.gap is None:
        check_sizes(study, ())
        return None
    return gap_request(study, machine)


def gap_request(study: Study, machine: Machine) -> GapRequest:
    """What [gap] requests, or its defaults without the table.

    Raises InputError for unknown effects and constants, and for gravity of length 0.
    """
    table = GapTable() if study.gap is None else study.gap
    location = study.location.key("gap")
    if not np.linalg.norm(table.gravity) > 0.0:
        raise location.key("gravity").error(
            "gravity has no direction", "give where it pulls: [0, 0, -1]"
        )
    acting = [
        _acting_effect(study, entry, machine, location.key("acting").item(i))
        for i, entry in enumerate(table.acting)
    ]
    return GapRequest(
        effects=_tried_effects(study, table, location),
        gravity=table.gravity,
        acting=tuple(acting),
        conditions=table.conditions,
    )


def _tried_effects(
    study: Study, table: GapTable, location: Location
) -> tuple[Effect, ...]:
    """Effects in the order named; of two with one name, the later replaces the first."""
    effects: dict[str, Effect] = {}
    named: set[str] = set()
    for i, entry in enumerate(table.effects):
        field = location.key("effects").item(i)
        names = [entry]
        if entry == ALL:
            names = [e.name for e in catalogue.listing("effects")]
        for name in names:
            effect = catalogue.effect(name, study.origin, field)
            effects[effect.name] = effect
            if entry != ALL:
                named.add(effect.name)
    for i, name in enumerate(table.without):
        if name not in effects:
            field = location.key("without").item(i)
            raise field.error("no such effect is tried", suggest(name, effects), name)
    check_sizes(study, effects.values())
    instruments = _instruments(study)
    tried = tuple(
        effect_with_sizes(e, study)
        for name, e in effects.items()
        if name not in table.without and (name in named or e.is_offered(instruments))
    )
    if not tried:
        raise location.key("effects").error(
            "no effect is left to try", 'name some, or "all"'
        )
    return tried


def _instruments(study: Study) -> list[str]:
    """Names of the instruments of the study's set-ups."""
    field = study.location.key("setup")
    return [
        catalogue.instrument(
            table.instrument, study.origin, field.item(i).key("instrument")
        ).name
        for i, table in enumerate(study.setup)
    ]


def _acting_effect(
    study: Study, table: ActingTable, machine: Machine, location: Location
) -> ActingEffect:
    effect: Effect = catalogue.effect(
        table.effect, study.origin, location.key("effect")
    )
    reason = effect.unfit(machine)
    if reason is not None:
        raise location.key("effect").error(
            f"it cannot act on {machine.name}: {reason}", "take another", table.effect
        )
    for name in table.constants:
        if name not in effect.constants:
            field = location.key("constants").key(name)
            raise field.error("no such constant", suggest(name, effect.constants))
    return ActingEffect(
        effect=effect_with_sizes(effect, study),
        constants=_usual_constants(effect) | table.constants,
        size=table.size,
        draw=table.draw,
        coefficients=table.coefficients or None,
        location=location,
    )


def _usual_constants(effect: Effect) -> dict[str, float]:
    """The middle value of the first constant, the first value of the others."""
    usual = {name: values[0] for name, values in effect.constants.items()}
    for name, values in list(effect.constants.items())[:1]:
        usual[name] = values[len(values) // 2]
    return usual


def unknown_coefficient(
    location: Location, name: str, allowed: Sequence[str]
) -> InputError:
    """The error for a coefficient that an effect does not have on this machine."""
    field = location.key("coefficients").key(name)
    return field.error(
        "the effect has no such coefficient here", suggest(name, allowed)
    )
