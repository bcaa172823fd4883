"""Planar manipulator: what the relative measurements RM 1 to 5 of its paper see, and
why two are better than one.

    python docs/gallery/planar_2dof.py [FOLDER]

Chang, Li and Li (2011), Chinese Journal of Mechanical Engineering, section 2.3. RM 5
alone sees all six combinations of the seven errors that relative readings can see, one
of them hardly. RM 4, the guides' tilts against a square, makes that one 19 times as
strong, though it sees two combinations only, both of which RM 5 sees too.
"""

import _draw
import numpy as np

from oed.explain import Seen, look
from oed.instrument import mount
from oed.measurement import Measurement, Series
from pkm_models.instruments import relative
from pkm_models.machines.planar_2dof import machine
from pkm_reports import style

PLACES = [
    0.0,
    *(0.3 * k for k in (-5, -4, -3, -2, -1, 1, 2, 3, 4, 5)),
]  # m; the reference first
LINES = {
    "along y": (PLACES, [0.0, 0.75, 1.5]),
    "along z": ([-1.5, 0.0, 1.5], [0.3 * k for k in range(6)]),
}
KINDS = {
    "rm1": "along y",
    "rm2": "along z",
    "rm3": "along y",
    "rm4": "along z",
    "rm5": "along y",
}

measurement = Measurement(
    machine, [mount(getattr(relative, name), name) for name in KINDS]
)


def read(name: str) -> Series:
    """One measurement on the paper's lines, each line a run that begins with its
    reference.
    """
    y, z = LINES[KINDS[name]]
    if KINDS[name] == "along y":
        poses = [(a, b, f"z = {b:.2f}") for b in z for a in y]
    else:
        poses = [(a, b, f"y = {a:.2f}") for a in y for b in z]
    return measurement.series(
        name, np.array([p[:2] for p in poses]), run=[p[2] for p in poses]
    )


series = {name: read(name) for name in KINDS}
seen: dict[str, Seen] = {name: look(measurement, [s]) for name, s in series.items()}
seen["rm4 and rm5"] = look(measurement, [series["rm4"], series["rm5"]])
picture = _draw.Picture("Reading lines of RM 4 and RM 5", "What is seen, and how well")
for y in (-1.5, 0.0, 1.5):
    picture.machine(
        measurement.kinematics,
        np.array([y, 0.75]),
        lw=1.2 if y else 2.0,
        alpha=1.0 if y == 0.0 else 0.4,
    )
for name, colour in (("rm4", style.ORANGE), ("rm5", style.BLUE)):
    lines = series[name].command
    picture.points(
        np.column_stack([np.zeros(len(lines)), lines]), color=colour, label=name
    )
for k, (name, found) in enumerate(seen.items()):
    values = found.verdict.identifiable
    look_of = {"marker": style.marker(k), "color": style.CYCLE[k], "ms": 3.5, "lw": 1.0}
    picture.plot.plot(np.arange(1, len(values) + 1), values, label=name, **look_of)
style.log_axis(picture.plot, "y")
picture.plot.set(xlabel="direction, best seen first", ylabel="singular value")
picture.plot.legend(fontsize=6.5, frameon=False)

assert {name: found.verdict.rank for name, found in seen.items()} == {
    "rm1": 5, "rm2": 1, "rm3": 6, "rm4": 2, "rm5": 6, "rm4 and rm5": 6,
}  # fmt: skip
gain = (
    seen["rm4 and rm5"].verdict.identifiable[-1] / seen["rm5"].verdict.identifiable[-1]
)
assert 18.5 < gain < 19.1, (
    "RM 4 beside RM 5 makes the least seen direction 19 times as strong"
)
picture.save(
    __file__,
    [
        f"{name}: {found.verdict.rank} of 7, the least by"
        f" {found.verdict.identifiable[-1]:.2g}"
        for name, found in seen.items()
    ]
    + [f"RM 4 beside RM 5 makes the least seen direction {gain:.0f} times as strong"],
)
