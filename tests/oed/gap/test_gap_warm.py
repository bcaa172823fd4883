"""What nobody's library has, but goes with a temperature, fades after a set-up's start,
or lets the tool grow.
"""

import dataclasses

import numpy as np
import pytest
from effects_sample import session

from kernel.gap_lines import readings
from kernel.laws import STATED_LAW
from oed.effect_model import State
from oed.gap.cause.compare import compare
from oed.gap.cause.search import Hypothesis, Search
from oed.gap.data.problem import GapProblem
from oed.gap.forms import discrepancy, library


def _with(problem: GapProblem, **changes: object) -> GapProblem:
    """The problem with its states changed."""
    return dataclasses.replace(
        problem, states=tuple(dataclasses.replace(s, **changes) for s in problem.states)
    )  # type: ignore[arg-type]


def _best(
    problem: GapProblem, change: np.ndarray
) -> tuple[library.Library, Hypothesis]:
    acting = problem.with_residual(problem.residual + change)
    processes = discrepancy.build(problem)
    return (
        processes,
        compare(
            [Search(acting, library.build(problem, ()), processes, STATED_LAW, 0.0)]
        )[0],
    )


def _read(problem: GapProblem, channel: str, wave: np.ndarray) -> np.ndarray:
    """A wave (m,) over the poses of the only series, added to a channel's readings (N,)
    in units of the noise.
    """
    at = wave[problem.series[0].index[:, 0]]
    kinds = len(np.unique(problem.channel))
    return np.where(problem.rows["channel"] == channel, np.repeat(at, kinds), 0.0)


@pytest.mark.parametrize("recorded", [True, False])
def test_what_goes_with_a_temperature_is_told_by_it(recorded: bool) -> None:
    """A temperature that jumps about as no smooth curve over time does, recorded as
    kelvin that are not from zero.
    """
    problem = readings(14)
    poses = len(problem.states[0])
    warm = 293.15 + np.random.default_rng(3).normal(size=poses).repeat(8)[:poses]
    if recorded:
        problem = _with(
            problem,
            temperature={"arm": warm, "shop": np.full(poses, 293.15)},
            start_temperature={"arm": 293.15, "shop": 293.15},
        )
    processes, best = _best(problem, _read(problem, "dz", 1.5 * (warm - 293.15)))
    named = None if best.process is None else processes.atoms[best.process].effect
    assert (named == "with the temperature of arm") is recorded


def test_no_temperature_recorded_is_no_process() -> None:
    processes = discrepancy.build(readings(14))
    assert not {e for e in processes.effects if "temperature" in e}


@pytest.mark.parametrize("within", [0.03, 0.1])
def test_what_fades_after_a_set_ups_start_is_found_in_the_middle_of_a_session(
    within: float,
) -> None:
    problem = _later(readings(12))
    gone = problem.states[0].session_progress - 0.5
    processes, best = _best(problem, _read(problem, "dz", 6.0 * np.exp(-gone / within)))
    assert best.key == (frozenset(), True)
    assert best.process is not None
    assert processes.atoms[best.process].effect == "over time"


def test_a_growing_tool_moves_along_its_axis() -> None:
    """Joints that displace the tool point along the platform's z and do not turn it."""
    sample = session("hexapod")
    for s in sample.states:
        none, tool = np.zeros(3), np.array([0.0, 0.0, 0.1])
        longer = (
            sample.measurement.kinematics.frames(s.pose, tool)[1]
            - sample.measurement.kinematics.frames(s.pose, none)[1]
        )
        assert s.axis == pytest.approx(longer / 0.1)
        moved = np.einsum("mki,mi->mk", s.twist, s.joints_per_extension)
        assert moved[:, :3] == pytest.approx(s.axis, abs=1e-9)
        assert moved[:, 3:] == pytest.approx(np.zeros_like(s.axis), abs=1e-9)


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
