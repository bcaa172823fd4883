"""Score tests of what a fit holds exactly: fixed parameters, unknowns of instruments.

Of whitened residuals r, and slopes c over a held parameter, only the part counts that no
free parameter explains, whatever its prior. Freed alone, the parameter changes by c.r /
c.c, and where its held value is exact,

    t^2 = (c.r)^2 / (c.c s^2),    s^2 = (r.r - (c.r)^2 / c.c) / (N - rank - 1),

is that of Student, however large the noise is (Cook and Weisberg 1982, Residuals and
Influence in Regression, added variables). What only chooses a frame has no c and no test.
Held parameters that differ by their number alone are tested moved together as well. What
is found is freed, and the others are tested beside it; p-values are times the number of
the tests (Bonferroni).
"""

from __future__ import annotations

import dataclasses
import re
from collections.abc import Sequence

import numpy as np
from scipy import special

from oed.base import units
from oed.base.arrays import Array
from oed.estimation.estimate import Estimate
from oed.measurement import Measurement, Series
from oed.result.fit import HeldParameter
from oed.result.fit_limits import FAR

#: probability that a study whose held values are exact has one reported
LEVEL = 0.01
#: degrees of freedom, beside all parameters, from which residuals tell their scatter
LEAST_FREEDOM = 3
#: share of slopes, or of singular values, that is rounding
ROUNDING = 1e-6
#: parameters whose changes are named
NAMED = 3

#: names of parameters that move together
Names = tuple[str, ...]


def contradicted_parameters(
    measurement: Measurement, series: Sequence[Series], y: Array, estimate: Estimate
) -> list[HeldParameter]:
    """Held parameters that readings y (N,), SI, contradict, the surest first."""
    whole = _with_held_unknowns(measurement)
    known = dict(zip(measurement.names, estimate.theta, strict=True))
    theta = np.array([known.get(p.name, p.nominal) for p in whole.parameters])
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
    while min((t.p_value for t in tests.values()), default=1.0) < LEVEL:
        names = min(tests, key=lambda key: tests[key].p_value)
        column, test = columns.pop(names), tests[names]
        change = test.change * np.isin(whole.names, names)
        taken = np.linalg.solve(
            over_free.T @ over_free + np.eye(over_free.shape[1]), over_free.T @ column
        )
        change = change - test.change * (prior_root @ taken)
        # a machine that shrinks to nothing explains any closure: others must stay near
        offset = np.abs(theta + change - whole.nominal)[free]
        if (offset <= FAR * whole.tolerance[free]).all():
            explained = np.column_stack([explained, column])
            contradicted.append(_record(whole, series, names, test, theta, change, sd))
        tests = _tests(columns, residual, explained)
    return contradicted


def _with_held_unknowns(measurement: Measurement) -> Measurement:
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
    basis = vectors[:, values > ROUNDING]
    freedom = len(residual) - basis.shape[1] - 1
    if freedom < LEAST_FREEDOM:
        return {}
    r = residual - basis @ (basis.T @ residual)
    tests = {}
    for names, column in columns.items():
        c = column - basis @ (basis.T @ column)
        length = float(np.linalg.norm(c))
        if length <= ROUNDING * np.linalg.norm(column):
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
    unit, held = unit_of[names[0]], float(np.mean(theta[np.isin(whole.names, names)]))
    scaled = np.abs(change) / sd
    largest = [whole.names[k] for k in np.argsort(-scaled)[:NAMED] if scaled[k] > 0.0]
    by_name = dict(zip(whole.names, change, strict=True))
    shifts = []
    for s in series:
        x, p = whole.poses(s, theta), theta[: len(whole.machine.parameters)]
        dx = whole.kinematics.slopes.over_parameters(x, s.q, p) @ change[: len(p)]
        twist = whole.kinematics.frames(x, np.zeros(3))[2]
        shifts.append(np.einsum("nij,nj->ni", twist, dx)[:, :3])
    shift = np.vstack(shifts)
    return HeldParameter(
        parameters=list(names),
        held=units.number(held, unit),
        estimate=units.number(held + test.change, unit),
        sd=units.number(test.sd, unit),
        unit=unit,
        p_value=test.p_value,
        changes={n: units.number(by_name[n], unit_of[n]) for n in largest},
        units={n: unit_of[n] for n in largest},
        tool_mm=1e3 * float(np.sqrt((shift**2).sum(axis=1).mean())),
    )
