"""Hexapod: what a ball bar sees of 42 parameters, and what brings the rest back.

    python docs/gallery/hexapod.py [FOLDER]

A bar from the tool point to a cup reads one distance a pose. With the platform level it
hardly sees the machine. At all orientations it sees 36 of 45 directions, cup included,
and never more: turning the six platform joints about the ball, or moving the base
together with the cup, changes no distance. A second tool shows the tilts; full poses in
a known frame show everything.
"""

import itertools

import _draw
import numpy as np

from oed.explain import explain, look
from oed.instrument import mount
from oed.measurement import Measurement
from pkm_models.instruments import ball_bar, pose_tracker
from pkm_models.machines.hexapod import HEIGHT, machine
from pkm_reports import style

CUP, TILT, LONGER = 0.200, np.deg2rad(15.0), 0.100
KNOWN = {f"{kind}_{n}": 0.0 for kind in ("shift", "turn") for n in "xyz"}
hexapod = Measurement(
    machine,
    [
        mount(ball_bar.free_cup, "bar", at_x=0.0, at_y=0.0, at_z=CUP),
        mount(
            ball_bar.free_cup,
            "long tool",
            at_x=0.0,
            at_y=0.0,
            at_z=CUP + LONGER,
            tool=(0.0, 0.0, LONGER),
        ),
        mount(pose_tracker.position, "positions", tolerances=KNOWN),
        mount(pose_tracker.instrument, "poses", tolerances=KNOWN),
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
turned = np.array(
    [
        (x, y, HEIGHT, *angles)
        for x in side
        for y in side
        for angles in itertools.product((-TILT, TILT), repeat=3)
    ]
)


def held(setup: str, command: np.ndarray) -> np.ndarray:
    """Commands led onto the bar's sphere by z."""
    solved, possible = hexapod.hold(setup, command, "z")
    assert possible.all()
    return solved


bar, long_tool = (
    hexapod.series("bar", held("bar", turned)),
    hexapod.series("long tool", held("long tool", turned)),
)
plans = {
    "bar, level": [hexapod.series("bar", held("bar", level))],
    "bar, turned": [bar],
    "bar, two tools": [bar, long_tool],
    "positions": [hexapod.series("positions", turned)],
    "full poses": [hexapod.series("poses", turned)],
}
seen = {name: look(hexapod, series) for name, series in plans.items()}
found = {name: (s.verdict.rank, len(s.names)) for name, s in seen.items()}
assert found["bar, level"][0] < 20
assert found["bar, turned"] == (36, 45)
assert found["bar, two tools"] == (41, 48)
assert found["positions"] == (39, 42)
assert found["full poses"] == (42, 42)
lost = next(f for f in explain(seen["bar, turned"]) if f.kind == "lost")
assert "rotation of the platform joints about the tool point" in lost.text
assert (
    "translation of the base joints along z together with what bar is set up on"
    in lost.text
)

picture = _draw.Picture(
    "72 bar readings, all orientations", "Directions seen, and lost"
)
picture.machine(hexapod.kinematics)
tips = bar.commands()[:, :3]
picture.points(tips, label="ball at the tool point")
for tip in np.unique(tips.round(9), axis=0):
    picture.line(np.array([[0.0, 0.0, CUP], tip]), color=style.BLUE, lw=0.5)
for k, (rank, n) in enumerate(reversed(found.values())):
    picture.plot.barh(k, rank, 0.6, color=style.BLUE, label="seen" if k == 0 else None)
    picture.plot.barh(
        k, n - rank, 0.6, left=rank, color=style.GREY, label="lost" if k == 0 else None
    )
picture.plot.set_yticks(range(len(found)), list(reversed(found)), fontsize=7.0)
picture.plot.set_xlabel("directions of machine and set-up")
picture.plot.set_xlim(0.0, 64.0)
picture.plot.legend(loc="lower right", frameon=False, fontsize=7.0)
picture.save(
    __file__,
    [
        *(f"{name}: {r} of {n}" for name, (r, n) in found.items()),
        lost.text,
        *lost.remedies,
    ],
)
