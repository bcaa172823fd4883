"""Fit of readings with a mistake of unknown amounts, together with the parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.checks.fit import Fit, fit
from oed.checks.large_misfit import at_scale_of_misfit
from oed.checks.mistakes.moved import CANNOT_BE
from oed.checks.mistakes.trial import MistakeTrial
from oed.checks.session import SessionReadings
from oed.estimation.fitter import READINGS_ROUNDED, Minima, minimise

#: steps of one fit
MOST_STEPS = 30
#: steps by which an amount may change with no doubt: its prior is that wide
WIDE = 1e9


@dataclasses.dataclass(frozen=True)
class FitOfAmounts:
    """Amounts (k,) and their covariance (k, k), SI, with the fit at them."""

    amounts: Array
    covariance: Array
    solution: Fit

    @property
    def sd(self) -> Array:
        """Standard deviations (k,), SI."""
        return np.sqrt(np.diag(self.covariance))


def fit_amounts(trial: MistakeTrial, scale: float) -> FitOfAmounts | None:
    """Fit the amounts of a trial with the parameters; None where they have no fit.

    scale  guess of what remains, over the stated noise; see `fit_of_any_misfit`
    """
    return at_scale_of_misfit(
        lambda factor, before: _at_scale(trial, factor, before),
        lambda fitted: fitted.solution,
        scale,
    )


def _at_scale(
    trial: MistakeTrial, scale: float, before: FitOfAmounts | None
) -> FitOfAmounts | None:
    """The fit with the noise times a scale, from where another one ended."""
    problem = _AmountProblem(trial, scale)
    first = problem.first
    if before is not None:
        steps = before.amounts / trial.steps
        first = np.concatenate([before.solution.departure, steps])
    elif trial.is_blind:
        other = fit(trial.undo(trial.amounts)[0], scale=scale)
        if other is not None:
            first[: problem.count] = other.departure
    try:
        minima = minimise(problem, first[None], weight=problem.weight, steps=MOST_STEPS)
        return problem.fitted(minima)
    except CANNOT_BE:
        return None


class _AmountProblem:
    """One machine's readings over parameters in their tolerances and amounts in steps."""

    def __init__(self, trial: MistakeTrial, scale: float) -> None:
        self.trial, self.scale = trial, scale
        self._sessions: dict[bytes, SessionReadings] = {}
        session = trial.undo(trial.amounts)[0]
        self.measurement = session.measurement
        self.root = session.prior_root()
        self.count = self.root.shape[1]
        self.noise = session.noise().scaled(scale)
        self.first = np.concatenate([np.zeros(self.count), trial.amounts / trial.steps])
        self.weight = np.concatenate(
            [np.ones(self.count), np.full(len(trial.steps), 1.0 / WIDE)]
        )
        self.rounding = READINGS_ROUNDED * (np.abs(session.y) / self.noise.sigma)[None]

    def session(self, x: Array) -> SessionReadings:
        """The session without the mistake of the amounts."""
        amounts = x[self.count :] * self.trial.steps
        key = amounts.tobytes()
        if key not in self._sessions:
            self._sessions[key] = self.trial.undo(amounts)[0]
        return self._sessions[key]

    def theta(self, x: Array) -> Array:
        """Parameters (n,)."""
        return self.measurement.nominal + self.root @ x[: self.count]

    def difference(self, x: Array) -> Array:
        """Whitened residual (N,); NaN where it cannot be computed."""
        try:
            session = self.session(x)
        except CANNOT_BE:
            return np.full(len(self.noise.sigma), np.nan)
        # a trial may change the tool, and with it the measurement
        predicted = session.measurement.try_readings(session.series, self.theta(x))
        return self.noise.whiten(session.y - predicted)

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (1, N)."""
        return self.difference(z[0])[None]

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened slopes (1, N, r + k) of the predicted readings."""
        x = z[0]
        session = self.session(x)
        jacobian = session.measurement.jacobian(session.series, self.theta(x))
        by_parameter = self.noise.whiten(jacobian @ self.root)
        moves = np.eye(len(x))[self.count :]
        by_amount = [self._change(x, move) for move in moves]
        return np.column_stack([by_parameter, *by_amount])[None]

    def _change(self, x: Array, move: Array) -> Array:
        """Change (N,) of the predicted readings, whitened, by a move of x."""
        ahead = self.difference(x) - self.difference(x + move)
        if np.isfinite(ahead).all():
            return ahead
        # beyond may lie poses out of reach
        return self.difference(x - move) - self.difference(x)

    def fitted(self, minima: Minima) -> FitOfAmounts | None:
        """The fit at a solution."""
        x, residual, slopes = minima.z[0], minima.residual[0], minima.slopes[0]
        if not np.isfinite(residual).all():
            return None
        rows = np.vstack([slopes, np.diag(self.weight)])
        norm = np.linalg.norm(rows, axis=0)
        covariance = linalg.pinvh((rows / norm).T @ (rows / norm))
        z, steps = x[: self.count], self.trial.steps
        solution = Fit(
            session=self.session(x),
            theta=self.theta(x),
            penalised=float(residual @ residual + z @ z),
            residual=residual,
            slopes=slopes[:, : self.count],
            departure=z,
            noise=self.noise,
            scale=self.scale,
        )
        scaled = steps / norm[self.count :]
        of_amounts = covariance[self.count :, self.count :] * np.outer(scaled, scaled)
        if not (np.diag(of_amounts) > 0.0).all():
            return None
        return FitOfAmounts(x[self.count :] * steps, of_amounts, solution)
