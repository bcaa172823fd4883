"""Gram matrix of all forms of all testable effects, in the metric of planned readings."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.effect import Effect
from oed.gap.data.metric import Embedding
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable
from oed.noise.law import NoiseLaw

#: prior standard deviations that a rival's textbook coefficients may go to
ROOM = 100.0


@dataclasses.dataclass(frozen=True)
class Form:
    """An effect at one set of constants.

    signature    its columns
    at           (k,) where these are in the Gram matrix
    raw          trace of its Gram matrix before calibration
    """

    signature: Signature
    at: Index
    raw: float

    @property
    def textbook(self) -> Index:
        """Its textbook columns; all where it has none."""
        plain = np.logical_not(self.signature.shape)
        return self.at[plain] if plain.any() else self.at


class GramTable:
    """Gram matrix of all forms of all testable effects."""

    def __init__(
        self,
        problem: GapProblem,
        law: NoiseLaw,
        effects: Sequence[Effect],
        room: float,
    ) -> None:
        """Compute the inner products.

        `room` is what a rival's textbook coefficients may go to, in prior standard
        deviations.
        """
        #: {effect: why it cannot be tested}
        self.refused: dict[str, str] = {}
        #: {effect: its forms}
        self.forms: dict[str, list[Form]] = {}
        embedding = Embedding(problem, law)
        blocks, start = [np.zeros((len(problem), 0))], 0
        for effect in effects:
            for signature in self._signatures(problem, effect):
                columns = problem.in_noise_units(signature.columns)
                raw = float(np.sum(embedding.whiten(columns) ** 2))
                stop = start + columns.shape[1]
                form = Form(signature, np.arange(start, stop), raw)
                self.forms.setdefault(effect.name, []).append(form)
                blocks.append(columns)
                start = stop
        embedded = embedding.scores(np.hstack(blocks))
        self._gram = embedded.T @ embedded
        self._precision = self._rival_precision(room)

    def _rival_precision(self, room: float) -> Array:
        """Prior precision (K,) of each column as a rival's."""
        adapting = [np.zeros(0, dtype=bool)]
        for forms in self.forms.values():
            adapting += [form.signature.shape for form in forms]
        return np.where(np.concatenate(adapting), 1.0, room**-2)

    def _signatures(
        self,
        problem: GapProblem,
        effect: Effect,
    ) -> list[Signature]:
        """Signatures of an effect over its grid that change a reading."""
        reason = untestable(effect, problem.states)
        if reason is not None:
            self.refused[effect.name] = reason
            return []
        every = [problem.signature(effect, point) for point in effect.constant_grid()]
        changing = [s for s in every if s.names]
        if not changing:
            self.refused[effect.name] = "it changes none of these readings"
        return changing

    def block(self, rows: Index, columns: Index) -> Array:
        """Inner products (k, l) of some columns."""
        return np.asarray(self._gram[np.ix_(rows, columns)])

    def gram(self, form: Form) -> Array:
        """A_kk (k, k) of a form."""
        return self.block(form.at, form.at)

    def separated(self, form: Form, rival: Form) -> Array:
        """A_kk less what the rival absorbs."""
        precision = np.diag(self._precision[rival.at])
        inner = self.block(rival.at, rival.at) + precision
        cross = self.block(rival.at, form.at)
        absorbed = cross.T @ linalg.solve(inner, cross, assume_a="pos")
        return np.asarray(self.gram(form) - absorbed)

    def worst(self, form: Form, rival: str) -> Form:
        """The rival's form that absorbs most of what the effect is expected to do."""

        def remaining(candidate: Form) -> float:
            return float(np.trace(self.separated(form, candidate)))

        return min(self.forms[rival], key=remaining)
