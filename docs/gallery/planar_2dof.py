"""Planar manipulator: what the relative measurements RM 1 to 5 of its paper see.

    python docs/gallery/planar_2dof.py [FOLDER]

Chang, Li and Li (2011), Chinese Journal of Mechanical Engineering, section 2.3. RM 5
alone sees all six combinations of the seven errors that relative readings can see, but
one of them hardly. RM 4 measures the guides' tilts against a square. It sees only two
combinations, both of which RM 5 sees too, but makes the weakest one 19 times as strong.
"""

import _draw
import numpy as np

from oed.identifiability import Assessment
from oed.instrument import mount
from oed.measurement import Measurement, Series
from pkm_models.instruments import relative
from pkm_models.machines.planar_2dof import machine
from pkm_reports import style

STEPS = (0, -5, -4, -3, -2, -1, 1, 2, 3, 4, 5)
PLACES = [0.3 * step for step in STEPS]  # m; the reference first
LINES = {
    "along y": (PLACES, [0.0, 0.75, 1.5]),
    "along z": ([-1.5, 0.0, 1.5], [0.3 * k for k in range(6)]),
}
DIRECTIONS = {
    "rm1": "along y",
    "rm2": "along z",
    "rm3": "along y",
    "rm4": "along z",
    "rm5": "along y",
}

measurement = Measurement(
    machine, [mount(getattr(relative, name), name) for name in DIRECTIONS]
)


def read(name: str) -> Series:
    """One measurement on the paper's lines, each line a run that begins with its
    reference.
    """
    y, z = LINES[DIRECTIONS[name]]
    if DIRECTIONS[name] == "along y":
        poses = [(a, b, f"z = {b:.2f}") for b in z for a in y]
    else:
        poses = [(a, b, f"y = {a:.2f}") for a in y for b in z]
    command = np.array([pose[:2] for pose in poses])
    return measurement.series(name, command, run=[pose[2] for pose in poses])


series = {name: read(name) for name in DIRECTIONS}
views: dict[str, Assessment] = {
    name: Assessment.of(measurement, [s]) for name, s in series.items()
}
views["rm4 and rm5"] = Assessment.of(measurement, [series["rm4"], series["rm5"]])
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
    places = np.column_stack([np.zeros(len(lines)), lines])
    picture.points(places, color=colour, label=name)
for k, (name, view) in enumerate(views.items()):
    values = view.identifiability.identifiable_singular_values
    appearance = {
        "marker": style.marker(k),
        "color": style.CYCLE[k],
        "ms": 3.5,
        "lw": 1.0,
    }
    numbers = np.arange(1, len(values) + 1)
    picture.plot.plot(numbers, values, label=name, **appearance)
style.log_axis(picture.plot, "y")
picture.plot.set(xlabel="direction, best seen first", ylabel="singular value")
picture.plot.legend(fontsize=6.5, frameon=False)

ranks = {name: view.identifiability.rank for name, view in views.items()}
assert list(ranks) == [*DIRECTIONS, "rm4 and rm5"]
assert list(ranks.values()) == [5, 1, 6, 2, 6, 6]
weakest = {
    name: view.identifiability.identifiable_singular_values[-1]
    for name, view in views.items()
}
gain = weakest["rm4 and rm5"] / weakest["rm5"]
assert 18.5 < gain < 19.1, (
    "RM 4 beside RM 5 makes the least seen direction 19 times as strong"
)
picture.save(
    __file__,
    [f"{name}: {ranks[name]} of 7, the least by {weakest[name]:.2g}" for name in views]
    + [f"RM 4 beside RM 5 makes the least seen direction {gain:.0f} times as strong"],
)
