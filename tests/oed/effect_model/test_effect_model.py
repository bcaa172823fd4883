"""Effects' lengths, speeds and sizes over decades follow the expected size and the machine."""

import dataclasses

import effects_sample
import numpy as np
import pytest
from scipy import integrate, stats
from shipped_models import backlash, friction, servo_lag

from oed.effect_model import Column, Effect, State
from oed.effect_model.size_prior import EFFECT_SIZES, UNKNOWN_SIZES


@pytest.mark.parametrize("effect", [backlash.effect, friction.effect])
def test_travel_after_a_reversal_is_in_proportion_to_the_expected_size(effect):
    usual = effect.constants["distance"]
    larger = effect.with_expected_size("m", 5.0 * effect.proportional["distance"])
    assert larger.constants["distance"] == pytest.approx([5.0 * d for d in usual])
    again = larger.with_expected_size("m", effect.proportional["distance"])
    assert again.constants["distance"] == pytest.approx(usual)
    assert effect.with_expected_size("K", 1.0).constants == effect.constants


@pytest.mark.parametrize("size", [0.5e-6, 30e-6])
def test_scales_keep_their_ratio_to_the_expected_size(size):
    """The largest textbook column of the unit has the size; others of the unit follow."""
    scales = {"leg 1": 4e-6, "leg 2": 8e-6, "bend": 16e-6, "warm": 3.0}

    def columns(state: State) -> list[Column]:
        shaped = {name: name == "bend" for name in scales}
        return [
            Column(name, scale, shape=shaped[name]) for name, scale in scales.items()
        ]

    effect = dataclasses.replace(
        backlash.effect, columns=columns, constants={}, units={"warm": "K"}
    )
    (state, *_) = effects_sample.session("a3_head").states
    resized = effect.with_expected_size("m", size)
    by_hand = {"leg 1": size / 2, "leg 2": size, "bend": 2 * size, "warm": 3.0}
    assert {c.name: c.scale for c in resized.columns(state)} == pytest.approx(by_hand)
    warmer = effect.with_expected_size("K", 6.0)
    by_hand = {**scales, "warm": 6.0}
    assert {c.name: c.scale for c in warmer.columns(state)} == pytest.approx(by_hand)


@pytest.mark.parametrize("machine", ["a3_head", "linear_delta"])
def test_joints_displace_the_tool_as_far_as_they_can(machine):
    """What they do to the tool is a projection: 1 m along what they reach, else nothing."""
    (state, *_) = effects_sample.session(machine).states
    moved = state.twist[:, :3] @ state.joints_per_displacement
    np.testing.assert_allclose(moved @ moved, moved, atol=1e-9)
    np.testing.assert_allclose(moved, np.swapaxes(moved, 1, 2), atol=1e-9)
    up = state.displacing_joints(2, np.full(len(state), 1e-3))
    rise = sum(state.twist[:, 2, i] * change for i, change in up.items())
    assert rise == pytest.approx(1e-3 * moved[:, 2, 2])
    along = np.einsum("mi,mij,mj->m", state.axis, moved, state.axis)
    motion = np.einsum("mi,mij->mj", state.axis, state.twist[:, :3])
    extended = np.einsum("mj,mj->m", motion, state.joints_per_extension)
    assert extended == pytest.approx(along)


@pytest.mark.parametrize("effect", [friction.effect, servo_lag.effect])
def test_forms_over_the_rate_are_those_of_the_same_session_at_another_feed(effect):
    """What changes with the rate does so over the session's own feeds."""
    (state, *_) = effects_sample.session("a3_head").states
    assert state.max_feed > 0.0
    faster = dataclasses.replace(
        state, rate=7.0 * state.rate, max_feed=7.0 * state.max_feed
    )
    constants = effect.constant_grid()[0]
    usual = {c.name: c for c in effect.columns(state, **constants)}
    for column in effect.columns(faster, **constants):
        if column.name.endswith(("slow", "feed")):
            ((limb, change),) = column.joints.items()
            factor = 7.0 if column.name.endswith("feed") else 1.0
            wanted = factor * usual[column.name].joints[limb]
            np.testing.assert_allclose(change, wanted, rtol=1e-9)


def test_an_effect_knows_units_covariates_and_its_grid():
    constants, column = {"tau": (1.0, 2.0), "share": (0.5,)}, Column("leg 1 rise", 1.0)
    needs, units = ("time or temp_leg",), {"* rise": "K"}
    what = {"columns": lambda state: [column], "needs": needs, "units": units}
    effect = Effect(
        name="warm", source="by hand", about="", constants=constants, **what
    )
    assert effect.varies_with_time
    assert not dataclasses.replace(effect, needs=("direction: both",)).varies_with_time
    assert (effect.unit("leg 1 rise"), effect.unit("leg 1")) == ("K", "m")
    assert effect.coefficient_units() == ("K", "m")
    assert effect.constant_grid() == [
        {"tau": 1.0, "share": 0.5},
        {"tau": 2.0, "share": 0.5},
    ]


@pytest.mark.parametrize("prior", [EFFECT_SIZES, UNKNOWN_SIZES])
def test_the_prior_is_proper_and_ascends(prior):
    assert np.exp(prior.log_shares).sum() == pytest.approx(1.0)
    assert (np.diff(prior.values) > 0.0).all()
    assert np.diff(np.log10(prior.values)) == pytest.approx(0.5, abs=0.03)


def _density(beta: float) -> float:
    """Prior density of a coefficient, in expected sizes."""
    of_sizes = stats.norm.pdf(beta, scale=EFFECT_SIZES.values)
    return float(np.exp(EFFECT_SIZES.log_shares) @ of_sizes)


def test_a_decade_more_costs_a_decade_of_density_and_no_square():
    """About 1 / |beta| from 100 to 30 000 expected sizes; a normal one falls by e^-50."""
    for beta in (100.0, 300.0, 1000.0, 3000.0):
        assert _density(10.0 * beta) / _density(beta) == pytest.approx(0.1, rel=0.5)
    whole = integrate.quad(lambda u: np.exp(u) * _density(np.exp(u)), -20.0, 14.0)
    assert 2.0 * whole[0] == pytest.approx(1.0, abs=1e-3)


def test_sizes_that_nothing_shows_are_no_hypotheses():
    """But for the largest usual one; what is far keeps its share among those that show."""
    seen, weak = np.exp(EFFECT_SIZES.log_visible_shares(np.array([1.0, 1e-6])))
    usual = len(EFFECT_SIZES.usual)
    assert np.flatnonzero(seen[:usual]).tolist() == [5, 6]  # 10 and 30
    assert seen[:usual].sum() == pytest.approx(0.9)
    assert weak[:usual].tolist() == [0.0] * (usual - 1) + [pytest.approx(0.9)]
    assert EFFECT_SIZES.values[np.flatnonzero(weak)[1]] == 10_000.0
    assert weak.sum() == pytest.approx(1.0)


@pytest.mark.parametrize(("scale", "unit", "limit"), [
    (3.0, "K", 100.0 / 3.0), (4e-6, "m", 1e4), (1e-3, "m", 1e3), (50e-6, "1", 1e4),
])  # fmt: skip
def test_no_machine_has_a_hundred_kelvin_a_metre_or_ten_thousand_expected_sizes(
    scale, unit, limit
):
    effect = Effect(
        name="any", source="", about="", columns=lambda state: (), units={"*": unit}
    )
    assert effect.size_limit("size", scale) == pytest.approx(limit)
