"""Each run predicted from all other runs: the leave-one-run-out score.

With tolerances T and noise S, readings have the covariance K = S + J T^2 J^T about those
of the nominal machine. Of a run b the others leave the error Q_bb^-1 (Q r)_b with the
covariance Q_bb^-1, Q = K^-1 (Dubrule 1983, Mathematical Geology 15, 687-699), so that

    chi2_b = (Q r)_b^T Q_bb^-1 (Q r)_b,
    log p(y_b | others) = -1/2 [ n_b log 2 pi - log |Q_bb| + chi2_b ].

Noise is that of the estimate. What of it all readings share, a course or effects, stands
beside the slopes J T; the rest is independent between runs. The model is linear at the
estimate.
"""

import dataclasses
from collections.abc import Sequence

import msgspec
import numpy as np
from scipy import linalg, special

from oed import text
from oed.base import Array, Index
from oed.estimation.estimate import Estimate
from oed.measurement import Measurement, Series
from oed.result import GoodnessSection, LeftOutRun

#: probability below which a run is surprising, over the number of runs
P_SURPRISE = 1e-3
MAX_NAMED = 3  #: runs that a sentence names


@dataclasses.dataclass(frozen=True)
class RunPrediction:
    """All runs, each predicted from the others."""

    runs: tuple[LeftOutRun, ...]

    @property
    def log_score(self) -> float:
        """Sum of the log predictive densities: higher is better."""
        return float(sum(one.log_score for one in self.runs))

    @property
    def log_score_sd(self) -> float:
        """Standard deviation of that sum, from its scatter between runs."""
        scores = [one.log_score for one in self.runs]
        return float(np.sqrt(len(scores)) * np.std(scores, ddof=1))

    @property
    def surprising(self) -> tuple[LeftOutRun, ...]:
        """Runs that the others contradict, the worst first."""
        limit = P_SURPRISE / len(self.runs)
        far = [one for one in self.runs if one.p_high < limit]
        return tuple(sorted(far, key=lambda one: one.p_high))

    @property
    def warnings(self) -> list[str]:
        """Runs that all others contradict, as one sentence; none where there are none."""
        far = self.surprising
        if not far:
            return []
        phrases = [
            f"run {one.run} of {one.setup} by {text.rounded(one.ratio)} times what is"
            f" predicted (p {text.format_p_value(one.p_high)})"
            for one in far[:MAX_NAMED]
        ]
        others = len(far) - MAX_NAMED
        more = f", and {others} more runs" if others > 0 else ""
        return [f"all other runs contradict {', '.join(phrases)}{more}"]

    def add_to(self, section: GoodnessSection) -> GoodnessSection:
        """The section with the runs."""
        return msgspec.structs.replace(
            section,
            left_out=list(self.runs),
            left_out_score=self.log_score,
            left_out_sd=self.log_score_sd,
        )


def predict_runs(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> RunPrediction | None:
    """Each run predicted from the others; None where there is one run alone."""
    labels, members = _runs(measurement, series)
    if len(members) < 2:
        return None
    jacobian = measurement.jacobian(series, estimate.theta)
    origin = np.where(estimate.prior_sd > 0.0, measurement.nominal, estimate.theta)
    residual = estimate.residuals
    if estimate.robust_readings is not None:  # with those far off replaced
        predicted = measurement.readings(series, estimate.theta)
        residual = estimate.robust_readings - predicted
    about_nominal = residual + jacobian @ (estimate.theta - origin)
    noise, common = estimate.noise.split_common()
    white = noise.whiten(about_nominal)
    freed = estimate.prior_sd > 0.0
    in_prior_units = estimate.widening * measurement.in_prior_units(jacobian, freed)
    slopes = noise.whiten(np.hstack([in_prior_units, common]))
    gram = np.eye(slopes.shape[1]) + slopes.T @ slopes
    root = linalg.cholesky(gram, lower=True)
    shared = linalg.solve_triangular(root, slopes.T, lower=True).T
    error = white - shared @ (shared.T @ white)
    runs = [
        _predicted(label, error[rows], shared[rows])
        for label, rows in zip(labels, members, strict=True)
    ]
    return RunPrediction(tuple(runs))


def _predicted(label: tuple[str, str], error: Array, shared: Array) -> LeftOutRun:
    """A run of whitened errors (Q r)_b (n,), with Q_bb = 1 - B B^T, B (n, r)."""
    count = len(error)
    # By the smaller of the two matrices: Q_bb^-1 = 1 + B (1 - B^T B)^-1 B^T.
    inner = np.eye(shared.shape[1]) - shared.T @ shared
    root = linalg.cholesky(inner, lower=True)
    half = linalg.solve_triangular(root, shared.T @ error, lower=True)
    chi2 = float(error @ error + half @ half)
    log_det = 2.0 * float(np.log(np.diag(root)).sum())
    score = -0.5 * (count * np.log(2.0 * np.pi) - log_det + chi2)
    p_high = float(special.chdtrc(count, chi2))
    ratio = float(np.sqrt(chi2 / count))
    return LeftOutRun(*label, count, ratio, p_high, float(score))


def _runs(
    measurement: Measurement, series: Sequence[Series]
) -> tuple[list[tuple[str, str]], list[Index]]:
    """Set-up and label of each run, and its values by number."""
    labels: dict[tuple[str, str], list[Index]] = {}
    start = 0
    for s in series:
        channels = len(measurement.setups[s.setup].instrument.channels)
        numbers = start + np.arange(len(s) * channels).reshape(len(s), channels)
        for run in dict.fromkeys(s.run):
            rows = numbers[np.flatnonzero(s.run == run)].ravel()
            labels.setdefault((s.setup, str(run)), []).append(rows)
        start += len(s) * channels
    return list(labels), [np.concatenate(rows) for rows in labels.values()]
