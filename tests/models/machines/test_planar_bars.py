"""The planar manipulator of Chang, Li and Li (2011): oracle and printed numbers.

Lengths are in mm against angles scaled by 1 m throughout, which is the toolkit's
"length" scaling with a lever of 1 m.
"""

import numpy as np
import pytest
from oracles import planar_geometry as oracle
from shipped_models import relative

from oed.design import CRITERIA
from oed.identifiability import Identifiability, analyse, posterior_covariance, scaled
from oed.instrument import Setup, mount
from oed.measurement import Measurement, Series
from pkm_models.machines.planar_2dof import machine

RM = {k: getattr(relative, f"rm{k}") for k in range(1, 6)}
NAMES = ("D", "z1", "z2", "l1", "l2", "beta1", "beta2")
#: the machine's error of a virtual test, SI; of the size of the deviations the paper
#: began with
WRONG = oracle.NOMINAL + np.array(
    [0.9e-3, 0.4e-3, -0.5e-3, -0.6e-3, 0.3e-3, 0.35e-3, -0.25e-3]
)


def measured(number: int, **tolerances: float) -> tuple[Measurement, Series]:
    """One RM on the paper's lines."""
    m = Measurement(machine, [mount(RM[number], "rm", tolerances=tolerances)])
    pose, line = oracle.lines(number)
    return m, m.series("rm", pose, run=[str(k) for k in line])


def together(*numbers: int) -> tuple[Measurement, list[Series]]:
    """Several RMs as set-ups of one measurement."""
    setups: list[Setup] = [mount(RM[k], f"rm{k}") for k in numbers]
    m = Measurement(machine, setups)
    series = []
    for k in numbers:
        pose, line = oracle.lines(k)
        series.append(m.series(f"rm{k}", pose, run=[str(v) for v in line]))
    return m, series


def verdict(m: Measurement, series: list[Series]) -> Identifiability:
    h = scaled(m, series, m.nominal, "length")[:, m.free]
    return analyse(
        h,
        [n for n, f in zip(m.names, m.free, strict=True) if f],
        1 / m.length_factors[m.free],
    )


def table(v: Identifiability) -> list[dict[str, float]]:
    return v.coefficients_by_name(v.combinations)


# -- the machine -----------------------------------------------------------------------
def test_poses_agree_with_the_intersection_of_circles(rng):
    m, _ = measured(5)
    command = np.column_stack([rng.uniform(-1.5, 1.5, 300), rng.uniform(0.0, 1.5, 300)])
    x, q = m.kinematics.inverse(command)
    assert np.abs(q - oracle.inverse(command)).max() < 1e-14
    for p in (oracle.NOMINAL, WRONG):
        reached = m.kinematics.forward(q, p, x)
        assert np.abs(reached - oracle.forward(q, p)).max() < 1e-13


def test_slopes_agree_with_the_paper_s_jacobian_and_with_the_complex_step(rng):
    """Eq. (11) as printed is right: it is the slope of the exact pose."""
    m, _ = measured(5)
    command = np.column_stack([rng.uniform(-1.5, 1.5, 50), rng.uniform(0.0, 1.5, 50)])
    x, q = m.kinematics.inverse(command)
    printed = oracle.rows(command)
    moved = [oracle.forward(q, oracle.NOMINAL + 1e-30j * e) for e in np.eye(7)]
    step = np.stack(moved, -1).imag / 1e-30
    assert np.abs(printed - step).max() < 1e-13
    slopes = m.kinematics.slopes.pose_by_parameter(x, q, oracle.NOMINAL)
    assert np.abs(slopes - printed).max() < 1e-13


@pytest.mark.parametrize("number", RM)
def test_readings_are_the_oracle_s(number):
    m, series = measured(number)
    pose, line = oracle.lines(number)
    exact = oracle.relative(oracle.forward(oracle.inverse(pose), WRONG), line)
    channel = {1: [0], 2: [1], 3: [1], 4: [0], 5: [0, 1]}[number]
    theta = np.r_[WRONG, m.nominal[7:]]
    assert np.abs(m.readings([series], theta) - exact[:, channel].ravel()).max() < 1e-13
    slopes = m.jacobian([series], m.nominal)[:, :7]
    assert np.abs(slopes - oracle.identification_rows(number)).max() < 1e-13


def test_tolerances_make_the_deviations_the_paper_began_with(rng):
    """+-1.589 mm in y and +-1.715 mm in z on horizontal lines.

    A machine of median luck has about that.
    """
    pose, line = oracle.lines(5)
    spread = [p.tolerance for p in machine.parameters]
    wrong = oracle.NOMINAL + spread * rng.standard_normal((400, 1, 7))
    errors = oracle.forward(oracle.inverse(pose), wrong) - pose
    deviation = np.stack([oracle.relative(e, line) for e in errors])
    largest = np.abs(deviation).max(axis=1)
    median_mm = 1e3 * np.median(largest, axis=0)
    assert (median_mm > 0.5).all()
    assert (median_mm < 3.0).all()


# -- noise -----------------------------------------------------------------------------
def test_readings_of_a_line_share_the_noise_of_its_reference():
    """Covariance of X_i - X_0: 2 sigma^2 on the diagonal, sigma^2 off it.

    Between lines it is 0.
    """
    m, series = measured(5)
    noise = m.noise([series])
    root = noise.correlate(np.eye(len(noise.sigma)))
    covariance = root.T @ root
    variance = np.array([1e-6, 3e-6]) ** 2
    per_line = np.kron(np.ones((10, 10)) + np.eye(10), np.diag(variance))
    assert covariance == pytest.approx(
        np.kron(np.eye(3), per_line), rel=1e-9, abs=1e-24
    )


def test_differences_carry_the_information_of_the_readings_themselves():
    """Correlated differences equal all readings of a line with a free zero point.

    Taken as independent, readings against the first of their line promise 20 % too
    little for RM 4's tilts, and waste 30 % of RM 1's D.
    """
    for number, name, ratio in ((4, "beta1", 1.2536), (1, "D", 0.7072)):
        m, series = measured(number)
        pose, line = oracle.lines(number)
        tolerance, k = m.tolerance[:7], NAMES.index(name)
        honest = posterior_covariance(
            scaled(m, [series], m.nominal, "tolerance")[:, :7]
        )
        rows = oracle.rows(pose)[:, 0] * tolerance / RM[number].channels[0].sigma
        zero = line[:, None] == np.arange(3)
        centred = rows - zero @ np.linalg.lstsq(zero.astype(float), rows, rcond=None)[0]
        assert honest == pytest.approx(
            np.linalg.inv(np.eye(7) + centred.T @ centred), rel=1e-6, abs=1e-12
        )
        h = m.jacobian([series], m.nominal)[:, :7] * tolerance
        naive = posterior_covariance(h / m.sigma([series])[:, None])
        assert np.sqrt(honest[k, k] / naive[k, k]) == pytest.approx(ratio, abs=1e-3)


# -- identifiability: section 2.3.3 ----------------------------------------------------
def test_relative_measurements_see_their_combinations():
    """What RM 1 to 5 see, section 2.3.3; the coefficient of RM 1 is one over D."""
    v = verdict(*_one(1))
    one = pytest.approx(1.0)
    slope = pytest.approx(1 / oracle.D, rel=1e-9)  # 0.279 1/m
    minus = pytest.approx(-1 / oracle.D, rel=1e-9)
    assert v.rank == 5
    assert table(v) == [
        {"D": one},
        {"l1": one},
        {"l2": one},
        {"z1": slope, "z2": minus, "beta1": one},
        {"z1": slope, "z2": minus, "beta2": one},
    ]
    v = verdict(*_one(2))
    assert v.rank == 1
    assert table(v) == [{"beta1": pytest.approx(1.0), "beta2": pytest.approx(-1.0)}]
    for number in (3, 5):
        v = verdict(*_one(number))
        assert v.rank == 6
        assert table(v) == SIX
        assert v.coefficients_by_name(v.lost) == [
            {"z1": pytest.approx(1.0), "z2": pytest.approx(1.0)}
        ]
    v = verdict(*_one(4))
    assert v.rank == 2
    assert table(v) == [{"beta1": pytest.approx(1.0)}, {"beta2": pytest.approx(1.0)}]


SIX = [
    {"D": pytest.approx(1.0)},
    {"z1": pytest.approx(1.0), "z2": pytest.approx(-1.0)},
    *({name: pytest.approx(1.0)} for name in ("l1", "l2", "beta1", "beta2")),
]


def test_all_relative_readings_of_the_workspace_see_six(rng):
    """Eqs. (14)-(15): 100 random poses against one, both components."""
    m = Measurement(machine, [mount(relative.rm5, "rm")])
    poses = np.column_stack([rng.uniform(-1.5, 1.5, 101), rng.uniform(0.0, 1.5, 101)])
    v = verdict(m, [m.series("rm", poses)])
    assert v.rank == 6
    assert table(v) == SIX


def test_smallest_singular_values():
    """Lengths in mm, angles scaled by 1 m, all seven columns, not whitened.

    Lines and reference points are the paper's.
    """
    least = {k: verdict(*_one(k)).identifiable_singular_values[-1] for k in (3, 5)}
    both = verdict(*together(4, 5)).identifiable_singular_values[-1]
    assert least[3] == pytest.approx(0.0006, rel=0.02)
    assert least[5] == pytest.approx(0.0137, rel=0.02)
    assert both == pytest.approx(0.257, rel=0.02)
    assert both / least[5] == pytest.approx(19.0, rel=0.02)


def test_indices_over_the_six_columns_of_eq_16():
    """The paper drops the column of z2 before Eq. (17)."""
    six = [0, 1, 3, 4, 5, 6]
    h3, h5 = (oracle.identification_rows(k)[:, six] for k in (3, 5))
    assert amplification(h3, 33) == pytest.approx(0.0186, abs=5e-5)
    assert np.linalg.svd(h5, compute_uv=False)[-1] == pytest.approx(0.0112, abs=5e-5)


def test_singular_values_are_the_oracle_s():
    for k in RM:
        expected = np.linalg.svd(oracle.identification_rows(k), compute_uv=False)
        v = verdict(*_one(k))
        assert v.identifiable_singular_values == pytest.approx(
            expected[: v.rank], rel=1e-9
        )


def test_a_ruler_of_unknown_direction_hides_a_turn_of_the_machine():
    """Not in the paper, whose reference planes are perfect.

    Freed, the square's tilt takes one direction from RM 4: a common tilt of both guides.
    The ruler's takes one from RM 5: z1 - z2 against both tilts, the machine as a whole.
    """
    m4, s4 = measured(4, tilt=1e-3)
    v4 = verdict(m4, [s4])
    assert (v4.rank, len(v4.names)) == (2, 8)
    assert table(v4) == [
        {"beta1": pytest.approx(1.0), "beta2": pytest.approx(-1.0)},
        {"beta1": pytest.approx(1.0), "rm.tilt": pytest.approx(1.0)},
    ]
    m5, s5 = measured(5, tilt=1e-3)
    v5 = verdict(m5, [s5])
    assert (v5.rank, len(v5.names)) == (6, 8)
    # the whole machine turned by 1 rad/m D: one slider up, the other down, both guides
    # and the apparent ruler back
    turned = np.array([0.0, oracle.D / 2, -oracle.D / 2, 0.0, 0.0, -1.0, -1.0, -1.0])
    assert np.abs(v5.combinations @ turned).max() < 1e-12
    assert np.abs(m5.jacobian([s5], m5.nominal) @ turned).max() < 1e-12


def test_by_the_index_alone_the_longest_line_is_the_best():
    """Section 2.4.1 takes z = 0 and 900 mm.

    Eq. (17) grows in proportion to the travel, up to 1500 mm.
    """
    index = {}
    for z in (0.9, 1.5):
        poses = [(y, v) for y in (-1.5, 1.5) for v in (0.0, z)]
        index[z] = amplification(_two_sided(4, poses), 4)
    assert index[1.5] / index[0.9] == pytest.approx(1.5 / 0.9)


def test_the_height_of_step_two_makes_no_difference():
    """Section 2.4.1 takes z = 200 mm: with the tilts known, no row depends on z."""
    index = []
    for z in (0.0, 0.2, 1.5):
        h = _two_sided(5, [(y, z) for y in (0.0, -1.5, 1.5)])
        index.append(amplification(h[:, [0, 1, 3, 4]], 3))
    assert index == pytest.approx([0.28319] * 3, rel=1e-4)


def _two_sided(number: int, poses: list[tuple[float, float]]) -> np.ndarray:
    """H of an RM at poses, as lengths: a line for each y of RM 4, one for RM 5."""
    m = Measurement(machine, [mount(RM[number], "rm")])
    run = [str(y) for y, _ in poses] if number == 4 else ["1"] * len(poses)
    return scaled(m, [m.series("rm", np.array(poses), run=run)], m.nominal, "length")[
        :, :7
    ]


def _one(number: int) -> tuple[Measurement, list[Series]]:
    m, series = measured(number)
    return m, [series]


def _lengths(number: int) -> np.ndarray:
    """H of an RM on the paper's lines, as lengths."""
    m, series = _one(number)
    return scaled(m, series, m.nominal, "length")[:, :7]


# -- which measurement: section 2.4, Eq. (17) ------------------------------------------
def amplification(h: np.ndarray, poses: int) -> float:
    """Eq. (17) over the non-zero singular values."""
    s = np.linalg.svd(h, compute_uv=False)
    return CRITERIA.index("noise_amplification", s[s > 1e-9 * s[0]], poses)


def test_rm2_is_excluded_and_rm4_is_selected():
    """RM 4 sees all that RM 2 sees, 2.3 times as strongly.

    RM 3 sees what RM 4 sees, and more, 7.9 times as weakly.
    """
    index = {k: amplification(_lengths(k), 33 if k == 3 else 18) for k in (2, 3, 4)}
    assert index[4] / index[2] == pytest.approx(2.27, abs=0.02)
    assert index[4] > index[2]
    assert index[4] > index[3]
    space2, space4 = (verdict(*_one(k)).row_space for k in (2, 4))
    assert np.linalg.norm(space4 @ space2.T) == pytest.approx(1.0)


def test_rm5_is_the_strongest_for_the_four_of_step_two():
    """D, z1 - z2, l1, l2 with the tilts known."""
    four, index = [0, 1, 3, 4], {}
    for k in (1, 3, 5):
        index[k] = amplification(oracle.identification_rows(k)[:, four], 33)
        assert amplification(_lengths(k)[:, four], 33) == pytest.approx(index[k])
    assert index[5] > index[1]
    assert index[5] > index[3]
