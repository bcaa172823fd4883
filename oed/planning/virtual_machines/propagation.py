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

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np

from oed import prediction, simulation
from oed.arrays import Array
from oed.measurement import Measurement, Series
from oed.planning.stage.knowledge import square_roots
from oed.planning.stage.prediction import PlanStage
from oed.planning.virtual_machines.readings import VirtualStage, prepare_stages
from oed.planning.virtual_machines.refit import refit
from oed.planning.virtual_machines.workspace import MachineErrors, WorkspaceErrors


@dataclasses.dataclass(frozen=True, eq=False)
class StageRealisation:
    """One stage, over all virtual machines.

    name            of the option
    predicted       (K,) root mean square of each pose component over workspace and
                    machines, SI
    realised        (K,) the same of the virtual machines
    predicted_loss  share of the chosen candidates expected to be lost
    realised_loss   share that virtual machines lost
    coverage        share of the true parameters within their 95 % intervals
    pose_coverage   share of the true pose errors within their 95 % intervals
    """

    name: str
    predicted: Array
    realised: Array
    predicted_loss: float
    realised_loss: float
    coverage: float
    pose_coverage: float

    @property
    def ratio(self) -> Array:
        """Realised over predicted (K,); NaN for a component that nothing moves."""
        moved = self.predicted > 0.0
        divisor = np.where(moved, self.predicted, 1.0)
        return np.asarray(np.where(moved, self.realised / divisor, np.nan))


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
    reference: prediction.Reference = "home",
    compensated: bool = True,
    start: Array | None = None,
    progress: Callable[[float], None] | None = None,
) -> PlanRealisation:
    """Propagate virtual machines through the stages.

    command      (n, n_dof) workspace commands at which errors are evaluated, SI
    compensated  whether the controller receives what each stage identifies; else it
                 stays nominal, and so do the readings that it expects
    start        (n, n) covariance of the machine before, in units of the tolerances;
                 by default the tolerances. Machines are drawn about the nominal one

    Raises ValueError where there is no stage or no machine, IdentificationError where a
    fit does not converge.
    """
    if not stages or machines < 1:
        raise ValueError(
            f"{len(stages)} stages and {machines} machines: at least one of each is"
            " needed"
        )
    measurement = stages[0].option.measurement
    workspace = WorkspaceErrors.of(measurement, command, reference)
    propagation = _Propagation(prepare_stages(stages), workspace, compensated, start)
    realised = []
    for k in range(machines):
        realised.append(propagation.one_machine(rng))
        if progress is not None:
            progress((k + 1) / machines)
    summaries = [
        _summary(stage, workspace, [machine[k] for machine in realised])
        for k, stage in enumerate(stages)
    ]
    return PlanRealisation(workspace.maps.names, machines, tuple(summaries))


def _summary(
    stage: PlanStage, workspace: WorkspaceErrors, machines: Sequence[MachineErrors]
) -> StageRealisation:
    """One stage over all virtual machines."""
    mean_square = np.mean([m.mean_square for m in machines], axis=0)
    return StageRealisation(
        name=stage.option.name,
        predicted=workspace.predicted(stage.covariance),
        realised=np.sqrt(mean_square),
        predicted_loss=stage.lost_share,
        realised_loss=float(np.mean([m.lost_share for m in machines])),
        coverage=float(np.mean([m.coverage for m in machines])),
        pose_coverage=float(np.mean([m.pose_coverage for m in machines])),
    )


@dataclasses.dataclass(frozen=True, eq=False)
class _Propagation:
    stages: tuple[VirtualStage, ...]
    workspace: WorkspaceErrors
    compensated: bool
    start: Array | None

    def one_machine(self, rng: np.random.Generator) -> list[MachineErrors]:
        """Errors of one virtual machine after each stage."""
        truth = self._draw(self.stages[-1].measurement, rng)
        machine = self.workspace.kinematics.machine
        parameters = len(self.workspace.tolerance)
        theta = machine.nominal
        series: tuple[Series, ...] = ()
        y: list[Array] = []
        errors = []
        for stage in self.stages:
            measurement = stage.measurement
            # the parameters of the set-ups mounted now are believed to be nominal
            of_new_setups = measurement.nominal[len(theta) :]
            believed = np.concatenate([theta, of_new_setups])
            expected = believed if self.compensated else measurement.nominal
            controller = believed[:parameters] if self.compensated else None
            readings = stage.read(truth[: len(believed)], expected, controller, rng)
            series = series + readings.series
            y.append(readings.y)
            theta, covariance = self._identify(measurement, series, y, believed)
            identified = theta[:parameters]
            errors.append(
                self.workspace.evaluate(
                    identified if self.compensated else machine.nominal,
                    identified,
                    truth[:parameters],
                    covariance[:parameters, :parameters],
                    readings.lost_share,
                )
            )
        return errors

    def _identify(
        self,
        measurement: Measurement,
        series: Sequence[Series],
        y: Sequence[Array],
        believed: Array,
    ) -> tuple[Array, Array]:
        """Parameters (n,) and their covariance (n, n), SI, from all readings so far."""
        if not series:
            return believed, self._prior_covariance(measurement)
        root = self._prior_root(measurement)
        fit = refit(measurement, series, np.concatenate(y), believed, root)
        return fit.theta, fit.covariance

    def _prior_root(self, measurement: Measurement) -> Array | None:
        """R (free, free), R R^T the prior covariance of machine and set-ups.

        None stands for the identity: the tolerances alone.
        """
        if self.start is None:
            return None
        root = np.eye(int(measurement.free.sum()))
        n = len(self.start)
        root[:n, :n] = square_roots(self.start[None])[0]
        return root

    def _prior_covariance(self, measurement: Measurement) -> Array:
        """Covariance (n, n) of machine and set-ups before, SI."""
        root, free = self._prior_root(measurement), measurement.free
        covariance = np.diag(measurement.tolerance**2)
        if root is not None:
            scaled = measurement.tolerance[free, None] * root
            covariance[np.ix_(free, free)] = scaled @ scaled.T
        return covariance

    def _draw(self, measurement: Measurement, rng: np.random.Generator) -> Array:
        """True parameters (n,) of a machine and of all set-ups."""
        truth = simulation.draw_parameters(measurement, rng)
        root = self._prior_root(measurement)
        if root is not None:
            free = measurement.free
            nominal = measurement.nominal[free]
            tolerance = measurement.tolerance[free]
            normals = (truth[free] - nominal) / tolerance
            truth[free] = nominal + tolerance * (root @ normals)
        return truth
