"""Linear delta printer: heights alone do not tell the arm lengths.

    python docs/gallery/linear_delta.py [FOLDER]

A touch probe on the bed reads z at 61 places, which is what a printer's own calibration
does. The common error of the three arms stays nearly as it was; it shows as a wrong
scale in x and y, which heights hardly see. Six distances on an object help as far as
the object's own scale is known: a printed one shrinks, a metal plate does not.
"""

import _draw
import numpy as np

from oed import explain
from oed.instrument import mount
from oed.measurement import Measurement, Series
from pkm_models.instruments import calliper, height_probe
from pkm_models.machines.linear_delta import machine
from pkm_reports import style

HEIGHT = 0.020
KINDS = ("arm", "angle", "endstop")
printer = Measurement(
    machine,
    [
        mount(height_probe.instrument, "probe", sigma=[30e-6]),
        mount(
            calliper.instrument, "print", sigma=[60e-6]
        ),  # its shrinkage is known to 0.1 %
        mount(
            calliper.instrument, "gauge", sigma=[60e-6], tolerances={"scale": 1e-5}
        ),  # a metal plate
    ],
)
rings = [
    (r, 2.0 * np.pi * k / n)
    for r, n in ((0.0, 1), (0.035, 12), (0.070, 20), (0.120, 28))
    for k in range(n)
]
bed = np.array([(r * np.cos(a), r * np.sin(a), HEIGHT) for r, a in rings])
hexagon = np.array(
    [(0.1 * np.cos(a), 0.1 * np.sin(a), HEIGHT) for a in np.pi / 3.0 * np.arange(6)]
)
corners = np.vstack([[0.0, 0.0, HEIGHT], hexagon])
heights = printer.series("probe", bed)
plans = {
    "heights": [heights],
    "and a printed object": [heights, printer.series("print", corners)],
    "and a metal plate": [heights, printer.series("gauge", corners)],
}


def common(series: list[Series], kind: str) -> float:
    """Posterior over prior standard deviation of the mean error of three parameters of
    a kind.
    """
    seen = explain.look(printer, series, "tolerance")
    mean = np.array([n.rstrip("123") == kind for n in seen.names]) / np.sqrt(3.0)
    return float(np.sqrt(mean @ seen.covariance @ mean))


seen = explain.look(printer, [heights])
words = " ".join(finding.text for finding in explain.explain(seen))
assert "the common arm (arm1, arm2, arm3) keeps" in words
left = {
    name: [common(series, kind) for kind in KINDS] for name, series in plans.items()
}
assert left["heights"][0] > 0.75
assert left["and a printed object"][0] < 0.7
assert left["and a metal plate"][0] < 0.35

picture = _draw.Picture("61 heights, 6 distances", "Common error left of its tolerance")
picture.machine(printer.kinematics)
picture.points(bed, color=style.GREY, label="heights")
picture.points(hexagon, label="distances")
for corner in hexagon:
    picture.line(np.array([corners[0], corner]), color=style.BLUE, lw=0.8)
shades = (style.GREY, style.SKY, style.BLUE)
for k, ((name, values), shade) in enumerate(zip(left.items(), shades, strict=True)):
    picture.plot.barh(
        np.arange(3) + 0.25 * (1 - k),
        [100.0 * v for v in values],
        0.23,
        color=shade,
        label=name,
    )
picture.plot.set_yticks(range(3), KINDS)
picture.plot.set_xlabel("% of the tolerance")
picture.plot.set_xlim(0.0, 100.0)
picture.plot.legend(loc="upper right", frameon=False, fontsize=7.0)
picture.save(
    __file__,
    [
        f"{name}: the common arm keeps {100.0 * values[0]:.0f} % of its tolerance"
        for name, values in left.items()
    ],
)
