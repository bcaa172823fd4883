"""Expected errors by effects that the model lacks, through calibration to the workspace.

An effect with coefficients beta ~ N(0, I), in prior standard deviations, changes the
readings by G beta and the pose by E beta. A calibration that does not know it takes a
part for parameters, so that the compensated machine errs by

    e = (E - A K G) beta,        K = S H^T C^-1.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np

from oed.accuracy.budget.model import BudgetModel
from oed.accuracy.maps import ErrorMaps, Reference
from oed.base.arrays import Array
from oed.compensate.effects.effect_maps import (
    ActingForm,
    SessionStates,
    effect_maps,
    workspace_state,
)
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import untestable
from oed.model.effect import Effect, State

#: points of an effect's constants that are tried
POINTS = 5


@dataclasses.dataclass(frozen=True, eq=False)
class ExpectedEffect:
    """Expected errors by one effect that the model lacks.

    effect        the effect
    sizes         {coefficient: prior standard deviation, in its SI unit}
    variance      (n, k) of the pose components at the workspace poses, SI; median over
                  its constants
    not_testable  why the readings cannot test it; None where they can
    """

    effect: Effect
    sizes: Mapping[str, float]
    variance: Array
    not_testable: str | None


@dataclasses.dataclass(frozen=True, eq=False)
class _Form:
    """An effect at one set of constants, with its textbook's coefficients.

    changes  (N, m) of the readings per prior standard deviation, SI
    """

    acting: ActingForm
    sizes: Mapping[str, float]
    changes: Array


def expected_effects(
    problem: GapProblem,
    session: SessionStates,
    model: BudgetModel,
    maps: ErrorMaps,
    effects: Sequence[Effect],
    reference: Reference,
    rng: np.random.Generator,
) -> list[ExpectedEffect]:
    """Expected errors at the commands of `maps`, of those effects that have any.

    model  of the problem's readings, linearised where the problem is. Effects that
           depend on what the plan does not state (a payload) are left out
    """
    state = workspace_state(session, problem.theta, maps.command, rng)
    machine = session.measurement.machine
    forms = [
        form
        for effect in effects
        if effect.unfit(machine) is None
        for form in _forms(problem, effect, state)
    ]
    if not forms:
        return []
    parameters = problem.theta[: len(machine.parameters)]
    acting = [form.acting for form in forms]
    in_workspace = effect_maps(
        session.measurement.kinematics,
        acting,
        state,
        parameters,
        maps.command,
        reference,
    )
    changes = np.hstack([form.changes for form in forms])
    errors = in_workspace.raw - maps.raw @ model.response(changes)
    ends = np.cumsum([form.changes.shape[1] for form in forms])
    variances: dict[str, list[Array]] = {}
    for form, part in zip(forms, np.split(errors, ends[:-1], axis=2), strict=True):
        if np.isfinite(part).all() and part.any():
            of_effect = variances.setdefault(form.acting.effect.name, [])
            of_effect.append(np.sum(part**2, axis=2))
    first = {form.acting.effect.name: form for form in reversed(forms)}
    return [
        ExpectedEffect(
            effect=first[name].acting.effect,
            sizes=first[name].sizes,
            variance=np.median(table, axis=0),
            not_testable=untestable(first[name].acting.effect, problem.states),
        )
        for name, table in variances.items()
    ]


def _forms(problem: GapProblem, effect: Effect, state: State) -> list[_Form]:
    """The effect at some of its constants; none where it has no coefficient here."""
    points = effect.constant_grid()
    tried = np.unique(np.linspace(0, len(points) - 1, POINTS).round().astype(int))
    forms = []
    for constants in (points[k] for k in tried):
        columns = effect.columns(state, **constants)
        sizes = {c.name: float(c.scale) for c in columns if not c.shape}
        if not sizes:
            continue
        names = list(sizes)
        signature = problem.signature(effect, constants, textbook=True)
        changes = np.zeros((len(problem), len(names)))
        for k, name in enumerate(signature.names):
            if name in sizes:
                changes[:, names.index(name)] = signature.columns[:, k]
        acting = ActingForm(effect, constants, tuple(names))
        forms.append(_Form(acting, sizes, changes))
    return forms
