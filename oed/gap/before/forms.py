"""Forms of effects, one for each value of their constants, as columns of readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.effect_model import Effect
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable

#: prior standard deviations that a rival's textbook coefficients may go to
ROOM = 100.0


@dataclasses.dataclass(frozen=True, eq=False)
class ColumnSet:
    """Columns of one explanation among those of all.

    effect     what it explains the readings by
    at         (k,) numbers of its columns
    precision  (k,) prior precision of its coefficients as a rival's
    """

    effect: str
    at: Index
    precision: Array


@dataclasses.dataclass(frozen=True, eq=False)
class Form(ColumnSet):
    """An effect at one set of constants, with the signature that its columns are of."""

    signature: Signature

    @property
    def textbook(self) -> Index:
        """Which of its columns are textbook columns; all where it has none."""
        plain = np.flatnonzero(np.logical_not(self.signature.shape))
        return plain if plain.size else np.arange(len(self.at))


@dataclasses.dataclass(frozen=True, eq=False)
class EffectForms:
    """Forms of all testable effects.

    by_effect    {effect: its forms}
    reasons      {effect: why the readings cannot test it}
    columns      (N, K) of all forms, in units of the stated noise
    """

    by_effect: dict[str, list[Form]]
    reasons: dict[str, str]
    columns: Array


def effect_forms(
    problem: GapProblem, effects: Sequence[Effect], most: int | None = None
) -> EffectForms:
    """Forms over the grids of the effects' constants that change a reading.

    `most` is the number of constants, evenly spaced in the grid, that stand for it.
    """
    by_effect: dict[str, list[Form]] = {}
    reasons: dict[str, str] = {}
    blocks, start = [np.zeros((len(problem), 0))], 0
    for effect in effects:
        reason = untestable(effect, problem.states)
        grid = effect.constant_grid() if reason is None else []
        if most is not None and len(grid) > most:
            places = np.linspace(0, len(grid) - 1, most).round().astype(int)
            grid = [grid[k] for k in np.unique(places)]
        every = [problem.signature(effect, constants) for constants in grid]
        for signature in every:
            if signature.names:
                at = np.arange(start, start + len(signature.names))
                precision = np.where(signature.shape, 1.0, ROOM**-2)
                form = Form(effect.name, at, precision, signature)
                by_effect.setdefault(effect.name, []).append(form)
                blocks.append(problem.in_noise_units(signature.columns))
                start += len(at)
        if effect.name not in by_effect:
            reasons[effect.name] = reason or "it changes none of these readings"
    return EffectForms(by_effect, reasons, np.hstack(blocks))
