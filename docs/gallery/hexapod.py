"""Hexapod: what a ball bar sees of 42 parameters, and what other readings add.

    python docs/gallery/hexapod.py [FOLDER]

A bar from the tool point to a cup reads one distance a pose. With the platform level it
hardly sees the machine. At all orientations it sees 36 of 45 directions, cup included,
and never more. No distance changes when the six platform joints rotate about the ball,
or when the base moves together with the cup. A second tool shows the tilts; full poses
in a known frame show everything.
"""

import itertools

import _draw
import numpy as np

from oed.identifiability import Assessment, explain
from oed.instrument import mount
from oed.measurement import Measurement, commands_at_fixed_reading
from pkm_models.instruments import ball_bar, pose_tracker
from pkm_models.machines.hexapod import HEIGHT, machine
from pkm_reports import style

CUP, TILT, EXTENSION = 0.200, np.deg2rad(15.0), 0.100
KNOWN_FRAME = {f"{kind}_{n}": 0.0 for kind in ("shift", "turn") for n in "xyz"}
hexapod = Measurement(
    machine,
    [
        mount(ball_bar.free_cup, "bar", at_x=0.0, at_y=0.0, at_z=CUP),
        mount(
            ball_bar.free_cup,
            "long tool",
            at_x=0.0,
            at_y=0.0,
            at_z=CUP + EXTENSION,
            tool=(0.0, 0.0, EXTENSION),
        ),
        mount(pose_tracker.position, "positions", tolerances=KNOWN_FRAME),
        mount(pose_tracker.instrument, "poses", tolerances=KNOWN_FRAME),
    ],
)
side = (-0.1, 0.0, 0.1)
level = np.array(
    [
        (x, y, HEIGHT, 0.0, 0.0, 0.0)
        for x in np.linspace(-0.1, 0.1, 7)
        for y in np.linspace(-0.1, 0.1, 7)
    ]
)
oriented = np.array(
    [
        (x, y, HEIGHT, *angles)
        for x in side
        for y in side
        for angles in itertools.product((-TILT, TILT), repeat=3)
    ]
)


def on_sphere(setup: str, command: np.ndarray) -> np.ndarray:
    """Commands led onto the bar's sphere by z."""
    solved, possible = commands_at_fixed_reading(hexapod, setup, command, "z")
    assert possible.all()
    return solved


bar, long_tool = (
    hexapod.series("bar", on_sphere("bar", oriented)),
    hexapod.series("long tool", on_sphere("long tool", oriented)),
)
plans = {
    "bar, level": [hexapod.series("bar", on_sphere("bar", level))],
    "bar, turned": [bar],
    "bar, two tools": [bar, long_tool],
    "positions": [hexapod.series("positions", oriented)],
    "full poses": [hexapod.series("poses", oriented)],
}
views = {name: Assessment.of(hexapod, series) for name, series in plans.items()}
ranks = {name: (v.identifiability.rank, len(v.names)) for name, v in views.items()}
assert ranks["bar, level"][0] < 20
assert ranks["bar, turned"] == (36, 45)
assert ranks["bar, two tools"] == (41, 48)
assert ranks["positions"] == (39, 42)
assert ranks["full poses"] == (42, 42)
findings = explain(views["bar, turned"])
lost_finding = next(f for f in findings if f.kind == "lost")
assert "rotation of the platform joints about the tool point" in lost_finding.text
assert (
    "translation of the base joints along z together with what bar is set up on"
    in lost_finding.text
)

picture = _draw.Picture(
    "72 bar readings, all orientations", "Directions seen, and lost"
)
picture.machine(hexapod.kinematics)
tips = bar.reading_commands()[:, :3]
picture.points(tips, label="ball at the tool point")
cup = np.array([0.0, 0.0, CUP])
for tip in np.unique(tips.round(9), axis=0):
    picture.line(np.array([cup, tip]), color=style.BLUE, lw=0.5)
labels = list(reversed(ranks))
rank, count = np.array([ranks[name] for name in labels]).T
rows = np.arange(len(labels))
picture.plot.barh(rows, rank, 0.6, color=style.BLUE, label="seen")
picture.plot.barh(rows, count - rank, 0.6, left=rank, color=style.GREY, label="lost")
picture.plot.set_yticks(rows, labels, fontsize=7.0)
picture.plot.set_xlabel("directions of machine and set-up")
picture.plot.set_xlim(0.0, 64.0)
picture.plot.legend(loc="lower right", frameon=False, fontsize=7.0)
picture.save(
    __file__,
    [
        *(f"{name}: {r} of {n}" for name, (r, n) in ranks.items()),
        lost_finding.text,
        *lost_finding.remedies,
    ],
)
