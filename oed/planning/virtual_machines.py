"""Virtual machines carried exactly through all stages, to check a plan's prediction.

A machine with true parameters drawn from the tolerances goes through the stages. In
each stage, the controller uses the parameters p_hat identified so far and sends the
joints q(command, p_hat). Readings are those of the exact closure at the true
parameters, with noise. They are lost where they are farther from their expected value
than the instrument's travel. All readings so far are then fitted together, which to
first order hands the posterior on. What identification leaves is the pose error between
the true and the believed machine,

    e = x(q, p) - x(q, p_hat) ~ A delta,        delta ~ N(0, S'),

compared with the covariance S' that the plan predicts after the stage.
"""

import dataclasses
import functools
import math
from collections.abc import Callable, Sequence
from typing import NamedTuple

import numpy as np

from oed.accuracy import ErrorMaps, Reference, relative_to_reference
from oed.base import Array, Index, Mask, consecutive_slices
from oed.estimation import IdentificationError, identify, minimise
from oed.identifiability import posterior_covariance
from oed.instrument import Setup
from oed.linear_algebra import symmetric_root
from oed.measurement import Measurement, Series, draw_parameters
from oed.mechanism import NO_TOOL, Kinematics, twist_between
from oed.noise import Noise
from oed.planning.prediction import PlanStage


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualReadings:
    """Readings (N) of m machines."""

    series: tuple[Series, ...]  #: with the joints that each machine is sent
    y: Array  #: (m, N) SI; NaN where a pose cannot be assembled
    captured: Mask  #: (m, N) which readings are captured
    lost_share: Array  #: (m,) share of the chosen candidates that is lost


@dataclasses.dataclass(frozen=True, eq=False)
class VirtualStage:
    """One stage as it is carried out."""

    #: all set-ups up to this stage, so that its parameters begin with those of the
    #: stage before
    measurement: Measurement
    series: tuple[Series, ...]  #: planned readings
    candidate: Index  #: (readings,) candidate that each number belongs to
    #: (readings,) which numbers are first channels: the travel limits them
    first_channel: Mask
    travel: float  #: m or rad; infinite: unlimited

    def read(
        self, truth: Array, expected: Array, controller: Array | None, normals: Array
    ) -> VirtualReadings:
        """Readings of machines `truth` (m, n), expected at (m, n), by controllers (m,
        np) or nominal ones, with normal numbers (m, readings) for the noise.
        """
        measurement = self.measurement
        sent = tuple(self._send(s, controller) for s in self.series)
        exact = measurement.try_readings(sent, truth)
        # a pose that cannot be assembled cannot be read
        lost = np.isnan(exact)
        if math.isfinite(self.travel):
            deviation = np.abs(exact - measurement.try_readings(sent, expected))
            lost |= self.first_channel & ~(deviation <= self.travel)
        candidates = int(self.candidate[-1]) + 1
        belongs = self.candidate[:, None] == np.arange(candidates)
        complete = (lost @ belongs.astype(float)) == 0.0
        noise = [
            measurement.noise([s.of_machines(k) for s in sent]).correlate(normal)
            for k, normal in enumerate(normals)
        ]
        return VirtualReadings(
            series=sent,
            y=exact + np.array(noise),
            captured=complete[:, self.candidate],
            lost_share=1.0 - complete.mean(axis=1),
        )

    def _send(self, series: Series, controller: Array | None) -> Series:
        """The series with joints that controllers send; recorded ones stay."""
        if controller is None or np.isnan(series.command).any():
            return series
        tool = np.array(self.measurement.setups[series.setup].tool)
        (machines, _), (poses, _) = controller.shape, series.command.shape
        command = np.tile(series.command, (machines, 1))
        parameters = np.repeat(controller, poses, axis=0)
        x, q = self.measurement.kinematics.inverse(command, parameters, tool)
        return dataclasses.replace(
            series,
            q=q.reshape(machines, poses, -1),
            start=x.reshape(machines, poses, -1),
        )


def prepare_stages(stages: Sequence[PlanStage]) -> tuple[VirtualStage, ...]:
    """The stages of a plan, ready to be carried out one after the other."""
    setups: list[Setup] = []
    virtual = []
    for number, stage in enumerate(stages, start=1):
        measurement = stage.option.measurement
        # A set-up mounted in two stages stands elsewhere in each: it gets a name and
        # parameters of its own.
        for setup in measurement.setups.values():
            name = _stage_name(number, setup.name)
            setups.append(dataclasses.replace(setup, name=name))
        series = tuple(
            dataclasses.replace(s, setup=_stage_name(number, s.setup))
            for s in stage.series
        )
        channels = _channels(stage)
        counts = stage.option.candidates.members[stage.chosen, 1]
        candidate_of_reading = np.repeat(np.arange(len(stage.chosen)), counts)
        first_channel = np.zeros(channels.sum(), dtype=bool)
        first_channel[np.cumsum(channels) - channels] = True
        virtual.append(
            VirtualStage(
                measurement=measurement.with_setups(setups),
                series=series,
                candidate=np.repeat(candidate_of_reading, channels),
                first_channel=first_channel,
                travel=stage.option.travel,
            )
        )
    return tuple(virtual)


def _channels(stage: PlanStage) -> Index:
    setups = stage.option.measurement.setups
    counts = [np.full(len(s), len(setups[s.setup].sigma)) for s in stage.series]
    return np.concatenate(counts)


def _stage_name(number: int, setup: str) -> str:
    return f"{number}. {setup}"


#: distance to the minimum, in posterior standard deviations, of the last step: its square
#: is a small share of any interval
NEAR_STEP = 3e-3


@dataclasses.dataclass(frozen=True, eq=False)
class Refit:
    """theta (n,) and its covariance (n, n), SI; zero for fixed parameters."""

    theta: Array
    covariance: Array


def refit_machines(
    measurement: Measurement,
    series: Sequence[Series],
    y: Array,
    captured: Mask,
    start: Array,
    root: Array | None = None,
) -> list[Refit]:
    """Fit the readings y (m, N), SI, of m machines from theta `start` (m, n).

    series    planned readings, with joints of each machine or the same for all
    captured  (m, N) which of them are captured
    root      R (free, free) of the prior; the identity by default

    Fixed parameters stay as in `start`. Raises IdentificationError where a fit does not
    converge.
    """
    by_machine = [
        _captured_series(measurement, series, k, c) for k, c in enumerate(captured)
    ]
    noises = [measurement.noise(s) if s else None for s in by_machine]
    free = np.flatnonzero(measurement.free)
    basis = np.zeros((len(measurement.nominal), len(free)))
    basis[free] = np.diag(measurement.tolerance[free])
    if root is not None:
        basis = basis @ root
    origin = start.copy()
    origin[:, free] = measurement.nominal[free]
    problem = _CapturedReadings(measurement, series, noises, captured, y, origin, basis)
    offsets = (start - origin)[:, free]
    z = np.asarray(np.linalg.lstsq(basis[free], offsets.T, rcond=None)[0].T, float)
    # a pose that is not captured may be one that cannot be assembled
    return [
        _refit_alone(problem, k, by_machine[k], z[k], root is None)
        if fit is None
        else fit
        for k, fit in enumerate(_refits(problem, z))
    ]


def _refits(problem: "_CapturedReadings", z: Array) -> list[Refit | None]:
    """Fits of all machines from z (m, k); None where one does not converge."""
    minima = minimise(problem, z, precision=NEAR_STEP)
    theta = problem.theta(np.arange(len(z)), minima.z)
    return [
        Refit(theta[k], _covariance(problem.basis, minima.slopes[k]))
        if minima.converged[k]
        else None
        for k in range(len(z))
    ]


def _refit_alone(
    problem: "_CapturedReadings",
    machine: int,
    series: Sequence[Series],
    z: Array,
    prior_is_stated: bool,
) -> Refit:
    """One machine's fit from z (k,) to its captures. IdentificationError."""
    measurement = problem.measurement
    y = problem.y[machine, problem.captured[machine]]
    alone = dataclasses.replace(
        problem,
        series=series,
        noises=[problem.noises[machine]],
        captured=np.ones((1, len(y)), dtype=bool),
        y=y[None],
        origin=problem.origin[machine][None],
    )
    (fit,) = _refits(alone, z[None])
    if fit is not None:
        return fit
    if not prior_is_stated:
        raise IdentificationError(
            "the fit of a virtual machine does not converge; start from a smaller covariance"
        )
    start = alone.theta(np.arange(1), z[None])[0]
    estimate = identify(measurement, series, y, start=start)
    return Refit(estimate.theta, estimate.covariance)


def _covariance(basis: Array, jacobian: Array) -> Array:
    """Posterior covariance (n, n), SI, from whitened jacobian (N, k) over z."""
    return np.asarray(basis @ posterior_covariance(jacobian) @ basis.T)


def _captured_series(
    measurement: Measurement, series: Sequence[Series], machine: int, captured: Mask
) -> list[Series]:
    """The captured readings (N,) of one machine; series without any are left out."""
    parts = []
    start = 0
    for s in series:
        channels = len(measurement.setups[s.setup].sigma)
        end = start + channels * len(s)
        rows = np.flatnonzero(captured[start:end:channels])
        start = end
        if len(rows):
            parts.append(s.of_machines(machine).take(rows))
    return parts


@dataclasses.dataclass(frozen=True, eq=False)
class _CapturedReadings:
    """Readings y (m, N), SI, of m machines that are captured in part, over z (m, k)."""

    measurement: Measurement
    series: Sequence[Series]
    #: of what each machine's readings capture; None where that is nothing
    noises: Sequence[Noise | None]
    captured: Mask
    y: Array
    origin: Array  #: (m, n) parameters at z = 0, SI
    basis: Array  #: (n, k) changes of the parameters, SI, per z

    @functools.cached_property
    def magnitude(self) -> Array:
        """Sizes (m, N) of the whitened readings."""
        return self._whiten(np.arange(len(self.y)), np.abs(self.y))

    def theta(self, machines: Index, z: Array) -> Array:
        """Parameters (s, n), SI."""
        return np.asarray(self.origin[machines] + z @ self.basis.T)

    def residuals(self, machines: Index, z: Array) -> Array:
        """Whitened residuals (s, N); NaN where a captured pose cannot be assembled."""
        series = self._series(machines)
        expected = self.measurement.try_readings(series, self.theta(machines, z))
        return self._whiten(machines, self.y[machines] - expected)

    def slopes(self, machines: Index, z: Array) -> Array:
        """Whitened jacobian (s, N, k). Raises AssemblyError."""
        theta = self.theta(machines, z)
        jacobian = self.measurement.jacobian(self._series(machines), theta)
        return self._whiten(machines, jacobian @ self.basis)

    def _series(self, machines: Index) -> list[Series]:
        return [s.of_machines(machines) for s in self.series]

    def _whiten(self, machines: Index, values: Array) -> Array:
        """Values (s, N, ...), the captured ones whitened, the others 0."""
        white = np.zeros_like(values)
        for k, machine in enumerate(machines):
            captured, noise = self.captured[machine], self.noises[machine]
            if noise is not None:
                white[k, captured] = noise.whiten(values[k, captured])
        return white


HALF_WIDTH = 1.959964  #: standard deviations to either side of a 95 % interval
#: share of a component's widest interval below which an interval is left out
STILL_STEP = 1e-6


class MachineErrors(NamedTuple):
    """m machines after one stage."""

    mean_square: Array  #: (m, K) pose errors over the workspace, SI
    lost_share: Array  #: (m,) share of the candidates lost in the stage
    coverage: Array  #: (m,) share of the parameters within their 95 % intervals
    pose_coverage: Array  #: (m,) share of the pose errors within their 95 % intervals


@dataclasses.dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Errors at workspace commands, relative to a reference.

    tolerance  (np,) of the machine's parameters, SI
    maps       jacobian of the errors over the parameters
    poses      (n + 1, n_dof) the commands, home the last, SI
    """

    kinematics: Kinematics
    tolerance: Array
    maps: ErrorMaps
    poses: Array
    reference: Reference

    @classmethod
    def of(
        cls, measurement: Measurement, command: Array, reference: Reference
    ) -> "WorkspaceErrors":
        """Errors of a measurement's machine at commands (n, n_dof), SI."""
        kinematics = measurement.kinematics
        machine = kinematics.machine
        return cls(
            kinematics=kinematics,
            tolerance=measurement.tolerance[: len(machine.parameters)],
            maps=ErrorMaps.of(kinematics, command, reference),
            poses=machine.and_home(command, NO_TOOL),
            reference=reference,
        )

    def predicted(self, covariance: Array) -> Array:
        """Predicted rms errors (K,), SI, of a covariance (n, n) in tolerances."""
        free = np.flatnonzero(self.tolerance > 0.0)
        scale = np.outer(self.tolerance[free], self.tolerance[free])
        full = np.zeros((len(self.tolerance), len(self.tolerance)))
        full[np.ix_(free, free)] = covariance * scale
        return np.asarray(np.sqrt(np.mean(self.variance(full), axis=0)))

    def variance(self, covariance: Array) -> Array:
        """Variance (n, K) of the components, from a covariance (np, np), SI."""
        jacobian = self.maps.raw
        variance = np.einsum(
            "nkp,pq,nkq->nk", jacobian, covariance, jacobian, optimize=True
        )
        return np.asarray(np.maximum(variance, 0.0))

    def evaluate(
        self,
        controller: Array,
        believed: Array,
        truth: Array,
        covariance: Array,
        lost_share: Array,
    ) -> MachineErrors:
        """Errors of m machines, and how many lie within the intervals of a covariance.

        controller, believed, truth  (m, np) parameters, SI
        covariance                   (m, np, np) of the believed parameters, SI
        lost_share                   (m,)
        """
        errors = self.errors(controller, believed, truth)
        half = HALF_WIDTH * np.sqrt([self.variance(c) for c in covariance])
        # what hardly moves, as the home pose itself, has errors of rounding alone
        moved = half > STILL_STEP * half.max(axis=1, keepdims=True)
        within = moved & (np.abs(errors) <= half)
        free = self.tolerance > 0.0
        variances = np.diagonal(covariance, axis1=1, axis2=2)[:, free]
        deviation = np.abs(truth - believed)[:, free]
        return MachineErrors(
            mean_square=np.mean(errors**2, axis=1),
            lost_share=lost_share,
            coverage=(deviation <= HALF_WIDTH * np.sqrt(variances)).mean(axis=1),
            pose_coverage=within.sum(axis=(1, 2)) / moved.sum(axis=(1, 2)),
        )

    def errors(self, controller: Array, believed: Array, truth: Array) -> Array:
        """Pose errors (m, n, K), SI, of true from believed machines.

        A lost turn at home is zeroed about the axes of the believed machine.
        """
        machines, n = len(truth), len(self.poses)
        sent = np.repeat(controller, n, axis=0)
        start, q = self.kinematics.inverse(np.tile(self.poses, (machines, 1)), sent)
        rotation, point = self._frames(q, np.repeat(believed, n, axis=0), start)
        true = self._frames(q, np.repeat(truth, n, axis=0), start)
        twist = twist_between(rotation, point, *true)
        lever = self.kinematics.machine.alignment_lever
        errors = []
        for part in consecutive_slices([n] * machines):
            frame = twist[part], rotation[part], point[part]
            referenced = relative_to_reference(*frame, self.reference, lever)
            errors.append(
                self.kinematics.error_components(self.maps.command, referenced)
            )
        return np.array(errors)

    def _frames(self, q: Array, p: Array, start: Array) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and points (n, 3) of the platform at joints q, p each."""
        pose = self.kinematics.forward_per_pose(q, p, start)
        rotation, point, _ = self.kinematics.frames(pose, NO_TOOL)
        return rotation, point


MACHINES_AT_ONCE = 50  #: machines whose poses are computed together


@dataclasses.dataclass(frozen=True, eq=False)
class StageRealisation:
    """One stage, over all virtual machines."""

    name: str  #: of the option
    #: (K,) root mean square of each pose component over workspace and machines, SI
    predicted: Array
    realised: Array  #: (K,) the same of the virtual machines
    predicted_loss: float  #: share of the chosen candidates expected to be lost
    realised_loss: float  #: share that virtual machines lost
    coverage: float  #: share of the true parameters within their 95 % intervals
    pose_coverage: float  #: share of the true pose errors within their 95 % intervals

    @property
    def ratio(self) -> Array:
        """Realised over predicted (K,); NaN for a component that nothing moves."""
        moved = self.predicted > 0.0
        divisor = np.where(moved, self.predicted, 1.0)
        return np.where(moved, self.realised / divisor, np.nan)


@dataclasses.dataclass(frozen=True, eq=False)
class PlanRealisation:
    """A plan's stages on virtual machines; `names` (K,) of the pose components."""

    names: tuple[str, ...]
    machines: int
    stages: tuple[StageRealisation, ...]


def propagate(
    stages: Sequence[PlanStage],
    command: Array,
    machines: int,
    rng: np.random.Generator,
    *,
    reference: Reference = "home",
    start: Array | None = None,
    progress: Callable[[float], None] | None = None,
) -> PlanRealisation:
    """Propagate virtual machines through the stages.

    The controller receives what each stage identifies.

    command  (n, n_dof) workspace commands at which errors are evaluated, SI
    start    (n, n) covariance of the machine before, in units of the tolerances; by
             default the tolerances. Machines are drawn about the nominal one

    Raises ValueError where there is no stage or no machine, IdentificationError where a
    fit does not converge.
    """
    if not stages or machines < 1:
        raise ValueError(
            f"{len(stages)} stages and {machines} machines: at least one of each is needed"
        )
    measurement = stages[0].option.measurement
    workspace = WorkspaceErrors.of(measurement, command, reference)
    propagation = _Propagation(prepare_stages(stages), workspace, start)
    batches: list[list[MachineErrors]] = []
    done = 0
    while done < machines:
        count = min(MACHINES_AT_ONCE, machines - done)
        batches.append(propagation.carry_out(count, rng))
        done += count
        if progress is not None:
            progress(done / machines)
    summaries = [
        _summary(stage, workspace, [batch[k] for batch in batches])
        for k, stage in enumerate(stages)
    ]
    return PlanRealisation(workspace.maps.names, machines, tuple(summaries))


def _summary(
    stage: PlanStage, workspace: WorkspaceErrors, batches: Sequence[MachineErrors]
) -> StageRealisation:
    """One stage over all virtual machines."""
    whole = MachineErrors(*map(np.concatenate, zip(*batches, strict=True)))
    return StageRealisation(
        name=stage.option.name,
        predicted=workspace.predicted(stage.covariance),
        realised=np.sqrt(whole.mean_square.mean(axis=0)),
        predicted_loss=stage.lost_share,
        realised_loss=float(whole.lost_share.mean()),
        coverage=float(whole.coverage.mean()),
        pose_coverage=float(whole.pose_coverage.mean()),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Propagation:
    stages: tuple[VirtualStage, ...]
    workspace: WorkspaceErrors
    start: Array | None

    def carry_out(self, machines: int, rng: np.random.Generator) -> list[MachineErrors]:
        """Errors of some virtual machines after each stage."""
        truth, normals = self._draw_machines(machines, rng)
        parameters = len(self.workspace.kinematics.held)
        first = self.stages[0].measurement.nominal[:parameters]
        theta = np.tile(first, (machines, 1))
        readings: list[VirtualReadings] = []
        errors = []
        for stage, of_stage in zip(self.stages, normals, strict=True):
            measurement = stage.measurement
            # the parameters of the set-ups mounted now are believed to be nominal
            believed = np.tile(measurement.nominal, (machines, 1))
            believed[:, : theta.shape[1]] = theta
            known_truth = truth[:, : believed.shape[1]]
            controller = believed[:, :parameters]
            readings.append(stage.read(known_truth, believed, controller, of_stage))
            theta, covariance = self._identify(readings, believed)
            identified = theta[:, :parameters]
            errors.append(
                self.workspace.evaluate(
                    identified,
                    identified,
                    truth[:, :parameters],
                    covariance[:, :parameters, :parameters],
                    readings[-1].lost_share,
                )
            )
        return errors

    def _draw_machines(
        self, machines: int, rng: np.random.Generator
    ) -> tuple[Array, list[Array]]:
        """True parameters (m, n), and normal numbers (m, readings) of each stage."""
        measurement = self.stages[-1].measurement
        sizes = [len(stage.candidate) for stage in self.stages]
        truth, normals = [], []
        for _ in range(machines):
            truth.append(self._draw(measurement, rng))
            normals.append(rng.standard_normal(sum(sizes)))
        ends = np.cumsum(sizes)[:-1]
        return np.array(truth), np.split(np.array(normals), ends, axis=1)

    def _identify(
        self, readings: Sequence[VirtualReadings], believed: Array
    ) -> tuple[Array, Array]:
        """Parameters (m, n) and covariances (m, n, n), SI, from all readings so far."""
        measurement = self.stages[len(readings) - 1].measurement
        fits = refit_machines(
            measurement,
            [s for stage in readings for s in stage.series],
            np.hstack([stage.y for stage in readings]),
            np.hstack([stage.captured for stage in readings]),
            believed,
            self._prior_root(measurement),
        )
        theta = np.array([fit.theta for fit in fits])
        return theta, np.array([fit.covariance for fit in fits])

    def _prior_root(self, measurement: Measurement) -> Array | None:
        """R (free, free), R R^T the prior covariance; None for the tolerances alone."""
        if self.start is None:
            return None
        root = np.eye(int(measurement.free.sum()))
        n = len(self.start)
        root[:n, :n] = symmetric_root(self.start[None])[0]
        return root

    def _draw(self, measurement: Measurement, rng: np.random.Generator) -> Array:
        """True parameters (n,) of a machine and of all set-ups."""
        truth = draw_parameters(measurement, rng)
        root = self._prior_root(measurement)
        if root is not None:
            free = measurement.free
            nominal = measurement.nominal[free]
            tolerance = measurement.tolerance[free]
            normals = (truth[free] - nominal) / tolerance
            truth[free] = nominal + tolerance * (root @ normals)
        return truth
