"""Mistakes that no check can see: they turn a machine of the model into another one."""

import blunder_machines as machines
import numpy as np
import pytest
from blunder_spatial import delta_numbers
from blunder_tables import Array
from oracles import a3_geometry as a3
from oracles import delta_trilateration as trilateration

from oed.checks import judgement
from oed.estimation import identify

MIRROR = np.array([-1.0, 1.0, 1.0])
#: limbs and towers that a reflection of x exchanges
LIMBS, TOWERS = [0, 2, 1], [1, 0, 2]


def mirrored(p: Array) -> Array:
    """Errors (24,) of an A3 head whose mirror image in x = 0 has these."""
    base, platform = p[a3.SL_B].reshape(3, 3), p[a3.SL_A].reshape(3, 3)
    parts = [
        p[a3.SL_Q][LIMBS],
        (base[LIMBS] * MIRROR).ravel(),
        (platform[LIMBS] * MIRROR).ravel(),
        -p[a3.SL_BETA][LIMBS],
    ]
    return np.concatenate(parts)


def test_the_sign_of_psi_mirrors_an_a3_head() -> None:
    rng = np.random.default_rng(8)
    p, cup = machines.a3_errors(rng), 1e-4 * rng.standard_normal(3)
    command = machines.a3_circle("long_tool", 1.2)
    reversed_psi = command * [1.0, -1.0, 1.0]
    read = machines.a3_lengths(p, "long_tool", cup, command)
    other = mirrored(p)
    again = machines.a3_lengths(other, "long_tool", MIRROR * cup, reversed_psi)
    assert np.ptp(read) > 1e-4
    assert np.abs(again - read).max() < 1e-12


def test_the_sign_of_x_exchanges_two_towers_of_a_delta() -> None:
    rng = np.random.default_rng(9)
    drawn, true = delta_numbers(None), delta_numbers(rng)
    point = rng.uniform([-0.1, -0.1, 0.0], [0.1, 0.1, 0.3], (20, 3))

    def heights(at: Array, numbers: tuple[float, Array, Array, Array]) -> Array:
        travel = trilateration.travel_to(at, *drawn)
        return np.asarray(trilateration.nozzle(travel, *numbers)[:, 2])

    radius, arm, angle, endstop = true
    other = (radius, arm[TOWERS], (np.pi - angle)[TOWERS], endstop[TOWERS])
    turns = np.round((other[2] - true[2]) / (2.0 * np.pi))
    assert np.abs(other[2] - true[2] - 2.0 * np.pi * turns).max() < 0.02
    read = heights(point, true)
    assert np.abs(heights(MIRROR * point, other) - read).max() < 1e-12


def test_check_and_fit_judge_by_one_noise_law() -> None:
    """Of readings with run offsets: scale of single readings, error of a run."""
    one = machines.session("delta", machines.readings("delta", 3, "run offsets"))
    search = judgement.find_outliers(one, np.zeros(0, dtype=np.intp))
    law, _ = judgement.estimated_law(search.solution)
    estimate = identify(one.measurement, one.series, one.y, estimate_noise=True)
    posterior = estimate.noise_posterior
    fitted = posterior.prior.laws(posterior.mode[None])
    scales = [law.scale[name] for name in posterior.structure.names]
    assert scales == pytest.approx(fitted.scale[0].tolist(), rel=0.1)
    assert law.law.level[0] == pytest.approx(fitted.level[0], rel=0.2)
    assert fitted.level[0] > 0.9


@pytest.mark.slow
@pytest.mark.parametrize("size", [0.02, 0.05])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_drift_is_no_other_bar(size: float, seed: int) -> None:
    """In um: 20 and 50 times the noise, carried through the session."""
    rows = machines.readings("a3", seed)
    rows["length_mm"] += size * np.linspace(0.0, 1.0, len(rows))
    checked = machines.check("a3", rows.round(4))
    assert not checked.explanations


def test_no_sign_is_lost_where_none_is_known() -> None:
    """Heights of a nominal machine are zero: its noise does not tell their sign."""
    rows = machines.readings("delta", 0)
    probe = rows["setup"] == "probe"
    rows.loc[probe, "height_mm"] = rows.loc[probe, "height_mm"].abs().round(0)
    checked = machines.check("delta", rows)
    assert all("is lost" not in one.what for one in checked.explanations)
