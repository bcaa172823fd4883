"""Readings of a machine by one set-up, and their jacobians, compiled by CasADi.

A reading sees one pose, or two (a taught cup, a reference); its row is in the README.
"""

import dataclasses
import functools
from collections.abc import Sequence

import casadi as ca
import numpy as np
import scipy

from oed.base import Array, Mask
from oed.instrument import Series, Setup
from oed.mechanism import BatchedFunction, Kinematics, MachineFrame, symbols
from oed.model import Machine
from oed.noise import Errors, FactoredNoise, Noise


class ObservationModel:
    """Reading y = g(x_1, x_2, s) of one set-up, and its Jacobian.

    A reading sees one pose or two; s are the set-up's nuisances. Where the instrument
    reads the misfit of a redundant machine, `uses_closure` is true. Then g depends on
    the joints of each pose and on the machine's parameters as well: its inputs are
    x_1, x_2, s, q_1, q_2, p.
    """

    def __init__(self, machine: Machine, setup: Setup) -> None:
        instrument = setup.instrument
        p, p_by_name = symbols("p", machine.parameters)
        s, s_by_name = symbols("s", setup.nuisances)
        poses, joints, frames = [], [], []
        for j in range(instrument.arity):
            x, x_by_name = symbols(f"x{j}", machine.pose)
            q, q_by_name = symbols(f"q{j}", machine.joints)
            by_name = x_by_name, q_by_name, p_by_name
            poses.append(x)
            joints.append(q)
            frames.append(MachineFrame(machine, x, by_name, ca.DM(setup.tool)))
        y = ca.vertcat(*instrument.observe(frames, s_by_name, setup.settings))
        self.uses_closure = bool(ca.depends_on(y, ca.vertcat(*joints, p)))
        inputs, over = [*poses, s], [*poses, s]
        if self.uses_closure:
            inputs, over = [*poses, s, *joints, p], [*poses, s, p]
        jacobians = [ca.jacobian(y, v) for v in over]
        sources = ca.SX(1, 1)
        if instrument.sources is not None:
            jacobian_of_errors = instrument.sources(frames, s_by_name, setup.settings)
            sources = ca.substitute(ca.SX(jacobian_of_errors), p, machine.nominal)

        self._arity = instrument.arity
        self._channels = len(instrument.channels)
        self._sizes = [v.numel() for v in over]
        self._sources_shape = sources.shape
        self._value = BatchedFunction("read", inputs, [y])
        self._jacobians = BatchedFunction("slope", inputs, jacobians)
        self._joint_jacobians = None
        if self.uses_closure:
            by_joint = [ca.jacobian(y, q) for q in joints]
            self._joint_jacobians = BatchedFunction("joint_slope", inputs, by_joint)
        self._sources = BatchedFunction("sources", [*poses, s], [ca.vec(sources)])

    def read(self, inputs: Sequence[Array]) -> Array:
        """Readings (n, channels), SI, at the inputs of g: each (n, size) or (size,)."""
        return self._value(*inputs)[0]

    def sources(self, poses: Sequence[Array], s: Array) -> Array:
        """Jacobian (n, channels, sources) over stated errors; x (n, nx), s (ns,)."""
        rows, columns = self._sources_shape
        flat = self._sources(*poses, s)[0]  # column by column, as CasADi stores
        return flat.reshape(-1, columns, rows).transpose(0, 2, 1)

    def jacobians(
        self, inputs: Sequence[Array]
    ) -> tuple[list[Array], Array, Array | None]:
        """Jacobian (n, channels, size) over poses, s, and p or None; poses fixed."""
        n = inputs[0].shape[0]
        jacobians = [
            jacobian.reshape(n, self._channels, size)
            for jacobian, size in zip(
                self._jacobians(*inputs), self._sizes, strict=True
            )
        ]
        by_pose, by_setup = jacobians[: self._arity], jacobians[self._arity]
        return by_pose, by_setup, jacobians[-1] if self.uses_closure else None

    def joint_jacobians(self, inputs: Sequence[Array]) -> list[Array] | None:
        """Jacobian (n, channels, nq) over the joints, or None without the closure."""
        if self._joint_jacobians is None:
            return None
        n = inputs[0].shape[0]
        jacobians = self._joint_jacobians(*inputs)
        return [jacobian.reshape(n, self._channels, -1) for jacobian in jacobians]


@dataclasses.dataclass(frozen=True, slots=True)
class Response:
    """Jacobian of n readings of a set-up over changes at the poses they see, SI."""

    joints: tuple[Array, ...]  #: for each pose of a reading, (n, channels, nq)
    parameters: tuple[Array, ...]  #: for each pose of a reading, (n, channels, np)
    #: (n, channels, ns), over the set-up's unknowns at the time of the reading
    nuisances: Array


class SetupReadings:
    """One set-up's readings.

    setup  of the instrument

    A vector theta has the machine's parameters first, and the set-up's unknowns at the
    slice `unknowns`. Shapes: m vectors, n readings, N = n times the channels.
    """

    def __init__(self, kinematics: Kinematics, setup: Setup, unknowns: slice) -> None:
        self.setup = setup
        self._kinematics, self._unknowns = kinematics, unknowns
        self._count = len(kinematics.machine.parameters)
        # a fit needs Jacobians where it has just computed the readings: the arguments of
        # a forward solution, copied, and the poses
        self._last: tuple[list[Array], Array] | None = None

    @functools.cached_property
    def model(self) -> ObservationModel:
        """Its readings at given poses; of many set-ups only a few may be read."""
        return ObservationModel(self._kinematics.machine, self.setup)

    def poses(
        self, series: Series, theta: Array, *, strict: bool, wanted: Mask | None = None
    ) -> Array:
        """Poses (m, poses, nx) at theta (m, n); NaN for failures unless `strict`.

        wanted  (m, poses) those to solve

        Raises AssemblyError where `strict`.
        """
        p = theta[:, : self._count]
        if len(p) == 1 or series.q.ndim == 3:
            return self._poses_once(series, p, strict=strict)
        if strict:
            return self._kinematics.forward(series.q, p, series.start)
        arguments = (series.q, p, series.start)
        x, failed = self._kinematics.try_forward(*arguments, wanted=wanted)
        return np.where(failed[..., None], np.nan, x)

    def _poses_once(self, series: Series, p: Array, *, strict: bool) -> Array:
        """Poses (m, poses, nx) at one vector (1, np), or one a machine; solved once."""
        arguments = (series.q, p, series.start)
        if self._last is not None:
            stored, poses = self._last
            if all(map(np.array_equal, stored, arguments)):
                return poses
        if strict:
            x = self._kinematics.forward(*arguments)
        else:
            x, failed = self._kinematics.try_forward(*arguments)
            if failed.any():
                return np.where(failed[..., None], np.nan, x)
        x.flags.writeable = False
        self._last = [argument.copy() for argument in arguments], x
        return x

    def read(self, series: Series, x: Array, theta: Array) -> Array:
        """Readings (m, N) at poses x (m, poses, nx) and theta (m, n)."""
        inputs = self._inputs(series, x, theta)
        return self.model.read(inputs).reshape(len(theta), -1)

    def jacobian(self, series: Series, theta: Array) -> Array:
        """Jacobian (m, N, n) over theta (m, n). Raises AssemblyError."""
        x = self.poses(series, theta, strict=True)
        p = theta[:, : self._count]
        by_pose, by_setup, by_parameter = self._jacobians(series, x, theta)
        joints = self._joints(series, len(x))
        adjoints = self._kinematics.slopes.adjoints(x, joints, p)
        shape = (len(x), len(series), by_setup.shape[1])
        pairs = zip(by_pose, series.pose_indices(), strict=True)
        parts = [adjoints.pull_back(g.reshape(*shape, -1), k) for g, k in pairs]
        if by_parameter is not None:
            parts.append(by_parameter.reshape(*shape, -1))
        rows = np.zeros((*shape, theta.shape[1]))
        rows[..., : self._count] = functools.reduce(np.add, parts)
        rows[..., self._unknowns] = by_setup.reshape(*shape, -1)
        return rows.reshape(len(x), -1, theta.shape[1])

    def response(self, series: Series, theta: Array) -> Response:
        """Jacobian over joints, parameters and nuisances, by pose. AssemblyError."""
        vectors = theta[None]
        x = self.poses(series, vectors, strict=True)
        p = theta[: self._count]
        by_pose, by_setup, by_parameter = self._jacobians(series, x, vectors)
        by_joint = self._kinematics.slopes.pose_by_joint(x[0], series.q, p)
        sensitivity = self._kinematics.slopes.pose_by_parameter(x[0], series.q, p)
        pairs = list(zip(by_pose, series.pose_indices(), strict=True))
        joints = [jacobian @ by_joint[k] for jacobian, k in pairs]
        at_fixed_poses = self.model.joint_jacobians(self._inputs(series, x, vectors))
        if at_fixed_poses is not None:
            joints = [a + b for a, b in zip(joints, at_fixed_poses, strict=True)]
        parameters = [jacobian @ sensitivity[k] for jacobian, k in pairs]
        if by_parameter is not None:
            parameters[0] = parameters[0] + by_parameter
        return Response(tuple(joints), tuple(parameters), by_setup)

    def perturbed(
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
        p, s = theta[: self._count] + parameters, theta[self._unknowns] + nuisances
        q = series.q + joints
        indices = series.pose_indices()
        x = self._kinematics.forward_per_pose(q, p, series.start)
        inputs = [*(x[k] for k in indices), s]
        if self.model.uses_closure:
            inputs += [*(q[k] for k in indices), p[indices[0]]]
        return self.model.read(inputs).ravel()

    def nominal_jacobian(self, series: Series) -> Array:
        """Jacobian (n, channels, ns) over the set-up's unknowns, all of it nominal."""
        theta = np.zeros(self._unknowns.stop)
        theta[: self._count] = self._kinematics.machine.nominal
        theta[self._unknowns] = [n.nominal for n in self.setup.nuisances]
        return self._jacobians(series, series.start[None], theta[None])[1]

    def _inputs(self, series: Series, x: Array, theta: Array) -> list[Array]:
        """Inputs at poses x (m, poses, nx), theta (m, n): m times the readings n."""
        indices, m, n = series.pose_indices(), len(x), len(series)
        inputs = [x[:, k].reshape(m * n, -1) for k in indices]
        inputs.append(np.repeat(theta[:, self._unknowns], n, axis=0))
        if self.model.uses_closure:
            q = self._joints(series, m)
            inputs += [q[:, k].reshape(m * n, -1) for k in indices]
            inputs.append(np.repeat(theta[:, : self._count], n, axis=0))
        return inputs

    def _joints(self, series: Series, machines: int) -> Array:
        """Joints (m, poses, nq) of so many machines."""
        return np.broadcast_to(series.q, (machines, *series.q.shape[-2:]))

    def _jacobians(
        self, series: Series, x: Array, theta: Array
    ) -> tuple[list[Array], Array, Array | None]:
        """Jacobian of the readings, as `ObservationModel.jacobians`, m times n."""
        return self.model.jacobians(self._inputs(series, x, theta))

    def source_gradients(self, series: Series) -> Array:
        """Jacobian (n, channels, sources), SI, over stated inner errors in sd."""
        poses = [series.start[k] for k in series.pose_indices()]
        nuisances = np.array([n.nominal for n in self.setup.nuisances])
        return self.model.sources(poses, nuisances)

    def run_errors(self, series: Series) -> Array:
        """Jacobian (n, channels, k), SI, over a run's k levels and seats, nominal."""
        setup = self.setup
        pairs = zip(setup.instrument.channels, setup.sigma, strict=True)
        shared = [channel.shared * sigma for channel, sigma in pairs]
        errors = np.diag(shared)[:, np.flatnonzero(shared)]
        levels = np.tile(errors, (len(series), 1, 1))
        if not setup.statement.seating:
            return levels
        renewed = [n.name in setup.instrument.renewed for n in setup.nuisances]
        jacobian = self.nominal_jacobian(series)[:, :, renewed]
        return np.concatenate([levels, jacobian * setup.statement.seating], axis=2)

    def reading_covariances(self, series: Series) -> Array:
        """Covariance (n, channels, channels), SI, of each reading without its run's error."""
        setup, instrument = self.setup, self.setup.instrument
        sigma = series.reading_sigma(setup.sigma)
        if instrument.sources is None:
            return np.square(sigma)[:, :, None] * np.eye(sigma.shape[1])
        default = np.array([c.sigma for c in instrument.channels])
        root = self.source_gradients(series) * (sigma / default)[:, :, None]
        return np.asarray(root @ np.swapaxes(root, 1, 2))


# Noise of readings, as instrument and study state it.
def stated_noise(several: Sequence[tuple[SetupReadings, Series]]) -> Noise:
    """Noise of the readings of several series at their nominal poses, SI.

    It is independent, unless an instrument's channels have common sources, the readings
    of a run share errors, or an error is carried along a run; then it is related within
    each run.
    """
    if all(_is_independent(readings, series) for readings, series in several):
        sigmas = [
            series.reading_sigma(readings.setup.sigma) for readings, series in several
        ]
        return Noise(np.concatenate([sigma.ravel() for sigma in sigmas]))
    errors = [_errors(readings, series) for readings, series in several]
    variances = [_variances(readings, series) for readings, series in several]
    sigma = np.sqrt(np.concatenate(variances))
    return FactoredNoise.of_errors(sigma, errors)


def _is_independent(readings: SetupReadings, series: Series) -> bool:
    """Whether no two readings of a series have an error in common."""
    setup = readings.setup
    alone = setup.instrument.sources is None and not setup.statement.correlated_share
    return alone and not readings.run_errors(series).size


def _variances(readings: SetupReadings, series: Series) -> Array:
    """Variances (N,) of the readings of a series."""
    alone = np.einsum("ncc->nc", readings.reading_covariances(series))
    shared = np.square(readings.run_errors(series)).sum(axis=2)
    return np.asarray((alone + shared).ravel())


def _errors(readings: SetupReadings, series: Series) -> Errors:
    """What the covariance of the readings of a series consists of, run by run."""
    setup = readings.setup
    channels = len(setup.sigma)
    share = setup.statement.correlated_share
    run = np.repeat(np.unique(series.run, return_inverse=True)[1], channels)
    channel = np.tile(np.arange(channels), len(series))
    order = np.lexsort((channel, run))
    first = np.diff(channels * run[order] + channel[order], prepend=-1) > 0
    decay = np.where(first, 0.0, np.exp(-1.0 / setup.statement.reach_median))
    unmix = decoupling(readings.reading_covariances(series))
    shared = unmix @ readings.run_errors(series).reshape(len(order), -1)
    return Errors(
        order=order,
        starts=np.flatnonzero(np.diff(run[order], prepend=-1)),
        decay=decay if share else np.zeros(len(order)),
        single=np.full(len(order), 1.0 - share),
        correlated=np.full(len(order), share),
        shared=shared[order],
        scale=np.ones(len(order)),
        unmix=scipy.sparse.csr_array(unmix[order][:, order]),
    )


def decoupling(covariances: Array) -> scipy.sparse.csr_array:
    """Block diagonal W with W C W^T = 1, for covariances (n, c, c) of n readings."""
    inverses = np.linalg.inv(np.linalg.cholesky(covariances))
    count = np.arange(len(inverses) + 1)
    blocks = scipy.sparse.bsr_array((inverses, count[:-1], count))
    matrix = scipy.sparse.csr_array(blocks)
    matrix.eliminate_zeros()
    return matrix
