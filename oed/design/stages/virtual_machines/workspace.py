"""Pose errors of virtual machines over a workspace, exact and predicted."""

from __future__ import annotations

import dataclasses

import numpy as np

from oed.accuracy import prediction
from oed.base import Array
from oed.measurement import Measurement
from oed.mechanism.error_model import ErrorModel, error_model
from oed.mechanism.kinematics import Kinematics
from oed.mechanism.pose_errors import NO_TOOL, twist_between

#: standard deviations to either side of a 95 % interval
HALF_WIDTH = 1.959964
#: share of a component's widest interval below which an interval is left out
STILL = 1e-6


@dataclasses.dataclass(frozen=True, eq=False)
class MachineErrors:
    """One machine after one stage.

    mean_square    (K,) pose errors over the workspace, SI
    lost_share     share of the candidates that it lost in the stage
    coverage       share of its parameters within their 95 % intervals
    pose_coverage  share of its pose errors within their 95 % intervals
    """

    mean_square: Array
    lost_share: float
    coverage: float
    pose_coverage: float


@dataclasses.dataclass(frozen=True, eq=False)
class WorkspaceErrors:
    """Errors at workspace commands, relative to a reference.

    tolerance  (np,) of the machine's parameters, SI
    maps       slopes of the errors over the parameters
    model      nominal poses at the commands;  home: at the home pose
    """

    kinematics: Kinematics
    tolerance: Array
    maps: prediction.ErrorMaps
    model: ErrorModel
    home: ErrorModel
    reference: prediction.Reference

    @classmethod
    def of(
        cls, measurement: Measurement, command: Array, reference: prediction.Reference
    ) -> WorkspaceErrors:
        """Errors of a measurement's machine at commands (n, n_dof), SI."""
        kinematics = measurement.kinematics
        machine = kinematics.machine
        return cls(
            kinematics=kinematics,
            tolerance=measurement.tolerance[: len(machine.parameters)],
            maps=prediction.error_maps(kinematics, command, reference),
            model=error_model(kinematics, command),
            home=error_model(kinematics, machine.home_command[None]),
            reference=reference,
        )

    def predicted(self, covariance: Array) -> Array:
        """Predicted root mean square errors (K,), SI.

        covariance  (n, n) of the free parameters, in units of their tolerances
        """
        free = np.flatnonzero(self.tolerance > 0.0)
        scale = np.outer(self.tolerance[free], self.tolerance[free])
        full = np.zeros((len(self.tolerance), len(self.tolerance)))
        full[np.ix_(free, free)] = covariance * scale
        return np.asarray(np.sqrt(np.mean(self.variance(full), axis=0)))

    def variance(self, covariance: Array) -> Array:
        """Variance (n, K) of the components, from a covariance (np, np), SI."""
        slopes = self.maps.raw
        variance = np.einsum(
            "nkp,pq,nkq->nk", slopes, covariance, slopes, optimize=True
        )
        return np.asarray(np.maximum(variance, 0.0))

    def evaluate(
        self,
        controller: Array,
        believed: Array,
        truth: Array,
        covariance: Array,
        lost_share: Array,
    ) -> list[MachineErrors]:
        """Errors of m machines, and how many lie within the intervals of a covariance.

        controller, believed, truth  (m, np) parameters, SI
        covariance                   (m, np, np) of the believed parameters, SI
        lost_share                   (m,)
        """
        free = self.tolerance > 0.0
        machines = []
        for k, errors in enumerate(self.errors(controller, believed, truth)):
            half = HALF_WIDTH * np.sqrt(self.variance(covariance[k]))
            # what hardly moves, as the home pose itself, has errors of rounding alone
            moved = half > STILL * half.max(axis=0)
            deviation = np.abs(truth[k] - believed[k])[free]
            parameter_half = HALF_WIDTH * np.sqrt(np.diag(covariance[k]))[free]
            within = (np.abs(errors) <= half)[moved]
            machines.append(
                MachineErrors(
                    mean_square=np.mean(errors**2, axis=0),
                    lost_share=float(lost_share[k]),
                    coverage=float((deviation <= parameter_half).mean()),
                    pose_coverage=float(within.mean()),
                )
            )
        return machines

    def errors(self, controller: Array, believed: Array, truth: Array) -> Array:
        """Exact pose errors (m, n, K), SI, between true and believed machines.

        Both are at the joints that a controller with parameters (m, np) sends.
        """
        poses = self._poses(self.model, controller, believed, truth)
        at_home = self._poses(self.home, controller, believed, truth)
        lever = self.kinematics.machine.alignment_lever
        errors = []
        for (twist, model), (home_twist, home) in zip(poses, at_home, strict=True):
            referenced = prediction.relative_to_reference(
                twist, home_twist, model, home, self.reference, lever
            )
            errors.append(
                self.kinematics.error_components(self.maps.command, referenced)
            )
        return np.array(errors)

    def _poses(
        self, model: ErrorModel, controller: Array, believed: Array, truth: Array
    ) -> list[tuple[Array, ErrorModel]]:
        """For each machine, twists (n, 6) from believed to true poses, and the model at
        believed poses.

        A lost turn at home is zeroed about the axes of the believed machine.
        """
        machines, n = len(truth), len(model.command)
        command = np.tile(model.command, (machines, 1))
        start, q = self.kinematics.inverse(command, np.repeat(controller, n, axis=0))
        rotation, point = self._frames(q, np.repeat(believed, n, axis=0), start)
        true = self._frames(q, np.repeat(truth, n, axis=0), start)
        twist = twist_between(rotation, point, *true)
        return [
            (
                twist[part],
                dataclasses.replace(model, rotation=rotation[part], point=point[part]),
            )
            for part in (slice(k * n, (k + 1) * n) for k in range(machines))
        ]

    def _frames(self, q: Array, p: Array, start: Array) -> tuple[Array, Array]:
        """Rotations (n, 3, 3) and points (n, 3) of the platform at joints q, p each."""
        pose = self.kinematics.forward_per_pose(q, p, start)
        rotation, point, _ = self.kinematics.frames(pose, NO_TOOL)
        return rotation, point
