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

from oed.accuracy import prediction
from oed.base import Array
from oed.design.stages.stage.prediction import PlanStage
from oed.design.stages.virtual_machines.readings import (
    VirtualReadings,
    VirtualStage,
    prepare_stages,
)
from oed.design.stages.virtual_machines.refit import refit_machines
from oed.design.stages.virtual_machines.workspace import MachineErrors, WorkspaceErrors
from oed.linear_algebra import symmetric_root
from oed.measurement import Measurement, draw_parameters

#: machines whose poses are computed together
TOGETHER = 50


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
    realised: list[list[MachineErrors]] = []
    while len(realised) < machines:
        count = min(TOGETHER, machines - len(realised))
        realised += propagation.carry_out(count, rng)
        if progress is not None:
            progress(len(realised) / machines)
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

    def carry_out(
        self, machines: int, rng: np.random.Generator
    ) -> list[list[MachineErrors]]:
        """Errors of some virtual machines after each stage, machine by machine."""
        truth, normals = self._draw_machines(machines, rng)
        held = np.tile(self.workspace.kinematics.held, (machines, 1))
        parameters = held.shape[1]
        first = self.stages[0].measurement.nominal[:parameters]
        theta = np.tile(first, (machines, 1))
        readings: list[VirtualReadings] = []
        errors = []
        for stage, of_stage in zip(self.stages, normals, strict=True):
            measurement = stage.measurement
            # the parameters of the set-ups mounted now are believed to be nominal
            believed = np.tile(measurement.nominal, (machines, 1))
            believed[:, : theta.shape[1]] = theta
            known = truth[:, : believed.shape[1]]
            expected = np.tile(measurement.nominal, (machines, 1))
            controller = None
            if self.compensated:
                expected, controller = believed, believed[:, :parameters]
            readings.append(stage.read(known, expected, controller, of_stage))
            theta, covariance = self._identify(readings, believed)
            identified = theta[:, :parameters]
            errors.append(
                self.workspace.evaluate(
                    identified if self.compensated else held,
                    identified,
                    truth[:, :parameters],
                    covariance[:, :parameters, :parameters],
                    readings[-1].lost_share,
                )
            )
        return [list(of_machine) for of_machine in zip(*errors, strict=True)]

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
        """R (free, free), R R^T the prior covariance of machine and set-ups.

        None stands for the identity: the tolerances alone.
        """
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
