"""Columns of forms as if every run had been driven the other way, at the same poses."""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base.arrays import Array
from oed.gap.cause.hypothesis import Hypothesis
from oed.gap.data import problem as problems
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library as libraries
from oed.gap.forms.library import Library
from oed.model.effect import Effect


class ReversedForms:
    """Columns of effects and of discrepancies in runs that are driven the other way."""

    def __init__(
        self,
        problem: GapProblem,
        library: Library,
        processes: Library,
        effects: Sequence[Effect],
    ) -> None:
        self._problem, self._library, self._processes = problem, library, processes
        self._effects = {effect.name: effect for effect in effects}
        self._known: dict[int, Array] = {}

    def columns(self, h: Hypothesis, factor: float) -> Array | None:
        """Columns (N, k) of a hypothesis at its sizes, times a factor.

        None where the readings do not say that they were driven both ways.
        """
        if not self._both_ways:
            return None
        parts = [np.zeros((len(self._problem), 0))]
        for atom, size in zip(h.atoms, h.sizes, strict=True):
            parts.append(factor * size * self._of_effect(atom))
        if h.process is not None:
            reversal = self._processes.atoms[h.process].reversal
            size = factor * h.process_size
            columns = self._processes.scaled_columns(h.process, size)
            parts.append(columns if reversal is None else columns * reversal)
        return np.hstack(parts)

    @functools.cached_property
    def _both_ways(self) -> bool:
        rows = self._problem.rows
        if "direction" not in rows.columns:
            return False
        direction = rows["direction"].to_numpy(dtype=float)
        return bool((direction > 0.0).any() and (direction < 0.0).any())

    def _of_effect(self, atom: int) -> Array:
        if atom not in self._known:
            self._known[atom] = self._rebuilt(atom)
        return self._known[atom]

    def _rebuilt(self, atom: int) -> Array:
        form = self._library.atoms[atom]
        effect = self._effects[form.effect]
        fixed = {name: (value,) for name, value in form.constants.items()}
        alone = dataclasses.replace(effect, constants=fixed)
        library = libraries.build(self._reversed, [alone])
        place = {name: k for k, name in enumerate(library.names)}
        columns = np.zeros((len(self._problem), len(form.columns)))
        for k, column in enumerate(form.columns):
            name = self._library.names[column]
            if name in place:
                columns[:, k] = library.columns[:, place[name]]
        return columns

    @functools.cached_property
    def _reversed(self) -> GapProblem:
        """The readings with the order of each run counted from its end."""
        problem = self._problem
        rows = problem.covariates
        orders = rows.groupby(["setup", "run"], sort=False)["order"]
        ends = orders.transform("min") + orders.transform("max")
        other_way = rows.assign(order=ends - rows["order"])
        other_way["direction"] = -rows["direction"]
        return problems.assemble(
            problem.measurement,
            problem.series,
            other_way,
            problem.theta,
            problem.y,
            gravity=problem.gravity,
        )
