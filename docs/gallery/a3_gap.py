"""A3 spindle head that stays worse than its noise: which effects cause it, with and
without knowing the direction.

    python docs/gallery/a3_gap.py [FOLDER]

The head of `a3_gap.study.toml` has a leg that warms up and a drive with play.
Calibrated, it leaves eight times the noise. From the readings with time, feed and
direction, both effects are found in their legs and in their sizes. Without the column
`direction`, play cannot be named, and the diagnosis says so. What it finds in its place
in that leg, servo lag, which changes with the sense of motion too, explains a part
only; the rest it calls a form of no known effect.
"""

import tempfile
from pathlib import Path

import _draw
import numpy as np

from oed import dataset
from oed.gap.data import problem as problem_of
from oed.gap.data.diagnosis import Diagnosis
from oed.gap.diagnose import diagnose
from pkm_reports import style
from pkm_studies import pipeline, study
from pkm_studies.resolve import gap as resolve_gap
from pkm_studies.resolve import resolved as resolve

said = study.load(Path(__file__).with_suffix(".study.toml"))
found = resolve.resolve(said, readings=[])
bench = found.measurement_with(found.setups)
asked = resolve_gap.gap_request(said, found.machine, always=True)
with tempfile.TemporaryDirectory() as folder:
    readings, _ = pipeline.simulate(said, Path(folder) / "circles.csv")
    data = dataset.load(readings, bench)


def diagnosed(covariates) -> Diagnosis:
    problem = problem_of.prepare(
        bench, data.series, data.y, covariates, gravity=asked.gravity
    )
    return diagnose(problem, asked.effects, np.random.default_rng(said.seed))


def rms(values: np.ndarray) -> float:
    return 1e6 * float(np.sqrt(np.mean(values**2)))


full = diagnosed(data.covariates)
best = full.answers[0]
size = {(c.effect, c.name): c for c in full.coefficients}
play, rise = size["backlash", "leg 3"], size["leg_thermal", "leg 2 rise"]
assert set(best.effects) == {"backlash", "leg_thermal"}
assert abs(play.mean - 6e-6) < 3.5 * play.sd < 1e-6  # m
assert abs(rise.mean - 3.0) < 3.5 * rise.sd < 0.2  # K
assert full.where[0].block == "leg 3"
assert rms(full.before) > 7.0 * 0.5  # the bar's noise is 0.5 um
assert rms(full.after) < 0.6

blind = diagnosed(data.covariates.assign(direction=np.nan))
assert {"backlash", "friction"} <= set(blind.not_testable)
assert "backlash" not in blind.answers[0].effects
assert "unknown" in blind.answers[0].effects

series = data.series[0]
command = series.command[
    series.index[:, 0]
]  # of the pose read; the other one is where the cup was taught
angle = np.rad2deg(command[:, 1])
picture = _draw.Picture(
    "Circles at three heights", "Residual of the middle circle [um]"
)
picture.machine(bench.kinematics, np.array([command[0, 0], 0.9, np.deg2rad(30.0)]))
places, _ = bench.kinematics.inverse(command[::6])
picture.points(places[:, :3], label="readings", ms=2.0)
for name, shade in (("forward", style.BLUE), ("backward", style.ORANGE)):
    rows = np.flatnonzero(data.covariates["run"].eq(f"z=1166mm, {name} 1"))
    rows = rows[np.argsort(angle[rows])]
    for values, look in ((full.before, "o-"), (full.after, ":")):
        label = name if values is full.before else f"{name}, with causes"
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
            f"calibrated {rms(full.before):.2f} um rms, with the causes"
            f" {rms(full.after):.2f} um"
        ),
        f"{' and '.join(best.effects)}: {best.probability:.0%}",
        (
            f"play of leg 3: {1e6 * play.mean:.2f} um (6), rise of leg 2:"
            f" {rise.mean:.2f} K (3)"
        ),
        (
            f"without direction: {' and '.join(blind.answers[0].effects)}, where:"
            f" {blind.where[0].block}"
        ),
    ],
)
