"""Readings of a machine by its instruments, and their derivatives.

A reading y = g(x_1, x_2, s) sees one pose, or two (a taught cup, a reference); each
pose obeys the closure at the joints that the controller sent. Its identification row is

    dy/d(p, s) = [ sum_j g_xj dx_j/dp,  g_s ],        dx/dp = -phi_x^-1 phi_p   (joints fixed).
"""

from __future__ import annotations

import functools
from collections.abc import Callable, Sequence

import numpy as np

from oed.base.arrays import Array, Mask
from oed.measurement import reading_noise
from oed.measurement.fixed_reading import solve_coordinate
from oed.measurement.observation import ObservationModel, Response
from oed.mechanism.adjoints import PoseAdjoints
from oed.mechanism.kinematics import AssemblyError, Kinematics
from oed.mechanism.nearby_poses import NearbyPoses
from oed.mechanism.pose_cache import PoseCache
from oed.model.instrument import Setup
from oed.model.machine import Machine
from oed.model.parameter_vector import ParameterVector
from oed.model.series import Series, TakenReadings, index_poses, run_labels
from oed.noise.covariance import Noise, concatenate_noise

__all__ = ["Measurement", "Response", "Series"]


class Measurement(ParameterVector):
    """A machine with its set-ups: predicts readings and their slopes.

    setups      set-ups by name
    kinematics  of the machine; compiled here unless they are given

    Raises ValueError where an instrument cannot read the machine, or names repeat.

    >>> import numpy as np
    >>> from oed import Measurement, mount
    >>> from pkm_models.instruments.pose_tracker import position
    >>> from pkm_models.machines.planar_2dof import machine
    >>> measurement = Measurement(machine, [mount(position, "tracker")])
    >>> series = measurement.series("tracker", np.array([[0.0, 0.5], [1.0, 0.5]]))
    >>> y = measurement.readings([series], measurement.nominal)
    >>> y.reshape(2, 3).round(6)  # x, y and z of the tool point at both commands, m
    array([[0. , 0. , 0.5],
           [0. , 1. , 0.5]])
    >>> measurement.jacobian([series], measurement.nominal).shape
    (6, 13)
    """

    def __init__(
        self,
        machine: Machine,
        setups: Sequence[Setup],
        kinematics: Kinematics | None = None,
    ) -> None:
        super().__init__(machine, setups)
        for setup in setups:
            setup.check_fit(machine)
        self.kinematics = kinematics or Kinematics(machine)
        self.setups = {setup.name: setup for setup in setups}
        self._models = {s.name: ObservationModel(machine, s) for s in setups}
        self._poses_at = PoseCache()

    def with_setups(self, setups: Sequence[Setup]) -> Measurement:
        """The same machine with other set-ups; its kinematics are shared."""
        return Measurement(self.machine, setups, self.kinematics)

    # -- series ------------------------------------------------------------------------

    def series(
        self,
        setup: str,
        command: Array,
        run: Sequence[str] | None = None,
        controller: Array | None = None,
    ) -> Series:
        """Readings at commanded poses (n, n_dof), SI.

        run         label of each pose's run; one run by default
        controller  (np,) parameters that the controller believes in; nominal by default

        For instruments with a run reference the first pose of each run is the
        reference, and no reading. Raises AssemblyError for poses out of reach.
        """
        mounted = self.setups[setup]
        command = np.atleast_2d(np.asarray(command, dtype=float))
        labels = run_labels(run, len(command))
        if mounted.teach is not None:
            command = np.vstack([command, np.array(mounted.teach)[None]])
        x, q = self.kinematics.inverse(command, controller, np.array(mounted.tool))
        index, labels = index_poses(mounted.instrument, labels)
        return Series(setup, q, x, command, index, labels)

    def series_from_joints(
        self, setup: str, q: Array, run: Sequence[str] | None = None
    ) -> Series:
        """As `series`, from recorded joints (n, nq), SI; their commands are NaN."""
        mounted = self.setups[setup]
        q = np.atleast_2d(np.asarray(q, dtype=float))
        labels = run_labels(run, len(q))
        x = self.kinematics.start_poses(q)
        command = np.full((len(q), len(self.machine.command)), np.nan)
        if mounted.teach is not None:
            teach = np.array(mounted.teach)[None]
            tool = np.array(mounted.tool)
            teach_x, teach_q = self.kinematics.inverse(teach, None, tool)
            q, x = np.vstack([q, teach_q]), np.vstack([x, teach_x])
            command = np.vstack([command, teach])
        index, labels = index_poses(mounted.instrument, labels)
        return Series(setup, q, x, command, index, labels)

    def commands_at_fixed_reading(
        self, setup: str, command: Array, coordinate: str
    ) -> tuple[Array, Mask]:
        """Solve one command coordinate for the reading that the instrument keeps.

        A ball bar of fixed length leads the tool on a sphere about its cup. Returns
        the commands (n, n_dof), and the mask (n,) of those that have a solution within
        the coordinate's range. Raises ValueError where the instrument keeps no reading.
        """
        mounted = self.setups[setup]
        if mounted.instrument.fixed_reading is None:
            raise ValueError(
                f"{mounted.instrument.name} holds no reading by design: give"
                f" {coordinate} itself"
            )
        wanted = mounted.instrument.fixed_reading(mounted.settings)
        column = [c.name for c in self.machine.command].index(coordinate)
        limits = self.machine.workspace(mounted.tool)[column]

        def read(poses: Array) -> Array:
            return self.readings([self.series(setup, poses)], self.nominal)

        return solve_coordinate(read, wanted, command, column, limits)

    # -- readings ----------------------------------------------------------------------

    def readings(self, series: Sequence[Series], theta: Array) -> Array:
        """Exact nonlinear readings y (N,) at theta (n,), or (m, N) at theta (m, n); SI.

        Series after series, channels innermost. Raises AssemblyError where a pose
        cannot be assembled.
        """
        y = self.try_readings(series, theta)
        if np.isnan(y).any():
            # solve again, for the error that states the failing poses
            for s in series:
                self._poses(s, np.atleast_2d(theta), strict=True)
            raise AssemblyError(
                f"{self.machine.name}: readings are not finite",
                np.flatnonzero(np.isnan(y)),
            )
        return y

    def try_readings(
        self, series: Sequence[Series], theta: Array, wanted: Mask | None = None
    ) -> Array:
        """As `readings`, with NaN where a pose cannot be assembled.

        wanted  (m, N) for theta (m, n): readings to compute; others may be NaN
        """
        vectors = np.atleast_2d(theta)
        parts: list[Mask | None] = [None] * len(series)
        if wanted is not None:
            numbers = [len(s) * len(self.setups[s.setup].sigma) for s in series]
            parts = list(np.split(wanted, np.cumsum(numbers)[:-1], axis=1))
        y = [self._read(s, vectors, w) for s, w in zip(series, parts, strict=True)]
        return np.hstack(y)[0] if theta.ndim == 1 else np.hstack(y)

    def readings_near(
        self, series: Sequence[Series], theta: Array
    ) -> Callable[[Array], Array]:
        """A faster `try_readings` for vectors (m, n) near theta (n,).

        Poses take the slopes at theta (`oed.mechanism.nearby_poses`).
        """
        size = len(self.machine.parameters)
        nearby = [
            NearbyPoses(self.kinematics, s.q, theta[:size], self.poses(s, theta))
            for s in series
        ]

        def readings(vectors: Array) -> Array:
            p = vectors[:, :size]
            pairs = zip(series, nearby, strict=True)
            y = [self._read_at(s, poses.solve(p), vectors) for s, poses in pairs]
            return np.hstack(y)

        return readings

    def of_taken(self, taken: Sequence[TakenReadings]) -> Measurement:
        """The measurement of series that have some readings of others."""
        return self

    def perturbed_readings(
        self,
        series: Series,
        theta: Array,
        joints: Array,
        parameters: Array,
        nuisances: Array,
    ) -> Array:
        """Exact readings (N,), SI, where each of m poses has changes of its own.

        joints      (m, nq) added to the joints sent
        parameters  (m, np) added to the machine's parameters
        nuisances   (n, ns) added to the set-up's unknowns at each of n readings

        Raises AssemblyError.
        """
        p, s = self._split(theta, series.setup)
        p, s, q = p + parameters, s + nuisances, series.q + joints
        x = self.kinematics.forward_per_pose(q, p, series.start)
        model, indices = self._models[series.setup], series.pose_indices()
        inputs = [*(x[k] for k in indices), s]
        if model.uses_closure:
            inputs += [*(q[k] for k in indices), p[indices[0]]]
        return model.read(inputs).ravel()

    def jacobian(self, series: Sequence[Series], theta: Array) -> Array:
        """dy/dtheta (N, n) at theta (n,), or (m, N, n) at theta (m, n), SI.

        Raises AssemblyError.
        """
        vectors = np.atleast_2d(theta)
        rows = np.concatenate([self._jacobian(s, vectors) for s in series], axis=1)
        return rows[0] if theta.ndim == 1 else rows

    def response(self, series: Series, theta: Array) -> Response:
        """Slopes of a series' readings over joints, parameters and nuisances, by pose.

        At theta (n,). Raises AssemblyError.
        """
        p, s = self._split(theta, series.setup)
        x = self.poses(series, theta)
        slopes = self._slopes(series, x[None], p[None], s[None])
        by_pose, by_setup, by_parameter = slopes
        by_joint = self.kinematics.joint_sensitivity(x, series.q, p)
        sensitivity = self.kinematics.parameter_sensitivity(x, series.q, p)
        pairs = list(zip(by_pose, series.pose_indices(), strict=True))
        joints = [slope @ by_joint[k] for slope, k in pairs]
        inputs = self._inputs(series, x[None], p[None], s[None])
        at_fixed_poses = self._models[series.setup].joint_slopes(inputs)
        if at_fixed_poses is not None:
            joints = [a + b for a, b in zip(joints, at_fixed_poses, strict=True)]
        parameters = [slope @ sensitivity[k] for slope, k in pairs]
        if by_parameter is not None:
            parameters[0] = parameters[0] + by_parameter
        return Response(tuple(joints), tuple(parameters), by_setup)

    def poses(self, series: Series, theta: Array) -> Array:
        """True poses (m, nx) of a series at theta (n,). Raises AssemblyError."""
        return np.asarray(self._poses(series, theta[None], strict=True)[0])

    # -- noise, and what belongs to each reading ---------------------------------------

    def noise(self, series: Sequence[Series]) -> Noise:
        """Stated noise of the readings (N,) at their nominal poses, SI."""
        return concatenate_noise(
            [
                reading_noise.stated_noise(
                    self.setups[s.setup], self._models[s.setup], s, self.run_errors(s)
                )
                for s in series
            ]
        )

    def run_errors(self, series: Series) -> Array:
        """Slopes (n, channels, k), SI, over the k stated errors that a run shares.

        Each error is standard normal: levels of channels, then unknowns that the run
        seats anew. Slopes are those at the nominal poses.
        """
        setup = self.setups[series.setup]
        levels = reading_noise.level_errors(setup, len(series))
        if not setup.statement.seating:
            return levels
        p, s = self._split(self.nominal, series.setup)
        by_setup = self._slopes(series, series.start[None], p[None], s[None])[1]
        renewed = [n.name in setup.instrument.renewed for n in setup.nuisances]
        seated = by_setup[:, :, renewed] * setup.statement.seating
        return np.concatenate([levels, seated], axis=2)

    def sigma(self, series: Sequence[Series]) -> Array:
        """Standard deviation (N,) of each reading's stated noise, SI."""
        return self.noise(series).sigma

    def reading_covariances(self, series: Series) -> Array:
        """Covariance (n, channels, channels), SI, of each reading without its run's."""
        setup, model = self.setups[series.setup], self._models[series.setup]
        return reading_noise.reading_covariances(setup, model, series)

    def source_slopes(self, series: Series) -> Array:
        """Slopes (n, channels, sources), SI, over the errors inside the instrument."""
        setup, model = self.setups[series.setup], self._models[series.setup]
        return reading_noise.source_slopes(setup, model, series)

    def setup_of_readings(self, series: Sequence[Series]) -> list[str]:
        """Set-up of each reading (N,), in the order of `readings`."""
        sizes = [len(s) * len(self.setups[s.setup].sigma) for s in series]
        return [s.setup for s, n in zip(series, sizes, strict=True) for _ in range(n)]

    def reading_length_factors(self, series: Sequence[Series]) -> Array:
        """Factor (N,) that turns each reading into a length, m.

        It is the machine's lever for angles and ratios.
        """
        lever = self.machine.lever
        factors = []
        for s in series:
            channels = self.setups[s.setup].instrument.channels
            of_reading = [1.0 if c.unit == "m" else lever for c in channels]
            factors.append(np.tile(of_reading, len(s)))
        return np.concatenate(factors)

    # -- one series --------------------------------------------------------------------

    def _split(self, theta: Array, setup: str) -> tuple[Array, Array]:
        """The machine's parameters and a set-up's nuisances in theta (..., n)."""
        p = theta[..., : len(self.machine.parameters)]
        return p, theta[..., self.nuisance_slice(setup)]

    def _poses(
        self, series: Series, theta: Array, *, strict: bool, wanted: Mask | None = None
    ) -> Array:
        """Poses (m, poses, nx) at theta (m, n); NaN for failures unless `strict`."""
        p = theta[:, : len(self.machine.parameters)]
        if len(p) == 1 or series.q.ndim == 3:
            return self._poses_once(series, p, strict=strict)
        if strict:
            return self.kinematics.forward(series.q, p, series.start)
        arguments = (series.q, p, series.start)
        x, failed = self.kinematics.try_forward(*arguments, wanted=wanted)
        return np.where(failed[..., None], np.nan, x)

    def _poses_once(self, series: Series, p: Array, *, strict: bool) -> Array:
        """Poses (m, poses, nx) at one vector (1, np), or one a machine; solved once."""
        arguments = (series.q, p, series.start)
        x = self._poses_at.recall(series.setup, *arguments)
        if x is not None:
            return x
        if strict:
            x = self.kinematics.forward(*arguments)
        else:
            x, failed = self.kinematics.try_forward(*arguments)
            if failed.any():
                return np.where(failed[..., None], np.nan, x)
        self._poses_at.store(series.setup, x, *arguments)
        return x

    def _read(self, series: Series, theta: Array, wanted: Mask | None = None) -> Array:
        """Readings (m, N of the series) at theta (m, n), NaN where not assembled."""
        poses = None
        if wanted is not None:
            by_reading = wanted.reshape(len(wanted), len(series), -1)
            poses = series.poses_of(np.asarray(by_reading.any(axis=2)))
        x = self._poses(series, theta, strict=False, wanted=poses)
        return self._read_at(series, x, theta)

    def _read_at(self, series: Series, x: Array, theta: Array) -> Array:
        """Readings (m, N of the series) at poses x (m, poses, nx) and theta (m, n)."""
        p, s = self._split(theta, series.setup)
        inputs = self._inputs(series, x, p, s)
        return self._models[series.setup].read(inputs).reshape(len(theta), -1)

    def _jacobian(self, series: Series, theta: Array) -> Array:
        """Slopes (m, N of the series, n) at theta (m, n)."""
        p, s = self._split(theta, series.setup)
        x = self._poses(series, theta, strict=True)
        by_pose, by_setup, by_parameter = self._slopes(series, x, p, s)
        joints = self._joints(series, len(x))
        adjoints = PoseAdjoints(self.kinematics, x, joints, p)
        shape = (len(x), len(series), by_setup.shape[1])
        pairs = zip(by_pose, series.pose_indices(), strict=True)
        parts = [adjoints.pull_back(g.reshape(*shape, -1), k) for g, k in pairs]
        if by_parameter is not None:
            parts.append(by_parameter.reshape(*shape, -1))
        rows = np.zeros((*shape, theta.shape[1]))
        rows[..., : p.shape[1]] = functools.reduce(np.add, parts)
        rows[..., self.nuisance_slice(series.setup)] = by_setup.reshape(*shape, -1)
        return rows.reshape(len(x), -1, theta.shape[1])

    def _inputs(self, series: Series, x: Array, p: Array, s: Array) -> list[Array]:
        """Inputs of the observation model, m times the readings n.

        Poses x (m, poses, nx), parameters p (m, np), the set-up's unknowns s (m, ns).
        """
        model, indices = self._models[series.setup], series.pose_indices()
        m, n = len(x), len(series)
        inputs = [x[:, k].reshape(m * n, -1) for k in indices]
        inputs.append(np.repeat(s, n, axis=0))
        if model.uses_closure:
            q = self._joints(series, m)
            inputs += [q[:, k].reshape(m * n, -1) for k in indices]
            inputs.append(np.repeat(p, n, axis=0))
        return inputs

    def _joints(self, series: Series, machines: int) -> Array:
        """Joints (m, poses, nq) of so many machines."""
        return np.broadcast_to(series.q, (machines, *series.q.shape[-2:]))

    def _slopes(
        self, series: Series, x: Array, p: Array, s: Array
    ) -> tuple[list[Array], Array, Array | None]:
        """Slopes of a series' readings, as `ObservationModel.slopes`, m times n."""
        inputs = self._inputs(series, x, p, s)
        return self._models[series.setup].slopes(inputs)
