"""Every form of every effect that the readings can test, laid out as columns of one
matrix.

An effect may act in one limb alone, in all limbs alike or in each as it likes, as in
the textbook or with its shape adapted, and with other constants: each such form is an
`Atom`, a choice of columns. All atoms of an effect share its prior probability.
"""

from __future__ import annotations

import dataclasses
import hashlib
import math
from collections.abc import Iterator, Mapping, Sequence

import numpy as np

from oed.arrays import Array, Index
from oed.effect import Effect
from oed.gap.data import evidence
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.data.signature import Signature, untestable

#: prior share of an effect's forms in which one limb alone has it
ALONE = 0.4
#: how much smaller the difference of limbs built alike is expected to be than what they
#: share
DIFFER = 0.3
#: signature, in units of the noise over all readings, below which an effect cannot be
#: seen at all
UNSEEN = 0.3
#: blocks of a form beyond which it is not tried in all of them at once
BLOCKS = 12
#: values of the constants beyond which only the best few are kept
MANY, KEPT = 16, 8
#: constants in a grid that is looked through in textbook forms
LARGE = 200


@dataclasses.dataclass(frozen=True, slots=True)
class Atom:
    """One form of one effect.

    columns     (k,) which of the library's; log_weight: of its prior share among the
                effect's forms
    about       what it is, in words
    """

    effect: str
    constants: Mapping[str, float]
    columns: Index
    log_weight: float
    about: str = ""


@dataclasses.dataclass(frozen=True)
class Library:
    """Columns (N, K) of all atoms in units of the noise, per prior standard deviation
    of each coefficient.

    names, labels (K,), scales (K,)   of the coefficients;  not_testable {effect: why}
    """

    columns: Array
    atoms: tuple[Atom, ...]
    names: tuple[str, ...]
    labels: tuple[str, ...]
    scales: Array
    not_testable: Mapping[str, str]

    @property
    def effects(self) -> tuple[str, ...]:
        """Names of the effects that have atoms, in order."""
        return tuple(dict.fromkeys(a.effect for a in self.atoms))

    def atoms_of(self, effect: str) -> list[int]:
        """Numbers of an effect's atoms."""
        return [k for k, a in enumerate(self.atoms) if a.effect == effect]


def build(
    problem: GapProblem, effects: Sequence[Effect], metric: Metric | None = None
) -> Library:
    """All atoms of the effects that these readings can test.

    With a metric, an effect of many constants keeps the few that explain most, each
    with its prior weight among all.
    """
    blocks: list[Array] = []
    atoms: list[Atom] = []
    names: list[str] = []
    labels: list[str] = []
    scales: list[Array] = []
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
        for form, log_weight, halved in _with_alike(forms, effect.alike):
            start = len(names)
            blocks.append(problem.in_noise_units(form.columns))
            names += form.names
            labels += form.labels
            scales.append(form.scales)
            atoms += _atoms(form, start, log_weight, halved, effect.about)
    columns = np.hstack(blocks) if blocks else np.zeros((len(problem), 0))
    joined = np.concatenate(scales) if scales else np.zeros(0)
    return Library(columns, tuple(atoms), tuple(names), tuple(labels), joined, refused)


def _forms(
    problem: GapProblem, effect: Effect, metric: Metric | None
) -> list[tuple[Signature, float]]:
    """The effect's signatures over its grid of constants, each with its log prior
    weight; those that change no reading are left out. With a metric, of many only the
    best few.

    A grid of very many is looked through in textbook forms; in it, the first values of
    all constants but the first have half the weight. Without a metric only these are
    tried.
    """
    grid = effect.grid()
    if len(grid) <= LARGE:
        return _best(problem, metric, _weighed(_seen(problem, effect, grid), 1.0))
    name = next(iter(effect.constants))
    simple = {n: values[0] for n, values in effect.constants.items() if n != name}

    def plain(point: Mapping[str, float]) -> bool:
        return all(point[n] == value for n, value in simple.items())

    first, rest = [p for p in grid if plain(p)], [p for p in grid if not plain(p)]
    if metric is None:
        return _weighed(_seen(problem, effect, first), 1.0)
    weights = {
        True: math.log(0.5 / len(first)),
        False: math.log(0.5 / max(len(rest), 1)),
    }
    tried = _seen(problem, effect, [*first, *rest], textbook=True)
    best = _best(
        problem, metric, [(form, weights[plain(form.constants)]) for form in tried]
    )
    return [
        (problem.signature(effect, form.constants), log_weight)
        for form, log_weight in best
    ]


def _seen(
    problem: GapProblem,
    effect: Effect,
    points: Sequence[Mapping[str, float]],
    *,
    textbook: bool = False,
) -> list[Signature]:
    """The signatures at some constants: those that change a reading, once where
    constants make no difference.
    """
    made: dict[bytes, Signature] = {}
    for point in points:
        form = problem.signature(effect, point, textbook=textbook)
        if form.names and np.linalg.norm(problem.in_noise_units(form.columns)) > UNSEEN:
            made.setdefault(
                hashlib.sha1(form.columns.tobytes(), usedforsecurity=False).digest(),
                form,
            )
    return list(made.values())


def _weighed(forms: Sequence[Signature], share: float) -> list[tuple[Signature, float]]:
    """Forms that have a share of an effect's prior, each as much as another."""
    return [(form, math.log(share / len(forms))) for form in forms]


def _best(
    problem: GapProblem,
    metric: Metric | None,
    forms: Sequence[tuple[Signature, float]],
    kept: int = KEPT,
) -> list[tuple[Signature, float]]:
    """The forms that explain most of the residual, where there are many and a metric."""
    if metric is None or len(forms) <= MANY:
        return list(forms)
    ends = np.cumsum([0, *(len(form.names) for form, _ in forms)])
    every = evidence.WhitenedColumns(
        problem,
        metric,
        problem.in_noise_units(np.hstack([form.columns for form, _ in forms])),
    )
    scores = []
    for (form, log_weight), start, end in zip(forms, ends, ends[1:], strict=False):
        choices = [a.columns for a in _atoms(form, 0, 0.0)]
        found = every.grams(slice(start, end)).log_evidences(choices)
        scores.append(float(found.max()) + log_weight)
    order = np.argsort(scores)[::-1][:kept]
    return [forms[k] for k in sorted(order)]


def _with_alike(
    forms: Sequence[tuple[Signature, float]], alike: bool
) -> Iterator[tuple[Signature, float, bool]]:
    """Forms, their log weights, and whether limbs that are alike have half of all
    limbs' share; their form follows.
    """
    for form, log_weight in forms:
        joined = _alike(form) if alike else None
        yield form, log_weight, joined is not None
        if joined is not None:
            yield joined, log_weight + math.log(0.5 * (1.0 - ALONE)), False


def _alike(form: Signature) -> Signature | None:
    """The form of limbs that are alike: the sum over limbs of each kind of column, and
    the limbs' own differences from it in the textbook's columns. None where limbs do
    not have the same kinds of columns, or are too many.
    """
    kinds: dict[str, list[int]] = {}
    for k, (name, label) in enumerate(zip(form.names, form.labels, strict=True)):
        kinds.setdefault(name.removeprefix(label).strip(), []).append(k)
    limbs = set(form.labels)
    if (
        not 2 <= len(limbs) <= BLOCKS
        or "" in limbs
        or any({form.labels[k] for k in own} != limbs for own in kinds.values())
    ):
        return None
    own = [k for k in range(len(form.names)) if not form.shape[k]]
    return dataclasses.replace(
        form,
        columns=np.column_stack(
            [
                *(form.columns[:, ks].sum(axis=1) for ks in kinds.values()),
                DIFFER * form.columns[:, own],
            ]
        ),
        names=(
            *(f"all legs {kind}".strip() for kind in kinds),
            *(f"{form.names[k]} apart" for k in own),
        ),
        labels=("",) * len(kinds) + tuple(form.labels[k] for k in own),
        scales=np.concatenate(
            [[form.scales[ks[0]] for ks in kinds.values()], DIFFER * form.scales[own]]
        ),
        shape=np.array(
            [*(form.shape[ks[0]] for ks in kinds.values()), *(False for _ in own)],
            dtype=bool,
        ),
    )


def _atoms(
    form: Signature,
    start: int,
    log_weight: float,
    halved: bool = False,
    about: str = "",
) -> list[Atom]:
    """Forms of one signature: all limbs, if `halved` with half of their share, or one;
    with or without the columns that adapt.
    """
    limbs = list(dict.fromkeys(n for n in form.labels if n))
    choices: list[tuple[Index, float]] = []
    everything = np.arange(len(form.names), dtype=np.intp)
    if len(limbs) > 1 and all(form.labels):
        alone = ALONE if len(limbs) <= BLOCKS else 1.0
        if alone < 1.0:
            choices.append((everything, (1.0 - alone) * (0.5 if halved else 1.0)))
        choices += [
            (np.flatnonzero([n == limb for n in form.labels]), alone / len(limbs))
            for limb in limbs
        ]
    else:
        choices.append((everything, 1.0))
    made = []
    for rows, share in choices:
        plain = rows[~form.shape[rows]]
        forms = (
            [(rows, 1.0)]
            if plain.size in (0, rows.size)
            else [(plain, form.textbook), (rows, 1.0 - form.textbook)]
        )
        for chosen, part in forms:
            weight = log_weight + math.log(share * part)
            here = {form.labels[c] for c in chosen}
            told = (
                f"{about}, {here.pop()}" if len(here) == 1 and len(limbs) > 1 else about
            )
            made.append(Atom(form.effect, form.constants, start + chosen, weight, told))
    return made
