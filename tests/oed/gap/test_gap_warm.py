"""What no library has: with a temperature, or fading after a set-up's start."""

import dataclasses

import numpy as np
import pytest

from kernel.gap_lines import readings, search_of
from oed.effect_model import State
from oed.gap.cause.compare import compare
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy


def _with(problem: GapProblem, **changes: object) -> GapProblem:
    """The problem with its states changed."""
    return dataclasses.replace(
        problem, states=tuple(dataclasses.replace(s, **changes) for s in problem.states)
    )  # type: ignore[arg-type]


def _best(problem, change):
    acting = problem.with_residual(problem.residual + change)
    processes = discrepancy.build(problem)
    return processes, compare([search_of(acting, (), processes)])[0]


def _read(problem: GapProblem, channel: str, wave: np.ndarray) -> np.ndarray:
    """A wave (m,) over the poses, added to a channel's readings (N,), in noise units."""
    at = wave[problem.series[0].index[:, 0]]
    kinds = len(np.unique(problem.channel))
    return np.where(problem.rows["channel"] == channel, np.repeat(at, kinds), 0.0)


@pytest.mark.parametrize("recorded", [True, False])
def test_what_goes_with_a_temperature_is_told_by_it(recorded):
    """A temperature that jumps about, in kelvin that are not from zero."""
    problem = readings(14)
    poses = len(problem.states[0])
    warm = 293.15 + np.random.default_rng(3).normal(size=poses).repeat(8)[:poses]
    if recorded:
        start, shop = {"arm": 293.15, "shop": 293.15}, np.full(poses, 293.15)
        problem = _with(
            problem, temperature={"arm": warm, "shop": shop}, start_temperature=start
        )
    processes, best = _best(problem, _read(problem, "dz", 1.5 * (warm - 293.15)))
    named = None if best.process is None else processes.atoms[best.process].effect
    assert (named == "with the temperature of arm") is recorded


def test_no_temperature_recorded_is_no_process():
    processes = discrepancy.build(readings(14))
    assert not {e for e in processes.effects if "temperature" in e}


@pytest.mark.parametrize("within", [0.03, 0.1])
def test_what_fades_after_a_set_ups_start_is_found_in_the_middle_of_a_session(within):
    problem = _later(readings(12))
    gone = problem.states[0].session_progress - 0.5
    processes, best = _best(problem, _read(problem, "dz", 6.0 * np.exp(-gone / within)))
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].effect == "over time"


def _later(problem: GapProblem) -> GapProblem:
    """The set-up as the second half of a session."""

    def half(state: State) -> np.ndarray:
        return np.asarray(0.5 + 0.5 * state.session_progress)

    return dataclasses.replace(
        problem,
        states=tuple(
            dataclasses.replace(s, session_progress=half(s)) for s in problem.states
        ),
    )
