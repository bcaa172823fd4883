"""Fit of readings for checks: maximum a posteriori, and the precision of prediction.

With tolerances T and noise covariance S, readings have the covariance C = J T^2 J^T + S
about those of the nominal machine. At the maximum a posteriori the penalised sum of
squares |W (y - f)|^2 + |z|^2 is r^T C^-1 r, and chi-squared of N degrees of freedom.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
import scipy

from oed.base import Array, Index, Mask
from oed.checks.session import SessionReadings
from oed.estimation import Estimate, Minima, minimise
from oed.fit_limits import ALARM_PROBABILITY, GUESS_RATIO, noise_ratio
from oed.measurement import Measurement, Series
from oed.mechanism import AssemblyError
from oed.noise import Noise
from oed.result import GoodnessSection

if TYPE_CHECKING:
    from oed.checks.mistakes.trial import MistakeTrial


MAX_STEPS = 30  #: steps of one fit
#: steps by which an amount may change with no doubt: its prior is that wide
AMOUNT_PRIOR_STEPS = 1e9
SETTLED_RATIO = 2.0  #: residuals over the noise that ask for no further round
#: factor on the noise up to which the stated noise is tried as well
MAX_STATED_SCALE = 100.0
#: errors of poses that cannot be reached
CANNOT_BE = (AssemblyError, ArithmeticError, ValueError, np.linalg.LinAlgError)

NO_AMOUNTS: Array = np.zeros(0)
#: sessions without a mistake of some amounts (k,): one, or several of machines apart
Undo = Callable[[Array], Sequence[SessionReadings]]


@dataclasses.dataclass(frozen=True)
class Fit:
    """Readings fitted within the tolerances."""

    session: SessionReadings  #: the readings
    theta: Array  #: (n,) parameters, SI
    penalised: float  #: sum of squares of whitened residuals and scaled parameters
    residual: Array  #: (N,) whitened residual
    slopes: Array  #: (N, r) whitened slopes over free parameters in their tolerances
    departure: Array  #: (r,) free parameters from nominal, in their tolerances
    noise: Noise  #: of the readings
    scale: float = 1.0  #: factor on their noise that the fit assumes
    #: (k,) of the mistake that is undone, SI
    amounts: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    #: (k,) their standard deviations, SI
    sd: Array = dataclasses.field(default_factory=lambda: NO_AMOUNTS)
    #: (k, k) inverse of their covariance, SI
    precision: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))

    @property
    def is_significant(self) -> bool:
        """Whether the amounts are surely not nothing; true where there are none."""
        size = float(self.amounts @ self.precision @ self.amounts)
        return not self.amounts.size or size >= 3.0**2

    @property
    def chi2(self) -> float:
        """Sum of squared whitened residuals."""
        return float(self.residual @ self.residual)

    @property
    def ratio(self) -> float:
        """Penalised squares over their expectation, in amplitudes of noise unscaled."""
        square = self.scale**2 * self.chi2 + float(self.departure @ self.departure)
        return float(np.sqrt(square / max(len(self.residual), 1)))

    def remaining(self) -> float:
        """Root mean square of the residuals over the noise without its factor."""
        return self.scale * float(np.sqrt(np.mean(self.residual**2)))

    def parameter(self, name: str) -> tuple[Array, Array]:
        """Departure (1,) of a parameter from nominal, and its standard deviation, SI."""
        measurement = self.session.measurement
        k = measurement.names.index(name)
        row = self.session.prior_root()[k] @ self.half_covariance()
        departure = self.theta[k] - measurement.nominal[k]
        return np.array([departure]), np.array([np.linalg.norm(row)])

    def linear_residual(self) -> Array:
        """Whitened residual (N,) about the nominal machine, linear at the solution."""
        return self.residual + self.slopes @ self.departure

    def half_covariance(self) -> Array:
        """L (r, r) with L L^T = (1 + A^T A)^-1, A the slopes."""
        # by singular values: a sum of large squares would lose the 1
        count = min(self.slopes.shape)
        triangle = scipy.linalg.qr(self.slopes, mode="r")[0][:count]
        _, singular, vectors = scipy.linalg.svd(triangle, full_matrices=True)
        size = np.zeros(len(vectors))
        size[: len(singular)] = singular
        return np.asarray(vectors.T / np.hypot(1.0, size))


def fit(
    session: SessionReadings, start: Array | None = None, scale: float = 1.0
) -> Fit | None:
    """Fit a session from `start` (n,), or from nominal; None where it cannot be read.

    scale  factor on the noise
    """
    return _Problem(lambda amounts: [session], NO_AMOUNTS, NO_AMOUNTS, scale).fit(start)


def fit_of_any_misfit(session: SessionReadings, scale: float) -> Fit | None:
    """Fit a session whose misfit is about `scale`; None where it cannot be read."""

    def at_scale(factor: float, before: Fit | None) -> Fit | None:
        return fit(session, None if before is None else before.theta, factor)

    return _fit_scale(at_scale, scale)


def fit_amounts(trial: MistakeTrial, scale: float) -> Fit | None:
    """Fit amounts of a mistake where about `scale` of misfit remains; None without."""
    undo, steps = trial.undo, trial.steps

    def at_scale(factor: float, before: Fit | None) -> Fit | None:
        amounts = trial.amounts if before is None else before.amounts
        if before is None and trial.is_blind:
            before = fit(undo(amounts)[0], scale=factor)
        start = None if before is None else before.theta
        return _Problem(undo, amounts, steps, factor).fit(start)

    return _fit_scale(at_scale, scale)


def _fit_scale(
    at_scale: Callable[[float, Fit | None], Fit | None], scale: float
) -> Fit | None:
    """A fit with noise as large as what remains, about `scale`, or the stated one."""
    fitted = at_scale(max(scale, 1.0), None)
    for _ in range(4):
        if fitted is None:
            return None
        remains = fitted.remaining()
        factor = fitted.scale
        if factor == 1.0 and remains <= SETTLED_RATIO:
            return fitted
        if factor / SETTLED_RATIO <= remains <= factor * SETTLED_RATIO:
            break
        fitted = at_scale(max(remains, 1.0), fitted if remains < factor else None)
    if fitted is None or fitted.scale > MAX_STATED_SCALE:
        return fitted
    stated = at_scale(1.0, fitted)
    return fitted if stated is None or stated.remaining() > SETTLED_RATIO else stated


class _Problem:
    """Readings over parameters in their tolerances and amounts of a mistake in steps."""

    def __init__(self, undo: Undo, amounts: Array, steps: Array, scale: float) -> None:
        self._undo, self._scale = undo, scale
        self._amounts, self._steps = amounts, steps
        self._sessions: dict[bytes, SessionReadings] = {}
        session = undo(amounts)[0]
        self._measurement = session.measurement
        self._root = session.prior_root()
        self._count = self._root.shape[1]
        self._noise = session.noise().scaled(scale)
        weights = (np.ones(self._count), np.full(len(steps), 1.0 / AMOUNT_PRIOR_STEPS))
        self._weight = np.concatenate(weights)
        # a small reading may be the difference of lengths as large as the machine
        factors = session.measurement.reading_length_factors(session.series)
        size = np.maximum(
            np.abs(session.y), session.measurement.machine.lever / factors
        )
        # whitening divides by what the other errors leave of each one
        root = np.sqrt(self._noise.precision_diagonal())
        self.magnitude = (size * root)[None]

    def fit(self, start: Array | None) -> Fit | None:
        """The fit from parameters `start` (n,), or from nominal."""
        free = np.flatnonzero(self._measurement.free)
        departure: Array = np.zeros(self._count)
        if start is not None:
            away = start[free] - self._measurement.nominal[free]
            departure = scipy.linalg.solve(self._root[free], away)
        first = np.concatenate([departure, self._amounts / self._steps])
        try:
            minima = minimise(self, first[None], weight=self._weight, steps=MAX_STEPS)
            return self._fitted(minima)
        except (*CANNOT_BE, RuntimeError):
            return None

    def _session(self, x: Array) -> SessionReadings:
        """The session without the mistake of the amounts."""
        amounts = x[self._count :] * self._steps
        key = amounts.tobytes()
        if key not in self._sessions:
            self._sessions[key] = self._undo(amounts)[0]
        return self._sessions[key]

    def _theta(self, x: Array) -> Array:
        return self._measurement.nominal + self._root @ x[: self._count]

    def _difference(self, x: Array) -> Array:
        """Whitened residual (N,); NaN where it cannot be computed."""
        try:
            session = self._session(x)
        except CANNOT_BE:
            return np.full(len(self._noise.sigma), np.nan)
        # a mistake may change the tool, and with it the measurement
        predicted = session.measurement.try_readings(session.series, self._theta(x))
        return self._noise.whiten(session.y - predicted)

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (1, N)."""
        return self._difference(z[0])[None]

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (1, N, r + k) of the predicted readings."""
        x = z[0]
        session = self._session(x)
        jacobian = session.measurement.jacobian(session.series, self._theta(x))
        by_parameter = self._noise.whiten(jacobian @ self._root)
        moves = np.eye(len(x))[self._count :]
        by_amount = [self._change(x, move) for move in moves]
        return np.column_stack([by_parameter, *by_amount])[None]

    def _change(self, x: Array, move: Array) -> Array:
        """Change (N,) of the predicted readings, whitened, by a move of x."""
        ahead = self._difference(x) - self._difference(x + move)
        if np.isfinite(ahead).all():
            return ahead
        # beyond may lie poses out of reach
        return self._difference(x - move) - self._difference(x)

    def _fitted(self, minima: Minima) -> Fit | None:
        x, residual, slopes = minima.z[0], minima.residual[0], minima.slopes[0]
        # the distance of a pose from itself has no slope
        if not (np.isfinite(residual).all() and np.isfinite(slopes).all()):
            return None
        z, steps = x[: self._count], self._steps
        covariance = self._covariance_of_amounts(slopes)
        if not (np.diag(covariance) > 0.0).all():
            return None
        return Fit(
            session=self._session(x),
            theta=self._theta(x),
            penalised=float(residual @ residual + z @ z),
            residual=residual,
            slopes=slopes[:, : self._count],
            departure=z,
            noise=self._noise,
            scale=self._scale,
            amounts=x[self._count :] * steps,
            sd=np.sqrt(np.diag(covariance)),
            precision=scipy.linalg.pinvh(covariance) if len(steps) else covariance,
        )

    def _covariance_of_amounts(self, slopes: Array) -> Array:
        """Covariance (k, k), SI, by whitened slopes (N, r + k)."""
        if not len(self._steps):
            return np.zeros((0, 0))
        rows = np.vstack([slopes, np.diag(self._weight)])
        norm = np.linalg.norm(rows, axis=0)
        covariance = scipy.linalg.pinvh((rows / norm).T @ (rows / norm))
        scaled = self._steps / norm[self._count :]
        of_amounts = covariance[self._count :, self._count :]
        return np.asarray(of_amounts * np.outer(scaled, scaled))


def residual_weights(slopes: Array) -> Array:
    """Eigenvalues (N,) of 1 - A (1 + A^T A)^-1 A^T, A whitened slopes (N, r): weights of
    the terms of a sum of squared residuals.
    """
    count = len(slopes)
    singular = scipy.linalg.svdvals(slopes)[:count]
    return np.concatenate([1.0 / (1.0 + singular**2), np.ones(count - len(singular))])


# Goodness of fit against the stated noise, with a probability in both tails.
@dataclasses.dataclass(frozen=True)
class Goodness:
    """How residuals compare with the stated noise."""

    chi2: float  #: sum of squared whitened residuals
    dof: float  #: its expectation: values less effectively determined directions
    p_low: float  #: probability of a smaller sum
    p_high: float  #: probability of a larger sum
    #: the same of the sum under the law that is estimated, with a scatter within what a
    #: statement is good for (`oed.checks.judgement`); None where no law is
    law_p_low: float | None = None
    law_p_high: float | None = None

    @property
    def section(self) -> GoodnessSection:
        """These figures as the result holds them."""
        return GoodnessSection(**dataclasses.asdict(self))

    @property
    def ratio(self) -> float | None:
        """Residuals over the stated noise; None where too little freedom judges it."""
        return noise_ratio(self.chi2, self.dof)

    @property
    def too_large(self) -> bool:
        """Whether neither the stated noise nor its law explains the residuals."""
        is_by_law = self.law_p_high is not None and (self.ratio or 0.0) <= GUESS_RATIO
        p_high = self.law_p_high if is_by_law else self.p_high
        return p_high is not None and p_high < ALARM_PROBABILITY

    def is_bad(self, *, noise_is_a_guess: bool) -> bool:
        """Whether neither the stated noise nor an estimated one explains the residuals."""
        explained = noise_is_a_guess and self.chi2 <= GUESS_RATIO**2 * self.dof
        return self.too_large and not explained

    @property
    def too_small(self) -> bool:
        """Whether the stated noise, or its law, would leave larger residuals."""
        p_low = self.p_low if self.law_p_low is None else self.law_p_low
        return p_low < ALARM_PROBABILITY


def goodness(solution: Fit) -> Goodness:
    """Goodness of a fit, by a scaled chi-squared law of the right mean and variance
    (Satterthwaite, Biometrics Bulletin 2 (1946) 110-114).
    """
    return goodness_of(solution.chi2, residual_weights(solution.slopes))


def goodness_of_estimate(
    measurement: Measurement,
    series: Sequence[Series],
    estimate: Estimate,
    doubtful: Mask | None = None,
) -> Goodness:
    """Goodness of an estimate by the stated noise, without `doubtful` (N,) values."""
    noise = measurement.noise(series)
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = measurement.in_prior_units(jacobian, estimate.prior_sd > 0.0)
    # values that are left out have no information and no misfit
    weight = np.ones(len(slopes))
    if doubtful is not None:
        weight[doubtful] = 0.0
    white = noise.whiten(weight * estimate.residuals)
    weights = residual_weights(noise.whiten(weight[:, None] * slopes))
    chi2 = estimate.chi2 if weight.all() else float(white @ white)
    # each value left out would add a weight of 1
    return goodness_of(chi2, np.sort(weights)[: int(weight.sum())])


def goodness_of(chi2: float, weights: Array) -> Goodness:
    """Goodness of a sum of squares chi2 of terms with these weights (N,)."""
    total, squares = float(weights.sum()), float(weights @ weights)
    if total <= 0.0:
        return Goodness(chi2, 0.0, 1.0, 1.0)
    scale, freedom = squares / total, total**2 / squares
    scaled = chi2 / scale
    p_low = float(scipy.special.chdtr(freedom, scaled))
    p_high = float(scipy.special.chdtrc(freedom, scaled))
    return Goodness(chi2, total, p_low, p_high)
