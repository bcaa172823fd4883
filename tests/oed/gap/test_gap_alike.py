"""Limbs that are built alike: what they share, and how they differ."""

import dataclasses

import numpy as np
import pytest

from kernel.gap_lines import BOW, planted, readings, search_of
from oed.effect_model import Column, Effect, State
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library
from oed.gap.forms.library import LIMB_DIFFERENCE, Library

LOOSE = dataclasses.replace(BOW, constants={"turns": (2.0,)})
TWINS = dataclasses.replace(LOOSE, name="twins", common_to_limbs=True)


def _more(state: State, turns: float) -> list[Column]:
    columns = list(BOW.columns(state, turns=turns))
    more = [
        (c, {"name": f"{c.name} more", "joints": _along(state, c)}) for c in columns
    ]
    return [*columns, *(dataclasses.replace(c, shape=True, **m) for c, m in more)]


def _along(state: State, column: Column) -> dict[int, np.ndarray]:
    return {i: change * state.joints[:, i] for i, change in column.joints.items()}


ADAPTING = dataclasses.replace(TWINS, columns=_more)


def _covariance(forms: Library, atom: library.Atom) -> np.ndarray:
    columns = forms.columns.take(atom.columns)
    return np.asarray(columns @ columns.T)


def test_prior_of_limbs_that_are_alike():
    """Coefficients of N(0, s^2 (1 1^T + DIFFER^2 I)), whatever columns they are told in."""
    problem = readings(1)
    free, twins = library.build(problem, [LOOSE]), library.build(problem, [TWINS])
    (joined,) = [
        a for a in twins.atoms if any("all legs" in twins.names[c] for c in a.columns)
    ]
    prior = np.ones((2, 2)) + LIMB_DIFFERENCE**2 * np.eye(2)
    columns = free.columns.all()
    wanted = columns @ prior @ columns.T
    np.testing.assert_allclose(_covariance(twins, joined), wanted, atol=1e-9)
    assert [twins.labels[c] for c in joined.columns] == ["", "leg 1", "leg 2"]


@pytest.mark.parametrize("effect", [TWINS, ADAPTING], ids=["textbook", "adapting"])
def test_shares_of_forms_add_up(effect):
    forms = library.build(readings(1), [effect])
    assert np.exp([a.log_weight for a in forms.atoms]).sum() == pytest.approx(1.0)


def test_what_adapts_is_alike_too():
    forms = library.build(readings(1), [ADAPTING])
    joined = [tuple(forms.names[c] for c in a.columns) for a in forms.atoms]
    differences = ("leg 1 apart", "leg 2 apart")
    assert ("all legs", *differences) in joined
    assert ("all legs", "all legs more", *differences) in joined


@pytest.mark.parametrize("share", [0.1, 0.5])
def test_an_effect_says_how_likely_its_textbook_form_is(share):
    forms = library.build(
        readings(1), [dataclasses.replace(ADAPTING, textbook_share=share)]
    )
    plain_forms = [
        a for a in forms.atoms if not any("more" in forms.names[c] for c in a.columns)
    ]
    assert np.exp([a.log_weight for a in plain_forms]).sum() == pytest.approx(share)


def test_limbs_of_unequal_kinds_are_not_alike():
    lame = dataclasses.replace(
        TWINS, columns=lambda state, turns: list(_more(state, turns))[:3]
    )
    forms = library.build(readings(1), [lame])
    assert not [n for n in forms.names if "all legs" in n]


@pytest.mark.parametrize(
    ("sizes", "alike"), [((1.0, 1.1), True), ((1.0, -1.0), False), ((1.0, 0.0), False)]
)
def test_evidence_is_for_what_limbs_are(sizes, alike):
    """Limbs that are alike are likelier so; else the even chance of it is lost."""
    problem = planted(
        readings(3), LOOSE, {"leg 1": sizes[0], "leg 2": sizes[1]}, turns=2.0
    )
    gain = _evidence(problem, TWINS) - _evidence(problem, LOOSE)
    assert gain > 0.2 if alike else -np.log(2.0) - 0.01 < gain < 0.1


def _evidence(problem: GapProblem, effect: Effect) -> float:
    hypotheses = search_of(problem, [effect]).run()
    return next(h for h in hypotheses if h.effects).log_evidence
