"""Expected errors by effects that the model lacks, through calibration to the workspace.

An effect with coefficients beta ~ N(0, I), in prior standard deviations, changes the
readings by G beta and the pose by E beta. A calibration that does not know it takes a
part for parameters, so that the compensated machine errs by

    e = (E - A K G) beta,        K = S H^T C^-1.

One that fits all effects with the parameters, and takes back what it then knows of both,
leaves what the joint posterior of z and beta leaves, each effect's constants unknown.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from oed.accuracy import BudgetModel, ErrorMaps, Reference
from oed.base import Array
from oed.effect_model import Effect, State
from oed.effects.effect_maps import (
    ActingForm,
    SessionStates,
    effect_maps,
    workspace_state,
)
from oed.gap import GapProblem, untestable

#: points of an effect's constants that are tried
N_CONSTANTS = 5


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
class ExpectedEffects:
    """Expected errors by effects that the model lacks.

    Variances (n, k) of the pose components, SI, are means over the constants.

    effects  those that have any
    added    variance by all of them together, beside the geometry's
    fitted   variance of all, where effects are fitted and corrected with the parameters
    """

    effects: list[ExpectedEffect]
    added: Array
    fitted: Array


@dataclasses.dataclass(frozen=True, eq=False)
class _Form:
    """An effect at one set of constants, with its textbook's coefficients.

    changes  (N, m) of the readings per prior standard deviation, SI
    """

    acting: ActingForm
    sizes: Mapping[str, float]
    changes: Array


class _FormErrors(NamedTuple):
    """A form, what it does to the tool (n, k, m), and the variance (n, k) of the errors.

    The errors are those of the compensated machine.
    """

    form: _Form
    tool: Array
    variance: Array


def expected_effects(
    problem: GapProblem,
    session: SessionStates,
    model: BudgetModel,
    maps: ErrorMaps,
    effects: Sequence[Effect],
    reference: Reference,
    rng: np.random.Generator,
) -> ExpectedEffects | None:
    """Expected errors at the commands of `maps`; None where no effect makes any.

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
        return None
    parameters = problem.theta[: len(machine.parameters)]
    in_workspace = effect_maps(
        session.measurement.kinematics,
        [form.acting for form in forms],
        state,
        parameters,
        maps.command,
        reference,
    )
    changes = np.hstack([form.changes for form in forms])
    errors = in_workspace.raw - maps.raw @ model.response(changes)
    ends = np.cumsum([form.changes.shape[1] for form in forms])[:-1]
    parts = (np.split(values, ends, axis=2) for values in (in_workspace.raw, errors))
    acting: dict[str, list[_FormErrors]] = {}
    for form, tool, error in zip(forms, *parts, strict=True):
        if np.isfinite(error).all() and error.any():
            of_effect = acting.setdefault(form.acting.effect.name, [])
            of_effect.append(_FormErrors(form, tool, np.sum(error**2, axis=2)))
    if not acting:
        return None
    by_effect = list(acting.values())
    # An effect has one set of constants: its coefficients at several share its variance.
    added = sum(np.mean([f.variance for f in some], axis=0) for some in by_effect)
    shared = [(f, len(some) ** -0.5) for some in by_effect for f in some]
    changes = np.hstack([share * f.form.changes for f, share in shared])
    tool = np.concatenate([share * f.tool for f, share in shared], axis=2)
    return ExpectedEffects(
        effects=[_expected(problem, some) for some in by_effect],
        added=np.asarray(added),
        fitted=_fitted(model, maps.raw, changes, tool),
    )


def _expected(problem: GapProblem, forms: Sequence[_FormErrors]) -> ExpectedEffect:
    """One effect's errors, by its forms."""
    first = forms[0].form
    effect = first.acting.effect
    return ExpectedEffect(
        effect=effect,
        sizes=first.sizes,
        variance=np.median([f.variance for f in forms], axis=0),
        not_testable=untestable(effect, problem.states),
    )


def _fitted(model: BudgetModel, gradients: Array, changes: Array, tool: Array) -> Array:
    """Variance (n, k), SI, by the joint posterior of parameters and effects.

    gradients  (n, k, p) of the pose over the parameters that move it, SI
    changes    (N, m) of the readings per prior standard deviation of each coefficient, SI
    tool       (n, k, m) of the pose likewise
    """
    columns = np.hstack([model.slopes, model.structure.standardise(changes)])
    white = model.readings.whiten(columns, {})
    covariance = np.linalg.inv(np.eye(columns.shape[1]) + white.T @ white)
    by_parameter = gradients @ model.root[model.used]
    by_unknown = np.concatenate([by_parameter, tool], axis=2)
    return np.asarray(np.sum((by_unknown @ covariance) * by_unknown, axis=2))


def _forms(problem: GapProblem, effect: Effect, state: State) -> list[_Form]:
    """The effect at some of its constants; none where it has no coefficient here."""
    points = effect.constant_grid()
    tried = np.unique(np.linspace(0, len(points) - 1, N_CONSTANTS).round().astype(int))
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
