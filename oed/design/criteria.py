"""Criteria of a plan of readings, as pure functions.

Alphabetic criteria take the Fisher information M (n, n). Observability indices take the
singular values of the scaled identification matrix H over its identifiable directions.
A larger value is better, except for kappa. Design methods use the same criteria as
information functions, with slopes and bounds (`oed.design.criterion`).

Sources: Pukelsheim (2006), Optimal Design of Experiments (D, A, E, I); Sun and
Hollerbach (2008), ICRA, and Joubair and Bonev (2013) for O1 to O5; Chang, Li and Li
(2011), Eq. (17), for the noise amplification index.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping
from types import MappingProxyType

import numpy as np

from oed.base.arrays import Array


def d(information: Array) -> float:
    """log det M; -inf where M is singular."""
    sign, value = np.linalg.slogdet(information)
    return float(value) if sign > 0 else -np.inf


def a(information: Array) -> float:
    """-trace M^-1, minus the sum of the variances; -inf where M is singular."""
    return i(information, np.eye(information.shape[0]))


def e(information: Array) -> float:
    """Least eigenvalue of M."""
    return float(np.linalg.eigvalsh(information)[0])


def i(information: Array, moment: Array) -> float:
    """-trace(W M^-1): minus the mean predicted pose variance over a workspace.

    `moment` W (n, n) = mean of J^T J over the workspace poses, J (k, n) from parameters
    to pose components.
    """
    eigenvalues, eigenvectors = np.linalg.eigh(information)
    if eigenvalues[0] <= eigenvalues[-1] * np.finfo(float).eps:
        return -np.inf
    variances = 1.0 / eigenvalues
    trace = np.einsum("ij,ik,kj,j->", eigenvectors, moment, eigenvectors, variances)
    return -float(trace)


def ds(information: Array, interest: Array) -> float:
    """-log det(K^T M^-1 K): D of the directions K (n, s), the others profiled out."""
    covariance = np.linalg.pinv(information, hermitian=True)
    sign, value = np.linalg.slogdet(interest.T @ covariance @ interest)
    return -float(value) if sign > 0 else -np.inf


def c(information: Array, combination: Array) -> float:
    """-c^T M^-1 c: minus the variance of one combination (n,) of the parameters."""
    return i(information, np.outer(combination, combination))


def g(information: Array, moments: Array) -> float:
    """-max_j trace(W_j M^-1): minus the largest predicted pose variance.

    `moments` W (J, n, n) = J_j^T J_j at the workspace poses.
    """
    return min(i(information, w) for w in moments)


def kappa(singular_values: Array) -> float:
    """Condition number sigma_max / sigma_min (the smaller the better)."""
    return float(singular_values.max() / singular_values.min())


def o1(singular_values: Array, readings: int) -> float:
    """(sigma_1 ... sigma_L)^(1/L) / sqrt(m), m the number of readings."""
    return float(np.exp(np.log(singular_values).mean()) / np.sqrt(readings))


def o2(singular_values: Array) -> float:
    """sigma_min / sigma_max = 1 / kappa."""
    return float(singular_values.min() / singular_values.max())


def o3(singular_values: Array) -> float:
    """sigma_min."""
    return float(singular_values.min())


def o4(singular_values: Array) -> float:
    """sigma_min^2 / sigma_max."""
    return float(singular_values.min() ** 2 / singular_values.max())


def o5(singular_values: Array) -> float:
    """1 / sum(1 / sigma_i)."""
    return float(1.0 / np.sum(1.0 / singular_values))


def noise_amplification(singular_values: Array, poses: int) -> float:
    """Noise amplification index, Eq. (17) of Chang, Li and Li (2011).

    The L-th root of the product of the singular values over sqrt(m): O1, with m counting
    measurement poses instead of readings.
    """
    return o1(singular_values, poses)


@dataclasses.dataclass(frozen=True, slots=True)
class CriterionInfo:
    """A criterion as the catalogue lists it."""

    name: str
    about: str
    source: str
    function: Callable[..., float]


_PUKELSHEIM = "Pukelsheim (2006), Optimal Design of Experiments"
_SUN = "Sun and Hollerbach (2008), Observability index selection, ICRA"

CATALOGUE: Mapping[str, CriterionInfo] = MappingProxyType(
    {
        entry.name: entry
        for entry in (
            CriterionInfo(
                "D", "log det M: volume of the confidence ellipsoid", _PUKELSHEIM, d
            ),
            CriterionInfo(
                "A", "-trace M^-1: sum of the parameter variances", _PUKELSHEIM, a
            ),
            CriterionInfo(
                "Ds",
                "as D, of the parameters of interest; others are profiled out",
                _PUKELSHEIM,
                ds,
            ),
            CriterionInfo(
                "c", "-c' M^-1 c: variance of one combination", _PUKELSHEIM, c
            ),
            CriterionInfo(
                "G",
                "-max trace W_j M^-1: largest predicted pose variance",
                _PUKELSHEIM,
                g,
            ),
            CriterionInfo(
                "E", "least eigenvalue of M: the worst-known direction", _PUKELSHEIM, e
            ),
            CriterionInfo(
                "I",
                "-trace W M^-1: mean predicted pose variance over the workspace",
                _PUKELSHEIM,
                i,
            ),
            CriterionInfo("kappa", "condition number of H", _SUN, kappa),
            CriterionInfo(
                "O1", "geometric mean of the singular values over sqrt(m)", _SUN, o1
            ),
            CriterionInfo("O2", "reciprocal condition number", _SUN, o2),
            CriterionInfo("O3", "least singular value", _SUN, o3),
            CriterionInfo(
                "O4", "least singular value squared over the largest", _SUN, o4
            ),
            CriterionInfo(
                "O5",
                "harmonic sum of the singular values",
                "Joubair and Bonev (2013), Mech. Mach. Theory 70",
                o5,
            ),
            CriterionInfo(
                "noise_amplification",
                "O1 with m counting poses",
                "Chang, Li and Li (2011), Chin. J. Mech. Eng., Eq. (17)",
                noise_amplification,
            ),
        )
    }
)


def observability(singular_values: Array, readings: int) -> dict[str, float]:
    """O1 to O5 of the identifiable directions."""
    s = singular_values
    return {"O1": o1(s, readings), "O2": o2(s), "O3": o3(s), "O4": o4(s), "O5": o5(s)}
