"""What a machine's effects do to readings and workspace, per expected size.

An effect depends on its constants nonlinearly: its coefficients at some of them stand
side by side, and share its variance. The columns of a group (an effect in one leg) are
then replaced by their few principal ones, of what the readings see and of what the tool
does at the same poses, so that errors that no reading shows stay.
"""

from __future__ import annotations

import dataclasses
import functools
import itertools
from collections.abc import Callable, Iterable, Iterator, Sequence

import numpy as np
import scipy

from oed.accuracy import ErrorMaps, Reference
from oed.base import Array, Index, Mask
from oed.effect_model import Column, Effect, State
from oed.effects.effect_maps import SessionStates, effect_maps, session_state
from oed.estimation import Discrepancy
from oed.gap import ActingEffectForm, GapProblem
from oed.linear_algebra import right_singular
from oed.mechanism import NO_TOOL

# Effects of no known form: smooth errors of the tool, of single joints and of the readings.
#
# Each is a Gaussian process of the workspace, of the workspace with the direction of
# motion, or of the time, as a series of cosines on a box a little larger than what the
# session visits (Solin and Sarkka 2020, Stat. Comput. 30, 419-446). The variance falls
# with the order. Their sizes are given by the caller.

WORKSPACE_TERMS = 24  #: terms of a series over the workspace
TIME_TERMS = 10  #: terms of a series over the time
BOX_FACTOR = 1.25  #: half width of the box over that of what the session visits
QUARTER_ORDER = 2.0  #: order at which the variance has fallen to a quarter
#: size of a unit coefficient, in the unit of the joint, the tool's m or the reading
UNIT_SIZE = 1e-6

#: what a course is a function of
NEEDS = {"direction": ("direction: both",), "time": ("time",)}

Series = Callable[[State], Array]


def unknown_effects() -> tuple[Effect, ...]:
    """Effects of no known form, for any machine."""
    series: dict[str, Series] = {
        "place": place_terms,
        "direction": place_terms,
        "time": course_terms,
    }
    carriers = {
        "tool": _tool_columns,
        "joints": _joint_columns,
        "readings": _reading_columns,
    }
    effects = []
    for (carrier, columns), (course, values) in itertools.product(
        carriers.items(), series.items()
    ):
        if carrier == "readings" and course == "direction":
            continue
        effects.append(
            Effect(
                name=f"unknown {carrier} {course}",
                source="Kennedy and O'Hagan 2001, J. R. Stat. Soc. B 63, 425-464",
                about=f"an error of the {carrier} of no known form ({course})",
                columns=functools.partial(columns, values, course == "direction"),
                needs=NEEDS.get(course, ()),
            )
        )
    return tuple(effects)


def place_terms(state: State) -> Array:
    """Terms (m, k) of a smooth function of the joints in their travels."""
    return np.column_stack(list(_terms(state.travel, WORKSPACE_TERMS)))


def course_terms(state: State) -> Array:
    """Terms (m, k) of a smooth function of the session's course."""
    course = 2.0 * state.session_progress[:, None] - 1.0
    return np.column_stack(list(_terms(course, TIME_TERMS)))


def _terms(places: Array, count: int) -> Iterator[Array]:
    """Products (m,) of cosines of the coordinates (m, d), the smoothest `count`."""
    angle = 0.5 * np.pi * (places / BOX_FACTOR + 1.0)
    for orders in _smoothest(places.shape[1], count):
        waves = np.prod(np.cos(angle * orders), axis=1)
        yield waves / (1.0 + (orders @ orders) / QUARTER_ORDER**2)


@functools.cache
def _smoothest(dimensions: int, count: int) -> Array:
    """Orders (count, d) of the products, the smoothest first, the constant left out."""
    most = 8 if dimensions <= 2 else 3
    if dimensions == 1:
        most = count
    grid = itertools.product(range(most + 1), repeat=dimensions)
    ranked = sorted(grid, key=lambda orders: (sum(k * k for k in orders), orders))
    return np.array(ranked[1 : count + 1], dtype=float)


def _tool_columns(series: Series, reverses: bool, state: State) -> Iterable[Column]:
    """Displacements of the tool along the axes of the base."""
    terms = series(state)
    sense = _zero_where_unknown(state.direction) if reverses else 1.0
    for axis, name in enumerate("xyz"):
        for k, term in enumerate(terms.T):
            joints = state.displacing_joints(axis, sense * term)
            yield Column(f"{name} {k + 1}", UNIT_SIZE, joints=joints)


def _joint_columns(series: Series, reverses: bool, state: State) -> Iterable[Column]:
    """Errors of each joint by itself."""
    terms = series(state)
    for i in state.limbs:
        sense = _zero_where_unknown(state.motion_sign[:, i]) if reverses else 1.0
        leg = f"leg {i + 1}"
        for k, term in enumerate(terms.T):
            yield Column(f"{leg} {k + 1}", UNIT_SIZE, leg, {i: sense * term})


def _reading_columns(series: Series, reverses: bool, state: State) -> Iterable[Column]:
    """Errors of the instrument, in each channel of each set-up."""
    terms = series(state)
    for channel in state.channels:
        label = f"{state.setup} {channel}"
        for k, term in enumerate(terms.T):
            yield Column(f"{label} {k + 1}", UNIT_SIZE, label, reading={channel: term})


def _zero_where_unknown(values: Array) -> Array:
    """Values, 0 where they are not known."""
    return np.where(np.isfinite(values), values, 0.0)


MAX_FORMS = 16  #: most values of an effect's constants that stand side by side
VARIANCE_SHARE = 0.995  #: share of a group's variance that its principal columns hold
#: root mean square change of the readings, in units of the noise, below which a group
#: changes nothing
MIN_CHANGE = 1e-4


@dataclasses.dataclass(frozen=True, eq=False)
class ExpectedColumns:
    """Effects of a machine at their expected sizes."""

    discrepancy: Discrepancy  #: what they do to the readings
    #: effects at their constants, with all of their coefficients
    forms: tuple[ActingEffectForm, ...]
    mixing: Array  #: (a, k) of all a coefficients of the forms in each of the k columns

    @classmethod
    def side_by_side(cls, parts: Sequence[ExpectedColumns]) -> ExpectedColumns | None:
        """The columns of several, one after the other; None of none."""
        if len(parts) < 2:
            return parts[0] if parts else None
        names: list[str] = []
        forms: list[ActingEffectForm] = []
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
        mixing = scipy.linalg.block_diag(*[part.mixing for part in parts])
        return cls(discrepancy, tuple(forms), mixing)

    def changes(self, problem: GapProblem, session: SessionStates) -> Array:
        """Changes (N, k) of other readings of the session per unit of each column, SI."""
        states = tuple(session_state(s, session.states[0]) for s in problem.states)
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
        state = session.workspace_state(theta, command, rng, tool=tool)
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

    @classmethod
    def of(
        cls, problem: GapProblem, effects: Sequence[Effect], *, unknown: bool = True
    ) -> ExpectedColumns | None:
        """Columns of the machine's effects, and of unknown ones as large as known ones
        usually are, by the median change of readings. None where no effect changes a
        reading.
        """
        machine = problem.measurement.machine
        forms: list[ActingEffectForm] = []
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
                    unit = typical / group.size
                    groups.append(dataclasses.replace(group, unit=unit))
        return _assembled(problem, forms, groups)


@dataclasses.dataclass(frozen=True, eq=False)
class _EffectGroup:
    """One group's coefficients at all of its constants.

    readings  (N, a) changes, in units of the noise;  tool (m, a) displacements, m
    members   (a,) numbers among all coefficients of all forms
    share     that a coefficient at one of the constants has, in standard deviations
    unit      factor of all coefficients
    """

    name: str
    unknown: bool
    readings: Array
    tool: Array
    members: Index
    share: float
    unit: float = 1.0

    @property
    def size(self) -> float:
        """Root mean square change of the readings by all coefficients together."""
        return float(np.sqrt((self.readings**2).sum(axis=1).mean()))

    def principal(self) -> Array:
        """Combinations (a, k) of the coefficients that hold the variance."""
        parts = [_unit(self.readings), _unit(self.tool)]
        values, rows = right_singular(np.vstack(parts))
        squares = values**2
        before = np.cumsum(squares) - squares
        return np.asarray(rows[before <= VARIANCE_SHARE * squares.sum()].T)


def _unit(values: Array) -> Array:
    norm = float(np.linalg.norm(values))
    return values / norm if norm else values


def _typical_size(known_groups: Sequence[_EffectGroup], unknown: _EffectGroup) -> float:
    """Median rms change by known groups, of what an unknown one changes, over noise."""
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
    problem: GapProblem, effect: Effect, forms: list[ActingEffectForm], *, unknown: bool
) -> list[_EffectGroup]:
    """The groups of one effect; its forms are appended to `forms`."""
    grid = effect.constant_grid()
    tried = np.unique(np.linspace(0, len(grid) - 1, MAX_FORMS).round().astype(int))
    first = sum(len(form.names) for form in forms)
    labels: list[str] = []
    readings, displaced = [], []
    for constants in (grid[k] for k in tried):
        signature = problem.signature(effect, constants)
        if signature.names:
            tool = _tool_changes(problem.states, effect, constants)
            labels += signature.labels
            readings.append(signature.columns)
            displaced += [tool[name] for name in signature.names]
            forms.append(ActingEffectForm(effect, constants, signature.names, 1.0))
    if not labels:
        return []
    share = len(readings) ** -0.5
    changes = share * problem.noise_units(np.hstack(readings))
    moved = share * np.column_stack(displaced)
    groups = []
    for label in dict.fromkeys(labels):
        members = np.flatnonzero(np.array(labels) == label)
        name = f"{effect.name}: {label}" if label else effect.name
        parts = changes[:, members], moved[:, members]
        groups.append(_EffectGroup(name, unknown, *parts, first + members, share))
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
    problem: GapProblem, forms: list[ActingEffectForm], groups: list[_EffectGroup]
) -> ExpectedColumns:
    """All groups side by side."""
    count = sum(len(form.names) for form in forms)
    columns, mixing, owner = [], [], []
    for g, group in enumerate(groups):
        combinations = group.principal() * group.unit
        columns.append(group.readings @ combinations)
        block = np.zeros((count, combinations.shape[1]))
        block[group.members] = group.share * combinations
        mixing.append(block)
        owner += [g] * combinations.shape[1]
    discrepancy = Discrepancy(
        columns=np.hstack(columns) * problem.sigma[:, None],
        group=np.array(owner, dtype=np.intp),
        names=tuple(group.name for group in groups),
        unknown=np.array([group.unknown for group in groups]),
    )
    return ExpectedColumns(discrepancy, tuple(forms), np.hstack(mixing))
