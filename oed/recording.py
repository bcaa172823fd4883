"""What planned readings leave where some effects' covariates are recorded, others not.

Recorded columns are those of a course, G(z), and the error is the mean over courses. The
others count by their moments (`oed.effects.courses`). A thermometer adds
its own uncertainty as scatter: u(T) times the change per kelvin.

With parameters and effects x of prior information P, readings of whitened slopes X taken t
times and pose errors F x,

    v(t) = tr F (P + t X^T X)^-1 F^T + rest = rest + sum_k s_k / (1 + t l_k),

l_k the eigenvalues of X^T X in units of P. As t grows, v falls to a floor: rest and what
no reading determines.
"""

import dataclasses
from collections.abc import Sequence

import numpy as np
import scipy

from oed.accuracy import ErrorMaps, Reference
from oed.base import Array, Mask
from oed.effects import Course, CourseColumns, ExpectedColumns, SessionStates
from oed.gap import GapProblem

#: standard uncertainty of a thermometer on a machine, K: of class A, and its contact
THERMOMETER_UNCERTAINTY = 0.2
#: most courses over which errors with a recorded covariate are averaged
MAX_COURSES = 4
TEMPERATURE = "temp_"  #: how a need names a temperature
#: rate, in units of the prior's information, below which readings determine nothing
MIN_RATE = 1e-9


@dataclasses.dataclass(frozen=True, eq=False)
class RemainingError:
    """Mean square errors of c pose components over a workspace."""

    shares: Array  #: (c, m) mean square by each eigenvector before any reading, SI
    #: (m,) information that the readings have of it, in units of the prior's
    rates: Array
    rest: Array  #: (c,) mean square that no reading reduces, SI

    def after(self, times: float) -> Array:
        """Mean squares (c,) with the readings taken so many times, inf allowed, SI."""
        undetermined = np.asarray(self.rates < MIN_RATE, dtype=float)
        share = undetermined if np.isinf(times) else 1.0 / (1.0 + times * self.rates)
        return np.asarray(self.rest + self.shares @ share)

    def gain(self, reached: Array) -> float:
        """Share by which the mean squares `reached` (c,) are below these, 0 at least."""
        return max(1.0 - relative(reached, self.after(1.0)), 0.0)

    def equal_times(self, reached: Array) -> float:
        """How often readings must be taken to leave the mean squares `reached` (c,).

        By the root mean square of the components, in units of what the readings taken once
        leave. Infinite where no number does.
        """
        unit = self.after(1.0)
        target = relative(reached, unit)

        def excess(log_times: float) -> float:
            return relative(self.after(float(np.exp(log_times))), unit) - target

        if excess(0.0) <= 0.0:
            return 1.0
        if relative(self.after(np.inf), unit) >= target:
            return float("inf")
        end = 1.0
        while excess(end) > 0.0:
            end *= 2.0
        return float(np.exp(scipy.optimize.brentq(excess, 0.0, end, xtol=1e-6)))


def remaining_error(
    white: Array, information: Array, pose_gradients: Array, rest: Array
) -> RemainingError:
    """The error that readings leave.

    white           (N, u) slopes of the readings over all unknowns, in units of the noise
    information     (u, u) of the prior
    pose_gradients  (n, c, u) pose errors over the unknowns at n poses, SI
    rest            (c,) mean square that no reading reduces, SI
    """
    root = scipy.linalg.cholesky(information, lower=True)
    standard = scipy.linalg.solve_triangular(root, white.T, lower=True).T
    rates, vectors = np.linalg.eigh(standard.T @ standard)
    poses, components, unknowns = pose_gradients.shape
    flat = pose_gradients.reshape(-1, unknowns)
    turned = scipy.linalg.solve_triangular(root, flat.T, lower=True).T @ vectors
    by_pose = turned.reshape(poses, components, unknowns)
    return RemainingError((by_pose**2).mean(axis=0), np.maximum(rates, 0.0), rest)


def relative(mean_squares: Array, unit: Array) -> float:
    """Root mean square over the components, each in units of its own (c,); 0 left out."""
    counted = unit > 0.0
    return float(np.sqrt((mean_squares[counted] / unit[counted]).mean()))


def mean_after_once(errors: Sequence[RemainingError]) -> Array:
    """Mean (c,) of the mean squares that several leave, SI."""
    return np.asarray(np.mean([error.after(1.0) for error in errors], axis=0))


@dataclasses.dataclass(frozen=True, eq=False)
class PlannedReadings:
    """N readings and the n unknowns beside effects."""

    white: Array  #: (N, n) slopes, per prior standard deviation, in units of the noise
    sigma: Array  #: (N,) noise, SI
    information: Array  #: (n, n) of the prior
    pose_gradients: Array  #: (p, c, n) pose errors at p poses, SI

    def predict(
        self, effects: CourseColumns, recorded: Mask, extra: Array
    ) -> list[RemainingError]:
        """Errors in some courses with recorded (k,) columns; one where none is.

        extra  (N,) standard deviation of further scatter, SI
        """
        hidden = effects.of_course & ~recorded
        scatter = np.hypot(effects.scatter(hidden), extra)
        rest = effects.tool_rest(hidden)
        count = min(len(effects.changes), MAX_COURSES) if recorded.any() else 1
        errors = []
        for number in range(count):
            columns, tool = effects.mean, effects.mean_tool
            columns[:, recorded] = effects.changes[number][:, recorded]
            tool[:, :, recorded] = effects.tool[number][:, :, recorded]
            errors.append(self._remaining(columns, tool, scatter, rest))
        return errors

    def _remaining(
        self, columns: Array, tool: Array, scatter: Array, rest: Array
    ) -> RemainingError:
        weight = self.sigma / np.hypot(self.sigma, scatter)
        of_effects = columns / self.sigma[:, None]
        white = np.hstack([self.white, of_effects]) * weight[:, None]
        unknowns, first = white.shape[1], self.white.shape[1]
        information = np.eye(unknowns)
        information[:first, :first] = self.information
        pose_gradients = np.concatenate([self.pose_gradients, tool], axis=2)
        return remaining_error(white, information, pose_gradients, rest)


@dataclasses.dataclass(frozen=True, eq=False)
class RecordedCase:
    """Readings with the effects in some courses."""

    readings: PlannedReadings
    courses: list[Course]
    columns: ExpectedColumns
    effects: CourseColumns

    @classmethod
    def of(
        cls,
        problem: GapProblem,
        courses: list[Course],
        columns: ExpectedColumns,
        session: SessionStates,
        command: Array,
        reference: Reference,
        rng: np.random.Generator,
        information: Array,
    ) -> "RecordedCase":
        """The readings of a problem, and their effects over a workspace.

        command      (n, n_dof) of the workspace, SI
        information  of the prior of the machine's free parameters
        """
        over = CourseColumns.of(
            problem, courses, columns, session, command, reference, rng
        )
        measurement = problem.measurement
        free, machine = measurement.free, measurement.machine
        slopes = measurement.jacobian(problem.series, measurement.nominal)
        noise = measurement.noise(problem.series)
        white = noise.whiten(slopes * measurement.tolerance)
        raw = ErrorMaps.of(measurement.kinematics, command, reference).raw
        pose = np.zeros((*raw.shape[:2], len(free)))
        pose[:, :, : len(machine.parameters)] = raw
        count = len(information)
        prior = np.eye(int(free.sum()))
        prior[:count, :count] = information
        readings = PlannedReadings(
            white=white[:, free],
            sigma=problem.sigma,
            information=prior,
            pose_gradients=(pose * measurement.tolerance)[:, :, free],
        )
        return cls(readings, courses, columns, over)

    @property
    def nothing(self) -> Mask:
        """No column (k,)."""
        return np.zeros(len(self.effects.of_course), dtype=bool)

    def needing(self, covariate: str) -> Mask:
        """Columns (k,) of effects that need a covariate."""
        names = {
            form.effect.name
            for form in self.columns.forms
            if any(covariate in need for need in form.effect.needs)
        }
        groups = [name.split(": ")[0] in names for name in self._groups]
        return np.array(groups)[self.columns.discrepancy.group]

    def restrict_to_bodies(self, effect: str, bodies: Sequence[str]) -> Mask:
        """Columns (k,) of an effect in bodies, or in all where it has no blocks."""
        groups = []
        for name in self._groups:
            named, _, label = name.partition(": ")
            groups.append(named == effect and label.replace(" ", "") in ("", *bodies))
        return np.array(groups)[self.columns.discrepancy.group]

    def names(self, mask: Mask) -> list[str]:
        """Effects of known form of some columns (k,)."""
        discrepancy = self.columns.discrepancy
        groups = np.unique(discrepancy.group[mask])
        group_names = [self._groups[g] for g in groups if not discrepancy.unknown[g]]
        return list(dict.fromkeys(name.split(": ")[0] for name in group_names))

    def predict(self, recorded: Mask) -> list[RemainingError]:
        """Errors with the covariates of some columns (k,) recorded."""
        return self.readings.predict(self.effects, recorded, np.zeros(1))

    def reached(self, recorded: Mask) -> Array:
        """Mean (c,) of the mean squares that these leave, SI."""
        return mean_after_once(self.predict(recorded))

    def reached_with(
        self, warm: "RecordedCase", hidden: Mask, effect: str, bodies: Sequence[str]
    ) -> Array:
        """The same with thermometers on bodies, of which an effect is hidden (k,) here.

        warm  where they are read: it has the effect, which is as large as it is here
        """
        measured = warm.effects.take(warm.restrict_to_bodies(effect, bodies))
        names = [f"{TEMPERATURE}{body}" for body in bodies]
        kelvin = np.array([c.covariates[names] for c in warm.courses])
        square = (measured.changes**2).sum(axis=2).mean(axis=0)
        extra = THERMOMETER_UNCERTAINTY * np.sqrt(square / np.mean(kelvin**2))
        size = self.effects.take(hidden).rms / measured.rms
        others = self.effects.take(~hidden)
        both = others.joined(measured.scaled(size))
        recorded = np.arange(both.changes.shape[2]) >= others.changes.shape[2]
        return mean_after_once(self.readings.predict(both, recorded, extra))

    @property
    def _groups(self) -> tuple[str, ...]:
        return self.columns.discrepancy.names
