"""What changed on a machine over its sessions, from their posteriors.

In parameters over their tolerances, session k has the posterior mean m_k and covariance
C_k under the common prior N(0, I). Its readings alone have the information L_k =
C_k^-1 - I = R_k' R_k, and say R_k p = t_k + N(0, 1). At the time s_k the machine is at
p = a + s_k d. With nothing assumed about the level a and the change d but the readings,
all sessions together are one least-squares problem,

    R_k a + s_k R_k d = t_k + N(0, 1)   for all k.

With the columns of a projected out, the change has a root S of its information and
estimates w, w = S d + N(0, 1), and w'w is chi2 where nothing changed. Two sessions are
the times 0 and 1; then S'S = L_1 (L_1 + L_2)^+ L_2, the parallel sum. The tolerances
cancel: they do not pull the change towards zero.

Each session is linear at its own estimate, so that what no session determines points a
little differently in each. A level that is free along such a direction would make a
change of what both determine well look undetermined. Level and change have therefore no
part in directions that all sessions together leave more open than one tolerance.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base.arrays import Array
from oed.identifiability import analyse

#: information about a change, in tolerances, below which it counts as undetermined: a
#: standard deviation of ten tolerances
LEAST_INFORMATION = 1e-2
#: share of a combination's sd below which a parameter does not belong to it
LEAST_SHARE = 0.01
#: largest eigenvalue of a posterior covariance over the prior's: what no reading
#: determines has 1, up to rounding
PRIOR_SHARE = 1.0 - 1e-9


@dataclasses.dataclass(frozen=True, slots=True)
class CombinationChange:
    """Change of a combination of parameters that both sessions determine.

    coefficients  by parameter, the pivot first with 1, then those that contribute most
                  to sd; what contributes less than LEAST_SHARE is left out
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


@dataclasses.dataclass(frozen=True, slots=True)
class ChangeEstimate:
    """A change over sessions, in tolerances, in its determined directions.

    root            (r, n) of its information
    white           (r,) estimates, standard normal where the truth is 0
    rest, rest_dof  chi2 of what the change leaves, and its degrees of freedom
    """

    root: Array
    white: Array
    rest: float
    rest_dof: int

    @property
    def chi2(self) -> float:
        """Of the test of no change."""
        return float(self.white @ self.white)

    @property
    def dof(self) -> int:
        """Number of determined directions."""
        return len(self.white)


def compare(
    names: Sequence[str], nominal: Array, tolerance: Array, sessions: Sequence[Session]
) -> SessionChange:
    """Compare two sessions under the prior N(nominal (n,), diag(tolerance (n,))^2).

    Set-ups are mounted anew in each session: the parameters are the machine's alone,
    and the covariances marginal to them. Raises ValueError unless there are two.
    """
    first, second = sessions
    change = estimate_change([first, second], nominal, tolerance, np.array([0.0, 1.0]))
    root, white = change.root, change.white
    return SessionChange(
        chi2=change.chi2,
        dof=change.dof,
        p_value=float(special.chdtrc(change.dof, change.chi2)) if change.dof else 1.0,
        combinations=combinations(names, tolerance, root, white),
        causes=_causes(names, tolerance, root, white),
        undetermined=len(names) - change.dof,
    )


def estimate_change(
    sessions: Sequence[Session], nominal: Array, tolerance: Array, elapsed: Array
) -> ChangeEstimate:
    """The change over sessions at times `elapsed` (k,), per unit of time."""
    parts = [likelihood(s, nominal, tolerance) for s in sessions]
    span = _determined_span([root for root, _ in parts])
    rows = [_within(root, t, span) for root, t in parts]
    level = np.vstack([root for root, _ in rows])
    slope = np.vstack([s * root for s, (root, _) in zip(elapsed, rows, strict=True)])
    estimates = np.concatenate([t for _, t in rows])
    basis = np.linalg.qr(level)[0] if level.size else level
    slope, estimates = (_without(basis, _without(basis, v)) for v in (slope, estimates))
    vectors, singular, right = np.linalg.svd(slope, full_matrices=False)
    determined = singular**2 > LEAST_INFORMATION
    white = vectors[:, determined].T @ estimates
    rest = float(estimates @ estimates - white @ white)
    freedom = len(estimates) - level.shape[1] - len(white)
    return ChangeEstimate(
        root=singular[determined, None] * right[determined] @ span.T,
        white=white,
        rest=max(rest, 0.0),
        rest_dof=max(freedom, 0),
    )


def likelihood(
    session: Session, nominal: Array, tolerance: Array
) -> tuple[Array, Array]:
    """Root R (k, n) of the information of the readings, and t (k,), in tolerances.

    R p = t + N(0, 1) of the parameters p about nominal.
    """
    scaled = session.covariance / np.outer(tolerance, tolerance)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    informed = values < PRIOR_SHARE
    values, vectors = values[informed], vectors[:, informed]
    mean = vectors.T @ ((session.mean - nominal) / tolerance)
    root = np.sqrt(1.0 / values - 1.0)[:, None] * vectors.T
    return root, mean / np.sqrt(values * (1.0 - values))


def _determined_span(roots: Sequence[Array]) -> Array:
    """Basis (n, q) of what all sessions together determine to a tolerance or better."""
    _, singular, right = np.linalg.svd(np.vstack(roots), full_matrices=False)
    return right[singular >= 1.0].T


def _within(root: Array, estimate: Array, span: Array) -> tuple[Array, Array]:
    """Root (k, q) and estimates (k,) within a span (n, q), without what says nothing."""
    vectors, singular, right = np.linalg.svd(root @ span, full_matrices=False)
    informed = singular**2 > LEAST_INFORMATION
    reduced = singular[informed, None] * right[informed]
    return reduced, vectors[:, informed].T @ estimate


def _without(basis: Array, values: Array) -> Array:
    """Values (m,) or (m, q) without their part in an orthonormal basis (m, k)."""
    return values - basis @ (basis.T @ values)


def combinations(
    names: Sequence[str], tolerance: Array, root: Array, white: Array
) -> tuple[CombinationChange, ...]:
    """Changes of the combinations that the rows of `root` (r, n) determine."""
    if not len(root):
        return ()
    # one unit for all columns: the tolerance
    verdict = analyse(root, names, np.ones(len(names)))
    scaled, inverse = verdict.combinations, np.linalg.pinv(root)
    estimates = scaled @ inverse @ white
    deviations = np.linalg.norm(scaled @ inverse, axis=1)
    changes = []
    for row, estimate, sd in zip(scaled, estimates, deviations, strict=True):
        pivot = int(np.argmax(np.isclose(row, 1.0)))
        unit = tolerance[pivot]
        share = np.abs(row) * np.linalg.norm(inverse, axis=1) / sd
        ranked = np.argsort(-share, kind="stable")
        others = [k for k in ranked if share[k] >= LEAST_SHARE and k != pivot]
        coefficients = {names[pivot]: 1.0}
        for k in others:
            coefficients[names[k]] = float(row[k] * unit / tolerance[k])
        p_value = 2.0 * special.ndtr(-abs(estimate / sd))
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
                p_value=float(special.chdtrc(dof - 1, rest)) if dof > 1 else 1.0,
            )
        )
    return tuple(sorted(causes, key=lambda c: c.chi2))
