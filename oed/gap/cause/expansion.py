"""Hypotheses about the points at which large effects act, where linear models are off.

The search is linear about the calibration without effects. Where an effect is so large
that its best form departs from that model by more than the noise, the readings are
linearised where the effect acts (`oed.gap.data.linearisation`) and searched again. Every
hypothesis then counts with its evidence about the point that suits it best.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Sequence

import numpy as np

from oed.gap.cause.compare import compare
from oed.gap.cause.hypothesis import Hypothesis, Key
from oed.gap.cause.search import Search
from oed.gap.data.linearisation import ActingEffectForm, settle
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect

#: points at most about which the readings are searched again
POINTS = 3
#: departure from the linear model, in units of the noise over all readings, from which
#: it counts
DEPARTS = 1.0

#: the searches of a problem, one a noise law
SearchOf = Callable[[GapProblem], list[Search]]


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Hypotheses by log posterior, best first, and the searches that they come from.

    The law of a hypothesis is the number of its search.
    """

    searches: tuple[Search, ...]
    hypotheses: tuple[Hypothesis, ...]


def compare_expanded(
    problem: GapProblem, effects: Sequence[Effect], search: SearchOf
) -> Comparison:
    """Hypotheses of a problem, about other points as well where effects are large."""
    first = search(problem)
    comparison = Comparison(tuple(first), tuple(compare(first)))
    tried: set[Key] = set()
    for _ in range(POINTS):
        expanded = _next_point(comparison, effects, tried)
        if expanded is None:
            break
        acting, moved = expanded
        comparison = _joined(comparison, search(moved), acting)
    return comparison


def _next_point(
    comparison: Comparison, effects: Sequence[Effect], tried: set[Key]
) -> tuple[frozenset[str], GapProblem] | None:
    """The next hypothesis of large effects, with the readings linearised about it."""
    for h in _in_question(comparison.hypotheses):
        if h.key in tried:
            continue
        tried.add(h.key)
        search = comparison.searches[h.law]
        outlying = search.problem.residual - search.given.residual
        forms = list(_acting_forms(search, h, effects))
        settled = settle(search.given, forms, search.law, outlying)
        if DEPARTS < settled.departure < np.inf:
            return frozenset(h.effects), settled.problem
    return None


def _in_question(hypotheses: Sequence[Hypothesis]) -> Iterator[Hypothesis]:
    """The best single effect, and the best of all hypotheses that name effects."""
    named = [h for h in hypotheses if h.effects]
    yield from [h for h in named if len(h.effects) == 1 and not h.unknown][:1]
    yield from named[:1]


def _acting_forms(
    search: Search, h: Hypothesis, effects: Sequence[Effect]
) -> Iterator[ActingEffectForm]:
    by_name = {effect.name: effect for effect in effects}
    for name, atom, size in zip(h.effects, h.atoms, h.sizes, strict=True):
        form = search.library.atoms[atom]
        names = search.library.coefficients_of(atom)
        yield ActingEffectForm(by_name[name], form.constants, names, size)


def _joined(
    comparison: Comparison, further: Sequence[Search], acting: frozenset[str]
) -> Comparison:
    """The hypotheses with those about a further point, where some effects act.

    What has these effects counts as it is there; all others as suits them best.
    """
    offset = len(comparison.searches)
    by_key = {
        h.key: h for h in comparison.hypotheses if not acting <= frozenset(h.effects)
    }
    for h in compare(further):
        there = dataclasses.replace(h, law=offset + h.law)
        here = by_key.get(h.key)
        if here is None or there.score > here.score:
            by_key[h.key] = there
    hypotheses = sorted(by_key.values(), key=lambda h: -h.score)
    return Comparison((*comparison.searches, *further), tuple(hypotheses))
