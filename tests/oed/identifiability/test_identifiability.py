"""What readings can tell apart: closed forms, random matrices, assessments of small plans."""

import dataclasses

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shipped_models import a3_head, ball_bar, calliper, height_probe, linear_delta

from oed import identifiability
from oed.identifiability import (
    Assessment,
    column_scale,
    combination_text,
    explain,
    parameter_covariance,
    posterior_covariance,
    prior_information,
    recoveries,
)
from oed.identifiability.assessment import free_parameters
from oed.identifiability.identifiability import lost_motions, rigid_motions
from oed.instrument import mount
from oed.measurement import Measurement, Series
from oed.model import CommonTolerance


def analyse(h, scale=None):
    h = np.array(h, dtype=float)
    names = [f"p{k}" for k in range(h.shape[1])]
    return identifiability.analyse(
        h, names, np.ones(h.shape[1]) if scale is None else np.array(scale, dtype=float)
    )


def test_a_sum_that_cannot_be_taken_apart():
    """Readings see p0 + 2 p1 and p2."""
    v = analyse([[1, 2, 0], [0, 0, 3], [2, 4, 1]])
    assert v.rank == 2
    assert v.coefficients_by_name(v.combinations) == [
        {"p0": pytest.approx(0.5), "p1": pytest.approx(1.0)},
        {"p2": pytest.approx(1.0)},
    ]
    assert v.coefficients_by_name(v.lost) == [
        {"p0": pytest.approx(1.0), "p1": pytest.approx(-0.5)}
    ]


def test_a_difference_is_told_with_a_leading_plus():
    v = analyse([[1, -1]])
    assert v.coefficients_by_name(v.combinations) == [
        {"p0": pytest.approx(1.0), "p1": pytest.approx(-1.0)}
    ]
    assert np.abs(v.lost) == pytest.approx(np.ones((1, 2)))


def test_everything_or_nothing_seen():
    full = analyse(np.diag([3.0, 1.0, 2.0]))
    assert full.rank == 3
    assert full.combinations == pytest.approx(np.eye(3))
    assert full.lost.shape == full.null_space.shape == (0, 3)
    assert full.singular_values == pytest.approx([3, 2, 1])
    blind = analyse(np.zeros((4, 3)))
    assert blind.rank == 0
    assert blind.combinations.shape == (0, 3)
    assert blind.lost == pytest.approx(np.eye(3))


def test_fewer_readings_than_parameters():
    v = analyse([[1.0, 1.0, 1.0]])
    assert v.singular_values == pytest.approx([np.sqrt(3), 0, 0])
    assert v.identifiable_singular_values == pytest.approx([np.sqrt(3)])
    assert v.lost.shape == (2, 3)


def test_rank_is_a_share_of_the_largest_singular_value():
    h = np.diag([1.0, 1e-3, 2e-6, 5e-7])
    assert analyse(h).rank == 3
    assert analyse(1e9 * h).rank == 3
    assert identifiability.analyse(h, "abcd", np.ones(4), tolerance=1e-4).rank == 2
    assert identifiability.analyse(h, "abcd", np.ones(4), tolerance=1e-7).rank == 4


def test_combinations_are_told_in_si_whatever_the_scaling():
    """p0 (m) + 0.5 p1 (rad): the same words, as lengths and by tolerances."""
    for scale in ([1, 1], [1, 2], [1e-3, 1e-2]):
        v = analyse(np.array([[2.0, 1.0]]) * scale, scale)
        assert v.combinations == pytest.approx(np.array([[2.0, 1.0]]))
        assert v.lost[0] / v.lost[0, 1] == pytest.approx([-0.5, 1.0])


def test_combinations_that_hardly_depend_on_their_last_parameters():
    """The last three columns are independent, with a determinant of 4e-12."""
    last = np.array([[8e-3, 8e-3, 1.6e-4], [8e-3, 1.6e-4, 0.0], [1.6e-4, 0.0, 0.0]])
    first = np.linalg.cholesky(np.eye(3) - last @ last.T)
    v = analyse(np.hstack([first, last]))
    assert v.rank == 3
    assert np.linalg.matrix_rank(v.combinations, tol=1e-6) == 3
    shares = v.combinations / np.linalg.norm(v.combinations, axis=1, keepdims=True)
    assert shares @ v.lost.T == pytest.approx(np.zeros((3, 3)), abs=1e-6)


def test_the_published_relative_measurement():
    """Chang, Li and Li (2011), section 2.3: z1 - z2 and a tilt are seen as their sum."""
    D = 3.584
    v = identifiability.analyse(
        np.array([[1 / D, -1 / D, 1.0]] * 5), ["z1", "z2", "beta"], np.ones(3)
    )
    assert v.coefficients_by_name(v.combinations) == [
        {
            "z1": pytest.approx(1 / D),
            "z2": pytest.approx(-1 / D),
            "beta": pytest.approx(1.0),
        }
    ]
    seen = np.array([1 / D, -1 / D, 1.0])
    assert v.lost @ seen == pytest.approx(np.zeros(2), abs=1e-12)


@st.composite
def low_rank(draw: st.DrawFn) -> tuple[np.ndarray, int, np.ndarray]:
    """H (N, n) of known rank with sparse combinations; scales of the columns."""
    n = draw(st.integers(2, 9))
    rank = draw(st.integers(1, n))
    rng = np.random.default_rng(draw(st.integers(0, 10**6)))
    space = np.where(
        rng.uniform(size=(rank, n)) < 0.6, rng.integers(-3, 4, (rank, n)), 0
    ).astype(float)
    left = np.linalg.qr(rng.standard_normal((rank + draw(st.integers(0, 8)), rank)))[0]
    return (
        left @ space,
        int(np.linalg.matrix_rank(space)),
        10.0 ** rng.uniform(-3, 0, n),
    )


@settings(max_examples=150, deadline=None)
@given(low_rank())
def test_combinations_and_lost_directions_split_the_space(problem):
    h, rank, scale = problem
    v = identifiability.analyse(
        h, [f"p{k}" for k in range(h.shape[1])], np.ones(h.shape[1])
    )
    assert v.rank == rank
    assert np.abs(h @ v.lost.T).max(initial=0) < 1e-6
    assert np.abs(v.combinations @ v.lost.T).max(initial=0) < 1e-6
    both = np.vstack([v.combinations, v.lost])
    assert np.linalg.matrix_rank(both, tol=1e-6) == h.shape[1]
    # what is determined explains H: H = (H C^+) C
    assert np.abs(h @ np.linalg.pinv(v.combinations) @ v.combinations - h).max() < 1e-6
    si = identifiability.analyse(h * scale, v.names, scale, tolerance=1e-12)
    if si.rank == rank:
        assert np.abs(si.combinations @ v.lost.T).max(initial=0) < 1e-4 * np.abs(
            si.combinations
        ).max(initial=1)


@settings(max_examples=50, deadline=None)
@given(low_rank(), st.randoms(use_true_random=False))
def test_the_order_and_repetition_of_readings_does_not_matter(problem, random):
    h, rank, _ = problem
    order = list(range(len(h)))
    random.shuffle(order)
    again = analyse(np.vstack([h[order], h]))
    assert again.rank == rank
    assert again.combinations == pytest.approx(analyse(h).combinations, abs=1e-6)
    assert again.identifiable_singular_values == pytest.approx(
        np.sqrt(2) * analyse(h).identifiable_singular_values, rel=1e-9
    )


def test_names_and_scales_must_fit():
    with pytest.raises(ValueError, match="H has 3 columns for 2 names and 3 scales"):
        identifiability.analyse(np.eye(3), ["a", "b"], np.ones(3))


def test_rigid_motions_of_the_platforms_joints_move_them_as_one_body():
    names = [p.name for p in a3_head.machine.parameters]
    motions = {m.text: m.direction for m in rigid_motions(a3_head.machine, names)}
    assert len(motions) == 12
    spin = motions["rotation of the platform joints about the TCP, z axis"]
    centres = np.array([a3_head._platform(i) for i in a3_head.LIMBS])
    moved = spin[names.index("da1x") : names.index("da3z") + 1].reshape(3, 3)
    assert moved == pytest.approx(np.cross([0, 0, 1], centres))
    assert np.count_nonzero(spin) == np.count_nonzero(moved)
    lift = motions["translation of the base joints along z"]
    lifted = [n for n, v in zip(names, lift, strict=True) if v]
    assert lifted == ["db1z", "db2z", "db3z"]
    free = [n for n in names if n not in a3_head.machine.frame]
    kept = {m.text for m in rigid_motions(a3_head.machine, free)}
    assert kept == {t for t in motions if "platform" in t}
    assert rigid_motions(linear_delta.machine, ["radius"]) == []


def test_lost_motions_are_named_and_the_rest_is_left():
    """An H that sees all but the platform's spin and the mean of the home errors."""
    machine = a3_head.machine
    names, scale = [p.name for p in machine.parameters], np.full(24, 1e-3)
    motions = rigid_motions(machine, names)
    spin = next(m for m in motions if m.text.endswith("TCP, z axis")).direction
    mean = np.r_[1.0, 1.0, 1.0, np.zeros(21)]
    blind = np.linalg.svd(np.array([spin, mean]))[2][:2]
    h = np.eye(24) - blind.T @ blind
    told = identifiability.analyse(h, names, scale)
    texts, rest = lost_motions(told, machine, scale)
    assert texts == ["rotation of the platform joints about the TCP, z axis"]
    assert rest.shape == (1, 24)
    assert np.abs(rest @ mean) == pytest.approx(np.sqrt(3))
    everything = identifiability.analyse(np.eye(24), names, scale)
    assert lost_motions(everything, machine, scale)[0] == []


GRID = np.linspace(-0.06, 0.06, 4)
POINTS = np.array([[x, y, 0.0] for x in GRID for y in GRID])


@pytest.fixture(scope="module")
def delta() -> Measurement:
    setups = [
        mount(height_probe.instrument, "probe"),
        mount(calliper.instrument, "calliper"),
    ]
    return Measurement(linear_delta.machine, setups)


@pytest.fixture(scope="module")
def heights(delta: Measurement) -> list[Series]:
    return [delta.series("probe", POINTS)]


@pytest.fixture(scope="module")
def assessment(delta: Measurement, heights: list[Series]) -> Assessment:
    return Assessment.of(delta, heights)


def test_covariances_are_inverses_of_prior_and_information(delta, heights):
    slopes, noise = delta.jacobian(heights, delta.nominal), delta.sigma(heights)
    white = slopes * delta.tolerance / noise[:, None]
    scaled = identifiability.scaled(delta, heights, delta.nominal, "tolerance")
    np.testing.assert_allclose(scaled, white, rtol=1e-9, atol=1e-12)
    whole = np.linalg.inv(np.eye(white.shape[1]) + white.T @ white)
    told = posterior_covariance(scaled)
    np.testing.assert_allclose(told, whole, atol=1e-9)
    in_si = parameter_covariance(delta, heights, delta.nominal)
    outer = np.outer(delta.tolerance, delta.tolerance)
    np.testing.assert_allclose(in_si, whole * outer, atol=1e-9 * outer.max())


def test_each_scaling_has_its_units(delta, heights):
    slopes = delta.jacobian(heights, delta.nominal)
    angles = np.array([p.unit == "rad" for p in delta.parameters])
    lengths = np.where(angles, 1.0 / delta.machine.lever, 1.0)
    for scaling, factor in (("si", 1.0), ("length", lengths)):
        told = identifiability.scaled(delta, heights, delta.nominal, scaling)
        np.testing.assert_allclose(told, slopes * factor, rtol=1e-12)
    with pytest.raises(ValueError, match="scaling 'mm' is none of"):
        column_scale(delta, "mm")  # type: ignore[arg-type]


def test_a_common_cause_is_in_the_prior_information(delta):
    assert (prior_information(delta) == np.eye(delta.free.sum())).all()
    names = tuple(
        p.name for p in linear_delta.machine.parameters if "endstop" in p.name
    )
    machine = dataclasses.replace(
        linear_delta.machine, correlated=(CommonTolerance(names[:2], 0.5),)
    )
    matrix = prior_information(Measurement(machine, []))
    assert np.sort(np.linalg.eigvalsh(matrix))[[0, -1]] == pytest.approx([1 / 1.5, 2.0])


def test_heights_leave_the_common_size_to_the_calliper(delta, assessment):
    """Of height readings alone some direction is lost; distances recover it."""
    assert len(assessment.names) == len(free_parameters(delta, assessment.series))
    assert not any(name.startswith("calliper") for name in assessment.names)
    lost = len(assessment.names) - assessment.identifiability.rank
    assert lost > 0
    wide = np.array([[0.06, 0.0, 0.0], [-0.06, 0.0, 0.0], [0.0, 0.06, 0.0]])
    both = [*assessment.series, delta.series("calliper", wide)]
    together = Assessment.of(delta, both)
    recovered = lost - (len(together.names) - together.identifiability.rank)
    alternatives = {"distances": (delta, both[1:])}
    phrases = recoveries(assessment, alternatives)
    of_distances = [p for p in phrases if p.startswith("adding the readings of dist")]
    assert bool(of_distances) == (recovered > 0)
    kinds = [finding.kind for finding in explain(assessment, alternatives)]
    assert "lost" in kinds


def test_a_longer_tool_recovers_what_one_circle_loses():
    bar = mount(ball_bar.instrument, "cup", teach=(1.286, 0.0, 0.0))
    m = Measurement(a3_head.machine, [bar])
    psi = np.linspace(-3.0, 3.0, 15)
    command = np.column_stack([np.full(15, 1.15), psi, np.full(15, 0.4)])
    one = Assessment.of(m, [m.series("cup", command)])
    (phrase,) = [p for p in recoveries(one, {}) if p.startswith("a second tool")]
    assert phrase.startswith("a second tool, 100 mm longer, in a set-up of its own")
    lost = len(one.names) - one.identifiability.rank
    assert phrase.endswith((f"of {lost} lost directions", "all lost directions"))


def test_a_combination_begins_with_its_pivot():
    terms = {"z1": 0.2791, "beta1": 1.0, "q": -2.0}
    units = {"z1": "m", "beta1": "rad", "q": "rad"}
    assert combination_text(terms, units) == "beta1 + 0.279 rad/m z1 - 2 q"
