"""Three circles of an A3 head's ball bar, a run each, whose cup is seated at each."""

import numpy as np

from oed.measurement.measurement import Measurement
from oed.measurement.reading_structure import reading_structure
from oed.model.instrument import mount
from oed.noise.structure import ReadingStructure
from pkm_models.instruments import ball_bar
from pkm_models.machines import a3_head

STROKES = (1.15, 1.2, 1.25)


def circles(points: int) -> ReadingStructure:
    """The structure of so many readings a circle."""
    bar = mount(ball_bar.instrument, "bar", teach=(1.2, 0.0, 0.0))
    m = Measurement(a3_head.machine, [bar])
    psi = np.tile(np.linspace(-3.0, 3.0, points), len(STROKES))
    heights = np.repeat(STROKES, points)
    command = np.column_stack([heights, psi, np.full(len(psi), 0.4)])
    series = m.series("bar", command, run=[f"z {z}" for z in heights])
    return reading_structure(m, [series], m.nominal)
