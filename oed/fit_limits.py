"""From where on residuals and estimates speak against a fit: limits that all share.

ALARM_PROBABILITY  tail of chi2 that means a bad fit
FAR_TOLERANCES     distance from nominal that means another machine
GUESS_RATIO        residuals that a noise stated as a guess may explain
MIN_DOF            freedom that a judgement needs
chi2_is_large      whether the stated noise does not explain chi2
noise_ratio        residuals over the stated noise
"""

#: probability of a tail below which residuals are too large or too small
ALARM_PROBABILITY = 1e-5
#: residuals over the stated noise up to which a noise that is to be estimated, and was
#: stated as a guess, explains them
GUESS_RATIO = 10.0
MIN_DOF = 1.0  #: degrees of freedom below which residuals say nothing of the noise
FAR_TOLERANCES = 4.0  #: tolerances from nominal from which on an estimate is far off


def noise_ratio(chi2: float | None, dof: float | None) -> float | None:
    """Residuals over the stated noise; None where too little freedom judges it."""
    if chi2 is None or dof is None or dof < MIN_DOF:
        return None
    return float((chi2 / dof) ** 0.5)


def chi2_is_large(chi2: float, dof: float) -> bool:
    """Whether the stated noise does not explain chi2."""
    from scipy import special

    return (
        noise_ratio(chi2, dof) is not None
        and special.chdtrc(dof, chi2) < ALARM_PROBABILITY
    )
