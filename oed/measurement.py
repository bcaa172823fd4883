"""Readings of a machine by an instrument, and their derivatives: machine x instrument
-> y, dy/dp.

A reading y = g(x_1, x_2, s) sees one pose, or two (a taught cup, a reference); each
pose obeys the closure at the joints that the controller sent. Its identification row is

    dy/d(p, s) = [ sum_j g_xj dx_j/dp,  g_s ],        dx/dp = -phi_x^-1 phi_p   (joints fixed).

The parameter vector theta of a measurement is [machine parameters, unknowns of set-up
1, of set-up 2, ...].
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence

import numpy as np
from numpy.typing import NDArray
from scipy import linalg
from scipy.optimize import elementwise

from oed.arrays import Array, Index, Mask
from oed.instrument import Protocol, Setup
from oed.kinematics import STEP_TOLERANCE, AssemblyError, Kinematics
from oed.machine import Machine, Parameter
from oed.noise import covariance as noise
from oed.noise.covariance import Noise
from oed.observation import ObservationModel

#: Newton's last step (m, rad) where many parameter vectors near a known one are
#: evaluated: leaves 1e-11 m
NEAR_STEP_TOLERANCE = 2e-6


@dataclasses.dataclass(frozen=True, slots=True)
class Series:
    """Readings taken, or to be taken, in one set-up.

    setup    name of the set-up
    q        (m, nq) joints sent to the machine at the m poses involved, SI
    start    (m, nx) nominal poses, or (draws, m, nx): Newton's start
    command  (m, n_dof) what was commanded; NaN where joints were recorded instead
    index    (n, arity) which poses each of the n readings sees
    run      (n,) label of the run (circle, line) of each reading
    """

    setup: str
    q: Array
    start: Array
    command: Array
    index: Index
    run: NDArray[np.str_]

    def __len__(self) -> int:
        return int(self.index.shape[0])

    def take(self, rows: Index) -> Series:
        """The same series with some of its readings, in the given order, and only the
        poses they need.
        """
        kept, index = np.unique(self.index[rows], return_inverse=True)
        return Series(
            setup=self.setup,
            q=self.q[kept],
            start=self.start[kept],
            command=self.command[kept],
            index=index.reshape(self.index[rows].shape).astype(np.intp),
            run=self.run[rows],
        )

    def expand_passes(self, protocol: Protocol) -> Series:
        """The readings of all passes, each pass of a run a run of its own, backward
        ones in reverse; as they are if the protocol averages.
        """
        if protocol.average or len(protocol.pass_names) == 1:
            return self
        rows, labels = [], []
        for run in dict.fromkeys(self.run):
            members = np.flatnonzero(self.run == run)
            for name in protocol.pass_names:
                rows.append(members[::-1] if name.startswith("backward") else members)
                labels += [f"{run}, {name}"] * len(members)
        taken = self.take(np.concatenate(rows))
        return dataclasses.replace(taken, run=np.array(labels, dtype=np.str_))

    def separate_poses(self) -> Series:
        """The same readings with a pose of its own for each: the passes of a run share
        poses, but not their state.

        References stay shared: the taught pose by all readings, the first pose of a run
        by the run.
        """
        own, rest = self.index[:, 0], self.index[:, 1:]
        referred, place = np.unique(rest, return_inverse=True)
        kept = np.concatenate([own, referred])
        index = np.column_stack(
            [np.arange(len(own)), len(own) + place.reshape(rest.shape)]
        ).astype(np.intp)
        return dataclasses.replace(
            self,
            q=self.q[kept],
            start=self.start[kept],
            command=self.command[kept],
            index=index,
        )

    def reading_commands(self) -> Array:
        """Command (n, n_dof) of the pose that each reading reads."""
        return self.command[self.index[:, 0]]


class Measurement:
    """A machine with its set-ups: predicts readings for many parameter vectors at once,
    and their slopes.
    """

    def __init__(self, machine: Machine, setups: Sequence[Setup]) -> None:
        names = [s.name for s in setups]
        if len(set(names)) != len(names):
            raise ValueError(f"set-up names are not unique: {names}")
        for s in setups:
            reason = s.instrument.unfit(machine)
            if reason is not None:
                raise ValueError(
                    f"set-up {s.name}: {s.instrument.name} cannot read {machine.name}:"
                    f" {reason}"
                )
        self.machine = machine
        self.kinematics = Kinematics(machine)
        self.setups = {s.name: s for s in setups}
        self.parameters: tuple[Parameter, ...] = machine.parameters + tuple(
            dataclasses.replace(n, name=f"{s.name}.{n.name}")
            for s in setups
            for n in s.nuisances
        )
        self._views = {s.name: ObservationModel(machine, s) for s in setups}
        self._nuisance: dict[str, slice] = {}
        start = len(machine.parameters)
        for s in setups:
            self._nuisance[s.name] = slice(start, start + len(s.nuisances))
            start += len(s.nuisances)
        self._last: dict[str, tuple[Series, Array, Array]] = {}

    # -- the parameter vector ----------------------------------------------------------

    @property
    def names(self) -> tuple[str, ...]:
        """Names of theta's entries."""
        return tuple(p.name for p in self.parameters)

    @property
    def nominal(self) -> Array:
        """Nominal theta (n,), SI."""
        return np.array([p.nominal for p in self.parameters])

    @property
    def tolerance(self) -> Array:
        """Prior standard deviations (n,), SI; 0 for the parameters that only choose the
        base frame.
        """
        return np.array(
            [
                0.0 if p.name in self.machine.frame else p.tolerance
                for p in self.parameters
            ]
        )

    @property
    def free(self) -> Mask:
        """Which entries of theta (n,) are unknown."""
        return np.asarray(self.tolerance > 0.0)

    @property
    def length_factors(self) -> Array:
        """Factor (n,) that turns each entry into a length (m): the machine's lever for
        angles and ratios.
        """
        return np.array(
            [1.0 if p.unit == "m" else self.machine.lever for p in self.parameters]
        )

    # -- series ------------------------------------------------------------------------

    def series(
        self,
        setup: str,
        command: Array,
        run: Sequence[str] | None = None,
        controller: Array | None = None,
    ) -> Series:
        """Readings at commanded poses (n, n_dof), SI; `controller` (np,) are the
        parameters it believes in.

        For instruments with a run reference the first pose of each run is the
        reference, and is not a reading. Raises AssemblyError for poses out of reach.
        """
        command = np.atleast_2d(np.asarray(command, dtype=float))
        chosen = self.setups[setup]
        labels = np.array(
            ["1"] * len(command) if run is None else list(run), dtype=np.str_
        )
        poses = command
        if chosen.teach is not None:
            poses = np.vstack([command, np.array(chosen.teach)[None]])
        x, q = self.kinematics.inverse(poses, controller, np.array(chosen.tool))
        return self._indexed(setup, q, x, poses, labels)

    def series_from_joints(
        self, setup: str, q: Array, run: Sequence[str] | None = None
    ) -> Series:
        """As `series`, from recorded joints (n, nq), SI."""
        q = np.atleast_2d(np.asarray(q, dtype=float))
        chosen = self.setups[setup]
        labels = np.array(["1"] * len(q) if run is None else list(run), dtype=np.str_)
        x = self.kinematics.start_poses(q)
        command = np.full((len(q), len(self.machine.command)), np.nan)
        if chosen.teach is not None:
            teach = np.array(chosen.teach)[None]
            teach_x, teach_q = self.kinematics.inverse(
                teach, None, np.array(chosen.tool)
            )
            q, x, command = (
                np.vstack([q, teach_q]),
                np.vstack([x, teach_x]),
                np.vstack([command, teach]),
            )
        return self._indexed(setup, q, x, command, labels)

    def _indexed(
        self, setup: str, q: Array, x: Array, command: Array, run: NDArray[np.str_]
    ) -> Series:
        n = len(run)
        reference = self.setups[setup].instrument.reference
        if reference == "teach":
            index = np.column_stack([np.arange(n), np.full(n, n)])
        elif reference == "run":
            first = {
                label: int(np.flatnonzero(run == label)[0]) for label in np.unique(run)
            }
            firsts = np.array([first[label] for label in run])
            keep = firsts != np.arange(n)
            index, run = np.column_stack([np.arange(n), firsts])[keep], run[keep]
        else:
            index = np.arange(n)[:, None]
        return Series(setup, q, x, command, index.astype(np.intp), run)

    def commands_at_fixed_reading(
        self, setup: str, command: Array, coordinate: str
    ) -> tuple[Array, Mask]:
        """Solve one command coordinate so that the nominal reading is what the
        instrument holds by design.

        Returns the commands (n, n_dof) and the mask of poses where that is possible
        within the coordinate's range: a ball bar of fixed length leads the tool on a
        sphere about its cup.
        """
        chosen = self.setups[setup]
        if chosen.instrument.fixed_reading is None:
            raise ValueError(
                f"{chosen.instrument.name} holds no reading: give {coordinate} itself"
            )
        wanted = chosen.instrument.fixed_reading(chosen.settings)
        column = [c.name for c in self.machine.command].index(coordinate)
        limits = self.machine.workspace(chosen.tool)[column]
        command = np.array(command, dtype=float)

        def miss(value: Array, row: Array) -> Array:
            poses = command[row.astype(int)]
            poses[:, column] = value
            series = self.series(setup, poses)
            return self.readings([series], self.nominal) - wanted

        rows = np.arange(len(command), dtype=float)
        bracket = (
            np.full(len(command), limits.lower),
            np.full(len(command), limits.upper),
        )
        found = elementwise.find_root(
            miss, bracket, args=(rows,), tolerances={"xatol": 1e-12, "fatol": 1e-13}
        )
        command[:, column] = found.x
        return command, np.asarray(found.success)

    # -- readings ----------------------------------------------------------------------

    def readings(self, series: Sequence[Series], theta: Array) -> Array:
        """Exact nonlinear readings y (N,) for theta (n,), or (m, N) for theta (m, n);
        SI, channels innermost.

        Raises AssemblyError where a pose cannot be assembled at some theta.
        """
        y = self.try_readings(series, theta)
        if np.isnan(y).any():
            # repeat the failing solve, which raises with the poses by number
            for s in series:
                self._poses(s, np.atleast_2d(theta), strict=True)
            raise AssemblyError(
                f"{self.machine.name}: readings are not finite",
                np.flatnonzero(np.isnan(y)),
            )
        return y

    def try_readings(self, series: Sequence[Series], theta: Array) -> Array:
        """As `readings`, with NaN where a pose cannot be assembled."""
        wide = np.atleast_2d(theta)
        y = np.hstack([self._read(s, wide) for s in series])
        return y[0] if theta.ndim == 1 else y

    def jacobian(self, series: Sequence[Series], theta: Array) -> Array:
        """dy/dtheta (N, n) at theta (n,), SI."""
        return np.vstack([self._slope(s, theta) for s in series])

    def response(self, series: Series, theta: Array) -> Response:
        """Slopes of a series' readings over joints, parameters and set-up, pose by
        pose, at theta (n,).
        """
        p, s = (
            theta[: len(self.machine.parameters)],
            theta[self._nuisance[series.setup]],
        )
        x = self._poses(series, theta[None], strict=True)[0]
        by_pose, by_setup, by_machine = self._slopes(series, x, p, s)
        dq, dp = (
            self.kinematics.joint_sensitivity(x, series.q, p),
            self.kinematics.parameter_sensitivity(x, series.q, p),
        )
        places = [series.index[:, j] for j in range(series.index.shape[1])]
        joints = tuple(slope @ dq[k] for slope, k in zip(by_pose, places, strict=True))
        parameters = [slope @ dp[k] for slope, k in zip(by_pose, places, strict=True)]
        if by_machine is not None:
            parameters[0] = parameters[0] + by_machine
        return Response(joints, tuple(parameters), by_setup)

    def perturbed_readings(
        self,
        series: Series,
        theta: Array,
        joints: Array,
        parameters: Array,
        nuisances: Array,
    ) -> Array:
        """Exact readings (N,) of a series at theta (n,) where each pose has changes of
        its own.

        joints (m, nq) are added to what the joints do, parameters (m, np) to the
        machine's, nuisances (n, ns) to the set-up's unknowns at each reading. Raises
        AssemblyError.
        """
        p, s = (
            theta[: len(self.machine.parameters)] + parameters,
            theta[self._nuisance[series.setup]] + nuisances,
        )
        q = series.q + joints
        x = self.kinematics.forward_per_pose(q, p, series.start)
        places = [series.index[:, j] for j in range(series.index.shape[1])]
        view = self._views[series.setup]
        inner = [*(q[k] for k in places), p[places[0]]] if view.uses_closure else []
        return view.read([*(x[k] for k in places), s, *inner]).ravel()

    def nuisance_slice(self, setup: str) -> slice:
        """Where the unknowns of a set-up are in theta."""
        return self._nuisance[setup]

    def setup_of_readings(self, series: Sequence[Series]) -> list[str]:
        """Set-up of each reading (N,), in the order of `readings`."""
        return [
            s.setup
            for s in series
            for _ in range(len(s) * len(self.setups[s.setup].sigma))
        ]

    def sigma(self, series: Sequence[Series]) -> Array:
        """Noise standard deviation (N,) of each reading, SI."""
        return self.noise(series).sigma

    def noise(self, series: Sequence[Series]) -> Noise:
        """Noise of the readings, at their nominal poses, SI."""
        return noise.concatenate_noise([self._noise(s) for s in series])

    def reading_length_factors(self, series: Sequence[Series]) -> Array:
        """Factor (N,) that turns each reading into a length (m): the machine's lever
        for angles and ratios.
        """
        lever = self.machine.lever
        return np.concatenate(
            [
                np.tile(
                    [
                        1.0 if c.unit == "m" else lever
                        for c in self.setups[s.setup].instrument.channels
                    ],
                    len(s),
                )
                for s in series
            ]
        )

    def readings_near(
        self, series: Sequence[Series], theta: Array
    ) -> Callable[[Array], Array]:
        """`try_readings` of the series for many thetas (m, n) near `theta` (n,): fewer
        Newton iterations.

        Each solve starts from the pose predicted to first order, x(theta) + dx/dp (p -
        p(theta)).
        """
        np_ = len(self.machine.parameters)
        known = []
        for s in series:
            x = self._poses(s, theta[None], strict=True)[0]
            known.append(
                (s, x, self.kinematics.parameter_sensitivity(x, s.q, theta[:np_]))
            )

        def readings(many: Array) -> Array:
            move = many[:, :np_] - theta[:np_]
            moved = [(s, x + np.einsum("mkp,dp->dmk", dx, move)) for s, x, dx in known]
            return np.hstack(
                [
                    self._read(
                        dataclasses.replace(s, start=start), many, NEAR_STEP_TOLERANCE
                    )
                    for s, start in moved
                ]
            )

        return readings

    def poses(self, series: Series, theta: Array) -> Array:
        """True poses (m, nx) of a series at theta (n,)."""
        return np.asarray(self._poses(series, theta[None], strict=True)[0])

    def _poses(
        self,
        series: Series,
        theta: Array,
        *,
        strict: bool,
        step: float = STEP_TOLERANCE,
    ) -> Array:
        p = theta[:, : len(self.machine.parameters)]
        if len(p) == 1 and step == STEP_TOLERANCE:
            return self._poses_again(series, p, strict=strict)
        if strict:
            return self.kinematics.forward(series.q, p, series.start)
        x, bad = self.kinematics.try_forward(series.q, p, series.start, step)
        return np.where(bad[..., None], np.nan, x)

    def _poses_again(self, series: Series, p: Array, *, strict: bool) -> Array:
        """Poses (1, n, nx) at one parameter vector (1, np), kept for each set-up: a fit
        asks for the slopes where it has just asked for the readings.
        """
        if series.setup in self._last:
            of, at, x = self._last[series.setup]
            if of is series and np.array_equal(at, p):
                return x
        if strict:
            x = self.kinematics.forward(series.q, p, series.start)
        else:
            x, bad = self.kinematics.try_forward(series.q, p, series.start)
            if bad.any():
                return np.where(bad[..., None], np.nan, x)
        x.flags.writeable = False
        self._last[series.setup] = series, p.copy(), x
        return x

    def _read(
        self, series: Series, theta: Array, step: float = STEP_TOLERANCE
    ) -> Array:
        x = self._poses(series, theta, strict=False, step=step)
        s = theta[:, self._nuisance[series.setup]]
        m, n = theta.shape[0], len(series)
        frames = [
            x[:, series.index[:, j]].reshape(m * n, -1)
            for j in range(series.index.shape[1])
        ]
        view = self._views[series.setup]
        inner: list[Array] = []
        if view.uses_closure:
            inner = [
                np.tile(series.q[series.index[:, j]], (m, 1))
                for j in range(series.index.shape[1])
            ]
            inner.append(np.repeat(theta[:, : len(self.machine.parameters)], n, axis=0))
        return view.read([*frames, np.repeat(s, n, axis=0), *inner]).reshape(m, -1)

    def _noise(self, series: Series) -> Noise:
        setup = self.setups[series.setup]
        channels = setup.instrument.channels
        sigma = np.tile(setup.sigma, len(series))
        shared = np.array([c.shared for c in channels]) * setup.sigma
        if setup.instrument.sources is None and not shared.any():
            return Noise(sigma)
        own = self.reading_covariances(series)
        places, covariances = [], []
        for run in dict.fromkeys(series.run):
            members = np.flatnonzero(series.run == run)
            place = (
                members[:, None] * len(channels) + np.arange(len(channels))
            ).ravel()
            common = np.kron(np.ones((len(members), len(members))), np.diag(shared**2))
            covariances.append(linalg.block_diag(*own[members]) + common)
            places.append(place)
        return noise.block_noise(covariances, places)

    def reading_covariances(self, series: Series) -> Array:
        """Covariance (n, channels, channels), SI, of each reading by itself, without
        what its run shares.
        """
        setup = self.setups[series.setup]
        if setup.instrument.sources is None:
            return np.tile(np.diag(np.square(setup.sigma)), (len(series), 1, 1))
        frames = [
            series.start[series.index[:, j]] for j in range(series.index.shape[1])
        ]
        unknown = np.array([n.nominal for n in setup.nuisances])
        slopes = self._views[series.setup].sources(frames, unknown)
        factor = np.array(
            [
                s / c.sigma
                for s, c in zip(setup.sigma, setup.instrument.channels, strict=True)
            ]
        )
        root = slopes * factor[:, None]
        return np.asarray(root @ np.swapaxes(root, 1, 2))

    def _slope(self, series: Series, theta: Array) -> Array:
        p, s = (
            theta[: len(self.machine.parameters)],
            theta[self._nuisance[series.setup]],
        )
        x = self._poses(series, theta[None], strict=True)[0]
        self.kinematics.check_regular(x, series.q, p)
        dx = self.kinematics.parameter_sensitivity(x, series.q, p)
        by_pose, by_setup, by_machine = self._slopes(series, x, p, s)
        rows = np.zeros((len(series), by_setup.shape[1], len(theta)))
        for j, slope in enumerate(by_pose):
            rows[:, :, : len(p)] += slope @ dx[series.index[:, j]]
        if by_machine is not None:
            rows[:, :, : len(p)] += by_machine
        rows[:, :, self._nuisance[series.setup]] = by_setup
        return rows.reshape(-1, len(theta))

    def _slopes(
        self, series: Series, x: Array, p: Array, s: Array
    ) -> tuple[list[Array], Array, Array | None]:
        """Slopes (n, channels, .) of a series' readings over each pose, over s, and
        over p beside the poses.
        """
        frames = [x[series.index[:, j]] for j in range(series.index.shape[1])]
        view = self._views[series.setup]
        inner = (
            [*(series.q[series.index[:, j]] for j in range(series.index.shape[1])), p]
            if view.uses_closure
            else []
        )
        return view.slopes([*frames, s, *inner])


@dataclasses.dataclass(frozen=True, slots=True)
class Response:
    """How n readings of a set-up answer to changes at the poses they see, SI.

    joints      for each pose of a reading, (n, channels, nq);  parameters likewise, (n,
                channels, np)
    nuisances   (n, channels, ns) to the set-up's unknowns at the time of the reading
    """

    joints: tuple[Array, ...]
    parameters: tuple[Array, ...]
    nuisances: Array
