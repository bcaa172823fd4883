"""Linear delta printer: heights alone do not determine the arm lengths.

    python docs/gallery/linear_delta.py [FOLDER]

A touch probe on the bed reads z at 61 places, as the printer's own calibration does. The
common error of the three arms stays almost undetermined: it appears as a wrong scale in
x and y, which heights hardly see. Six distances on an object help as far as the object's
scale is known. A printed object shrinks, a metal plate does not.
"""

import _draw
import numpy as np

from oed.identifiability import Assessment, explain
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
        # a printed object, whose shrinkage is known to 0.1 %
        mount(calliper.instrument, "print", sigma=[60e-6]),
        # a metal plate
        mount(calliper.instrument, "gauge", sigma=[60e-6], tolerances={"scale": 1e-5}),
    ],
)
rings = [
    (r, 2.0 * np.pi * k / n)
    for r, n in ((0.0, 1), (0.035, 12), (0.070, 20), (0.120, 28))
    for k in range(n)
]
bed = np.array([(r * np.cos(a), r * np.sin(a), HEIGHT) for r, a in rings])
sixths = np.pi / 3.0 * np.arange(6)
level = np.full(6, HEIGHT)
hexagon = np.column_stack([0.1 * np.cos(sixths), 0.1 * np.sin(sixths), level])
corners = np.vstack([[0.0, 0.0, HEIGHT], hexagon])
heights = printer.series("probe", bed)
plans = {
    "heights": [heights],
    "and a printed object": [heights, printer.series("print", corners)],
    "and a metal plate": [heights, printer.series("gauge", corners)],
}


def common_share(series: list[Series], kind: str) -> float:
    """Share of the prior standard deviation that three parameters' mean keeps."""
    view = Assessment.of(printer, series, "tolerance")
    members = np.array([n.rstrip("123") == kind for n in view.names])
    mean = members / np.sqrt(3.0)
    return float(np.sqrt(mean @ view.covariance @ mean))


view = Assessment.of(printer, [heights])
words = " ".join(finding.text for finding in explain(view))
assert "the common arm (arm1, arm2, arm3) keeps" in words
shares = {
    name: [common_share(series, kind) for kind in KINDS]
    for name, series in plans.items()
}
assert shares["heights"][0] > 0.75
assert shares["and a printed object"][0] < 0.7
assert shares["and a metal plate"][0] < 0.35

picture = _draw.Picture(
    "61 heights, 6 distances", "Share of the tolerance that is left"
)
picture.machine(printer.kinematics)
picture.points(bed, color=style.GREY, label="heights")
picture.points(hexagon, label="distances")
for corner in hexagon:
    picture.line(np.array([corners[0], corner]), color=style.BLUE, lw=0.8)
shades = (style.GREY, style.SKY, style.BLUE)
for k, ((name, values), shade) in enumerate(zip(shares.items(), shades, strict=True)):
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
        for name, values in shares.items()
    ],
)
