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

A drift is a straight line for each combination: p(t) = a + v (t - t_last), v the change per
unit of time. What the line leaves of the sessions is chi2 as well: a machine that was
knocked does not drift.
"""

import dataclasses
import functools
import itertools
from collections.abc import Iterator, Mapping, Sequence
from typing import Self

import numpy as np
from scipy import optimize, special

from oed.base import Array
from oed.identifiability import analyse
from oed.linear_algebra import covariance_root
from oed.text import format_p_value

#: information about a change, in tolerances, below which it counts as undetermined: a
#: standard deviation of ten tolerances
MIN_INFORMATION = 1e-2
#: share of a combination's sd below which a parameter does not belong to it
MIN_SHARE = 0.01
#: largest eigenvalue of a posterior covariance over the prior's: what no reading
#: determines has 1, up to rounding
MAX_INFORMED = 1.0 - 1e-9
N_DIRECTIONS = 200  #: directions of drift that the proof is a mean over
#: log of the largest factor on the usual growth within which the provable one is sought
LOG_BRACKET = 12.0
#: p-value of what parameters leave of a change, from which they explain it
P_EXPLAINED = 0.01
#: p-value below which the sessions do not lie on a line, and intervals are widened
P_UNEVEN = 0.01

FALSE_ALARM = 0.01  #: probability of a false alarm of a session's comparison
MAX_COMBINATIONS = 10  #: combinations and causes that are printed
MAX_TERMS = 4  #: parameters of a combination that are printed
UNIT_TOLERANCE = 5e-4  #: departure from 1 of a coefficient that is written as 1
#: p-value of no drift from which a combination is not shown: its 95 % interval has 0
MIN_P_VALUE = 0.05


@dataclasses.dataclass(frozen=True, slots=True)
class CombinationChange:
    """Change of a combination of parameters that both sessions determine."""

    #: by parameter, the pivot first with 1, then those that contribute most to sd; what
    #: contributes less than MIN_SHARE is left out
    coefficients: dict[str, float]
    #: second session less the first, and its standard deviation
    change: float
    sd: float
    p_value: float  #: of no change, two-sided, for this combination alone

    def in_words(self, units: Mapping[str, str]) -> tuple[str, str]:
        """A combination in words, `z2 less 0.5 times z1`, and the unit of its pivot."""
        (pivot, _), *others = self.coefficients.items()
        phrases = [pivot]
        for name, coefficient in others[: MAX_TERMS - 1]:
            sign = "less" if coefficient < 0.0 else "plus"
            amount = _amount(abs(coefficient), units[pivot], units[name])
            phrases.append(f"{sign} {amount}{name}")
        if len(others) >= MAX_TERMS:
            phrases.append(f"and {len(others) - MAX_TERMS + 1} smaller terms")
        return " ".join(phrases), units[pivot]

    def sentence(self, units: Mapping[str, str]) -> str:
        """The change with its standard deviation, in the units of the parameters."""
        phrase, unit = self.in_words(units)
        z = self.change / self.sd
        return (
            f"{phrase}: {self.change:+.4g} {unit}, sd {self.sd:.2g} {unit}, {z:+.1f} sd"
        )

    def interval_sentence(self, units: Mapping[str, str]) -> str:
        """The change with its 95 % interval, in the units of the parameters."""
        phrase, of = self.in_words(units)
        half = 1.96 * self.sd
        low, high = self.change - half, self.change + half
        return f"{phrase}: {self.change:+.3g} {of}, {low:+.3g} to {high:+.3g}"


@dataclasses.dataclass(frozen=True, slots=True)
class Cause:
    """One parameter, or two, as all that changed."""

    #: by parameter, all others unchanged
    changes: dict[str, float]
    sds: dict[str, float]
    chi2: float  #: of what they do not explain
    p_value: float  #: of chi2, for the degrees of freedom that they leave

    @property
    def explains_all(self) -> bool:
        """Whether what they leave is no more than chance."""
        return self.p_value >= P_EXPLAINED


def _amount(size: float, unit: str, of_unit: str) -> str:
    """A coefficient in words that end before the parameter's name; nothing for 1."""
    if unit != of_unit:
        return f"{size:.3g} {unit} per {of_unit} of "
    return "" if abs(size - 1.0) < UNIT_TOLERANCE else f"{size:.3g} times "


def _explanations(
    causes: Sequence[Cause], units: Mapping[str, str], per: str = ""
) -> Iterator[str]:
    """Parameters whose change explains all of it, or that no two do; `per`: a time."""
    enough = [cause for cause in causes if cause.explains_all]
    if not enough:
        yield "No single parameter explains the change, nor do two."
        return
    count = "one parameter" if len(enough[0].changes) == 1 else "two parameters"
    yield f"A change of {count} alone explains all of it:"
    for cause in enough[:MAX_COMBINATIONS]:
        parts = [
            f"{name}: {size:+.4g} {units[name]}{per}, sd {cause.sds[name]:.2g} {units[name]}"
            for name, size in cause.changes.items()
        ]
        rest = f"chi2 falls to {cause.chi2:.4g}, p {format_p_value(cause.p_value)}"
        yield f"    {' and '.join(parts)}; {rest}"


@dataclasses.dataclass(frozen=True, slots=True)
class Session:
    """Posterior of one session: mean (n,) and covariance (n, n) of the parameters."""

    mean: Array
    covariance: Array


def likelihood(
    session: Session, nominal: Array, tolerance: Array
) -> tuple[Array, Array]:
    """Root R (k, n) of the readings' information, and t: R p = t + N(0, 1)."""
    scaled = session.covariance / np.outer(tolerance, tolerance)
    values, vectors = np.linalg.eigh((scaled + scaled.T) / 2)
    informed = values < MAX_INFORMED
    values, vectors = values[informed], vectors[:, informed]
    mean = vectors.T @ ((session.mean - nominal) / tolerance)
    root = np.sqrt(1.0 / values - 1.0)[:, None] * vectors.T
    return root, mean / np.sqrt(values * (1.0 - values))


def _reduced(root: Array, estimate: Array, span: Array) -> tuple[Array, Array]:
    """Root (k, q) and estimates (k,) within a span (n, q), without what says nothing."""
    vectors, singular, right = np.linalg.svd(root @ span, full_matrices=False)
    informed = singular**2 > MIN_INFORMATION
    reduced = singular[informed, None] * right[informed]
    return reduced, vectors[:, informed].T @ estimate


def _projected_out(basis: Array, values: Array) -> Array:
    """Values (m,) or (m, q) without their part in an orthonormal basis (m, k)."""
    return values - basis @ (basis.T @ values)


@dataclasses.dataclass(frozen=True)
class ParameterChange:
    """A change over sessions, per unit of time, in its determined directions."""

    names: Sequence[str]  #: (n,) of the parameters
    unit: Array  #: (n,) of the change: the tolerances, over the span of all sessions
    root: Array  #: (r, n) of its information, in these units
    white: Array  #: (r,) estimates, standard normal where the truth is 0
    #: chi2 of what the change leaves, and its degrees of freedom
    rest: float
    rest_dof: int

    @classmethod
    def of(cls, sessions: "MachineSessions", times: Array) -> Self:
        """The change over sessions at times (k,). Raises ValueError for one time alone."""
        span_of_time = float(np.ptp(times))
        if span_of_time <= 0.0:
            raise ValueError("a drift needs sessions at two different times")
        elapsed = (times - np.max(times)) / span_of_time
        nominal, tolerance = sessions.nominal, sessions.tolerance
        parts = [likelihood(s, nominal, tolerance) for s in sessions.posteriors]
        # what all sessions together determine to a tolerance or better
        roots = np.vstack([root for root, _ in parts])
        _, singular, right = np.linalg.svd(roots, full_matrices=False)
        span = right[singular >= 1.0].T
        rows = [_reduced(root, t, span) for root, t in parts]
        level = np.vstack([root for root, _ in rows])
        slopes = [s * root for s, (root, _) in zip(elapsed, rows, strict=True)]
        estimates = np.concatenate([t for _, t in rows])
        basis = np.linalg.qr(level)[0] if level.size else level
        slope, estimates = (
            _projected_out(basis, _projected_out(basis, v))
            for v in (np.vstack(slopes), estimates)
        )
        vectors, singular, right = np.linalg.svd(slope, full_matrices=False)
        determined = singular**2 > MIN_INFORMATION
        white = vectors[:, determined].T @ estimates
        freedom = len(estimates) - level.shape[1] - len(white)
        return cls(
            names=sessions.names,
            unit=tolerance / span_of_time,
            root=singular[determined, None] * right[determined] @ span.T,
            white=white,
            rest=max(float(estimates @ estimates - white @ white), 0.0),
            rest_dof=max(freedom, 0),
        )

    @property
    def widening(self) -> float:
        """Factor on all standard deviations."""
        return 1.0

    @property
    def chi2(self) -> float:
        """Of the test of no change."""
        return float(self.white @ self.white)

    @property
    def dof(self) -> int:
        """Number of determined directions."""
        return len(self.white)

    @property
    def p_value(self) -> float:
        """Of the test of no change; 1 where no direction is determined."""
        chi2 = self.chi2 / self.widening**2
        return float(special.chdtrc(self.dof, chi2)) if self.dof else 1.0

    @property
    def is_proven(self) -> bool:
        """Whether no change is less likely than the probability of a false alarm."""
        return self.p_value < FALSE_ALARM

    @property
    def undetermined(self) -> int:
        """Number of directions in which a change stays unseen."""
        return len(self.unit) - self.dof

    @functools.cached_property
    def combinations(self) -> tuple[CombinationChange, ...]:
        """Changes of the combinations that are determined, the surest first."""
        if not self.dof:
            return ()
        # one unit for all columns: the tolerance
        scaled = analyse(self.root, self.names, np.ones(len(self.names))).combinations
        inverse = np.linalg.pinv(self.root)
        estimates = scaled @ inverse @ self.white
        deviations = np.linalg.norm(scaled @ inverse, axis=1)
        changes = []
        for row, estimate, sd in zip(scaled, estimates, deviations, strict=True):
            pivot = int(np.argmax(np.isclose(row, 1.0)))
            unit = self.unit[pivot]
            share = np.abs(row) * np.linalg.norm(inverse, axis=1) / sd
            ranked = np.argsort(-share, kind="stable")
            coefficients = {self.names[pivot]: 1.0}
            for k in ranked:
                if share[k] >= MIN_SHARE and k != pivot:
                    coefficients[self.names[k]] = float(row[k] * unit / self.unit[k])
            z = estimate / (self.widening * sd)
            changes.append(
                CombinationChange(
                    coefficients=coefficients,
                    change=float(estimate * unit),
                    sd=float(self.widening * sd * unit),
                    p_value=float(2.0 * special.ndtr(-abs(z))),
                )
            )
        return tuple(sorted(changes, key=lambda c: -abs(c.change / c.sd)))

    @functools.cached_property
    def causes(self) -> tuple[Cause, ...]:
        """Parameters, or pairs where none does, as all that changed, the best first."""
        information = (self.root**2).sum(axis=0)
        determined = np.flatnonzero(information > MIN_INFORMATION)
        for size in (1, 2):
            tried = map(self._cause, itertools.combinations(determined.tolist(), size))
            causes = sorted(filter(None, tried), key=lambda cause: cause.chi2)
            if not causes or causes[0].explains_all:
                break
        return tuple(causes)

    def _cause(self, members: Sequence[int]) -> Cause | None:
        """These parameters as all that changed; None where they are not told apart."""
        columns = self.root[:, list(members)]
        gram = columns.T @ columns
        if np.linalg.eigvalsh(gram)[0] <= MIN_INFORMATION:
            return None
        estimates = np.linalg.solve(gram, columns.T @ self.white)
        rest = max(self.chi2 - float(estimates @ gram @ estimates), 0.0)
        rest /= self.widening**2
        freedom = self.dof - len(members)
        units = self.unit[list(members)]
        sds = self.widening * units * np.sqrt(np.diag(np.linalg.inv(gram)))
        of = [self.names[k] for k in members]
        return Cause(
            changes=dict(zip(of, (estimates * units).tolist(), strict=True)),
            sds=dict(zip(of, sds.tolist(), strict=True)),
            chi2=rest,
            p_value=float(special.chdtrc(freedom, rest)) if freedom > 0 else 1.0,
        )


class SessionChange(ParameterChange):
    """The change between two sessions; in the units of the parameters."""

    def sentences(self, units: Mapping[str, str]) -> Iterator[str]:
        """The test, parameters that explain the change, and the combinations."""
        if not self.dof:
            yield "The two sessions determine no common combination of parameters."
            return
        verdict = "The machine changed" if self.is_proven else "No change"
        yield (
            f"{verdict}: chi2 {self.chi2:.4g} for {self.dof} combinations that both"
            f" sessions determine, p {format_p_value(self.p_value)}."
        )
        if self.undetermined:
            verb = "is" if self.undetermined == 1 else "are"
            yield (
                f"{self.undetermined} of {len(units)} directions {verb} not determined by"
                " both sessions: a change there stays unseen."
            )
        if self.is_proven:
            yield from _explanations(self.causes, units)
        # Sidak: the smallest of dof p-values, each uniform where nothing changed
        threshold = 1.0 - (1.0 - FALSE_ALARM) ** (1.0 / self.dof)
        yield f"Changes (* beyond chance among {self.dof}, at {FALSE_ALARM:g}):"
        for combination in self.combinations[:MAX_COMBINATIONS]:
            mark = "*" if combination.p_value < threshold else " "
            yield f"  {mark} {combination.sentence(units)}"


@dataclasses.dataclass(frozen=True, slots=True)
class NextCalibration:
    """When the error reaches its limit, in time after the last session."""

    #: median over the drifts that the sessions allow; inf where it never does
    time: float
    #: 95 % interval
    low: float
    high: float


class SessionDrift(ParameterChange):
    """Drift over the sessions, per unit of time, in the units of the parameters."""

    @property
    def widening(self) -> float:
        """Factor on all standard deviations where a line does not suit."""
        p_even = special.chdtrc(self.rest_dof, self.rest) if self.rest_dof else 1.0
        return float(np.sqrt(self.rest / self.rest_dof)) if p_even < P_UNEVEN else 1.0

    @functools.cached_property
    def _inverse(self) -> Array:
        """(n, r) with which white estimates become changes; 0 along what is unseen."""
        return self.unit[:, None] * np.linalg.pinv(self.root)

    @property
    def rate(self) -> Array:
        """Drift (n,) of each parameter; 0 along undetermined directions."""
        return np.asarray(self._inverse @ self.white)

    @property
    def covariance(self) -> Array:
        """Covariance (n, n) of `rate`, widened."""
        return np.asarray(self.widening**2 * self._inverse @ self._inverse.T)

    def sentences(self, units: Mapping[str, str], unit: str) -> Iterator[str]:
        """Whether the machine drifts, and whether evenly; causes; combinations.

        units  of the parameters by name
        unit   of time
        """
        if not self.dof:
            yield "The sessions determine the drift of no combination of parameters."
            return
        verdict = "The machine drifts" if self.is_proven else "No drift is proven"
        yield (
            f"{verdict}: chi2 {self.chi2:.4g} for {self.dof} combinations, p"
            f" {format_p_value(self.p_value)}."
        )
        if self.widening > 1.0:
            yield (
                f"The sessions do not lie on a line (chi2 {self.rest:.4g} for"
                f" {self.rest_dof}): all intervals are {self.widening:.2g} times as"
                " wide. `oed compare` shows between which sessions the machine changed."
            )
        if self.undetermined:
            count = self.undetermined
            directions = "1 direction is" if count == 1 else f"{count} directions are"
            yield f"{directions} not determined: a drift there stays unseen."
        if self.is_proven:
            yield from _explanations(self.causes, units, f" a {unit}")
        yield f"Drift a {unit}, with its 95 % interval:"
        proven = [c for c in self.combinations if c.p_value < MIN_P_VALUE]
        for combination in (proven or self.combinations[:1])[:MAX_COMBINATIONS]:
            yield f"  {combination.interval_sentence(units)}"

    def next_calibration(
        self,
        maps: Array,
        after: float,
        limit: float,
        rng: np.random.Generator,
        draws: int = 4000,
    ) -> NextCalibration:
        """When a component's rms error over the workspace, `after` now, exceeds a
        limit, SI.

        With the drift v and maps (m, np) its square is after^2 + t^2 mean (maps v)^2.
        """
        root = covariance_root(self.covariance)
        normal = rng.standard_normal((draws, len(self.rate)))
        rates = self.rate + normal @ root.T
        growth = np.sqrt(np.mean((rates @ maps.T) ** 2, axis=1))
        room = np.sqrt(max(limit**2 - after**2, 0.0))
        with np.errstate(divide="ignore"):
            times = room / growth
        low, median, high = np.quantile(times, [0.025, 0.5, 0.975], method="lower")
        return NextCalibration(float(median), float(low), float(high))


@dataclasses.dataclass(frozen=True)
class MachineSessions:
    """Sessions of one machine under the prior N(nominal (n,), diag(tolerance (n,))^2)."""

    names: Sequence[str]  #: of the machine's parameters
    nominal: Array
    tolerance: Array
    #: one a session, marginal to its set-ups, which are mounted anew in each
    posteriors: Sequence[Session]

    @classmethod
    def of(
        cls,
        names: Sequence[str],
        nominal: Array,
        tolerance: Array,
        posteriors: Sequence[tuple[Array, Array]],
    ) -> "MachineSessions":
        """Sessions of which the posteriors are given as mean and covariance."""
        return cls(names, nominal, tolerance, [Session(*p) for p in posteriors])

    def change(self) -> SessionChange:
        """Compare two sessions. Raises ValueError unless there are two."""
        return SessionChange.of(self, np.array([0.0, 1.0]))

    def drift(self, times: Array) -> SessionDrift:
        """Drift of the parameters (n,) over times (k,). Raises ValueError."""
        return SessionDrift.of(self, np.asarray(times, dtype=float))

    def provable_growth(
        self,
        maps: Array,
        counts: Sequence[int],
        power: float,
        rng: np.random.Generator,
        alarm: float = FALSE_ALARM,
    ) -> Array:
        """Growth (len(counts),) of an rms error, SI a session, that so many sessions prove.

        maps    (m, np) pose errors per parameter
        counts  of equally spaced sessions, each with the mean information of those given
        alarm   probability of a false alarm
        power   probability of the proof

        The drift's direction is random in the tolerances. Its proof is by the noncentral chi2
        of the test: n sessions have the information L n (n^2 -
        1) / 12 of the change between two of them, L that of one.
        """
        from scipy import stats  # takes a second to import

        sessions, tolerance = self.posteriors, self.tolerance
        roots = [likelihood(s, self.nominal, tolerance)[0] for s in sessions]
        _, singular, right = np.linalg.svd(np.vstack(roots), full_matrices=False)
        informed = singular >= np.sqrt(len(sessions))
        root = singular[informed, None] / np.sqrt(len(sessions)) * right[informed]
        direction = (
            rng.standard_normal((N_DIRECTIONS, int(informed.sum()))) @ right[informed]
        )
        growth = np.sqrt(np.mean((direction * tolerance @ maps.T) ** 2, axis=1))
        information = np.sum((direction @ root.T) ** 2, axis=1) / growth**2
        dof = int(informed.sum())
        critical = special.chdtri(dof, alarm)

        def excess(log_growth: float, count: int) -> float:
            times = count * (count**2 - 1) / 12.0
            squared = np.exp(2.0 * log_growth) * information * times
            return float(np.mean(stats.ncx2.sf(critical, dof, squared)) - power)

        usual = -0.5 * float(np.median(np.log(information)))
        bracket = (usual - LOG_BRACKET, usual + LOG_BRACKET)
        solutions = [optimize.brentq(excess, *bracket, args=(n,)) for n in counts]
        return np.exp(solutions)
