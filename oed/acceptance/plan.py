"""Chooses the poses of an acceptance test, states limits and power, judges the errors.

The promise is an rms error S over the workspace for each pose component. Of the shapes of
errors half are what calibration leaves, or the tolerances allow where something else is
wrong; the others are what no parameter makes: linear and quadratic functions of the
command, one of them or a sum. The test compares T^2 = 1/n sum_i (a S f(x_i) + u e_i)^2
with two limits. Machines at the promise (a = 1) exceed the upper one with a stated
probability: beyond it a machine fails. Its power is the probability that a machine which
misses the promise (a = 1.2) exceeds it. Machines that miss stay below the lower one with a
probability of 5 %: up to it a machine meets the promise, if the power is at least 0.8.
Between the two the test cannot tell. The next pose is the one that best separates the two.

Accuracy and repeatability of positioning follow ISO 230-2. At each target i, n_i
approaches in a direction have mean x_i and standard deviation s_i. With both directions
B_i is the difference of the means, and

    M   range of the mean bidirectional deviations
    E   range of the unidirectional means over all targets
    B   largest |B_i|
    R   largest max(2 s_i+ + 2 s_i- + |B_i|, 4 s_i+, 4 s_i-)
    A   largest x_i + 2 s_i less the smallest x_i - 2 s_i, over targets and directions.

The standard asks for five approaches a direction along one axis; the caller states how
many there were.
"""

import dataclasses
from collections.abc import Mapping, Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.linear_algebra import covariance_root
from oed.result import Judgement, PositioningRecord, PromiseRecord, VerdictRecord


def measured_rms_within(
    rms: float, uncertainty: float, poses: int, largest: float
) -> float:
    """Probability that the true rms error over measured poses is at most `largest`.

    JCGM 106:2012: of errors that were measured at n poses with standard uncertainty u and
    no other knowledge, n (true rms)^2 / u^2 has a noncentral chi-squared distribution of n
    degrees of freedom and noncentrality n (measured rms)^2 / u^2.
    """
    if uncertainty == 0.0:
        return float(rms <= largest)
    scale = poses / uncertainty**2
    return float(special.chndtr(scale * largest**2, poses, scale * rms**2))


SMOOTH_SHARE = 0.5  #: share of the shapes that no parameter makes
N_CHOOSING = 600  #: machines drawn to choose poses
N_STATING = 8000  #: machines drawn to state limits and power
MIN_POWER = 0.8  #: power below which a test confirms nothing, whatever it reads
#: probability that a machine which misses its promise is said to meet it
FALSE_CONFIRMATION = 0.05


@dataclasses.dataclass(frozen=True)
class Promise:
    """What was promised of k pose components, and m poses that may be measured; SI."""

    names: tuple[str, ...]  #: (k,) of the components
    maps: Array  #: (m, k, p) pose errors per parameter
    #: of the parameters (p, p): shapes of error fields, equally likely
    covariances: Sequence[Array]
    rms: Array  #: (k,) promised rms errors
    uncertainty: Array  #: (k,) standard uncertainty of one measured error
    #: whether errors are differences to one reading at home, which they share
    zeroed: bool = False
    #: (m, b) smooth functions of the command, shapes that no parameter makes
    smooth: Array = dataclasses.field(default_factory=lambda: np.zeros((0, 0)))
    #: number of the leading poses over which the rms is promised; all by default
    workspace: int | None = None

    def fields(self, count: int, rng: np.random.Generator) -> Array:
        """Error fields (count, m, k) of unit rms over the workspace."""
        shape = rng.integers(len(self.covariances), size=count)
        changes = np.empty((count, self.maps.shape[2]))
        for k, covariance in enumerate(self.covariances):
            members = np.flatnonzero(shape == k)
            normal = rng.standard_normal((len(members), len(covariance)))
            changes[members] = normal @ covariance_root(covariance).T
        fields = np.einsum("mkp,dp->dmk", self.maps, changes, optimize=True)
        if self.smooth.size:
            chosen = np.flatnonzero(rng.random(count) < SMOOTH_SHARE)
            fields[chosen] = self._smooth_fields(len(chosen), rng)
        promised = fields[:, : self.workspace]
        rms = np.sqrt(np.mean(promised**2, axis=1, keepdims=True))
        return np.asarray(fields / np.where(rms > 0.0, rms, 1.0))

    def _smooth_fields(self, count: int, rng: np.random.Generator) -> Array:
        """Fields (count, m, k), each one smooth function or a sum of all."""
        functions = self.smooth.shape[1]
        number = rng.integers(functions + 1, size=count)
        weights = rng.standard_normal((count, functions, len(self.names)))
        single = np.arange(functions) == number[:, None]
        is_sum = (number == functions)[:, None]
        weights = weights * (single | is_sum)[:, :, None]
        fields = np.einsum("mb,dbk->dmk", self.smooth, weights, optimize=True)
        return np.asarray(fields)

    def plan(
        self,
        candidates: Index,
        rng: np.random.Generator,
        *,
        miss: float = 1.2,
        false_alarm: float = 0.05,
        power: float = 0.9,
        most: int = 12,
    ) -> "AcceptancePlan":
        """The fewest poses of the candidates that reach the power, or the best `most`.

        candidates  numbers of the workspace poses that may be measured

        Raises ValueError for no candidates.
        """
        if not len(candidates):
            raise ValueError("there are no poses to choose from")
        fields = self.fields(N_CHOOSING, rng)
        sizes = (self.rms * fields[:, candidates]) ** 2
        noise = self.uncertainty**2
        total = np.zeros((N_CHOOSING, len(self.names)))
        free = list(range(len(candidates)))
        chosen: list[int] = []
        while True:
            scores = [
                _separation(total + sizes[:, j], noise, len(chosen) + 1, miss)
                for j in free
            ]
            best = free.pop(int(np.argmax(scores)))
            chosen.append(best)
            total = total + sizes[:, best]
            poses = candidates[chosen]
            plan = self.limits_at(poses, rng, miss=miss, false_alarm=false_alarm)
            if plan.power.min() >= power or not free or len(chosen) >= most:
                return plan

    def limits_at(
        self,
        poses: Index,
        rng: np.random.Generator,
        *,
        miss: float = 1.2,
        false_alarm: float = 0.05,
    ) -> "AcceptancePlan":
        """Limits and power of poses, on machines that had no part in choosing them."""
        good = _statistics(self, poses, 1.0, rng)
        bad = _statistics(self, poses, miss, rng)
        each = 1.0 - (1.0 - false_alarm) ** (1.0 / len(self.names))
        limits = np.quantile(good, 1.0 - each, axis=0)
        power = np.mean(bad > limits, axis=0)
        confirms = np.minimum(np.quantile(bad, FALSE_CONFIRMATION, axis=0), limits)
        return AcceptancePlan(
            poses=np.asarray(poses),
            limits=limits,
            confirms=np.where(power >= MIN_POWER, confirms, np.nan),
            power=power,
            miss=miss,
            false_alarm=float(np.mean((good > limits).any(axis=1))),
        )


def smooth_functions(command: Array, home: Array | None) -> Array:
    """Linear and quadratic functions (m, b) of commands (m, n_dof), over their ranges.

    home  (n_dof,) where they are 0; None: where they have no mean
    """
    low, high = command.min(axis=0), command.max(axis=0)
    varied = high > low
    middle, half = 0.5 * (low + high)[varied], 0.5 * (high - low)[varied]

    def functions(commands: Array) -> Array:
        x = (commands[:, varied] - middle) / half
        first, second = np.triu_indices(x.shape[1])
        return np.hstack([x, x[:, first] * x[:, second]])

    values = functions(command)
    zero = values.mean(axis=0) if home is None else functions(home[None])[0]
    return np.asarray(values - zero)


@dataclasses.dataclass(frozen=True)
class AcceptancePlan:
    """Poses to measure, and when a machine passes."""

    poses: Index  #: (n,) numbers of workspace poses
    limits: Array  #: (k,) rms of the measured errors beyond which it fails, SI
    #: (k,) rms up to which it meets the promise, SI; NaN where the power is low
    confirms: Array
    power: Array  #: (k,) probability that a machine which misses the promise is caught
    miss: float  #: factor on the promised rms of such a machine
    #: probability that a machine at the promise fails, all components counted
    false_alarm: float


def _separation(squares: Array, noise: Array, count: int, miss: float) -> float:
    """How far missing machines lie from good ones, in standard deviations.

    squares  (machines, k) sums over `count` poses of squared errors at the promise

    The smallest over the components.
    """
    mean = squares.mean(axis=0)
    of_noise = 2.0 * noise * (count * noise + 2.0 * mean)
    spread = np.sqrt(squares.var(axis=0) + of_noise)
    gain = (miss**2 - 1.0) * mean
    return float((gain / np.maximum(spread, 1e-300)).min())


def _statistics(
    promise: Promise, poses: Index, factor: float, rng: np.random.Generator
) -> Array:
    """T (machines, k), SI, of machines at a factor on the promise."""
    fields = promise.fields(N_STATING, rng)[:, poses]
    noise = rng.standard_normal(fields.shape)
    if promise.zeroed:  # half of the variance is that of the reading at home
        home = rng.standard_normal((len(fields), 1, fields.shape[2]))
        noise = (noise + home) / np.sqrt(2.0)
    noise = noise * promise.uncertainty
    errors = factor * promise.rms * fields + noise
    return np.asarray(np.sqrt(np.mean(errors**2, axis=1)))


def judge(
    errors: Mapping[str, Array], demands: Mapping[str, PromiseRecord]
) -> dict[str, VerdictRecord]:
    """Verdicts by component, from errors (n,) at the poses, in their demand's unit."""
    return {name: _verdict(errors[name], demand) for name, demand in demands.items()}


def _verdict(errors: Array, demand: PromiseRecord) -> VerdictRecord:
    rms = float(np.sqrt(np.mean(errors**2)))
    verdict: Judgement = "fail" if rms > demand.limit else "cannot tell"
    if demand.confirms is not None and rms <= demand.confirms:
        verdict = "pass"
    return VerdictRecord(
        rms=rms,
        max=float(np.abs(errors).max()),
        limit=demand.limit,
        promised=demand.promised,
        unit=demand.unit,
        passed=verdict == "pass",
        verdict=verdict,
        probability=measured_rms_within(
            rms, demand.uncertainty, len(errors), demand.promised
        ),
    )


def positioning(
    errors: Array, target: Index, direction: Array, unit: str
) -> PositioningRecord | None:
    """Figures of errors (n,) in `unit` at numbered targets, by directions (n,): +1, -1
    or, unknown, NaN; None where a target has fewer than two approaches in one.
    """
    direction = np.where(np.isfinite(direction), direction, 1.0)
    senses = np.unique(direction)
    shape = (len(np.unique(target)), len(senses))
    means, sds = np.empty(shape), np.empty(shape)
    fewest = len(errors)
    for i, number in enumerate(np.unique(target)):
        for k, sense in enumerate(senses):
            values = errors[(target == number) & (direction == sense)]
            if len(values) < 2:
                return None
            fewest = min(fewest, len(values))
            means[i, k], sds[i, k] = values.mean(), values.std(ddof=1)
    accuracy = (means + 2.0 * sds).max() - (means - 2.0 * sds).min()
    reversal = None
    middle = None
    spread = 4.0 * sds.max(axis=1)
    if len(senses) == 2:
        step = np.abs(means[:, 0] - means[:, 1])
        reversal = float(step.max())
        middle = float(np.ptp(means.mean(axis=1)))
        spread = np.maximum(spread, 2.0 * sds.sum(axis=1) + step)
    return PositioningRecord(
        targets=len(means),
        approaches=fewest,
        accuracy=float(accuracy),
        systematic=float(np.ptp(means)),
        repeatability=float(spread.max()),
        mean=middle,
        reversal=reversal,
        unit=unit,
    )
