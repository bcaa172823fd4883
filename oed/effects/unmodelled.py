"""Expected errors by effects that the model lacks, through calibration to the workspace.

An effect with coefficients beta ~ N(0, I), in prior standard deviations, changes the
readings by G beta and the pose by E beta. A calibration that does not know it takes a
part for parameters, so that the compensated machine errs by

    e = (E - A K G) beta,        K = S H^T C^-1.

One that fits all effects with the parameters, and takes back what it then knows of both,
leaves what the joint posterior P of z and beta leaves, each effect's constants unknown. A
controller that is sent parameters alone has them moved by D beta_hat, so that they take
up what they can of the effects, and leaves as well

    (E - C D) beta_hat,        beta_hat ~ N(0, I - P_bb),

with C what compensation changes per unit of a parameter.
"""

import dataclasses
from collections.abc import Mapping, Sequence
from typing import NamedTuple

import numpy as np

from oed import units
from oed.accuracy import BudgetModel, ErrorMaps, Prediction, Reference, predict
from oed.base import Array, Index, Mask
from oed.effect_model import Effect, State
from oed.effects.effect_maps import SessionStates, absorbing_shift, effect_maps
from oed.gap import ActingEffectForm, GapProblem, untestable
from oed.linear_algebra import covariance_root

N_CONSTANTS = 5  #: points of an effect's constants that are tried
N_MACHINES = 1000  #: machines drawn for intervals and percentiles


@dataclasses.dataclass(frozen=True, eq=False)
class ExpectedEffect:
    """Expected errors by one effect that the model lacks."""

    effect: Effect  #: the effect
    #: {coefficient: prior standard deviation at each of its constants, in its SI unit}
    sizes: Mapping[str, list[float]]
    #: (n, k) of the pose components at the workspace poses, SI, where the calibration
    #: knows none; median over its constants
    variance: Array
    #: (n, k) of the machine without it, where all others act and are fitted
    without: Array
    not_testable: str | None  #: why the readings cannot test it; None where they can

    @property
    def size_text(self) -> str:
        """Prior standard deviations of the coefficients: `3 C`, or the range of several."""
        sizes: dict[str, list[float]] = {}
        for name, scales in self.sizes.items():
            unit, factor = units.coefficient_unit(self.effect.unit(name))
            sizes.setdefault(unit, []).extend(scale / factor for scale in scales)
        parts = []
        for unit, values in sizes.items():
            low, high = f"{min(values):.3g}", f"{max(values):.3g}"
            span = low if low == high else f"{low} to {high}"
            parts.append(f"{span} {unit}")
        return ", ".join(parts)


@dataclasses.dataclass(frozen=True, eq=False)
class ExpectedEffects:
    """Expected errors by effects that the model lacks.

    The variance (n, k) of the pose components, SI, is the mean over the constants.
    """

    effects: list[ExpectedEffect]  #: those that have any
    #: variance by all of them together, beside the geometry's, where the calibration
    #: knows none
    added: Array
    #: of machines with all of them, fitted with the parameters: the parameters sent
    #: take up of them what they can; fully corrected, effects are compensated too
    prediction: Prediction

    @classmethod
    def of(
        cls,
        problem: GapProblem,
        session: SessionStates,
        model: BudgetModel,
        maps: ErrorMaps,
        effects: Sequence[Effect],
        reference: Reference,
        rng: np.random.Generator,
    ) -> "ExpectedEffects | None":
        """Expected errors at the commands of `maps`; None where no effect makes any.

        model  of the problem's readings, linearised where the problem is. Effects that
               depend on what the plan does not state (a payload), and incidents, are left out
        """
        machine = session.measurement.machine
        states = [
            session.workspace_state(problem.theta, maps.command, rng) for _ in range(2)
        ]
        forms = [
            form
            for effect in effects
            if not effect.incident and effect.unfit(machine) is None
            for form in _forms(problem, effect, states[0])
        ]
        if not forms:
            return None
        acting_forms = [form.acting for form in forms]
        kinematics = session.measurement.kinematics
        parameters = problem.theta[: len(machine.parameters)]
        where = parameters, maps.command, reference
        judged, absorbed = (
            effect_maps(kinematics, acting_forms, state, *where).raw for state in states
        )
        changes = np.hstack([form.changes for form in forms])
        by_effect = _errors_by_effect(
            forms, judged - maps.raw @ model.response(changes)
        )
        if not by_effect:
            return None
        # An effect has one set of constants: its coefficients at several share its variance.
        added = sum(np.mean([f.variance for f in some], axis=0) for some in by_effect)
        used = np.concatenate([f.columns for some in by_effect for f in some])
        widths = [[len(f.columns) for f in some] for some in by_effect]
        share = np.repeat([len(of) ** -0.5 for of in widths], list(map(sum, widths)))
        changes, tool, absorbed = (
            share * values[..., used] for values in (changes, judged, absorbed)
        )
        tolerance = session.measurement.tolerance[: len(machine.parameters)]
        shift = absorbing_shift(maps, absorbed, tolerance)
        joint = _joint_maps(model, maps, tool, shift)
        information = _joint_information(model, changes)
        owner = np.repeat(
            np.arange(-1, len(by_effect)), [len(model.names), *map(sum, widths)]
        )
        expected = [
            _expected(problem, some, _variance_of(joint, information, owner != number))
            for number, some in enumerate(by_effect)
        ]
        return cls(
            effects=expected,
            added=np.asarray(added),
            prediction=_prediction(joint, information, widths, rng, reference),
        )


@dataclasses.dataclass(frozen=True, eq=False)
class _Form:
    """An effect at one set of constants, with its textbook's coefficients."""

    acting: ActingEffectForm
    sizes: Mapping[str, float]
    changes: Array  #: (N, m) of the readings per prior standard deviation, SI


class _FormErrors(NamedTuple):
    """A form, and what it makes of the compensated machine."""

    form: _Form
    columns: Index  #: (m,) its coefficients, by number among those of all forms
    variance: Array  #: (n, k) of the errors


def _errors_by_effect(forms: Sequence[_Form], errors: Array) -> list[list[_FormErrors]]:
    """The forms of each effect that makes errors, of those (n, k, m) by all coefficients."""
    ends = np.cumsum([form.changes.shape[1] for form in forms])
    parts = np.split(np.arange(ends[-1]), ends[:-1])
    acting: dict[str, list[_FormErrors]] = {}
    for form, columns in zip(forms, parts, strict=True):
        error = errors[:, :, columns]
        if np.isfinite(error).all() and error.any():
            variance = np.sum(error**2, axis=2)
            of_effect = acting.setdefault(form.acting.effect.name, [])
            of_effect.append(_FormErrors(form, columns, variance))
    return list(acting.values())


def _prediction(
    joint: ErrorMaps,
    information: Array,
    widths: Sequence[Sequence[int]],
    rng: np.random.Generator,
    reference: Reference,
) -> Prediction:
    """Errors of machines, each with one set of constants an effect.

    With w = (z, beta) and eta ~ N(0, P (I - P)) from the noise, w_hat = (I - P) w + eta.

    widths  coefficients at each of the constants, by effect
    """
    prior = np.eye(len(information))
    covariance = np.asarray(np.linalg.inv(prior + information))
    machines = rng.standard_normal((N_MACHINES, len(prior)))
    start = len(prior) - sum(map(sum, widths))
    for of_constants in widths:
        count = len(of_constants)
        acts = rng.integers(count, size=(N_MACHINES, 1)) == np.arange(count)
        shares = np.repeat(np.sqrt(count) * acts, of_constants, axis=1)
        machines[:, start : start + shares.shape[1]] *= shares
        start += shares.shape[1]
    root = covariance_root(np.asarray(covariance - covariance @ covariance))
    scatter = rng.standard_normal(machines.shape) @ root.T
    estimates = machines @ (prior - covariance) + scatter
    return predict(
        joint,
        prior,
        covariance,
        rng,
        draws=machines - estimates,
        estimates=estimates,
        reference=reference,
    )


def _variance_of(joint: ErrorMaps, information: Array, acting: Mask) -> Array:
    """Variance (n, k), SI, after compensation where some unknowns (n + m,) act alone."""
    raw, remaining = joint.raw[:, :, acting], joint.remaining[:, :, acting]
    prior = np.eye(int(acting.sum()))
    covariance = np.linalg.inv(prior + information[np.ix_(acting, acting)])
    undetermined = np.sum((raw @ covariance) * raw, axis=2)
    explained = np.sum((remaining @ (prior - covariance)) * remaining, axis=2)
    return np.asarray(undetermined + explained)


def _joint_maps(
    model: BudgetModel, maps: ErrorMaps, tool: Array, shift: Array
) -> ErrorMaps:
    """Maps over z and beta; with compensation, parameters are moved by `shift` (np, m)."""
    root = model.root[model.used]
    uncorrected = tool - (maps.raw - maps.remaining) @ shift
    return dataclasses.replace(
        maps,
        raw=np.concatenate([maps.raw @ root, tool], axis=2),
        remaining=np.concatenate([maps.remaining @ root, uncorrected], axis=2),
    )


def _expected(
    problem: GapProblem, forms: Sequence[_FormErrors], without: Array
) -> ExpectedEffect:
    """One effect's errors, by its forms; `without`: those of all others together."""
    effect = forms[0].form.acting.effect
    sizes: dict[str, list[float]] = {}
    for of_constants in forms:
        for name, size in of_constants.form.sizes.items():
            sizes.setdefault(name, []).append(size)
    return ExpectedEffect(
        effect=effect,
        sizes=sizes,
        variance=np.median([f.variance for f in forms], axis=0),
        without=without,
        not_testable=untestable(effect, problem.states),
    )


def _joint_information(model: BudgetModel, changes: Array) -> Array:
    """Information (n + m, n + m) on z and beta, that changes readings by (N, m), SI."""
    columns = np.hstack([model.slopes, model.structure.standardise(changes)])
    white = model.readings.whiten(columns, {})
    return np.asarray(white.T @ white)


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
        acting = ActingEffectForm(effect, constants, tuple(names), 1.0)
        forms.append(_Form(acting, sizes, changes))
    return forms
