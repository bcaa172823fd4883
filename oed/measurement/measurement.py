"""Readings of a machine by its instruments, their derivatives and stated noise.

Each set-up's readings are those of `oed.measurement.setup_readings`, series after series.
"""

from collections.abc import Callable, Sequence

import numpy as np

from oed.base import Array, Mask
from oed.instrument import ParameterVector, Series, Setup, TakenReadings
from oed.measurement.setup_readings import Response, SetupReadings, stated_noise
from oed.mechanism import AssemblyError, Kinematics
from oed.model import Coordinate, Machine
from oed.noise import Noise

__all__ = ["Measurement", "Response", "Series"]


class Measurement(ParameterVector):
    """A machine with its set-ups: predicts readings and their Jacobian.

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
        self._readings = {
            setup.name: SetupReadings(
                self.kinematics, setup, self.nuisance_slice(setup.name)
            )
            for setup in setups
        }

    def with_setups(self, setups: Sequence[Setup]) -> "Measurement":
        """The same machine with other set-ups; its kinematics are shared."""
        return Measurement(self.machine, setups, self.kinematics)

    def of(self, series: Series) -> SetupReadings:
        """The readings of a series' set-up alone."""
        return self._readings[series.setup]

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
        controller  (np,) parameters of the controller, in place of what that of the
                    kinematics holds

        For instruments with a run reference the first pose of each run is the
        reference, and no reading. Raises AssemblyError for poses out of reach.
        """
        mounted = self.setups[setup]
        command = np.atleast_2d(np.asarray(command, dtype=float))
        if mounted.teach is not None:
            command = np.vstack([command, np.array(mounted.teach)[None]])
        tool = np.array(mounted.tool)
        if controller is None:
            x, q = self.kinematics.sent(command, tool)
        else:
            x, q = self.kinematics.inverse(command, controller, tool)
        return self._at_poses(mounted, x, q, command, run)

    def series_from_joints(
        self, setup: str, q: Array, run: Sequence[str] | None = None
    ) -> Series:
        """As `series`, from recorded joints (n, nq), SI; their commands are NaN."""
        mounted = self.setups[setup]
        q = np.atleast_2d(np.asarray(q, dtype=float))
        x = self.kinematics.start_poses(q)
        command = np.full((len(q), len(self.machine.command)), np.nan)
        if mounted.teach is not None:
            teach = np.array(mounted.teach)[None]
            teach_x, teach_q = self.kinematics.sent(teach, np.array(mounted.tool))
            q, x = np.vstack([q, teach_q]), np.vstack([x, teach_x])
            command = np.vstack([command, teach])
        return self._at_poses(mounted, x, q, command, run)

    def _at_poses(
        self,
        mounted: Setup,
        x: Array,
        q: Array,
        command: Array,
        run: Sequence[str] | None,
    ) -> Series:
        """Readings at poses, the teach pose last; one run by default."""
        count = len(command) - (mounted.teach is not None)
        labels = np.array(["1"] * count if run is None else list(run), dtype=np.str_)
        index, labels = mounted.instrument.index_poses(labels)
        return Series(mounted.name, q, x, command, index, labels)

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
                self.of(s).poses(s, np.atleast_2d(theta), strict=True)
            raise AssemblyError(
                f"{self.machine.name}: readings are not finite",
                np.flatnonzero(np.isnan(y)),
            )
        return y

    def try_readings(
        self, series: Sequence[Series], theta: Array, wanted: Mask | None = None
    ) -> Array:
        """As `readings`, NaN where not assembled, or not `wanted` (m, N)."""
        vectors = np.atleast_2d(theta)
        parts: list[Mask | None] = [None] * len(series)
        if wanted is not None:
            numbers = [len(s) * len(self.setups[s.setup].sigma) for s in series]
            parts = list(np.split(wanted, np.cumsum(numbers)[:-1], axis=1))
        y = [self._read(s, vectors, w) for s, w in zip(series, parts, strict=True)]
        return np.hstack(y)[0] if theta.ndim == 1 else np.hstack(y)

    def taken_measurement(self, taken: Sequence[TakenReadings]) -> "Measurement":
        """The measurement of series that have some readings of others."""
        return self

    def jacobian(self, series: Sequence[Series], theta: Array) -> Array:
        """dy/dtheta (N, n) or (m, N, n), SI, at (n,), (m, n). AssemblyError."""
        vectors = np.atleast_2d(theta)
        rows = np.concatenate([self._jacobian(s, vectors) for s in series], axis=1)
        return rows[0] if theta.ndim == 1 else rows

    @property
    def start(self) -> Array:
        """Theta (n,) at which a fit begins: nominal, or free parameters as held, SI."""
        theta, controller = self.nominal, self.kinematics.controller
        if controller is not None and controller.corrections is None:
            free = np.flatnonzero(self.free[: len(controller.parameters)])
            theta[free] = controller.parameters[free]
        return theta

    def reading_seconds(self, setup: str) -> float:
        """Time of one planned reading with all passes that are averaged into it, s."""
        mounted = self.setups[setup]
        passes = len(mounted.protocol.pass_names) if mounted.protocol.average else 1
        return mounted.instrument.cost.reading * passes

    def expected_poses(self, series: Series) -> Array:
        """Poses (m, nx) at which readings are planned. Raises AssemblyError.

        A controller that was compensated brings the machine where it means to be; the
        nominal machine is elsewhere at its joints.
        """
        if self.kinematics.controller is None:
            return self.poses(series, self.nominal)
        return series.start

    def expected_readings(self, series: Series) -> Array:
        """What a series (N,) reads at the expected poses, SI. Raises AssemblyError."""
        theta = self.nominal
        if self.kinematics.controller is None:
            return self.readings([series], theta)
        theta[: len(self.machine.parameters)] = self.kinematics.held
        y = self._read_at(series, self.expected_poses(series)[None], theta[None])
        return np.asarray(y[0])

    def poses(self, series: Series, theta: Array) -> Array:
        """True poses (m, nx) of a series at theta (n,). Raises AssemblyError."""
        return np.asarray(self.of(series).poses(series, theta[None], strict=True)[0])

    # -- noise, and what belongs to each reading ---------------------------------------
    def noise(self, series: Sequence[Series]) -> Noise:
        """Stated noise of the readings (N,) at their nominal poses, SI."""
        return stated_noise([(self.of(s), s) for s in series])

    def sigma(self, series: Sequence[Series]) -> Array:
        """Standard deviation (N,) of each reading's stated noise, SI."""
        return self.noise(series).sigma

    def setup_of_readings(self, series: Sequence[Series]) -> list[str]:
        """Set-up of each reading (N,), in the order of `readings`."""
        sizes = [len(s) * len(self.setups[s.setup].sigma) for s in series]
        return [s.setup for s, n in zip(series, sizes, strict=True) for _ in range(n)]

    def reading_length_factors(self, series: Sequence[Series]) -> Array:
        """Factor (N,) that makes each reading a length, m, by the lever."""
        lever = self.machine.lever
        factors = []
        for s in series:
            channels = self.setups[s.setup].instrument.channels
            of_reading = [1.0 if c.unit == "m" else lever for c in channels]
            factors.append(np.tile(of_reading, len(s)))
        return np.concatenate(factors)

    # -- one series --------------------------------------------------------------------
    def _read(self, series: Series, theta: Array, wanted: Mask | None = None) -> Array:
        """Readings (m, N of the series) at theta (m, n), NaN where not assembled."""
        poses = None
        if wanted is not None:
            by_reading = wanted.reshape(len(wanted), len(series), -1)
            poses = series.poses_of(np.asarray(by_reading.any(axis=2)))
        x = self.of(series).poses(series, theta, strict=False, wanted=poses)
        return self._read_at(series, x, theta)

    def _read_at(self, series: Series, x: Array, theta: Array) -> Array:
        """Readings (m, N of the series) at poses x (m, poses, nx) and theta (m, n)."""
        return self.of(series).read(series, x, theta)

    def _jacobian(self, series: Series, theta: Array) -> Array:
        """Jacobian (m, N of the series, n) at theta (m, n)."""
        return self.of(series).jacobian(series, theta)

    def mode_jumps(self, series: Sequence[Series], theta: Array) -> tuple[int, int]:
        """Poses whose det(phi_x) turns its sign at theta (n,), and of all."""
        kinematics, nominal = self.kinematics, self.machine.nominal
        p = theta[: len(nominal)]
        jumps = count = 0
        for s in series:
            start = s.start if s.start.ndim == 2 else s.start[0]
            before = kinematics.assembly_side(start, s.q, nominal)
            after = kinematics.assembly_side(self.poses(s, theta), s.q, p)
            jumps += int(np.count_nonzero(before * after < 0.0))
            count += len(start)
        return jumps, count


def _solve_coordinate(
    read: Callable[[Array], Array],
    wanted: float,
    command: Array,
    column: int,
    limits: Coordinate,
    home: float,
) -> tuple[Array, Mask]:
    """Commands (n, n_dof) with one column solved so that `read` gives the wanted value.

    read    readings (n,) at commands (n, n_dof), SI
    limits  range of the column
    home    its value at home, within or at an end of the range

    A sphere about a cup at home crosses the range twice: then the crossing beyond home is
    taken. Returns the commands, and the mask (n,) of those that have a solution within the
    range.
    """
    from scipy.optimize import elementwise  # takes as long as NumPy to import

    solved = np.array(command, dtype=float)

    def excess(value: Array, row: Array) -> Array:
        poses = solved[row.astype(int)]
        poses[:, column] = value
        return read(poses) - wanted

    rows = np.arange(len(solved), dtype=float)
    lower, upper = np.full(len(rows), limits.lower), np.full(len(rows), limits.upper)
    at_lower, at_upper = excess(lower, rows), excess(upper, rows)
    lower[at_lower * at_upper > 0.0] = home
    root = elementwise.find_root(
        excess,
        (lower, upper),
        args=(rows,),
        tolerances={"xatol": 1e-12, "fatol": 1e-13},
    )
    solved[:, column] = root.x
    return solved, root.success


def commands_at_fixed_reading(
    measurement: Measurement, setup: str, command: Array, coordinate: str
) -> tuple[Array, Mask]:
    """Solve one command coordinate for the reading that the instrument keeps.

    A ball bar of fixed length leads the tool on a sphere about its cup. Returns
    the commands (n, n_dof), and the mask (n,) of those that have a solution within
    the coordinate's range. Raises ValueError where the instrument keeps no reading.
    """
    mounted = measurement.setups[setup]
    if mounted.instrument.fixed_reading is None:
        raise ValueError(
            f"{mounted.instrument.name} holds no reading by design: give {coordinate} itself"
        )
    wanted = mounted.instrument.fixed_reading(mounted.settings)
    column = [c.name for c in measurement.machine.command].index(coordinate)
    limits = measurement.machine.workspace(mounted.tool)[column]

    def read(poses: Array) -> Array:
        return measurement.expected_readings(measurement.series(setup, poses))

    home = float(
        measurement.machine.with_tool(
            measurement.machine.home_command, np.array(mounted.tool)
        )[column]
    )
    return _solve_coordinate(read, wanted, command, column, limits, home)
