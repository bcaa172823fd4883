"""Legs that warm up: strut i grows by alpha l_i dT_i(t). A driven screw warms by 2 to 10 K within hours (ISO 230-3)."""

from __future__ import annotations

from collections.abc import Iterable

from oed.effect import Column, Effect, State
from pkm_models.effects import terms

RISE = 3.0  # K


def columns(state: State, tau: float) -> Iterable[Column]:
    """The strut's growth a leg; shape: a second time constant, and what grows as the screw, or does not extend."""
    known = terms.travel(state.machine)
    for i in state.limbs:
        leg, own, rigid = f"leg {i + 1}", f"leg{i + 1}", not known.guide[i].any()
        measured, warm, second = terms.warming(state, own if own in state.temperature else "leg", tau)
        unit, scale, strain = ("per kelvin", terms.STEEL, 1.0) if measured else ("rise", RISE, terms.STEEL)
        growth = strain * state.per_length[:, i] * state.strut[:, i]
        other = strain * (state.per_length[:, i] * known.strut[i] if rigid else state.joints[:, i])
        part = "ends" if rigid else "screw"
        yield Column(f"{leg} {unit}", scale, leg, {i: growth * warm})
        yield Column(f"{leg} {unit} second", terms.ADAPT * scale, leg, {i: growth * second}, shape=True)
        yield Column(f"{leg} {unit} {part}", terms.ADAPT * scale, leg, {i: other * warm}, shape=True)


effect = Effect(
    name="leg_thermal",
    source="ISO 230-3 (thermal effects); steel 11.5e-6 / K",
    about="legs that grow with their temperature",
    columns=columns,
    needs=("time or temp_leg or temp_leg1",),
    constants={"tau": terms.TIMES},
    remedy="let the legs warm up before use, cool the screws, or compensate by a temperature sensor on each leg",
    exposed_by="a reference circle repeated in the course of hours",
    unfit=terms.no_struts,
)
