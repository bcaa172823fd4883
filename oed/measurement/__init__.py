"""A machine read by instruments: readings, Jacobians, noise of readings, simulation.

Measurement                a machine with its set-ups
Response                   how readings change with what changes at their poses
Series                     readings of one set-up at commanded poses
commands_at_fixed_reading  commands at which an instrument keeps its reading
draw_errors                errors of readings, by the stated noise
draw_parameters            true parameters of virtual machines
draw_readings              noisy readings of virtual machines
reading_structure          runs, chains and courses that readings belong to
"""

from typing import TYPE_CHECKING

from oed.base import door

if TYPE_CHECKING:
    from oed.measurement.measurement import (
        Measurement,
        Response,
        Series,
        commands_at_fixed_reading,
    )
    from oed.measurement.noise_structure import reading_structure
    from oed.measurement.simulation import draw_errors, draw_parameters, draw_readings
else:
    # imported when first used: CasADi takes time to load
    __getattr__ = door(__name__)
