"""What an effect is, and what its forms draw from: the stage (plan, motion, climate)
and small tools.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator.instruments import BARS
from benchmarks.blind.generator.machine import Array, Machine
from benchmarks.blind.generator.machines import joint_columns
from benchmarks.blind.generator.plans import Plan
from benchmarks.blind.generator.scene import Layout, Motion, Push


@dataclasses.dataclass(frozen=True, kw_only=True)
class Effect:
    """An effect with its form drawn; only its size is open.

    push    amplitude (m, the largest addition to a joint, a place, a reading) -> what
            it adds
    blocks  where it acts, if it acts in part: "leg 2", "time 7200-9000", "run C3",
            "direction +1", "phase 30-80"
    about   hidden numbers of its form, for the label
    unit    amplitude of one unit of `about`'s quantity: {name: value at 1 m of
            amplitude}
    """

    name: str
    push: Callable[[float], Push]
    blocks: tuple[str, ...] = ()
    about: dict[str, object] = dataclasses.field(default_factory=dict)
    unit: dict[str, float] = dataclasses.field(default_factory=dict)


@dataclasses.dataclass(frozen=True)
class Climate:
    """Temperature rises, K: each leg's (n, legs), the frame's and the bar's (n,);
    `shown` what sensors say.
    """

    leg: Array
    frame: Array
    bar: Array
    shown: dict[str, Array]


@dataclasses.dataclass(frozen=True)
class Stage:
    """What an effect may depend on."""

    plan: Plan
    motion: Motion
    layout: Layout
    climate: Climate

    @property
    def machine(self) -> Machine:
        """The machine."""
        return self.plan.machine

    @property
    def rows(self) -> int:
        """Number of rows."""
        return len(self.plan.command)

    @property
    def stroke(self) -> Array:
        """Each leg's place in its range of this plan, -1..1, (n, legs)."""
        q = self.motion.q
        low, high = q.min(0), q.max(0)
        return np.asarray((2 * q - low - high) / (high - low))

    @property
    def by_bar(self) -> Array:
        """1 for readings (N,) of a ball bar, 0 for others."""
        bars = np.array(
            [s.instrument.name in BARS for s in self.plan.setups], dtype=float
        )
        return np.asarray(bars[self.plan.setup[self.layout.row]])

    def zero(self) -> Array:
        """dp (n, np + extras) of nothing."""
        return np.zeros((self.rows, len(self.machine.full)))


def unit(push: Push) -> Push:
    """A push scaled to a largest addition of 1 m. Raises ArithmeticError if there is
    none.
    """
    peak = push.peak()
    if not peak > 0 or not np.isfinite(peak):
        raise ArithmeticError("this form of the effect does nothing on this plan")
    return push.times(1.0 / peak)


def linear(
    name: str,
    push: Push,
    blocks: tuple[str, ...] = (),
    unit_of: dict[str, float] | None = None,
    **about: object,
) -> Effect:
    """An effect proportional to its amplitude; `unit_of` values are per unit of the
    push as given.
    """
    peak = push.peak()
    shape = unit(push)
    scaled = {k: v / peak for k, v in (unit_of or {}).items()}
    return Effect(
        name=name, push=shape.times, blocks=blocks, about=dict(about), unit=scaled
    )


def pick_legs(
    rng: Generator, count: int, single: float = 0.5
) -> tuple[Array, tuple[str, ...]]:
    """Gains (legs,): one leg alone with probability `single`, else all with unequal
    gains; and the blocks.
    """
    if rng.random() < single:
        leg = int(rng.integers(count))
        return np.eye(count)[leg], (f"leg {leg + 1}",)
    return np.clip(1.0 + 0.3 * rng.normal(size=count), 0.3, 1.8), ()


def place_joints(stage: Stage, leg: int, shift: Array, *, platform: bool) -> Array:
    """dp (n, np + extras) that moves a leg's base joint (or carriage), or its platform
    joint, by shift (n, 3).

    Machines whose carriages run on guides take the components that these have: planar
    sideways and along; delta outward, sideways and along; the hexaglide along, across
    and up.
    """
    base, local = joint_columns(stage.machine, leg)
    columns = local if platform and local else base
    dp = stage.zero()
    dp[:, columns] = shift[:, : len(columns)]
    return dp


def smooth(rng: Generator, u: Array, knots: int = 6) -> Array:
    """A random smooth curve over u in -1..1, (any shape): natural cubic through normal
    values at uneven knots.
    """
    from scipy.interpolate import CubicSpline

    inner = np.sort(rng.uniform(-0.9, 0.9, knots - 2))
    at = np.concatenate([[-1.0], inner, [1.0]])
    at += np.linspace(0.0, 0.05, knots)  # never twice the same
    return np.asarray(
        CubicSpline(at, rng.normal(size=knots), bc_type="natural")(
            np.clip(u, -1.0, 1.05)
        )
    )


def spans(plan: Plan) -> float:
    """Last time of the plan, s."""
    return float(plan.time.max())
