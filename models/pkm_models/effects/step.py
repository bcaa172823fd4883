"""A step: at some time a joint loses its zero, or a set-up is knocked: H(t - t0) in a leg or a set-up's readings."""

from __future__ import annotations

from collections.abc import Iterable

from oed.effect import Column, Effect, State
from pkm_models.effects import terms

LOST, KNOCKED = 20e-6, 10e-6  # m
COUNT = 59
WHEN = tuple((k + 1) / (COUNT + 1) for k in range(COUNT))  # share of the session


def columns(state: State, when: float) -> Iterable[Column]:
    """A step a leg, and one a set-up; shape: one that comes a third, or two, of a grid step later."""
    time = terms.share(state)
    after = (time >= when).astype(float)
    windows = [after * (time < when + k / 3.0 / (COUNT + 1)) for k in (1, 2)]
    unit = terms.metre(state)
    for name, form, part in (("", after, 1.0), (" later", windows[0], 0.5), (" latest", windows[1], 0.5)):
        for i in state.limbs:
            leg = f"leg {i + 1}"
            yield Column(f"{leg}{name}", part * LOST, leg, {i: unit[:, i] * form}, shape=bool(name))
        block = f"set-up {state.setup}"
        yield Column(f"{block}{name}", part * KNOCKED, block, reading={"*": form}, shape=bool(name))


effect = Effect(
    name="step",
    source="ISO 230-2 (repeatability); practice: a lost reference mark, a collision, a knocked cup",
    about="a joint's zero or a set-up that changes at once",
    columns=columns,
    needs=("time",),
    constants={"when": WHEN},
    remedy="look up the log at that time, home the leg again or repeat the set-up, and drop the readings on one side",
    exposed_by="a reference circle repeated before and after",
)
