"""What a machine's effects do to readings and workspace, per expected size.

An effect depends on its constants nonlinearly: its coefficients at some of them stand
side by side, and share its variance. The columns of a group (an effect in one leg) are
then replaced by their few principal ones, of what the readings see and of what the tool
does at the same poses, so that errors that no reading shows stay.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg

from oed.accuracy import ErrorMaps, Reference
from oed.base import Array, Index, Mask
from oed.effect_model import Effect, State
from oed.effects.effect_maps import (
    ActingForm,
    SessionStates,
    effect_maps,
    in_session,
    workspace_state,
)
from oed.effects.unknown_effects import unknown_effects
from oed.estimation import Discrepancy
from oed.gap import GapProblem, Signature
from oed.mechanism import NO_TOOL

#: most values of an effect's constants that stand side by side
MAX_FORMS = 16
#: share of a group's variance that its principal columns hold
VARIANCE_SHARE = 0.995
#: root mean square change of the readings, in units of the noise, below which a group
#: changes nothing
MIN_CHANGE = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class ExpectedColumns:
    """Effects of a machine at their expected sizes.

    discrepancy  what they do to the readings
    forms        effects at their constants, with all of their coefficients
    mixing       (a, k) of all a coefficients of the forms in each of the k columns
    """

    discrepancy: Discrepancy
    forms: tuple[ActingForm, ...]
    mixing: Array

    @classmethod
    def side_by_side(cls, parts: Sequence[ExpectedColumns]) -> ExpectedColumns | None:
        """The columns of several, one after the other; None of none."""
        if len(parts) < 2:
            return parts[0] if parts else None
        names: list[str] = []
        forms: list[ActingForm] = []
        groups: list[Index] = []
        for part in parts:
            groups.append(part.discrepancy.group + len(names))
            names += part.discrepancy.names
            forms += part.forms
        discrepancy = Discrepancy(
            columns=np.hstack([part.discrepancy.columns for part in parts]),
            group=np.concatenate(groups),
            names=tuple(names),
            unknown=np.concatenate([part.discrepancy.unknown for part in parts]),
        )
        mixing = linalg.block_diag(*[part.mixing for part in parts])
        return cls(discrepancy, tuple(forms), mixing)

    def changes(self, problem: GapProblem, session: SessionStates) -> Array:
        """Changes (N, k) of other readings of the session per unit of each column, SI."""
        states = tuple(in_session(s, session.states[0]) for s in problem.states)
        others = dataclasses.replace(problem, states=states)
        parts = []
        for form in self.forms:
            signature = others.signature(form.effect, form.constants)
            parts.append(signature.columns_of(form.names))
        return np.asarray(np.hstack(parts) @ self.mixing)

    def take(self, chosen: Mask) -> ExpectedColumns:
        """Some of the columns (k,), with the groups and forms that they need."""
        mixing = self.mixing[:, chosen]
        ends = np.cumsum([len(form.names) for form in self.forms])
        blocks = np.split(mixing, ends[:-1])
        acting = [block.any() for block in blocks]
        numbers, group = np.unique(self.discrepancy.group[chosen], return_inverse=True)
        return ExpectedColumns(
            dataclasses.replace(
                self.discrepancy,
                columns=self.discrepancy.columns[:, chosen],
                group=group.astype(np.intp),
                names=tuple(self.discrepancy.names[g] for g in numbers),
                unknown=self.discrepancy.unknown[numbers],
            ),
            tuple(f for f, acts in zip(self.forms, acting, strict=True) if acts),
            np.vstack([b for b, acts in zip(blocks, acting, strict=True) if acts]),
        )

    def of_sizes(self, sizes: Array) -> ExpectedColumns:
        """The same at some common sizes (t,), in expected sizes."""
        discrepancy = dataclasses.replace(self.discrepancy, sizes=sizes)
        return dataclasses.replace(self, discrepancy=discrepancy)

    def workspace_maps(
        self,
        session: SessionStates,
        theta: Array,
        command: Array,
        reference: Reference,
        rng: np.random.Generator,
        tool: Array = NO_TOOL,
    ) -> ErrorMaps:
        """Pose errors per unit of each column at commands (n, n_dof), in drawn states.

        The commands are those of a tool point (3,).
        """
        state = workspace_state(session, theta, command, rng, tool=tool)
        kinematics = session.measurement.kinematics
        parameters = theta[: len(session.measurement.machine.parameters)]
        maps = effect_maps(
            kinematics, self.forms, state, parameters, command, reference, tool
        )
        return dataclasses.replace(
            maps, raw=self._mixed(maps.raw), remaining=self._mixed(maps.remaining)
        )

    def _mixed(self, gradients: Array) -> Array:
        """Slopes (n, k, a) over coefficients as slopes over the columns."""
        poses, components, count = gradients.shape
        flat = gradients.reshape(poses * components, count)
        return np.asarray((flat @ self.mixing).reshape(poses, components, -1))


@dataclasses.dataclass(frozen=True, eq=False)
class _EffectGroup:
    """One group's coefficients at all of its constants.

    readings      (N, a) changes, in units of the noise;  tool (m, a) displacements, m
    coefficients  (form, coefficient) of each
    share         that a coefficient at one of the constants has, in standard deviations
    unit          factor of all coefficients
    """

    name: str
    unknown: bool
    readings: Array
    tool: Array
    coefficients: list[tuple[int, str]]
    share: float
    unit: float = 1.0

    def scaled(self, unit: float) -> _EffectGroup:
        """The group with its coefficients in another unit."""
        return dataclasses.replace(self, unit=unit)

    @property
    def size(self) -> float:
        """Root mean square change of the readings by all coefficients together."""
        return float(np.sqrt((self.readings**2).sum(axis=1).mean()))

    def principal(self) -> Array:
        """Combinations (a, k) of the coefficients that hold the variance."""
        parts = [_unit(self.readings), _unit(self.tool)]
        _, values, rows = np.linalg.svd(np.vstack(parts), full_matrices=False)
        squares = values**2
        before = np.cumsum(squares) - squares
        return np.asarray(rows[before <= VARIANCE_SHARE * squares.sum()].T)


def _unit(values: Array) -> Array:
    norm = float(np.linalg.norm(values))
    return values / norm if norm else values


def expected_columns(
    problem: GapProblem, effects: Sequence[Effect], *, unknown: bool = True
) -> ExpectedColumns | None:
    """Columns of the effects that the machine can have, and by default of unknown ones.

    Unknown effects are as large as known ones usually are: their unit changes the
    readings that they change at all by the median of what known ones do to these at their
    expected sizes. None where no effect changes a reading.
    """
    machine = problem.measurement.machine
    forms: list[ActingForm] = []
    groups: list[_EffectGroup] = []
    for effect in effects:
        if effect.unfit(machine) is None:
            groups += _groups_of(problem, effect, forms, unknown=False)
    known_groups = [group for group in groups if group.size > MIN_CHANGE]
    if not known_groups:
        return None
    for effect in unknown_effects() if unknown else ():
        for group in _groups_of(problem, effect, forms, unknown=True):
            typical = _typical_size(known_groups, group)
            if group.size > MIN_CHANGE and typical > MIN_CHANGE:
                groups.append(group.scaled(typical / group.size))
    return _assembled(problem, forms, groups)


def _typical_size(known_groups: Sequence[_EffectGroup], unknown: _EffectGroup) -> float:
    """Median root mean square change of readings by known groups, in units of the noise.

    Over the readings that an unknown group changes: its instrument's, if it is an error
    of one.
    """
    changed = (unknown.readings != 0.0).any(axis=1)
    sizes = []
    for group in known_groups:
        squares = (group.readings[changed] ** 2).sum(axis=1)
        size = float(np.sqrt(squares.mean())) if changed.any() else 0.0
        if size > MIN_CHANGE:
            sizes.append(size)
    if not sizes:
        return 0.0
    share = np.sqrt(changed.mean())
    return float(np.median(sizes) * share)


def _groups_of(
    problem: GapProblem, effect: Effect, forms: list[ActingForm], *, unknown: bool
) -> list[_EffectGroup]:
    """The groups of one effect; its forms are appended to `forms`."""
    grid = effect.constant_grid()
    tried = np.unique(np.linspace(0, len(grid) - 1, MAX_FORMS).round().astype(int))
    signatures: list[tuple[int, Signature, dict[str, Array]]] = []
    for constants in (grid[k] for k in tried):
        signature = problem.signature(effect, constants)
        tool = _tool_changes(problem.states, effect, constants)
        if signature.names:
            signatures.append((len(forms), signature, tool))
            forms.append(ActingForm(effect, constants, signature.names))
    labels = dict.fromkeys(label for _, s, _ in signatures for label in s.labels)
    share = 1.0 / np.sqrt(max(len(signatures), 1))
    groups = []
    for label in labels:
        readings, displaced, coefficients = [], [], []
        for number, signature, tool in signatures:
            for k, name in enumerate(signature.names):
                if signature.labels[k] == label:
                    readings.append(signature.columns[:, k])
                    displaced.append(tool[name])
                    coefficients.append((number, name))
        name = f"{effect.name}: {label}" if label else effect.name
        changes = problem.in_noise_units(np.column_stack(readings))
        moved = share * np.column_stack(displaced)
        groups.append(
            _EffectGroup(name, unknown, share * changes, moved, coefficients, share)
        )
    return groups


def _tool_changes(
    states: Sequence[State], effect: Effect, constants: dict[str, float]
) -> dict[str, Array]:
    """Displacements (m,) of the tool by joints, by coefficient, over all series, m."""
    ends = np.cumsum([0, *(3 * len(state) for state in states)])
    result: dict[str, Array] = {}
    for start, state in zip(ends, states, strict=False):
        for column in effect.columns(state, **constants):
            values = result.setdefault(column.name, np.zeros(ends[-1]))
            moved = np.zeros((len(state), 3))
            for joint, change in column.joints.items():
                moved += state.twist[:, :3, joint] * change[:, None]
            values[start : start + moved.size] += column.scale * moved.ravel()
    return result


def _assembled(
    problem: GapProblem, forms: list[ActingForm], groups: list[_EffectGroup]
) -> ExpectedColumns:
    """All groups side by side."""
    numbers_of: dict[tuple[int, str], int] = {}
    for number, form in enumerate(forms):
        for name in form.names:
            numbers_of[number, name] = len(numbers_of)
    columns, mixing, owner = [], [], []
    for g, group in enumerate(groups):
        combinations = group.principal() * group.unit
        columns.append(group.readings @ combinations)
        block = np.zeros((len(numbers_of), combinations.shape[1]))
        block[[numbers_of[coefficient] for coefficient in group.coefficients]] = (
            group.share * combinations
        )
        mixing.append(block)
        owner += [g] * combinations.shape[1]
    discrepancy = Discrepancy(
        columns=np.hstack(columns) * problem.sigma[:, None],
        group=np.array(owner, dtype=np.intp),
        names=tuple(group.name for group in groups),
        unknown=np.array([group.unknown for group in groups]),
    )
    return ExpectedColumns(discrepancy, tuple(forms), np.hstack(mixing))
