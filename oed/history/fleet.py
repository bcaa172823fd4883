"""Prior of a machine from the estimates of others of its model: mean and spread together.

In units of the tolerances, about nominal, machine j has the parameters

    x_j = m + d_j,   m_k ~ N(0, 1 - s_k^2),   d_jk ~ N(0, s_k^2),   s_k uniform in (0, 1):

an offset m that all machines share, and one of its own. Without machines their sum has
the tolerance as its standard deviation; few machines leave s_k open, many determine it.
What machine j's readings say is exp(b_j'x - x'A_j x / 2), its posterior without its prior.
With S = diag(s^2), d_j and m integrate to normal ones:

    P_j = A_j (I + S A_j)^-1,      v_j = (I + A_j S)^-1 b_j,
    Q = (I - S)^-1 + sum_j P_j,    a = Q^-1 sum_j v_j,
    log p(readings | s) = (a'Q a - log det (I - S) Q) / 2
                          + sum_j (b_j'S v_j - log det (I + S A_j)) / 2,

and a further machine has the mean a and the covariance V = Q^-1 + S. The spreads are
integrated one at a time over a grid, the others at their expected variance. What each
changes in a and V on average adds up, and so does the covariance of a with each: exact
for one parameter. Uniform spreads: A. Gelman, Bayesian Analysis 1 (2006) 515-534.
"""

import dataclasses
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from oed.base import Array
from oed.history.sessions import Session, likelihood

#: middles of the steps of a spread over the tolerance
SPREAD_RATIOS = (np.arange(16) + 0.5) / 16.0
#: passes over all spreads; their expected variances then change by less than a step
N_SWEEPS = 3
#: least variance of a combination of parameters, squared tolerances
MIN_VARIANCE = 1e-6


@dataclasses.dataclass(frozen=True)
class MachineInformation:
    """What the readings of a machine say of its parameters, in tolerances from nominal."""

    matrix: Array  #: (p, p) A, positive semidefinite
    vector: Array  #: (p,) b

    @classmethod
    def from_posterior(
        cls, value: Array, covariance: Array, nominal: Array, tolerance: Array
    ) -> "MachineInformation":
        """A posterior (p,), (p, p) without its prior (p,), of one unit each."""
        root, white = likelihood(Session(value, covariance), nominal, tolerance)
        return cls(root.T @ root, root.T @ white)

    def rescaled(self, factor: Array, shift: Array) -> "MachineInformation":
        """In other tolerances and about another nominal value.

        factor  (p,) the other tolerances over those of the machine
        shift   (p,) the machine's nominal values less the others, in the other tolerances
        """
        matrix = self.matrix * np.outer(factor, factor)
        return MachineInformation(matrix, self.vector * factor + matrix @ shift)


@dataclasses.dataclass(frozen=True)
class FleetPrior:
    """Parameters of a further machine, in tolerances from nominal."""

    mean: Array  #: (p,)
    covariance: Array  #: (p, p)


def fleet_prior(machines: Sequence[MachineInformation]) -> FleetPrior:
    """The prior of a further machine. Raises ValueError without machines."""
    if not machines:
        raise ValueError("a fleet has at least one machine")
    A = np.stack([m.matrix for m in machines])
    b = np.stack([m.vector for m in machines])
    variance = np.full(b.shape[1], np.mean(SPREAD_RATIOS**2))
    for _ in range(N_SWEEPS):
        for k in range(len(variance)):
            variance[k] = _grid(A, b, variance, k).weights @ SPREAD_RATIOS**2
    _, middle, about = _further_machine(A, b, variance)
    mean, covariance = middle.copy(), about.copy()
    for k in range(len(variance)):
        grid = _grid(A, b, variance, k)
        average = grid.weights @ grid.means
        change = grid.means - average
        mean += average - middle
        covariance += np.tensordot(grid.weights, grid.covariances, axes=1) - about
        covariance += (change * grid.weights[:, None]).T @ change
    return FleetPrior(mean, _raised(covariance, MIN_VARIANCE))


class _Grid(NamedTuple):
    """A further machine by the values of one spread: weights (g,), means, covariances."""

    weights: Array
    means: Array
    covariances: Array


def _grid(A: Array, b: Array, variance: Array, k: int) -> _Grid:
    """Spread k over the grid, the others at their variance."""
    changed = variance.copy()
    machines = []
    for spread in SPREAD_RATIOS:
        changed[k] = spread**2
        machines.append(_further_machine(A, b, changed))
    evidence = np.array([m[0] for m in machines])
    weights = np.exp(evidence - evidence.max())
    means = np.array([m[1] for m in machines])
    return _Grid(weights / weights.sum(), means, np.array([m[2] for m in machines]))


def _raised(matrix: Array, least: float) -> Array:
    """The symmetric matrix with eigenvalues raised to a least one."""
    values, vectors = np.linalg.eigh(matrix)
    return np.asarray((vectors * np.maximum(values, least)) @ vectors.T)


def _further_machine(A: Array, b: Array, variance: Array) -> tuple[float, Array, Array]:
    """Log evidence of the spreads, mean (p,) and covariance (p, p) of a further machine."""
    inner = np.eye(len(variance)) + A * variance  # I + A S
    solved = np.linalg.solve(inner, np.concatenate([A, b[:, :, None]], axis=2))
    precision, vector = solved[:, :, :-1], solved[:, :, -1]
    shared = np.eye(len(variance)) + (1.0 - variance)[:, None] * precision.sum(axis=0)
    total = vector.sum(axis=0)
    root = np.linalg.inv(shared) * (1.0 - variance)  # Q^-1
    root = 0.5 * (root + root.T)
    mean = root @ total
    evidence = mean @ total - np.linalg.slogdet(shared)[1]
    evidence += np.einsum("jk,k,jk->", b, variance, vector)
    evidence -= np.linalg.slogdet(inner)[1].sum()
    return 0.5 * float(evidence), mean, root + np.diag(variance)
