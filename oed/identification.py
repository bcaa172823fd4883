"""Identification: Gauss-Newton / Levenberg-Marquardt on the exact nonlinear readings,
with tolerance priors.

The unknowns are identifiable coordinates. With T = diag(tolerances) and the whitened,
tolerance-scaled H = U S V^T,

    theta = origin + T V_r z,        z ~ N(0, I) a priori,

where V_r spans the directions that some reading sees. The rest of V keeps its prior: to
first order no reading says anything about it. Minimised is |W (y - f(theta))|^2 +
|z|^2, W whitening the noise.
"""

from __future__ import annotations

import dataclasses
import fnmatch
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from oed import identifiability, information, units
from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.noise.covariance import Noise, as_noise

#: rounds of the noise-scale estimate; it settles in a few
NOISE_ROUNDS = 8
#: posterior over prior standard deviation above which a parameter is weakly identified,
#: or stays at its prior
WEAK, AT_PRIOR = 0.3, 0.7


class IdentificationError(RuntimeError):
    """The fit could not be made: too few readings, or the machine cannot be assembled
    on the way.
    """


@dataclasses.dataclass(frozen=True)
class IdentifiableCoordinates:
    """Identifiable coordinates about an origin: theta = origin + basis @ z + unseen @
    w; SI.

    basis (n, r), unseen (n, n_free - r): orthonormal directions times tolerances. z and
    w are N(0, I) a priori. dual (r, n): the same directions over tolerances, so that z
    = dual @ (theta - origin).
    """

    origin: Array
    basis: Array
    null_basis: Array
    dual: Array

    def from_theta(self, theta: Array) -> Array:
        """Coordinates z (r,) of parameters (n,); what lies in unseen directions is
        dropped.
        """
        return np.asarray(self.dual @ (theta - self.origin))

    def to_theta(self, z: Array) -> Array:
        """Parameters (n,) or (m, n) at coordinates (r,) or (m, r)."""
        return self.origin + z @ self.basis.T


@dataclasses.dataclass(frozen=True)
class FitStage:
    """One stage of an identification: what it freed, where it began and ended. rms in
    whitened units.
    """

    patterns: tuple[str, ...]
    iterations: int
    rms_before: float
    rms_after: float


@dataclasses.dataclass(frozen=True)
class Estimate:
    """Identified parameters.

    theta           (n,) maximum a posteriori, SI
    covariance      (n, n) posterior (Laplace), SI; directions no reading sees keep
                    their prior variance
    prior_sd        (n,) tolerances of the last stage, SI
    coordinates     identifiable coordinates of the last stage, about its origin
    z               (r,) the solution in them
    residuals       (N,) y - f(theta), SI;  before: the same at the start
    noise           noise used, SI (scaled where the scale was estimated)
    noise_scale     {set-up: factor on the stated noise}
    noise_estimated whether those factors were estimated
    dof             readings less effectively determined directions
    chi2            sum of squared whitened residuals
    rounds          the stages
    warnings        what a user must know
    """

    theta: Array
    covariance: Array
    prior_sd: Array
    coordinates: IdentifiableCoordinates
    z: Array
    residuals: Array
    residuals_before: Array
    noise: Noise
    noise_scale: dict[str, float]
    noise_estimated: bool
    dof: float
    chi2: float
    stages: tuple[FitStage, ...]
    warnings: tuple[str, ...]

    @property
    def sd(self) -> Array:
        """Posterior standard deviations (n,), SI."""
        return np.sqrt(np.diag(self.covariance))

    @property
    def shrinkage(self) -> Array:
        """Posterior over prior standard deviation (n,): 1 where the readings say
        nothing; 0 for held entries.
        """
        return np.divide(
            self.sd, self.prior_sd, out=np.zeros_like(self.sd), where=self.prior_sd > 0
        )


def identifiable_coordinates(
    measurement: Measurement,
    series: Sequence[Series],
    theta: Array,
    noise: Noise | Array,
    tolerance: Array | None = None,
) -> IdentifiableCoordinates:
    """Identifiable coordinates of the readings, with H taken `at` (n,); held are
    entries with zero tolerance.

    The origin is nominal, where the tolerances hold, wherever H was taken.
    """
    scale = measurement.tolerance if tolerance is None else tolerance
    free = np.flatnonzero(scale > 0)
    jacobian = measurement.jacobian(series, theta)
    h = information.whiten(jacobian, noise)
    # judged with lengths, so that a generous tolerance or a quiet instrument does not
    # change what is seen
    judged = (
        jacobian
        * measurement.reading_length_factors(series)[:, None]
        / measurement.length_factors
    )[:, free]
    verdict = identifiability.analyse(
        judged,
        [measurement.names[k] for k in free],
        1.0 / measurement.length_factors[free],
    )
    moves = np.linalg.qr(
        (verdict.null_space / measurement.length_factors[free] / scale[free]).T
    )[0]
    full = np.linalg.qr(moves, mode="complete")[0] if moves.size else np.eye(len(free))
    lost, kept = full[:, : moves.shape[1]], full[:, moves.shape[1] :]
    # among the kept directions take H's own, strongest first: they decouple the
    # sampler's coordinates
    _, _, vt = np.linalg.svd((h * scale)[:, free] @ kept, full_matrices=True)
    basis, unseen = (
        np.zeros((len(scale), kept.shape[1])),
        np.zeros((len(scale), lost.shape[1])),
    )
    dual = np.zeros((kept.shape[1], len(scale)))
    basis[free] = scale[free, None] * (kept @ vt.T)
    dual[:, free] = (kept @ vt.T).T / scale[free]
    unseen[free] = scale[free, None] * lost
    return IdentifiableCoordinates(
        np.where(scale > 0, measurement.nominal, theta), basis, unseen, dual
    )


def identify(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    *,
    stages: Sequence[Sequence[str]] = (("*",),),
    estimate_noise: bool = False,
    noise: Noise | Array | None = None,
    start: Array | None = None,
    max_iterations: int = 100,
) -> Estimate:
    """Fit all readings y (N,), SI.

    stages          name patterns freed in turn ("dq*", then "*"): rough before fine, so
                    that a large error of few parameters is gone before the others are
                    freed. A stage that is not the last only finds a place to start
                    from: the tolerances hold about nominal all the time.
    estimate_noise  scale the stated noise of each set-up's readings by what their
                    residuals say (never below 1)
    start           (n,) where to begin; nominal by default

    Raises IdentificationError.
    """
    stated = measurement.noise(series) if noise is None else as_noise(noise)
    _check(measurement, series, y)
    theta = measurement.nominal if start is None else start
    before = left = y - measurement.readings(series, theta)
    rounds = []
    for patterns in stages[:-1]:
        theta, left, done = _rough(
            measurement, series, y, stated, theta, left, patterns, max_iterations
        )
        rounds.append(done)
    estimate = _settled(
        measurement,
        series,
        y,
        stated,
        theta,
        left,
        stages[-1],
        estimate_noise,
        max_iterations,
    )
    estimate = dataclasses.replace(
        estimate, residuals_before=before, stages=(*rounds, *estimate.stages)
    )
    return dataclasses.replace(
        estimate, warnings=tuple(_warnings(measurement, estimate))
    )


def _settled(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    stated: Noise,
    theta: Array,
    before: Array,
    patterns: Sequence[str],
    estimate_noise: bool,
    max_iterations: int,
) -> Estimate:
    """The last stage from theta (n,), where residuals are `before` (N,): fitted until
    the noise has settled; without warnings.
    """
    tolerance = _freed(measurement, patterns)
    groups, scale = (
        measurement.setup_of_readings(series),
        dict.fromkeys(measurement.setups, 1.0),
    )
    used = stated
    # at least twice: the coordinates of the result are those of H at the result, not at
    # the start
    for _ in range(NOISE_ROUNDS if estimate_noise else 2):
        local = identifiable_coordinates(measurement, series, theta, used, tolerance)
        z, iterations = _solve(
            measurement, series, y, used, local, local.from_theta(theta), max_iterations
        )
        theta = local.to_theta(z)
        residuals = y - measurement.readings(series, theta)
        covariance, leverage = _covariance(measurement, series, theta, used, tolerance)
        if not estimate_noise:
            continue
        newer = _noise_scale(stated.whiten(residuals), leverage, groups)
        settled = max(abs(newer[k] / scale[k] - 1.0) for k in newer) < 1e-3
        scale |= newer
        used = stated.scaled(np.array([scale[g] for g in groups]))
        if settled:
            break
    white = used.whiten(residuals)
    return Estimate(
        theta=theta,
        covariance=covariance,
        prior_sd=tolerance,
        coordinates=local,
        z=z,
        residuals=residuals,
        residuals_before=before,
        noise=used,
        noise_scale={k: scale[k] for k in dict.fromkeys(groups)},
        noise_estimated=estimate_noise,
        dof=len(y) - float(leverage.sum()),
        chi2=float(white @ white),
        stages=(
            FitStage(
                tuple(patterns), iterations, _rms(used.whiten(before)), _rms(white)
            ),
        ),
        warnings=(),
    )


def _check(measurement: Measurement, series: Sequence[Series], y: Array) -> None:
    expected = len(measurement.setup_of_readings(series))
    if y.shape != (expected,):
        raise IdentificationError(
            f"{expected} readings were planned, {y.shape} are given"
        )
    if not np.isfinite(y).all():
        raise IdentificationError(
            f"readings number {np.flatnonzero(~np.isfinite(y))[:5].tolist()} are not"
            " finite"
        )


def _freed(measurement: Measurement, patterns: Sequence[str]) -> Array:
    """Tolerances (n,) with everything that no pattern frees set to 0."""
    freed = np.array(
        [any(fnmatch.fnmatchcase(n, p) for p in patterns) for n in measurement.names]
    )
    if not (freed & measurement.free).any():
        raise IdentificationError(
            f"the patterns {list(patterns)} free no parameter of"
            f" {list(measurement.names)}"
        )
    return np.where(freed, measurement.tolerance, 0.0)


def _rough(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    noise: Noise,
    theta: Array,
    before: Array,
    patterns: Sequence[str],
    max_iterations: int,
) -> tuple[Array, Array, FitStage]:
    """A stage that only finds a place to start from: theta (n,), residuals (N,) there,
    and what was done.
    """
    local = identifiable_coordinates(
        measurement, series, theta, noise, _freed(measurement, patterns)
    )
    z, iterations = _solve(
        measurement, series, y, noise, local, local.from_theta(theta), max_iterations
    )
    found = local.to_theta(z)
    after = y - measurement.readings(series, found)
    return (
        found,
        after,
        FitStage(
            tuple(patterns),
            iterations,
            _rms(noise.whiten(before)),
            _rms(noise.whiten(after)),
        ),
    )


def _solve(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    noise: Noise,
    local: IdentifiableCoordinates,
    z0: Array,
    max_iterations: int,
) -> tuple[Array, int]:
    """Trust-region Gauss-Newton over z; steps into places that cannot be assembled are
    rejected.
    """
    r = local.basis.shape[1]

    def residual(z: Array) -> Array:
        model = measurement.try_readings(series, local.to_theta(z))
        return np.concatenate([noise.whiten(model - y), z])

    def slope(z: Array) -> Array:
        h = noise.whiten(measurement.jacobian(series, local.to_theta(z)))
        return np.vstack([h @ local.basis, np.eye(r)])

    found = optimize.least_squares(
        residual, z0, slope, method="trf", xtol=1e-12, ftol=1e-14, gtol=1e-10,
        max_nfev=max_iterations,
    )  # fmt: skip
    if found.status <= 0:
        raise IdentificationError(
            f"the fit did not converge in {max_iterations} iterations (cost"
            f" {found.cost:.3g}); check units and signs of the readings, or free fewer"
            " parameters in a rough stage first"
        )
    return found.x, int(found.nfev)


def _covariance(
    measurement: Measurement,
    series: Sequence[Series],
    theta: Array,
    noise: Noise,
    tolerance: Array,
) -> tuple[Array, Array]:
    """Posterior covariance (n, n), SI, and each reading's leverage (N,): how much of it
    the fit uses up.
    """
    h = noise.whiten(measurement.jacobian(series, theta)) * tolerance
    unit = information.posterior_covariance(h)
    leverage = np.einsum("ij,jk,ik->i", h, unit, h)
    return unit * np.outer(tolerance, tolerance), leverage


def _noise_scale(
    white: Array, leverage: Array, groups: Sequence[str]
) -> dict[str, float]:
    """Restricted maximum likelihood of a noise factor for each set-up: r^2 over
    readings less leverage.
    """
    labels = np.array(groups)
    scale = {}
    for label in dict.fromkeys(groups):
        mine = labels == label
        spare = float(mine.sum() - leverage[mine].sum())
        scale[label] = max(
            1.0, float(np.sqrt(white[mine] @ white[mine] / max(spare, 1.0)))
        )
    return scale


def _rms(values: Array) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _still_wide(
    measurement: Measurement, estimate: Estimate, above: float, below: float
) -> list[str]:
    """Parameters whose posterior keeps a share of the tolerance between the two, with
    what is left.
    """
    told = []
    for p, sd, share in zip(
        measurement.parameters, estimate.sd, estimate.shrinkage, strict=True
    ):
        if above < share <= below:
            unit = units.display(p.unit)
            left = f"{units.number(sd, unit):.2g}{'' if unit == '1' else ' ' + unit}"
            told.append(f"{p.name} (sd {left}, {100 * share:.0f} % of its tolerance)")
    return told


def _warnings(measurement: Measurement, estimate: Estimate) -> list[str]:
    told = []
    prior = _still_wide(measurement, estimate, AT_PRIOR, np.inf)
    if prior:
        told.append(
            "these stay near their tolerance, the readings hardly see them: "
            + ", ".join(prior)
        )
    weak = _still_wide(measurement, estimate, WEAK, AT_PRIOR)
    if weak:
        told.append(
            "these are weakly identified, their posterior stays wide: "
            + ", ".join(weak)
        )
    far = [
        n
        for n, d, s in zip(
            measurement.names,
            estimate.theta - estimate.coordinates.origin,
            estimate.prior_sd,
            strict=True,
        )
        if s > 0 and abs(d) > 4.0 * s
    ]
    if far:
        told.append(
            "these ended more than 4 tolerances from where they began; widen [prior] or"
            " doubt the model: " + ", ".join(far)
        )
    if estimate.dof >= 3 and estimate.chi2 > estimate.dof + 5.0 * np.sqrt(
        2.0 * estimate.dof
    ):
        told.append(
            f"the residuals are {np.sqrt(estimate.chi2 / estimate.dof):.1f} times the"
            " stated noise: noise is understated, or an effect is not in the model;"
            " [noise] estimate = true widens the intervals"
        )
    return told
