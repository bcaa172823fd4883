"""What changed on a machine between two sessions, from their two posteriors.

In parameters over their tolerances, session k has the posterior mean m_k and covariance
C_k under the common prior N(0, I). Its readings alone have the information L_k =
C_k^-1 - I and the score b_k = C_k^-1 m_k. With nothing assumed about the machine but
the readings, the change d between the sessions has

    information  P = L_1 (L_1 + L_2)^+ L_2          (the parallel sum)
    score        h = L_1 (L_1 + L_2)^+ b_2 - L_2 (L_1 + L_2)^+ b_1

so that d = P^+ h, and h' P^+ h is chi2 with rank(P) degrees of freedom where nothing
changed. Directions that one session does not determine are in the null space of P. The
tolerances cancel: they do not pull the change towards zero.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import linalg, stats

from oed import identifiability
from oed.arrays import Array

#: information about a change, in tolerances, below which it counts as undetermined: a
#: standard deviation of ten tolerances
LEAST_INFORMATION = 1e-2
#: largest eigenvalue of a posterior covariance over the prior's: what no reading
#: determines has 1, up to rounding
PRIOR_SHARE = 1.0 - 1e-9


@dataclasses.dataclass(frozen=True, slots=True)
class CombinationChange:
    """Change of a combination of parameters that both sessions determine.

    coefficients  by parameter; 1 at the pivot
    change, sd    second session less the first, and its standard deviation
    p_value       of no change, two-sided, for this combination alone
    """

    coefficients: dict[str, float]
    change: float
    sd: float
    p_value: float


@dataclasses.dataclass(frozen=True, slots=True)
class SingleCause:
    """One parameter as the only one that changed.

    change, sd  of the parameter, all others unchanged
    chi2        of what it does not explain
    p_value     of chi2, for one degree of freedom less than the test over all
    """

    parameter: str
    change: float
    sd: float
    chi2: float
    p_value: float


@dataclasses.dataclass(frozen=True, slots=True)
class SessionChange:
    """The change between two sessions; in the units of the parameters.

    chi2, dof, p_value  test of no change at all
    combinations        that both sessions determine, the most changed first
    causes              single parameters, the best explanation first
    undetermined        number of directions that one session or both leave open
    """

    chi2: float
    dof: int
    p_value: float
    combinations: tuple[CombinationChange, ...]
    causes: tuple[SingleCause, ...]
    undetermined: int


@dataclasses.dataclass(frozen=True, slots=True)
class Session:
    """Posterior of one session: mean (n,) and covariance (n, n) of the parameters."""

    mean: Array
    covariance: Array


def compare(
    names: Sequence[str], nominal: Array, tolerance: Array, sessions: Sequence[Session]
) -> SessionChange:
    """Compare two sessions under the prior N(nominal (n,), diag(tolerance (n,))^2).

    Set-ups are mounted anew in each session: the parameters are the machine's alone,
    and the covariances marginal to them. Raises ValueError unless there are two.
    """
    first, second = (likelihood(s, nominal, tolerance) for s in sessions)
    inverse = linalg.pinvh(first[0] + second[0])
    information = first[0] @ inverse @ second[0]
    score = first[0] @ inverse @ second[1] - second[0] @ inverse @ first[1]
    root, white = determined_directions(information, score)
    chi2, dof = float(white @ white), len(white)
    return SessionChange(
        chi2=chi2,
        dof=dof,
        p_value=float(stats.chi2.sf(chi2, dof)),
        combinations=combinations(names, tolerance, root, white),
        causes=_causes(names, tolerance, root, white),
        undetermined=len(names) - dof,
    )


def determined_directions(information: Array, score: Array) -> tuple[Array, Array]:
    """Root (r, n) of the information in its determined directions, and their estimates.

    The estimates (r,) are standard normal where the truth is 0.
    """
    values, vectors = np.linalg.eigh((information + information.T) / 2)
    determined = values > LEAST_INFORMATION
    root = np.sqrt(values[determined])[:, None] * vectors[:, determined].T
    white = vectors[:, determined].T @ score / np.sqrt(values[determined])
    return root, white


def likelihood(
    session: Session, nominal: Array, tolerance: Array
) -> tuple[Array, Array]:
    """Information (n, n) and score (n,) of the readings, in tolerances."""
    scaled = session.covariance / np.outer(tolerance, tolerance)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    informed = values < PRIOR_SHARE
    values, vectors = values[informed], vectors[:, informed]
    mean = vectors.T @ ((session.mean - nominal) / tolerance)
    information = (vectors * (1.0 / values - 1.0)) @ vectors.T
    return information, vectors @ (mean / values)


def combinations(
    names: Sequence[str], tolerance: Array, root: Array, white: Array
) -> tuple[CombinationChange, ...]:
    """Changes of the combinations that the rows of `root` (r, n) determine."""
    if not len(root):
        return ()
    # one unit for all columns: the tolerance
    verdict = identifiability.analyse(root, names, np.ones(len(names)))
    scaled, inverse = verdict.combinations, np.linalg.pinv(root)
    estimates = scaled @ inverse @ white
    deviations = np.linalg.norm(scaled @ inverse, axis=1)
    changes = []
    for row, estimate, sd in zip(scaled, estimates, deviations, strict=True):
        pivot = int(np.argmax(np.isclose(row, 1.0)))
        unit = tolerance[pivot]
        coefficients = {
            name: float(c * unit / t)
            for name, c, t in zip(names, row, tolerance, strict=True)
            if c != 0.0
        }
        p_value = 2.0 * stats.norm.sf(abs(estimate / sd))
        changes.append(
            CombinationChange(
                coefficients, float(estimate * unit), float(sd * unit), float(p_value)
            )
        )
    return tuple(sorted(changes, key=lambda c: -abs(c.change / c.sd)))


def _causes(
    names: Sequence[str], tolerance: Array, root: Array, white: Array
) -> tuple[SingleCause, ...]:
    """Each parameter as the only one that changed, if the sessions determine it."""
    chi2, dof = float(white @ white), len(white)
    causes = []
    for name, column, unit in zip(names, root.T, tolerance, strict=True):
        information = float(column @ column)
        if information <= LEAST_INFORMATION:
            continue
        estimate = float(column @ white) / information
        rest = chi2 - estimate**2 * information
        causes.append(
            SingleCause(
                parameter=name,
                change=float(estimate * unit),
                sd=float(unit / np.sqrt(information)),
                chi2=rest,
                p_value=float(stats.chi2.sf(rest, dof - 1)) if dof > 1 else 1.0,
            )
        )
    return tuple(sorted(causes, key=lambda c: c.chi2))
