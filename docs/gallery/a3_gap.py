"""A3 spindle head that stays worse than its noise: the causes, with and without direction.

    python docs/gallery/a3_gap.py [FOLDER]

The head of `a3_gap.study.toml` has a leg that warms up and a drive with backlash. After
calibration its residual is eight times the noise. From readings with time, feed and
direction, the diagnosis finds both effects in the right legs with the right sizes.

Without the column `direction` it cannot name backlash, and says so. Servo lag, which
also changes with the direction of motion, then explains a part of the residual in that
leg. The diagnosis reports the remainder as unknown.
"""

import tempfile
from pathlib import Path

import _draw
import numpy as np

from oed import dataset
from oed.gap import Diagnosis, diagnose, prepare
from pkm_reports import style
from pkm_studies import stages, study
from pkm_studies.resolve import GapRequest, resolve

study_file = study.Study.load(Path(__file__).with_suffix(".study.toml"))
resolved = resolve(study_file, readings=[])
measurement = resolved.measurement_with(resolved.setups)
request = GapRequest.from_study(study_file, resolved.machine)
with tempfile.TemporaryDirectory() as folder:
    readings, _ = stages.simulate_study(study_file, Path(folder) / "circles.csv")
    data = dataset.load(readings, measurement)


def diagnosis_with(covariates) -> Diagnosis:
    problem = prepare(
        measurement, data.series, data.y, covariates, gravity=request.gravity
    )
    return diagnose(problem, request.effects, np.random.default_rng(study_file.seed))


def rms(values: np.ndarray) -> float:
    return 1e6 * float(np.sqrt(np.mean(values**2)))


complete = diagnosis_with(data.covariates)
best = complete.answers[0]
coefficients = {(c.effect, c.name): c for c in complete.coefficients}
backlash, temperature_rise = (
    coefficients["backlash", "leg 3"],
    coefficients["leg_thermal", "leg 2 rise"],
)
assert set(best.effects) == {"backlash", "leg_thermal"}
assert abs(backlash.value - 6e-6) < 3.5 * backlash.sd < 1e-6  # m
assert abs(temperature_rise.value - 3.0) < 3.5 * temperature_rise.sd < 0.2  # K
legs = [place.block for place in complete.where if place.block.startswith("leg ")]
assert legs[:2] == ["leg 3", "leg 2"]  # backlash, then temperature
assert rms(complete.before) > 7.0 * 0.5  # the bar's noise is 0.5 um
assert rms(complete.after) < 0.6

without_direction = diagnosis_with(data.covariates.assign(direction=np.nan))
assert {"backlash", "friction"} <= set(without_direction.not_testable)
assert "backlash" not in without_direction.answers[0].effects
assert "unknown" in without_direction.answers[0].effects

series = data.series[0]
command = series.command[
    series.index[:, 0]
]  # of the pose read; the other one is where the cup was taught
angle = np.rad2deg(command[:, 1])
picture = _draw.Picture(
    "Circles at three heights", "Residual of the middle circle [um]"
)
picture.machine(
    measurement.kinematics, np.array([command[0, 0], 0.9, np.deg2rad(30.0)])
)
places, _ = measurement.kinematics.inverse(command[::6])
picture.points(places[:, :3], label="readings", ms=2.0)
for name, shade in (("forward", style.BLUE), ("backward", style.ORANGE)):
    rows = np.flatnonzero(data.covariates["run"].eq(f"z=1166mm, {name} 1"))
    rows = rows[np.argsort(angle[rows])]
    for values, look in ((complete.before, "o-"), (complete.after, ":")):
        label = name if values is complete.before else f"{name}, with causes"
        picture.plot.plot(
            angle[rows],
            1e6 * values[rows],
            look,
            color=shade,
            ms=2.0,
            lw=1.0,
            label=label,
        )
picture.plot.set_xlabel("angle of the circle [degrees]")
picture.plot.set_ylim(-9.0, 14.0)
picture.plot.legend(
    loc="upper center", ncols=2, fontsize=6.5, columnspacing=0.8, handlelength=1.5
)
picture.save(
    __file__,
    [
        (
            f"calibrated {rms(complete.before):.2f} um rms, with the causes"
            f" {rms(complete.after):.2f} um"
        ),
        f"{' and '.join(best.effects)}: {best.probability:.0%}",
        (
            f"play of leg 3: {1e6 * backlash.value:.2f} um (6), rise of leg 2:"
            f" {temperature_rise.value:.2f} K (3)"
        ),
        (
            f"without direction: {' and '.join(without_direction.answers[0].effects)}, where:"
            f" {without_direction.where[0].block}"
        ),
    ],
)
