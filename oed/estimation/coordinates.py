"""Identifiable coordinates: the directions that some reading determines, and the
others.

theta = origin + T V_r z with z ~ N(0, I) a priori (T S in place of T where tolerances
are correlated, S the root of their correlation). V_r spans the directions that the
whitened, tolerance-scaled H = U S V^T determines. The others keep their prior.
"""

import dataclasses
import functools
from collections.abc import Sequence

import numpy as np

from oed.base import Array, Index
from oed.estimation.fitter import minimise
from oed.identifiability import analyse
from oed.linear_algebra import canonical_rows, right_singular
from oed.measurement import Measurement, Series
from oed.noise import Noise


@dataclasses.dataclass(frozen=True)
class IdentifiableCoordinates:
    """Coordinates about an origin: theta = origin + basis @ z + null_basis @ w; SI.

    z (r,) and w are N(0, I) a priori; n parameters, k of them free.
    """

    origin: Array  #: (n,)
    basis: Array  #: (n, r) orthonormal directions times tolerances
    null_basis: Array  #: (n, k - r) the directions that no reading determines, likewise
    #: (r, n) the directions of `basis` over tolerances, so that z = dual @ (theta -
    #: origin)
    dual: Array

    @classmethod
    def of(
        cls,
        measurement: Measurement,
        series: Sequence[Series],
        theta: Array,
        noise: Noise | Array,
        tolerance: Array | None = None,
    ) -> "IdentifiableCoordinates":
        """Identifiable coordinates of readings, with H taken at theta (n,), SI.

        noise      of the readings, or its standard deviations (N,)
        tolerance  (n,) prior standard deviations, 0 for parameters that are held; the
                   measurement's by default

        The origin is nominal, where the tolerances hold, wherever H is taken; held
        parameters stay at theta. Raises AssemblyError.
        """
        scale = measurement.tolerance if tolerance is None else tolerance
        free = np.flatnonzero(scale > 0)
        unit = scale[free]
        root = measurement.correlation_root(free)
        jacobian = measurement.jacobian(series, theta)
        whitened = (Noise.of(noise).whiten(jacobian)[:, free] * unit) @ root
        null_space = _null_space(measurement, series, jacobian, free) / unit
        unmoved = np.asarray(np.linalg.solve(root, null_space.T), dtype=float)
        lost, determined = _split_directions(unmoved.T)
        # The right singular vectors of H, strongest first, decouple the sampler's
        # coordinates.
        _, vectors = right_singular(whitened @ determined)
        directions = determined @ vectors.T
        unit = unit[:, None]
        return cls(
            origin=np.where(scale > 0, measurement.nominal, theta),
            basis=_padded(free, unit * (root @ directions), len(scale)),
            null_basis=_padded(free, unit * (root @ lost), len(scale)),
            dual=_padded(free, np.linalg.solve(root, directions) / unit, len(scale)).T,
        )

    def from_theta(self, theta: Array) -> Array:
        """Coordinates z (..., r) of parameters (..., n); null directions are dropped."""
        return (self.dual @ (theta - self.origin).T).T

    def to_theta(self, z: Array) -> Array:
        """Parameters (n,) or (m, n) at coordinates (r,) or (m, r)."""
        return self.origin + z @ self.basis.T

    def match_readings(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        exact: Array,
        start: Array,
    ) -> Array:
        """Coordinates z (r,) whose readings are exact ones (N,), SI, from a start (r,):
        what readings say of a machine. A lost direction of a millimetre moves its own
        coordinates by micrometres.
        """
        noise = Noise(measurement.sigma(series))
        origin = self.origin[None]
        problem = ReadingsProblem(
            measurement, series, noise, exact[None], origin, self.basis
        )
        return np.asarray(minimise(problem, start[None], weight=0.0).z[0])

    def widened(self, factor: float) -> "IdentifiableCoordinates":
        """The same with tolerances a factor as large, null directions apart."""
        basis, dual = factor * self.basis, self.dual / factor
        return dataclasses.replace(self, basis=basis, dual=dual)


def _null_space(
    measurement: Measurement, series: Sequence[Series], jacobian: Array, free: Index
) -> Array:
    """Changes (rows, k) of the free parameters that change no reading, SI.

    The rank is judged with lengths, so that a generous tolerance or a quiet instrument
    does not change it.
    """
    lengths = measurement.length_factors
    reading_lengths = measurement.reading_length_factors(series)
    h = (jacobian * reading_lengths[:, None] / lengths)[:, free]
    names = np.array(measurement.names)[free].tolist()
    scale = 1.0 / lengths[free]
    identified = analyse(h, names, scale)
    return identified.null_space / lengths[free]


def _split_directions(null_space: Array) -> tuple[Array, Array]:
    """Orthonormal columns (k, .) of the null space, given as rows, and of the rest."""
    count, size = null_space.shape
    if not count:
        return np.zeros((size, 0)), np.eye(size)
    basis = np.linalg.qr(null_space.T)[0]
    complete = np.linalg.qr(basis, mode="complete")[0].T
    lost, determined = complete[:count], complete[count:]
    return canonical_rows(lost).T, canonical_rows(determined).T


def _padded(rows: Index, values: Array, count: int) -> Array:
    """A matrix (count, k) with values (len(rows), k) at rows, and 0 elsewhere."""
    matrix = np.zeros((count, values.shape[1]))
    matrix[rows] = values
    return matrix


@dataclasses.dataclass(frozen=True, eq=False)
class ReadingsProblem:
    """Readings of m machines over z: theta = origin + basis @ z."""

    measurement: Measurement
    series: Sequence[Series]
    noise: Noise
    y: Array  #: (m, N) readings, SI
    origin: Array  #: (m, n) parameters at z = 0, SI
    basis: Array  #: (n, k) changes of the parameters, SI, per z

    @functools.cached_property
    def magnitude(self) -> Array:
        """Sizes (m, N) of the whitened lengths whose difference a residual is."""
        # a small reading may be the difference of lengths as large as the machine
        factors = self.measurement.reading_length_factors(self.series)
        size = np.maximum(np.abs(self.y), self.measurement.machine.lever / factors)
        # whitening divides by what the other errors leave of each one
        return np.asarray(size * np.sqrt(self.noise.precision_diagonal()))

    def theta(self, machines: Index, z: Array) -> Array:
        """Parameters (s, n), SI, of some machines at z (s, k)."""
        return self.origin[machines] + z @ self.basis.T

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (s, N); NaN where a pose cannot be assembled."""
        theta = self.theta(machines, z)
        predicted = self.measurement.try_readings(self.series, theta)
        return self.noise.whiten_last(self.y[machines] - predicted)

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (s, N, k). Raises AssemblyError."""
        rows = self.measurement.jacobian(self.series, self.theta(machines, z))
        over_z = rows @ self.basis
        by_reading = over_z.swapaxes(0, 1).reshape(over_z.shape[1], -1)
        white = self.noise.whiten(by_reading)
        return white.reshape(over_z.shape[1], len(machines), -1).swapaxes(0, 1)
