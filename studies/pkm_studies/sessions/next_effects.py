"""Effects beside the geometry in the advice at the machine, at their expected sizes.

The readings taken and all candidates share the unknowns of the effects, so that a reading
is worth what it tells of both. What depends on side of approach, time or temperature
counts as in a plan: not recorded, for the order of the readings to come is not known.
"""

from __future__ import annotations

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.design import Candidates
from oed.effects import PlannedEffects
from oed.identifiability import prior_information
from oed.measurement import Measurement, Series, reading_structure
from oed.noise import Laws, Noise
from oed.poses import Belief
from oed.verdict import SURE_PROBABILITY
from pkm_studies.base import Stream
from pkm_studies.resolve import (
    MAX_EFFECT_UNKNOWNS,
    NO_EFFECTS,
    effects_of_planned,
    named_effects,
    pose_error_slopes,
)
from pkm_studies.stages import RunState

#: machines that are drawn for an interval or a probability
MACHINES = 4000
#: share of a wanted accuracy that no reading reaches
OUT_OF_REACH = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class Outlook:
    """What is known, and the candidates for the next reading.

    pool     of the candidates, after the `taken` readings
    before   what was known before any reading;  now  what is known
    others   (K,) mean square over the workspace that no reading can reduce, SI
    holds_effects  whether effects beside the geometry are in all this
    """

    pool: Candidates
    taken: int
    before: Belief
    now: Belief
    others: Array
    holds_effects: bool = False

    @property
    def blocks(self) -> Array:
        """Blocks (C, k, n) of the candidates."""
        return self.pool.blocks[self.taken :]

    def accuracy(self, belief: Belief) -> Array:
        """Rms (K,) of a belief."""
        return np.asarray(np.sqrt(belief.variances + self.others))

    @functools.cached_property
    def drawn_rms(self) -> Array:
        """Rms errors (machines, K) that this machine may have, SI.

        The mean square over the workspace is a sum of squares of normal errors.
        """
        rng = np.random.default_rng(0)
        values, vectors = np.linalg.eigh(self.now.covariance)
        root = vectors * np.sqrt(np.maximum(values, 0.0))
        squares = rng.standard_normal((MACHINES, len(values))) ** 2
        columns = []
        for weight, other in zip(self.now.weights, self.others, strict=True):
            spread = np.linalg.eigvalsh(root.T @ weight @ root)
            columns.append(squares @ np.maximum(spread, 0.0) + other)
        return np.asarray(np.sqrt(np.column_stack(columns)))

    def within(self, wanted: Array) -> tuple[Array, Array]:
        """Probabilities (K,) that wanted rms errors (K,) are met; NaN where none is.

        The second result is the expected rms errors (K,) with which they pass: a pass
        needs a high quantile of the error within what is wanted.
        """
        drawn = self.drawn_rms
        share = np.where(np.isfinite(wanted), (drawn <= wanted).mean(axis=0), np.nan)
        upper = np.maximum(
            np.quantile(drawn, SURE_PROBABILITY, axis=0), np.finfo(float).tiny
        )
        return share, wanted * self.accuracy(self.now) / upper

    def limits(self, wanted: Array) -> Array:
        """Wanted rms (K,) of what readings can reduce; NaN where none is wanted.

        Where more than wanted is left by what they cannot, nothing reaches the limit.
        """
        least = (OUT_OF_REACH * wanted) ** 2
        return np.asarray(np.sqrt(np.maximum(wanted**2 - self.others, least)))


def effects_at(
    state: RunState, measurement: Measurement, taken: Sequence[Series]
) -> PlannedEffects | None:
    """What the effects of [identify] do to readings taken and candidates; None without."""
    names, resolved = state.study.identify.fitted_effects, state.resolved
    if names == NO_EFFECTS or resolved.prediction is None:
        return None
    request = resolved.gap_or_default
    location = state.study.location.key("identify").key("effects")
    return effects_of_planned(
        measurement,
        [*taken, *resolved.candidates],
        named_effects(request, names, location),
        request,
        resolved.prediction,
        Stream.PLANNED_COURSES.rng(state.study.seed),
        MAX_EFFECT_UNKNOWNS,
    )


def noise_with_effects(
    measurement: Measurement, taken: Sequence[Series], effects: PlannedEffects
) -> Noise:
    """Stated noise of the readings taken, with the effects' covariance beside it."""
    structure = reading_structure(measurement, taken, measurement.nominal)
    changes = effects.readings.take(slice(0, len(structure)))
    columns = np.hstack([changes.columns, np.diag(changes.scatter)])
    wider = dataclasses.replace(structure, effects=structure.standardise(columns))
    return Laws.stated(wider).noise(wider)


def outlook_with_effects(
    state: RunState,
    measurement: Measurement,
    taken: Sequence[Series],
    theta: Array,
    raw: Array,
    effects: PlannedEffects,
) -> Outlook:
    """The outlook after the readings taken, linear about theta (n,).

    raw  (n, K, p) pose errors over the workspace per unit of each parameter, SI
    """
    pool = Candidates.build(
        measurement,
        [*taken, *state.resolved.candidates],
        theta,
        "tolerance",
        nuisances=effects.readings,
    )
    pool = pool.add_prior(prior_information(measurement))
    count = sum(map(len, taken))
    total, information_so_far = (
        pool.prior_information,
        pool.information(np.arange(count)),
    )
    factors = pose_error_slopes(pool, raw, effects)
    by_component = factors.swapaxes(0, 1) / np.sqrt(len(raw))
    before, now = (
        np.asarray(np.linalg.inv(i), dtype=float) for i in (total, information_so_far)
    )
    beliefs = Belief.build(before, by_component), Belief.build(now, by_component)
    return Outlook(pool, count, *beliefs, effects.others, holds_effects=True)
