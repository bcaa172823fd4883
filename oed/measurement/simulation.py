"""Virtual machines: true parameters drawn from the tolerances, and their readings.

A virtual machine obeys the exact closure at its true parameters, which the
identification does not know; its controller uses the nominal ones. Tests of the model
itself use machines that are written independently of this code.
"""

from collections.abc import Sequence

import numpy as np

from oed.base import Array
from oed.measurement.measurement import Measurement, Series
from oed.measurement.noise_structure import common_statement, reading_structure
from oed.noise import Laws

#: draws of a machine at most, until it keeps to the bounds of its parameters
MAX_DRAWS = 1000


def draw_parameters(
    measurement: Measurement, rng: np.random.Generator, machines: int | None = None
) -> Array:
    """Draw true parameters theta (n,) or (machines, n), SI, about nominal.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.measurement import draw_parameters
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> theta = draw_parameters(measurement, np.random.default_rng(1), machines=200)
    >>> theta.shape
    (200, 13)
    >>> scatter = theta.std(axis=0) / measurement.tolerance
    >>> bool(np.abs(scatter - 1.0).max() < 0.2)
    True
    """
    n = len(measurement.parameters)
    shape = (n,) if machines is None else (machines, n)
    theta = measurement.nominal + draw_deviations(measurement, rng, shape)
    if not measurement.bounded.size:
        return np.asarray(theta)
    return _redraw_outside(measurement, np.atleast_2d(theta), rng).reshape(shape)


def _redraw_outside(
    measurement: Measurement, theta: Array, rng: np.random.Generator
) -> Array:
    """Parameters (m, n) within bounds. Raises ValueError where hardly any are."""
    for _ in range(MAX_DRAWS):
        outside = np.flatnonzero(~measurement.in_bounds(theta))
        if not outside.size:
            return theta
        shape = (len(outside), theta.shape[1])
        theta[outside] = measurement.nominal + draw_deviations(measurement, rng, shape)
    raise ValueError(
        f"{measurement.machine.name}: hardly any machine drawn from the tolerances keeps"
        " to the bounds of its parameters; widen the bounds, or narrow the tolerances"
    )


def draw_deviations(
    measurement: Measurement, rng: np.random.Generator, shape: tuple[int, ...]
) -> Array:
    """Deviations (..., n) from nominal, SI, drawn from the tolerances."""
    normal = rng.standard_normal(shape)
    if measurement.correlation is None:
        return measurement.tolerance * normal
    return normal @ measurement.prior_root().T


def draw_readings(
    measurement: Measurement,
    series: Sequence[Series],
    truth: Array,
    rng: np.random.Generator,
) -> Array:
    """Draw noisy readings y (N,) or (m, N), SI, of machines at `truth` (n,) or (m, n).

    Raises AssemblyError where a pose cannot be assembled.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from oed.measurement import draw_readings
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> y, z = np.meshgrid(np.linspace(-1.2, 1.2, 5), np.linspace(0.2, 1.3, 5))
    >>> series = measurement.series("tracker", np.column_stack([y.ravel(), z.ravel()]))
    >>> truth = measurement.nominal
    >>> y = draw_readings(measurement, [series], truth, np.random.default_rng(1))
    >>> errors = y - measurement.readings([series], truth)
    >>> scatter = float((errors / measurement.sigma([series])).std())
    >>> 0.7 < scatter < 1.3  # of 75 errors
    True
    """
    exact = measurement.readings(series, truth)
    return exact + draw_errors(measurement, series, rng, exact.shape)


def draw_errors(
    measurement: Measurement,
    series: Sequence[Series],
    rng: np.random.Generator,
    shape: tuple[int, ...],
) -> Array:
    """Errors (..., N), SI, of the stated noise with the tails that are stated."""
    tails = common_statement(measurement, series)
    if tails.student_dof is None and not tails.outlier_share:
        return measurement.noise(series).draw(rng, shape)
    structure = reading_structure(measurement, series, measurement.nominal)
    laws = Laws.stated(structure, int(np.prod(shape[:-1])))
    errors = laws.whitening(structure).draw(rng, tails)
    return structure.restore(errors).reshape(shape)
