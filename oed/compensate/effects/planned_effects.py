"""Effects at their expected sizes, as few unknowns of planned readings.

The principal combinations of all effects' columns, in units of the noise, are unknowns of
prior variance 1. What the others change counts as scatter of single readings, and as
error of the tool that no reading can reduce.
"""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.accuracy.maps import Reference
from oed.base.arrays import Array
from oed.compensate.effects.effect_maps import SessionStates
from oed.compensate.effects.expected_columns import ExpectedColumns
from oed.design.nuisances import Nuisances

#: change of all planned readings together, in units of the noise, below which a
#: combination is not seen
FAINT = 0.1


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedEffects:
    """u combinations of effects in planned readings.

    readings  change of the readings per unit, and by other combinations, SI
    tool      (n, k, u) change of k pose components at n workspace poses per unit, SI
    others    (k,) mean square over the workspace by other combinations, SI
    groups    names of the groups of effects
    """

    readings: Nuisances
    tool: Array
    others: Array
    groups: tuple[str, ...]


def planned_effects(
    columns: ExpectedColumns,
    sigma: Array,
    session: SessionStates,
    theta: Array,
    command: Array,
    reference: Reference,
    rng: np.random.Generator,
    most: int,
) -> PlannedEffects:
    """The combinations that planned readings show.

    most     combinations that are unknowns: more describe the effects better, and a
             search with them takes longer

    sigma    (N,) noise of the readings, SI
    session  states in which the readings would be taken
    command  (n, n_dof) of the workspace, SI
    """
    changes = columns.discrepancy.columns
    _, sizes, rows = np.linalg.svd(changes / sigma[:, None], full_matrices=False)
    combinations = rows[:most][sizes[:most] > FAINT].T
    change = changes @ combinations
    scatter = np.maximum((changes**2).sum(axis=1) - (change**2).sum(axis=1), 0.0)
    maps = columns.workspace_maps(session, theta, command, reference, rng)
    tool = maps.raw @ combinations
    total = (maps.raw**2).sum(axis=2) - (tool**2).sum(axis=2)
    return PlannedEffects(
        readings=Nuisances(change, np.sqrt(scatter)),
        tool=tool,
        others=np.maximum(total, 0.0).mean(axis=0),
        groups=columns.discrepancy.names,
    )
