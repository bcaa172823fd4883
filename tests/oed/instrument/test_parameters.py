"""Parameter vectors, series and channels of set-ups against what is written out by hand."""

import dataclasses

import casadi as ca
import numpy as np
import pytest
from shipped_models import a3_head, ball_bar, pose_tracker, relative

from oed.instrument import (
    Instrument,
    ParameterVector,
    Protocol,
    Series,
    TakenReadings,
    mount,
)
from oed.model import CommonTolerance

CUP = mount(ball_bar.instrument, "cup", teach=(1.2, 0.0, 0.0))
CORRELATION = 0.6


@pytest.fixture
def correlated() -> ParameterVector:
    group = CommonTolerance(("dq1", "dq2", "dq3"), CORRELATION)
    return ParameterVector(
        dataclasses.replace(a3_head.machine, correlated=(group,)), [CUP]
    )


def test_unknowns_of_set_ups_follow_those_of_the_machine():
    vector = ParameterVector(a3_head.machine, [CUP])
    count = len(a3_head.machine.parameters)
    assert vector.names[count:] == ("cup.cup_x", "cup.cup_y", "cup.cup_z")
    assert vector.nuisance_slice("cup") == slice(count, count + 3)
    held = [n for n, free in zip(vector.names, vector.free, strict=True) if not free]
    assert set(held) == set(a3_head.machine.frame)
    freed = vector.freed(["dq*", "cup.*"])
    assert [n for n, f in zip(vector.names, freed, strict=True) if f] == [
        "dq1",
        "dq2",
        "dq3",
        *vector.names[count:],
    ]
    angles = np.array([p.unit == "rad" for p in vector.parameters])
    lever = np.where(angles, a3_head.machine.lever, 1.0)
    np.testing.assert_array_equal(vector.length_factors, lever)
    with pytest.raises(ValueError, match="not unique"):
        ParameterVector(a3_head.machine, [CUP, CUP])


def test_common_causes_correlate_the_prior(correlated):
    covariance, tolerance = correlated.prior_covariance, correlated.tolerance
    assert np.diag(covariance) == pytest.approx(tolerance**2)
    place = [correlated.names.index(n) for n in ("dq1", "dq2")]
    product = CORRELATION * tolerance[place].prod()
    assert covariance[place[0], place[1]] == pytest.approx(product)
    root = correlated.correlation_root(np.array(place))
    assert root is not None
    wanted = [[1.0, CORRELATION], [CORRELATION, 1.0]]
    np.testing.assert_allclose(root @ root, wanted, atol=1e-12)


def test_prior_units_are_those_of_the_root(correlated, rng):
    plain = ParameterVector(a3_head.machine, [CUP])
    for vector in (plain, correlated):
        root = vector.prior_root()
        rows = rng.standard_normal((4, len(root)))
        np.testing.assert_allclose(vector.in_prior_units(rows), rows @ root, atol=1e-15)
        z = np.cov(rng.standard_normal((len(root), 40)))
        wanted = root @ z @ root.T
        np.testing.assert_allclose(vector.from_prior_units(z), wanted, atol=1e-15)


def test_bounds_refuse_what_is_outside():
    bounded = [
        dataclasses.replace(p, bounds=(-1e-3, 2e-3)) if p.name == "dq2" else p
        for p in a3_head.machine.parameters
    ]
    vector = ParameterVector(a3_head.machine.with_parameters(bounded), [CUP])
    assert vector.bounded.tolist() == [vector.names.index("dq2")]
    theta = np.zeros((4, len(vector.names)))
    theta[:, vector.bounded[0]] = [-1.1e-3, -1e-3, 2e-3, 2.1e-3]
    assert vector.in_bounds(theta).tolist() == [False, True, True, False]


# -- series ----------------------------------------------------------------------------
def series(instrument: Instrument, runs: list[str]) -> Series:
    """Readings whose pose k has k in all its numbers; a teach pose is the last."""
    index, run = instrument.index_poses(np.array(runs))
    count = len(runs) + (instrument.reference == "teach")
    numbers = np.arange(float(count))[:, None] * np.ones(3)
    return Series("s", numbers, numbers, numbers, index, run)


def test_readings_see_their_reference():
    against_teach = series(ball_bar.instrument, ["a", "a", "b"])
    assert against_teach.index.tolist() == [[0, 3], [1, 3], [2, 3]]
    against_first = series(relative.rm5, ["a", "a", "b", "b", "b"])
    assert against_first.index.tolist() == [[1, 0], [3, 2], [4, 2]]
    assert against_first.run.tolist() == ["a", "b", "b"]


def test_readings_taken_keep_the_poses_that_they_see():
    taken = series(ball_bar.instrument, ["a", "a", "b"]).take(np.array([2, 0]))
    assert taken.reading_commands()[:, 0].tolist() == [2.0, 0.0]
    assert taken.command[taken.index[:, 1], 0].tolist() == [3.0, 3.0]
    assert taken.run.tolist() == ["b", "a"]
    assert len(taken.command) == 3


def test_passes_go_forward_and_backward():
    whole = series(ball_bar.instrument, ["a", "a", "b"])
    passes = whole.expand_passes(Protocol(both_directions=True, average=False))
    assert passes.reading_commands()[:, 0].tolist() == [0, 1, 1, 0, 2, 2]
    assert passes.run.tolist() == [
        *["a, forward 1"] * 2,
        *["a, backward 1"] * 2,
        "b, forward 1",
        "b, backward 1",
    ]
    assert whole.expand_passes(Protocol(repeats=3)) is whole
    separate = passes.separate_poses()
    np.testing.assert_array_equal(
        separate.reading_commands(), passes.reading_commands()
    )
    assert len(np.unique(separate.index[:, 0])) == len(passes)


def test_values_belong_to_readings_of_their_series():
    """Values 1 of two channels in the first series, 4 and 5 of the second's one."""
    first, second = (series(ball_bar.instrument, ["a"] * n) for n in (2, 3))
    taken, places = TakenReadings.of_values(
        [first, second], [2, 1], np.array([1, 4, 6])
    )
    assert [t.rows.tolist() for t in taken] == [[0], [0, 2]]
    assert places.tolist() == [1, 2, 3]


# -- channels and expressions ----------------------------------------------------------
def toy() -> Instrument:
    """Three channels that read 1, 2 and 3, with two sources of errors each."""
    channels = tuple(
        dataclasses.replace(ball_bar.instrument.channels[0], name=name)
        for name in "abc"
    )
    return dataclasses.replace(
        ball_bar.instrument,
        channels=channels,
        observe=lambda frames, s, k: [ca.DM(1.0), ca.DM(2.0), ca.DM(3.0)],
        sources=lambda frames, s, k: ca.DM([[1.0, 2.0], [3.0, 4.0], [5.0, 6.0]]),
        fixed_reading=lambda k: 1.0,
    )


def test_some_channels_keep_the_instruments_order_and_sources():
    some = toy().take_channels(["c", "a"])
    assert [c.name for c in some.channels] == ["a", "c"]
    assert [float(v) for v in some.observe([], {}, {})] == [1.0, 3.0]
    assert np.array(some.sources([], {}, {})).tolist() == [[1.0, 2.0], [5.0, 6.0]]


def test_the_first_channel_has_the_fixed_reading():
    first, rest = toy().take_channels(["a", "c"]), toy().take_channels(["b", "c"])
    assert first.fixed_reading is not None
    assert rest.fixed_reading is None
    assert (toy().arity, relative.rm5.arity, pose_tracker.position.arity) == (2, 2, 1)


def test_channels_that_are_not_there_are_refused():
    with pytest.raises(ValueError, match="has no channel"):
        toy().take_channels(["a", "d"])
    with pytest.raises(ValueError, match="at least"):
        toy().take_channels([])


def test_without_a_tool_the_reference_point_is_read():
    assert CUP.tool == (0.0, 0.0, 0.0)
