"""Library of effects: every form that the readings can test, as columns of one matrix.

An effect may act in one limb alone, in all limbs alike or in each independently, in its
textbook form or an adapted one, and with other constants. Each such form is an `Atom`,
a choice of columns. All atoms of an effect share its prior probability.
"""

import collections
import dataclasses
import functools
import hashlib
import math
from collections.abc import Iterable, Iterator, Mapping, Sequence

import numpy as np

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES, Effect
from oed.gap.data import evidence
from oed.gap.data.columns import Block, Columns
from oed.gap.data.problem import GapProblem, Metric, Signature, covariate, untestable

# Errors of references that these readings can tell from the free parameters.

#: why an error of a reference cannot be tested that is a parameter by another name
ALIASED_REASON = "free parameters change these readings in the same way"
#: share of its squared norm that parameters leave of a column, up to which it is aliased
MIN_REMAINING_SHARE = 0.002
#: singular value, against the largest, from which parameters change the readings
RANK_TOLERANCE = 1e-9


def distinct_from_parameters(
    problem: GapProblem, forms: Sequence[tuple[Signature, float]]
) -> list[tuple[Signature, float]]:
    """Forms, with their weights, without columns that free parameters reproduce.

    Priors of the parameters do not count: a length that is off by ten times its
    tolerance is no error of the reference.
    """
    axes, sizes, _ = np.linalg.svd(problem.slopes, full_matrices=False)
    axes = axes[:, sizes > RANK_TOLERANCE * sizes.max(initial=0.0)]
    distinct = []
    for form, log_weight in forms:
        columns = problem.noise_units(form.columns)
        remaining = columns - axes @ (axes.T @ columns)
        share = np.sum(remaining**2, axis=0) / np.sum(columns**2, axis=0)
        chosen = share > MIN_REMAINING_SHARE
        if (chosen & ~form.shape).any():
            distinct.append((form.take(chosen), log_weight))
    return distinct


ALONE_SHARE = 0.4  #: prior share of an effect's forms in which one limb alone has it
#: expected difference between limbs built alike, against what they share
LIMB_DIFFERENCE = 0.3
#: norm of a signature over all readings at the largest usual size, in units of the noise,
#: below which an effect cannot be tested at all
MIN_NORM = 0.3
MAX_LIMBS = 12  #: limbs of a form beyond which it is not tried in all of them at once
ALL_LEGS = "all legs"  #: name of what limbs built alike share
APART = " apart"  #: how the name of a limb's difference from it ends
N_BEST_FORMS = 8  #: forms that stay then
MAX_GRID = 200  #: constants in a grid that is scanned in textbook forms


@dataclasses.dataclass(frozen=True, slots=True)
class Atom:
    """One form of one effect."""

    effect: str  #: name of the effect
    constants: Mapping[str, float]  #: {constant: value}
    columns: Index  #: (k,) numbers of its columns in the library
    log_weight: float  #: log of its prior share among the effect's forms
    about: str = ""  #: the form in words
    timed: bool = False  #: whether it is a function of the time or of a temperature
    #: (k,) factor on each column where the runs are driven the other way; None where
    #: the effect's columns tell
    reversal: Array | None = None


@dataclasses.dataclass(frozen=True)
class Library:
    """Columns of all atoms, per prior standard deviation of each coefficient."""

    columns: Columns  #: (N, K) change of the readings, in units of the noise
    atoms: tuple[Atom, ...]  #: forms of the effects
    labels: tuple[str, ...]  #: (K,) the block of each coefficient; "" for none
    # of effects alone, not of a discrepancy:
    names: tuple[str, ...] = ()  #: (K,) of the coefficients
    scales: Sequence[float] = ()  #: (K,) prior standard deviations of the coefficients
    #: {effect: why these readings cannot test it}
    not_testable: Mapping[str, str] = dataclasses.field(default_factory=dict)
    #: {effect: family of effects that differ by the form alone}
    families: Mapping[str, str] = dataclasses.field(default_factory=dict)
    #: {covariate that effects need first, "" for none: number of effects}
    by_condition: Mapping[str, int] = dataclasses.field(default_factory=dict)
    #: (K,) coefficients, per standard deviation, that no machine exceeds
    limits: Sequence[float] = ()

    @functools.cached_property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that have atoms, in order."""
        return tuple(dict.fromkeys(a.effect for a in self.atoms))

    def differ_by_form(self, effect: str, rival: str) -> bool:
        """Whether two different effects are of one family."""
        return self.families.get(effect, effect) == self.families.get(rival, rival)

    def atoms_of(self, effect: str) -> list[int]:
        """Numbers of an effect's atoms."""
        return [k for k, a in enumerate(self.atoms) if a.effect == effect]

    def scaled_columns(self, atom: int, size: float) -> Array:
        """Columns (N, k) of an atom times its size."""
        return size * self.columns.take(self.atoms[atom].columns)

    def coefficients_of(self, atom: int) -> tuple[str, ...]:
        """Names of the effect's own coefficients that an atom moves."""
        columns = self.atoms[atom].columns
        names = [self.names[k] for k in columns]
        limbs = [self.labels[k] for k in columns if self.names[k].endswith(APART)]
        own: dict[str, None] = {}
        for name in names:
            if name.startswith(ALL_LEGS):
                kind = name.removeprefix(ALL_LEGS)
                own |= dict.fromkeys(f"{limb}{kind}" for limb in dict.fromkeys(limbs))
            else:
                own[name.removesuffix(APART)] = None
        return tuple(own)


def build(
    problem: GapProblem, effects: Sequence[Effect], metric: Metric | None = None
) -> Library:
    """All atoms that the readings can test; by a metric, the few of most evidence."""
    per_noise = 1.0 / problem.sigma[:, None]
    blocks: list[Block] = []
    atoms: list[Atom] = []
    names: list[str] = []
    labels: list[str] = []
    scales: list[float] = []
    limits: list[float] = []
    refused: dict[str, str] = {}
    for effect in effects:
        reason = untestable(effect, problem.states)
        if reason is not None:
            refused[effect.name] = reason
            continue
        forms = _forms(problem, effect, metric)
        if not forms:
            refused[effect.name] = "it changes none of these readings"
            continue
        if effect.instruments:
            forms = distinct_from_parameters(problem, forms)
        if not forms:
            refused[effect.name] = ALIASED_REASON
            continue
        for form, log_weight, halved in _add_alike(forms, effect.common_to_limbs):
            start = len(names)
            blocks.append(Block.of(form.columns, per_noise))
            names += form.names
            limits += map(effect.size_limit, form.names, form.scales)
            labels += form.labels
            scales += form.scales.tolist()
            of_form = _atoms(form, start, log_weight, halved, effect.about)
            timed = effect.varies_with_time
            atoms += [dataclasses.replace(atom, timed=timed) for atom in of_form]
    return Library(
        columns=Columns(len(problem), blocks),
        atoms=tuple(atoms),
        names=tuple(names),
        labels=tuple(labels),
        scales=scales,
        not_testable=refused,
        limits=limits,
        families={effect.name: effect.family for effect in effects if effect.family},
        by_condition=collections.Counter(
            covariate(effect.needs[0]) if effect.needs else ""
            for effect in effects
            if effect.name not in refused
        ),
    )


Weighted = tuple[Signature, float]


def _forms(
    problem: GapProblem, effect: Effect, metric: Metric | None
) -> list[Weighted]:
    """The effect's signatures over its grid of constants, with log prior weights.

    Those that change no reading are left out. With a metric, only the best few of many
    stay. A very large grid is scanned in textbook forms; there, the first values of all
    constants but the first have half the weight, and without a metric only these count.
    """
    grid = effect.constant_grid()
    if len(grid) <= MAX_GRID:
        equal = ((form, 0.0) for form in _signatures(problem, effect, grid))
        forms, distinct = _best(problem, metric, equal)
        return [(form, math.log(1.0 / distinct)) for form, _ in forms]
    name = next(iter(effect.constants))
    others = {n: v for n, v in effect.constants.items() if n != name}
    simple = {n: values[0] for n, values in others.items()}

    def is_simple(point: Mapping[str, float]) -> bool:
        return all(point[n] == value for n, value in simple.items())

    first = [point for point in grid if is_simple(point)]
    if metric is None:
        every = list(_signatures(problem, effect, first))
        return [(form, math.log(1.0 / len(every))) for form in every]
    further = [point for point in grid if not is_simple(point)]
    log_first = math.log(0.5 / len(first))
    log_further = math.log(0.5 / max(len(further), 1))
    weighted = (
        (form, log_first if is_simple(form.constants) else log_further)
        for form in _signatures(problem, effect, [*first, *further], textbook=True)
    )
    return [
        (problem.signature(effect, form.constants), log_weight)
        for form, log_weight in _best(problem, metric, weighted)[0]
    ]


def _signatures(
    problem: GapProblem,
    effect: Effect,
    points: Sequence[Mapping[str, float]],
    *,
    textbook: bool = False,
) -> Iterator[Signature]:
    """The distinct signatures at some constants that change a reading."""
    distinct: set[bytes] = set()
    for point in points:
        form = problem.signature(effect, point, textbook=textbook)
        columns = problem.noise_units(form.columns)
        largest = EFFECT_SIZES.usual[-1] * np.linalg.norm(columns)
        if form.names and largest > MIN_NORM:
            content = hashlib.sha1(form.columns.tobytes(), usedforsecurity=False)
            if content.digest() not in distinct:
                distinct.add(content.digest())
                yield form


def _best(
    problem: GapProblem, metric: Metric | None, forms: Iterable[Weighted]
) -> tuple[list[Weighted], int]:
    """The forms that explain most of the residual, where there are many and a metric.

    The second result is the number of all forms. Forms take much memory: those that are
    not among the best so far are not kept.
    """
    if metric is None:
        every = list(forms)
        return every, len(every)
    best: list[tuple[float, int, Weighted]] = []
    waiting: list[tuple[int, Weighted]] = []

    def keep_best() -> None:
        scores = _scores(problem, metric, [weighted for _, weighted in waiting])
        best.extend(
            (score, number, weighted)
            for score, (number, weighted) in zip(scores, waiting, strict=True)
        )
        best.sort(key=lambda entry: (-entry[0], -entry[1]))
        del best[N_BEST_FORMS:]
        waiting.clear()

    number = 0
    for number, weighted in enumerate(forms, start=1):
        waiting.append((number, weighted))
        if len(waiting) > 16:
            keep_best()
    if best and waiting:
        keep_best()
    numbered = [(entry[1], entry[2]) for entry in best] or waiting
    return [weighted for _, weighted in sorted(numbered, key=lambda k: k[0])], number


def _scores(
    problem: GapProblem, metric: Metric, forms: Sequence[Weighted]
) -> list[float]:
    """Log evidence of each form at its best atom and size, with its log weight."""
    ends = np.cumsum([0, *(len(form.names) for form, _ in forms)])
    columns = np.hstack([form.columns for form, _ in forms])
    whitened = evidence.WhitenedColumns(problem, metric, problem.noise_units(columns))
    scores = []
    for (form, log_weight), start, end in zip(forms, ends, ends[1:], strict=False):
        choices = [atom.columns for atom in _atoms(form, 0, 0.0)]
        grams = whitened.grams(slice(start, end))
        energy = np.array([grams.gram.diagonal()[c].sum() for c in choices])
        table = grams.log_evidences(choices, EFFECT_SIZES.values)
        table += EFFECT_SIZES.log_visible_shares(energy)
        scores.append(float(table.max()) + log_weight)
    return scores


def _add_alike(
    forms: Sequence[Weighted], alike: bool
) -> Iterator[tuple[Signature, float, bool]]:
    """Forms with log weights, then limbs alike, and whether these halve their share."""
    log_share = math.log(0.5 * (1.0 - ALONE_SHARE))
    for form, log_weight in forms:
        joined = _alike(form) if alike else None
        yield form, log_weight, joined is not None
        if joined is not None:
            yield joined, log_weight + log_share, False


def _alike(form: Signature) -> Signature | None:
    """The form of limbs built alike.

    It is the sum over limbs of each kind of column, and the limbs' differences from it
    in the textbook's columns. None where limbs do not have the same kinds of columns,
    or are too many.
    """
    kinds = form.kinds
    limbs = set(form.labels)
    if not 2 <= len(limbs) <= MAX_LIMBS or "" in limbs:
        return None
    if any({form.labels[k] for k in ks} != limbs for ks in kinds.values()):
        return None
    textbook = [k for k in range(len(form.names)) if not form.shape[k]]
    first = [ks[0] for ks in kinds.values()]
    sums = [form.columns[:, ks].sum(axis=1) for ks in kinds.values()]
    differences = LIMB_DIFFERENCE * form.columns[:, textbook]
    common = [f"{ALL_LEGS} {kind}".strip() for kind in kinds]
    apart = [f"{form.names[k]}{APART}" for k in textbook]
    scales = [form.scales[k] for k in first]
    shape = [form.shape[k] for k in first]
    return dataclasses.replace(
        form,
        columns=np.column_stack([*sums, differences]),
        names=(*common, *apart),
        labels=("",) * len(kinds) + tuple(form.labels[k] for k in textbook),
        scales=np.concatenate([scales, LIMB_DIFFERENCE * form.scales[textbook]]),
        shape=np.array([*shape, *[False] * len(textbook)], dtype=bool),
    )


def _atoms(
    form: Signature,
    start: int,
    log_weight: float,
    halved: bool = False,
    about: str = "",
) -> list[Atom]:
    """Atoms of a signature: all limbs or one; with or without adapting columns."""
    limbs = list(dict.fromkeys(n for n in form.labels if n))
    atoms = []
    for rows, share in _choices(form, limbs, halved):
        for columns, part in _textbook_and_adapted(form, rows):
            blocks = {form.labels[c] for c in columns}
            described = about
            if len(blocks) == 1 and len(limbs) > 1:
                described = f"{about}, {blocks.pop()}"
            weight = log_weight + math.log(share * part)
            numbers = start + columns
            atoms.append(Atom(form.effect, form.constants, numbers, weight, described))
    return atoms


def _choices(
    form: Signature, limbs: Sequence[str], halved: bool
) -> list[tuple[Index, float]]:
    """Columns of all limbs together and of each limb alone, with their prior shares."""
    everything = np.arange(len(form.names), dtype=np.intp)
    if len(limbs) <= 1 or not all(form.labels):
        return [(everything, 1.0)]
    choices: list[tuple[Index, float]] = []
    alone = ALONE_SHARE if len(limbs) <= MAX_LIMBS else 1.0
    if alone < 1.0:
        choices.append((everything, (1.0 - alone) * (0.5 if halved else 1.0)))
    for limb in limbs:
        columns = np.flatnonzero([n == limb for n in form.labels])
        choices.append((columns, alone / len(limbs)))
    return choices


def _textbook_and_adapted(form: Signature, rows: Index) -> list[tuple[Index, float]]:
    """Columns without and with those that adapt, where there are any, with shares."""
    plain = rows[~form.shape[rows]]
    if plain.size in (0, rows.size):
        return [(rows, 1.0)]
    return [(plain, form.textbook), (rows, 1.0 - form.textbook)]
