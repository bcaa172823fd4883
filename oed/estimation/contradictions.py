"""What readings contradict: values that a fit holds exactly, and all tolerances.

Score tests of fixed parameters and of unknowns that instruments hold: of whitened residuals
r, and slopes c over a held parameter, only the part counts that no free parameter
explains, whatever its prior. Freed alone, the parameter changes by c.r /
c.c, and where its held value is exact,

    t^2 = (c.r)^2 / (c.c s^2),    s^2 = (r.r - (c.r)^2 / c.c) / (N - rank - 1),

is that of Student, however large the noise is (Cook and Weisberg 1982, Residuals and
Influence in Regression, added variables). What only chooses a frame has no c and no test.
Held parameters that differ by their number alone are tested moved together as well. What
is found is freed, and the others are tested beside it; p-values are times the number of
the tests (Bonferroni).

Evidence of a common factor on all tolerances: to first order the whitened readings are
r = H z + e, with z ~ N(0, s^2 I) in tolerances and e ~ N(0, w^2 I) in the stated noise.
With H = U D V^T and a = U^T r, of r dimensions,

    -2 log p(r | s, w) = sum_k [ log(w^2 + s^2 d_k^2) + a_k^2 / (w^2 + s^2 d_k^2) ]
                         + (N - r) log w^2 + (|r|^2 - |a|^2) / w^2.

Tolerances may be too small by a decade, all alike: they then hold the parameters at
nominal, which looks like noise, or like an effect. s = 1 is given up where it is improbable
and another s leaves no more than noise can. Where a few combinations alone are far, nominal
numbers are wrong and no tolerances. Too large ones cost little, and are left.
"""

import dataclasses
import re
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed import units
from oed.base import Array
from oed.estimation.estimate import Estimate
from oed.estimation.law_stage import MAX_CORRELATED
from oed.fit_limits import FAR_TOLERANCES
from oed.measurement import Measurement, Series
from oed.model import Parameter
from oed.result import HeldParameter

#: probability that a study whose held values are exact has one reported
FALSE_ALARM = 0.01
#: degrees of freedom, beside all parameters, that the scatter of residuals needs
MIN_FREEDOM = 3
#: share of slopes, or of singular values, below which they are rounding
RANK_TOLERANCE = 1e-6
MAX_NAMED = 3  #: parameters whose changes are named
#: factors on the tolerances: four a decade, up to thirty times
TOLERANCE_FACTORS = 10.0 ** (np.arange(7) / 4.0)
P_AS_STATED = 0.95  #: prior probability that the tolerances are as stated
P_GIVEN_UP = 0.05  #: probability of tolerances as stated below which they are given up
#: share of the combinations that are far where few nominal numbers are wrong
FAR_SHARE = 0.2
#: noise over the stated one: 20 a decade
NOISE_LEVELS = 10.0 ** (np.arange(-20, 81) / 20.0)
#: scale of the log of the noise over the stated one, of a Cauchy density
LOG_NOISE_SCALE = 0.4

Names = tuple[str, ...]  #: names of parameters that move together


def contradicted_parameters(
    measurement: Measurement, series: Sequence[Series], y: Array, estimate: Estimate
) -> list[HeldParameter]:
    """Held parameters that readings y (N,), SI, contradict, the surest first."""
    whole = _free_unknowns(measurement)
    fitted_theta = dict(zip(measurement.names, estimate.theta, strict=True))
    theta = np.array([fitted_theta.get(p.name, p.nominal) for p in whole.parameters])
    fitted = np.where(estimate.prior_sd > 0.0, estimate.sd, np.inf)
    sd_of = dict(zip(measurement.names, fitted, strict=True))
    sd = np.array([sd_of.get(name, np.inf) for name in whole.names])
    free = np.isfinite(sd)
    robust = y if estimate.robust_readings is None else estimate.robust_readings
    residual = estimate.noise.whiten(estimate.residuals + robust - y)
    slopes = estimate.noise.whiten(whole.jacobian(series, theta))
    prior_root = whole.prior_root(free)[:, free]
    explained = over_free = slopes @ prior_root
    columns = {
        names: slopes @ np.isin(whole.names, names).astype(float)
        for names in _candidates(whole.names, free)
    }
    contradicted = []
    tests = _tests(columns, residual, explained)
    while min((t.p_value for t in tests.values()), default=1.0) < FALSE_ALARM:
        names = min(tests, key=lambda key: tests[key].p_value)
        column = columns.pop(names)
        test = tests[names]
        change = test.change * np.isin(whole.names, names)
        taken = np.linalg.solve(
            over_free.T @ over_free + np.eye(over_free.shape[1]), over_free.T @ column
        )
        change = change - test.change * (prior_root @ taken)
        # a machine that shrinks to nothing explains any closure: others must stay near
        offset = np.abs(theta + change - whole.nominal)[free]
        if (offset <= FAR_TOLERANCES * whole.tolerance[free]).all():
            explained = np.column_stack([explained, column])
            contradicted.append(_record(whole, series, names, test, theta, change, sd))
        tests = _tests(columns, residual, explained)
    return contradicted


def _free_unknowns(measurement: Measurement) -> Measurement:
    """The measurement with what its instruments hold among the parameters."""
    setups = []
    if not any(setup.instrument.held for setup in measurement.setups.values()):
        return measurement
    for setup in measurement.setups.values():
        every = (*setup.nuisances, *setup.instrument.held)
        instrument = dataclasses.replace(setup.instrument, nuisances=every)
        setups.append(
            dataclasses.replace(setup, instrument=instrument, nuisances=every)
        )
    return measurement.with_setups(setups)


def _candidates(names: Sequence[str], free: Array) -> list[Names]:
    """Held parameters, each alone, and those alike of which none is free together."""
    alike: dict[str, list[int]] = {}
    for k, name in enumerate(names):
        head, dot, tail = name.rpartition(".")
        alike.setdefault(head + dot + re.sub(r"\d", "", tail), []).append(k)
    single = [(name,) for name, is_free in zip(names, free, strict=True) if not is_free]
    families = [members for members in alike.values() if len(members) > 1]
    together = [tuple(names[k] for k in m) for m in families if not free[m].any()]
    return [*single, *together]


@dataclasses.dataclass(frozen=True)
class _Test:
    """Change of a held parameter if freed, SI, its standard deviation and p-value."""

    change: float
    sd: float
    p_value: float


def _tests(
    columns: dict[Names, Array], residual: Array, explained: Array
) -> dict[Names, _Test]:
    """Test of each column (N,), beside columns (N, k)."""
    size = np.linalg.norm(explained, axis=0)
    scaled = explained[:, size > 0.0] / size[size > 0.0]
    vectors, values, _ = np.linalg.svd(scaled, full_matrices=False)
    basis = vectors[:, values > RANK_TOLERANCE]
    freedom = len(residual) - basis.shape[1] - 1
    if freedom < MIN_FREEDOM:
        return {}
    r = residual - basis @ (basis.T @ residual)
    tests = {}
    for names, column in columns.items():
        c = column - basis @ (basis.T @ column)
        length = float(np.linalg.norm(c))
        if length <= RANK_TOLERANCE * np.linalg.norm(column):
            continue
        change = float(c @ r) / length**2
        scatter = float(np.linalg.norm(r - change * c)) / np.sqrt(freedom)
        t = abs(change) * length / scatter if scatter > 0.0 else np.inf
        p_value = float(2.0 * special.stdtr(freedom, -t))
        tests[names] = _Test(change, scatter / length, p_value)
    count = len(tests)
    return {
        names: dataclasses.replace(test, p_value=min(1.0, count * test.p_value))
        for names, test in tests.items()
    }


def _record(
    whole: Measurement,
    series: Sequence[Series],
    names: Names,
    test: _Test,
    theta: Array,
    change: Array,
    sd: Array,
) -> HeldParameter:
    """A test with what all parameters (n,) change by, of sd (n,), in display units."""
    unit_of = {p.name: units.display(p.unit) for p in whole.parameters}
    unit = unit_of[names[0]]
    value = float(np.mean(theta[np.isin(whole.names, names)]))
    scaled = np.abs(change) / sd
    largest = [
        whole.names[k] for k in np.argsort(-scaled)[:MAX_NAMED] if scaled[k] > 0.0
    ]
    by_name = dict(zip(whole.names, change, strict=True))
    shifts = []
    for s in series:
        x = whole.poses(s, theta)
        p = theta[: len(whole.machine.parameters)]
        dx = whole.kinematics.slopes.pose_by_parameter(x, s.q, p) @ change[: len(p)]
        twist = whole.kinematics.frames(x, np.zeros(3))[2]
        shifts.append(np.einsum("nij,nj->ni", twist, dx)[:, :3])
    shift = np.vstack(shifts)
    return HeldParameter(
        parameters=list(names),
        held=units.number(value, unit),
        estimate=units.number(value + test.change, unit),
        sd=units.number(test.sd, unit),
        unit=unit,
        p_value=test.p_value,
        changes={n: units.number(by_name[n], unit_of[n]) for n in largest},
        units={n: unit_of[n] for n in largest},
        tool_mm=1e3 * float(np.sqrt((shift**2).sum(axis=1).mean())),
    )


@dataclasses.dataclass(frozen=True)
class ToleranceFactor:
    """What readings say of all tolerances together."""

    factor: float  #: the most probable one, of `FACTORS`
    probability: float  #: that they are as stated, but for few parameters
    level: float  #: noise over the stated one with that factor

    @property
    def is_sure(self) -> bool:
        """Whether tolerances as stated are improbable, and larger ones explain it."""
        return self.probability < P_GIVEN_UP and self.level <= MAX_CORRELATED

    def widened(self, measurement: Measurement) -> Measurement:
        """The measurement with all tolerances times the factor."""

        def scaled(parameters: Sequence[Parameter]) -> tuple[Parameter, ...]:
            return tuple(
                dataclasses.replace(p, tolerance=self.factor * p.tolerance)
                for p in parameters
            )

        machine = measurement.machine.with_parameters(
            scaled(measurement.machine.parameters)
        )
        setups = [
            dataclasses.replace(s, nuisances=scaled(s.nuisances))
            for s in measurement.setups.values()
        ]
        kinematics = measurement.kinematics.with_priors_of(machine)
        return Measurement(machine, setups, kinematics)


def tolerance_factor(
    measurement: Measurement, series: Sequence[Series], estimate: Estimate
) -> ToleranceFactor:
    """The factor by readings linear about an estimate, under the stated noise."""
    noise = measurement.noise(series)
    free = estimate.prior_sd > 0.0
    jacobian = measurement.jacobian(series, estimate.theta)
    slopes = noise.whiten(measurement.in_prior_units(jacobian, free))
    change = np.where(free, estimate.theta - measurement.nominal, 0.0)
    residual = noise.whiten(estimate.residuals + jacobian @ change)
    return _most_probable(slopes, residual)


def _most_probable(slopes: Array, residual: Array) -> ToleranceFactor:
    """The factor for whitened slopes (N, n) and residuals (N,) about nominal."""
    directions, singular, _ = np.linalg.svd(slopes, full_matrices=False)
    along = (directions.T @ residual) ** 2
    outside = max(float(residual @ residual - along.sum()), 0.0)
    freedom = len(residual) - len(singular)
    noise = NOISE_LEVELS[None, :, None] ** 2
    variance = noise + (TOLERANCE_FACTORS[:, None] * singular)[:, None, :] ** 2
    each = -0.5 * (np.log(variance) + along / variance)
    further = -0.5 * (freedom * np.log(NOISE_LEVELS**2) + outside / NOISE_LEVELS**2)
    further = further - np.log1p((np.log(NOISE_LEVELS) / LOG_NOISE_SCALE) ** 2)
    all_alike = each.sum(axis=2) + further
    few = np.logaddexp(np.log(1.0 - FAR_SHARE) + each[:1], np.log(FAR_SHARE) + each[1:])
    few_far = few.sum(axis=2) + further
    others = np.log((1.0 - P_AS_STATED) / len(few))
    prior = np.full(len(TOLERANCE_FACTORS), others - np.log(2.0))
    prior[0] = np.log(P_AS_STATED)
    of_all = special.logsumexp(all_alike, axis=1) + prior
    of_few = special.logsumexp(few_far, axis=1) + prior[1:]
    best = int(np.argmax(of_all))
    total = special.logsumexp(np.concatenate([of_all, of_few]))
    return ToleranceFactor(
        factor=float(TOLERANCE_FACTORS[best]),
        probability=float(-np.expm1(special.logsumexp(of_all[1:]) - total)),
        level=float(NOISE_LEVELS[int(np.argmax(all_alike[best]))]),
    )
