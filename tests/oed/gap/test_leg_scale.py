"""A leg whose conversion is wrong: named, called implausible, and estimated."""

import dataclasses
from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares
from scipy.spatial.transform import Rotation
from shipped_models import encoder_scale

from kernel.laws import STATED_LAW
from oed.corrected import EffectReadings
from oed.dataset import Dataset
from oed.estimation import identify
from oed.gap.data import linearisation, problem
from oed.gap.data.linearisation import ActingEffectForm
from oed.measurement import Measurement
from pkm_studies import study as studies
from pkm_studies.resolve import resolved
from pkm_studies.stages.correct.corrected import implausible_sizes

POSES, LENGTH, ANGLE = 45, 0.05, np.radians(0.01)  # mm, rad
#: from where leg 1 counts, mm, and the spread of the geometry about its drawing, mm
MIDDLE, SPREAD = 700.0, 3.0
STUDY = """schema = 1
name = "leg_scale"
[machine]
model = "hexapod_ups"
[machine.geometry]
base_mm = {base}
platform_mm = {platform}
home_mm = [0, 0, 700]
reach_mm = 150
tilt_deg = 20
tolerance_mm = 3
[[setup]]
name = "t"
instrument = "pose_tracker"
tolerance = {{ shift_x_mm = 0.0, shift_y_mm = 0.0, shift_z_mm = 0.0, turn_x_deg = 0.0, \
turn_y_deg = 0.0, turn_z_deg = 0.0 }}
[noise]
read_x_um = 50
read_y_um = 50
read_z_um = 50
read_alpha_deg = 0.01
read_beta_deg = 0.01
read_gamma_deg = 0.01
[posterior]
enabled = false
[gap]
effects = {effects}
[report]
html = false
pdf = false
[readings]
files = ["readings.csv"]
[prediction]
reference = "absolute"
x_mm = [-80, 80]
y_mm = 0
z_mm = 700
rx_deg = 0
ry_deg = 0
spin_deg = 0
"""
COLUMNS = (
    "setup,run,order,q1_mm,q2_mm,q3_mm,q4_mm,q5_mm,q6_mm,read_x_mm,read_y_mm,read_z_mm,"
    "read_alpha_deg,read_beta_deg,read_gamma_deg"
)


def _ring(radius: float, degrees: tuple[float, ...]) -> np.ndarray:
    angle = np.radians(degrees)
    return np.column_stack([radius * np.cos(angle), radius * np.sin(angle), 0 * angle])


BASE = _ring(400.0, (-15.0, 15.0, 105.0, 135.0, 225.0, 255.0))
PLATFORM = _ring(220.0, (-45.0, 45.0, 75.0, 165.0, 195.0, 285.0))


@dataclasses.dataclass(frozen=True)
class Readings:
    """Joints (n, 6), mm, as the controller believes, and poses (n, 6) read, mm and rad."""

    joints: np.ndarray
    poses: np.ndarray


def leg_lengths(x: np.ndarray, base: np.ndarray, platform: np.ndarray) -> np.ndarray:
    """Lengths (n, 6) at poses (n, 6): position, then angles about x, y', z''."""
    rotation = Rotation.from_euler("XYZ", x[:, 3:]).as_matrix()
    tips = x[:, None, :3] + np.einsum("nij,kj->nki", rotation, platform)
    return np.linalg.norm(tips - base, axis=2)


def _geometry(rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Base, platform and zeros of a machine, mm."""
    base, platform = (v + rng.normal(0.0, 1.0, v.shape) for v in (BASE, PLATFORM))
    return base, platform, rng.normal(0.0, 1.0, 6)


def reached(
    x: np.ndarray, sent: Mapping[str, float], scale: float, seed: int = 5
) -> np.ndarray:
    """Poses (n, 6) of the machine of `readings` at commands x (n, 6).

    sent  parameters of the controller, mm
    """
    base, platform, zeros = _geometry(np.random.default_rng(seed))
    places = [
        np.array(
            [[sent[f"{part}{leg}{axis}"] for axis in "xyz"] for leg in range(1, 7)]
        )
        for part in "ba"
    ]
    joints = leg_lengths(x, *places) - [sent[f"l{leg}"] for leg in range(1, 7)]
    joints[:, 0] = MIDDLE + (joints[:, 0] - MIDDLE) * (1.0 + scale)

    def miss(pose: np.ndarray, driven: np.ndarray) -> np.ndarray:
        return leg_lengths(pose[None], base, platform)[0] - zeros - driven

    pairs = zip(x, joints, strict=True)
    return np.array([least_squares(miss, at, args=(q,)).x for at, q in pairs])


def readings(scale: float, seed: int = 5) -> Readings:
    """Readings of a machine whose leg 1 goes `scale` too far."""
    rng = np.random.default_rng(seed)
    base, platform, zeros = _geometry(rng)
    place = rng.uniform(-120.0, 120.0, (POSES, 3)) + np.array([0.0, 0.0, 700.0])
    x = np.hstack([place, np.radians(rng.uniform(-10.0, 10.0, (POSES, 3)))])
    joints = leg_lengths(x, base, platform) - zeros
    joints[:, 0] = MIDDLE + (joints[:, 0] - MIDDLE) / (1.0 + scale)
    noise = rng.standard_normal((POSES, 6)) * np.repeat([LENGTH, ANGLE], 3)
    return Readings(joints, x + noise)


def write(
    folder: Path,
    read: Readings,
    effects: str = '["all"]',
    setup_of: Callable[[int], str] = lambda _: "t",
) -> Path:
    """The study of these readings in a folder; its path.

    setup_of  set-up of a reading by its number
    """
    rows = [COLUMNS]
    for k, (q, x) in enumerate(zip(read.joints, read.poses, strict=True), 1):
        values = [*q, *x[:3], *np.degrees(x[3:])]
        rows.append(f"{setup_of(k)},1,{k}," + ",".join(f"{v:.6f}" for v in values))
    (folder / "readings.csv").write_text("\n".join(rows) + "\n", encoding="utf-8")
    study = folder / "leg_scale.study.toml"
    base, platform = (np.round(v, 6).tolist() for v in (BASE, PLATFORM))
    text = STUDY.format(base=base, platform=platform, effects=effects)
    study.write_text(text, encoding="utf-8")
    return study


def least_squares_scale(read: Readings) -> tuple[float, float]:
    """Scale of leg 1, and its sd, with geometry and zeros free about the drawing.

    Each leg of each pose is an equation, with the noise of the pose carried to it.
    """
    step = 1e-4
    plain = leg_lengths(read.poses, BASE, PLATFORM)
    slopes = [
        (leg_lengths(read.poses + step * axis, BASE, PLATFORM) - plain) / step
        for axis in np.eye(6)
    ]
    by_axis = np.stack(slopes, axis=2) * np.repeat([LENGTH, ANGLE], 3)
    roots = np.linalg.cholesky(by_axis @ np.swapaxes(by_axis, 1, 2))

    def residual(v: np.ndarray) -> np.ndarray:
        base, platform = BASE + v[:18].reshape(6, 3), PLATFORM + v[18:36].reshape(6, 3)
        driven = read.joints.copy()
        driven[:, 0] = MIDDLE + (driven[:, 0] - MIDDLE) * (1.0 + v[42])
        off = leg_lengths(read.poses, base, platform) - v[36:42] - driven
        white = np.linalg.solve(roots, off[:, :, None])
        return np.concatenate([white.ravel(), v[:42] / SPREAD])

    sizes = np.append(np.ones(42), 0.01)
    fit = least_squares(residual, np.zeros(43), x_scale=sizes)
    covariance = np.linalg.inv(fit.jac.T @ fit.jac)
    return float(fit.x[42]), float(np.sqrt(covariance[42, 42]))


def _session(folder: Path, scale: float) -> tuple[Measurement, Dataset]:
    study = write(folder, readings(scale))
    machine = resolved.resolve(studies.Study.load(study), readings=None)
    measurement = machine.measurement_with(machine.setups)
    assert machine.dataset is not None
    return measurement, machine.dataset


def test_the_joint_estimate_is_that_of_least_squares(tmp_path):
    """At 2000 times the 50 ppm that are expected; others stay near nothing."""
    scale = -0.1
    measurement, data = _session(tmp_path, scale)
    plain = identify(measurement, data.series, data.y)
    given = EffectReadings(measurement, tuple(data.series), data.y, data.covariates)
    corrected = given.estimate([encoder_scale.effect], plain.theta)
    start = corrected.parameters
    values = corrected.estimate.theta[start:] * corrected.scales
    sds = corrected.estimate.sd[start:] * corrected.scales
    wanted, sd = least_squares_scale(readings(scale))
    assert abs(wanted - scale) < 3.0 * sd
    assert abs(values[0] - wanted) < 2.0 * sd
    assert sds[0] == pytest.approx(sd, rel=0.3)
    assert (np.abs(values[1:]) < 4.0 * sds[1:]).all()
    assert corrected.estimate.chi2 < 1.3 * corrected.estimate.dof
    (sentence,) = implausible_sizes(corrected)
    assert sentence.startswith("Encoder scale: leg 1 is -1")
    assert "times the 50 ppm expected. That is implausible" in sentence


def test_the_linear_model_holds_where_the_effect_acts(tmp_path):
    """About the settled point the residuals change as the exact readings do."""
    measurement, data = _session(tmp_path, -0.06)
    given = problem.prepare(measurement, data.series, data.y, data.covariates)
    names = tuple(f"leg {k + 1}" for k in range(6))
    form = ActingEffectForm(encoder_scale.effect, {}, names, 1000.0)
    nothing = np.zeros(len(given))
    settled = linearisation.settle(given, [form], STATED_LAW, nothing)
    assert 10.0 < settled.departure < np.inf
    assert settled.coefficients[0] * 50e-6 == pytest.approx(-0.06, abs=4e-4)
    # what is left beside parameters and effect is noise
    there = settled.problem
    columns = there.noise_units(there.signature(encoder_scale.effect, {}).columns)
    root = measurement.prior_root()[:, measurement.free]
    z = np.linalg.lstsq(root, there.theta - measurement.nominal, rcond=None)[0]
    left = there.residual - there.slopes @ z - columns @ settled.coefficients
    assert np.sqrt(np.mean(left**2)) == pytest.approx(0.94, abs=0.08)
    # a small effect is linear from the start
    small = _session(tmp_path, -2e-4)
    measurement, data = small
    given = problem.prepare(measurement, data.series, data.y, data.covariates)
    small_form = ActingEffectForm(encoder_scale.effect, {}, names, 3.0)
    settled = linearisation.settle(given, [small_form], STATED_LAW, nothing)
    assert settled.departure < 1.0
