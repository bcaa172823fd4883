"""A bar that warms up in the hand or the shop: it grows by R alpha dT(t) and so reads that much less.

Its reading is the distance of the balls: a body longer by g than it is taken for tells g less than there is.
"""

from __future__ import annotations

from collections.abc import Iterable

from oed.effect import Column, Effect, State
from pkm_models.effects import bar, terms

RISE = 1.0  # K


def columns(state: State, tau: float) -> Iterable[Column]:
    """-R alpha dT(t) a bar; shape: a second time constant."""
    measured, warm, second = terms.warming(state, "bar", tau)
    name, long = bar.label(state), bar.length(state) or bar.NOMINAL
    unit, scale, strain = ("per kelvin", terms.STEEL, 1.0) if measured else ("rise", RISE, terms.STEEL)
    yield Column(f"{name} {unit}", scale, reading={"length": -strain * long * warm})
    yield Column(f"{name} {unit} second", terms.ADAPT * scale, reading={"length": -strain * long * second}, shape=True)


effect = Effect(
    name="bar_thermal",
    source="ISO 230-4 and ISO 1 (20 degrees C); steel 11.5e-6 / K",
    about="a bar that grows with its temperature",
    columns=columns,
    needs=("time or temp_bar",),
    constants={"tau": terms.TIMES},
    remedy="let the bar reach the shop's temperature, do not hold it in the hand, or correct by its sensor",
    exposed_by="the bar zeroed again on its calibrator between runs",
)
