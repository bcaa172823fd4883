"""Limits by which fits, checks of readings and verdicts judge residuals and parameters."""

from __future__ import annotations

#: probability of a tail below which residuals are too large or too small
ALARM = 1e-5
#: residuals over the stated noise up to which a noise that is to be estimated, and was
#: stated as a guess, explains them
GUESS = 10.0
#: degrees of freedom below which residuals say nothing of the noise
LEAST_DOF = 1.0
#: tolerances from nominal from which on an estimate is far off
FAR = 4.0


def noise_ratio(chi2: float | None, dof: float | None) -> float | None:
    """Residuals over the stated noise; None where too little freedom judges it."""
    if chi2 is None or dof is None or dof < LEAST_DOF:
        return None
    return float((chi2 / dof) ** 0.5)


def chi2_is_large(chi2: float, dof: float) -> bool:
    """Whether the stated noise does not explain chi2."""
    from scipy import special

    return noise_ratio(chi2, dof) is not None and special.chdtrc(dof, chi2) < ALARM
