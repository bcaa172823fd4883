"""Fit of readings with a mistake of unknown amounts, together with the parameters."""

from __future__ import annotations

import dataclasses

import numpy as np
from scipy import linalg, optimize

from oed.base.arrays import Array
from oed.checks.fit import UNREACHABLE, Fit, fit
from oed.checks.large_misfit import at_scale_of_misfit
from oed.checks.mistakes.moved import CANNOT_BE
from oed.checks.mistakes.trial import MistakeTrial
from oed.checks.session import SessionReadings

#: evaluations of the model in one fit
MOST_EVALUATIONS = 30
#: steps by which an amount may change with no doubt: its prior is that wide
WIDE = 1e9


@dataclasses.dataclass(frozen=True)
class FitOfAmounts:
    """Amounts (k,) and their standard deviations, SI, with the fit at them."""

    amounts: Array
    sd: Array
    solution: Fit


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
        solution = optimize.least_squares(
            problem.residuals,
            first,
            problem.slopes,
            x_scale="jac",
            xtol=1e-10,
            ftol=1e-8,
            max_nfev=MOST_EVALUATIONS,
        )
        return problem.fitted(solution.x)
    except CANNOT_BE:
        return None


class _AmountProblem:
    """Whitened residuals over parameters in their tolerances and amounts in their steps."""

    def __init__(self, trial: MistakeTrial, scale: float) -> None:
        self.trial, self.scale = trial, scale
        self._sessions: dict[bytes, SessionReadings] = {}
        session = trial.undo(trial.amounts)[0]
        self.measurement = session.measurement
        self.root = session.prior_root()
        self.count = self.root.shape[1]
        factor = np.full(len(session), scale)
        self.noise = session.noise().scaled(factor) if scale != 1.0 else session.noise()
        self.first = np.concatenate([np.zeros(self.count), trial.amounts / trial.steps])
        self.prior = np.concatenate(
            [np.ones(self.count), np.full(len(trial.steps), 1.0 / WIDE)]
        )

    def session(self, x: Array) -> SessionReadings:
        """The session without the mistake of the amounts."""
        amounts = x[self.count :] * self.trial.steps
        key = amounts.tobytes()
        if key not in self._sessions:
            self._sessions[key] = self.trial.undo(amounts)[0]
        return self._sessions[key]

    def theta(self, x: Array) -> Array:
        """Parameters (n,)."""
        return np.asarray(self.measurement.nominal + self.root @ x[: self.count])

    def difference(self, x: Array) -> Array:
        """Whitened residual (N,); what cannot be computed is far off."""
        try:
            session = self.session(x)
        except CANNOT_BE:
            return np.full(len(self.noise.sigma), UNREACHABLE)
        # a trial may change the tool, and with it the measurement
        predicted = session.measurement.try_readings(session.series, self.theta(x))
        return self.noise.whiten(np.nan_to_num(session.y - predicted, nan=UNREACHABLE))

    def residuals(self, x: Array) -> Array:
        """Whitened residual and what the priors say (N + r + k,)."""
        return np.concatenate([self.difference(x), self.prior * x])

    def slopes(self, x: Array) -> Array:
        """Slopes (N + r + k, r + k) of the residuals."""
        session = self.session(x)
        jacobian = session.measurement.jacobian(session.series, self.theta(x))
        by_parameter = -self.noise.whiten(jacobian @ self.root)
        here = self.difference(x)
        moves = np.eye(len(x))[self.count :]
        by_amount = [self.difference(x + move) - here for move in moves]
        both = np.column_stack([by_parameter, *by_amount])
        return np.vstack([both, np.diag(self.prior)])

    def fitted(self, x: Array) -> FitOfAmounts | None:
        """The fit at a solution."""
        rows = self.slopes(x)
        residual, count = self.difference(x), len(self.noise.sigma)
        if np.abs(residual).max() >= UNREACHABLE:
            return None
        norm = np.linalg.norm(rows, axis=0)
        covariance = linalg.pinvh((rows / norm).T @ (rows / norm))
        z, steps = x[: self.count], self.trial.steps
        solution = Fit(
            session=self.session(x),
            theta=self.theta(x),
            penalised=float(residual @ residual + z @ z),
            residual=residual,
            slopes=-rows[:count, : self.count],
            departure=z,
            noise=self.noise,
            scale=self.scale,
        )
        variance = (np.diag(covariance) / norm**2)[self.count :]
        if not (variance > 0.0).all():
            return None
        return FitOfAmounts(
            x[self.count :] * steps, np.sqrt(variance) * steps, solution
        )
