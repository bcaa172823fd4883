"""Equivalence classes of an A3's encoder scale and bar length, by dense matrices."""

import dataclasses
import functools

import numpy as np
import pandas as pd
import pytest
from shipped_models import a3_head, ball_bar

from kernel import a3_plans, gap_a3
from kernel.gap_lines import search_of
from oed.gap.cause import compare
from oed.gap.data.problem import GapProblem, assemble
from oed.instrument import Setup, mount
from oed.measurement import Measurement, commands_at_fixed_reading

POINTS = 12
STROKES = np.linspace(0.0, 0.2, 9)


Bar = tuple[str, float, float]  #: name, length and tool (m) of a bar's set-up
ONE: tuple[Bar, ...] = (("a", 0.3, 0.0),)
TOOLS: tuple[Bar, ...] = (*ONE, ("b", 0.3, 0.1))


def mounted(name: str, length: float, tool: float) -> Setup:
    teach, offset = (1.286 + tool, 0.0, 0.0), (0.0, 0.0, tool)
    return mount(ball_bar.instrument, name, teach=teach, length=length, tool=offset)


@functools.cache
def readings(bars: tuple[Bar, ...]) -> GapProblem:
    """Circles at all heights that each bar reaches; residuals of zero."""
    m = Measurement(a3_head.machine, [mounted(*b) for b in bars])
    series, rows = [], []
    for name, setup in m.setups.items():
        commands, runs = [], []
        for stroke in STROKES:
            z = a3_plans.HOME_Z + setup.tool[2] + stroke
            psi = 2 * np.pi * np.arange(POINTS) / POINTS
            command, possible = commands_at_fixed_reading(
                m, name, np.column_stack([0 * psi + z, psi, 0 * psi]), "theta"
            )
            if possible.all():
                commands.append(command)
                runs += [f"{name} {stroke:.3f} m"] * POINTS
        series.append(m.series(name, np.vstack(commands), run=runs))
        rows += [
            {"setup": name, "run": r, "order": 1 + k % POINTS, "direction": 1}
            for k, r in enumerate(runs)
        ]
    return assemble(m, series, pd.DataFrame(rows))


def metric(p: GapProblem) -> np.ndarray:
    """M (N, N) of independent noise of the stated size."""
    return np.linalg.inv(np.eye(len(p)) + p.slopes @ p.slopes.T)


EFFECTS = (gap_a3.encoder_scale, gap_a3.bar_length, gap_a3.gravity)


def searched(p, effect, size, seed=4):
    """The search where a bar or a common scale acts; the right hypothesis."""
    acting_effect = next(e for e in EFFECTS if e.name == effect)
    change = gap_a3.noise_columns(p, acting_effect)[0].sum(axis=1)
    change = change * size / np.sqrt(change @ metric(p) @ change)
    noise = np.random.default_rng(seed).standard_normal(len(p))
    acting = p.with_residual(change + noise)
    search = search_of(acting, EFFECTS)
    hypothesis = search.fit((effect,), (search.library.atoms_of(effect)[0],), (1.0,))
    return search, hypothesis


def dense(p, search, h, rival):
    """lambda_k|j and lambda_k of the posterior mean, for the form that absorbs most."""
    m = metric(p)
    mine = search.library.columns.take(search.library.atoms[h.atoms[0]].columns)
    inner = mine.T @ m @ mine + np.eye(mine.shape[1]) / h.sizes[0] ** 2
    y = mine @ np.linalg.solve(inner, mine.T @ m @ search.problem.residual)
    energies = [y @ m @ y]
    for atom in search.library.atoms_of(rival):
        g = search.library.columns.take(search.library.atoms[atom].columns)
        cross = g.T @ m @ y
        ridge = g.T @ m @ g + np.eye(g.shape[1]) / compare.MAX_RIVAL_SIZE**2
        energies.append(y @ m @ y - cross @ np.linalg.solve(ridge, cross))
    return min(energies), energies[0]


@pytest.mark.parametrize("size", [4.0, 12.0, 25.0, 60.0])
@pytest.mark.parametrize("effect", ["encoder_scale", "bar_length"])
@pytest.mark.parametrize("tools", [1, 2])
def test_a_class_is_what_the_dense_formula_says(tools, effect, size):
    """With every rival's evidence near, and with none near."""
    p = readings(TOOLS if tools == 2 else ONE)
    search, h = searched(p, effect, size)
    rivals = [e.name for e in EFFECTS if e.name != effect]
    energies = {r: dense(p, search, h, r) for r in rivals}
    for near in (True, False):
        scores = {
            (frozenset({r}), False): h.score - (1.0 if near else 100.0) for r in rivals
        }
        ((first, *others),) = compare.equivalent_effects(search, h, scores, 3.0)
        assert first == effect
        for r in rivals:
            lam, whole = energies[r]
            same = lam < compare.EXACT_SHARE * whole or (
                near and lam < compare.MIN_DISTINCT**2
            )
            assert (r in others) == same, (r, lam, whole)


@pytest.mark.parametrize("behind", [2.0, 10.0, 20.0, 1e4])
@pytest.mark.parametrize("size", [8.0, 60.0])
def test_a_rival_of_its_family_is_in_a_class_as_far_as_forms_depart(size, behind):
    """Half of sqrt(lambda): a quarter of lambda, and an eighth of it in nats."""
    p = readings(TOOLS)
    search, h = searched(p, "encoder_scale", size)
    rivals = [e.name for e in EFFECTS if e.name != "encoder_scale"]
    scores = {(frozenset({r}), False): h.score - behind for r in rivals}
    alone = compare.equivalent_effects(search, h, scores, 3.0)[0]
    families = {e.name: "alike" for e in EFFECTS}
    search.library = dataclasses.replace(search.library, families=families)
    members = compare.equivalent_effects(search, h, scores, 3.0)[0]
    for r in rivals:
        lam, whole = dense(p, search, h, r)
        odds = (
            search.fit((r,), (search.library.atoms_of(r)[0],), (1.0,)).score - h.score
        )
        near = min(behind, -odds) < max(compare.PRIOR_LOG_ODDS, whole / 8.0)
        by_form = near and lam < max(compare.MIN_DISTINCT**2, 0.25 * whole)
        assert (r in members) == (r in alone or by_form), (r, lam, whole)


@pytest.mark.parametrize("truth", ["encoder_scale", "bar_length"])
@pytest.mark.parametrize("size", [8.0, 60.0])
def test_one_tool_keeps_both_whichever_is_likelier(truth, size):
    """With one tool only the odds beforehand speak for one of the two."""
    search, _ = searched(readings(ONE), truth, size)
    hypotheses = {
        n: search.fit((n,), (search.library.atoms_of(n)[0],), (1.0,))
        for n in (e.name for e in EFFECTS)
    }
    best = max(
        (hypotheses[n] for n in ("encoder_scale", "bar_length")), key=lambda h: h.score
    )
    (members,) = compare.equivalent_effects(
        search, best, {h.key: h.score for h in hypotheses.values()}, 3.0
    )
    assert {"encoder_scale", "bar_length"} <= set(members)
