"""Fields of pose errors, where to read them, and the table that subtracts them in advance.

The errors of the joints (`oed.forecast.joint_errors`) are each a linear trend plus a
field with Matern's correlation of order 3/2 (the discrepancy's, `oed.base.field_modes`)
or 5/2, with one length for each axis and one size for all joints. Lengths, size and order
maximise the marginal likelihood times a weak prior on the lengths (Rasmussen and Williams
2006, Gaussian Processes for Machine Learning, Eqs. 2.25-2.26, 2.42, 4.9, 4.17, 5.8). The
noise of a reading is known: it is no part of the field. The zero of the instrument is not.

Chang, Li and Li (2011), section 3: with the errors dX_i at command X_i and dX_0 at the
reference, the drives get X_i' = X_i - (dX_i - dX_0), interpolated linearly between the
nodes of a grid. Here the errors are carried through the kinematics to the joints, so that
the commands need not be the coordinates in which errors are stated.
"""

import dataclasses
import functools
import itertools
from collections.abc import Callable

import numpy as np
from scipy import linalg, optimize, special

from oed.accuracy import ErrorMaps, Reference
from oed.base import Array, Index
from oed.compensate import CommandGrid, GridAxis, InterpolationTable, joint_motion
from oed.mechanism import NO_TOOL, Kinematics
from oed.model import Component
from oed.poses import Belief

MATERN_ORDERS = ("3/2", "5/2")  #: kernels that compete: correlation at scaled distances
#: prior median of a correlation length, in half spans of the workspace
LENGTH_MEDIAN = 1.0
LENGTH_SPREAD = 1.0  #: prior standard deviation of its logarithm
#: standard deviation of the coefficients of trend and zero over the size of the errors
TREND_SIZE = 10.0
#: share of a component's variance that is added to each reading: rounding
NUGGET_SHARE = 1e-9
START_LENGTHS = (0.5, 2.0)  #: lengths from which the optimisation starts
ENERGY_SHARE = 0.999  #: share of a field's variance that its modes represent
MAX_MODES = 40


# Errors of the driven components as functions of errors of the joints, here and at home.
#
# What calibration leaves is smooth in the joints, which yield under load, not in the pose:
# near a singular pose a joint's error moves the tool far. So an error of the k driven
# components at a command is
#
#     e = L(c) u(c) + H(c) u(home) + G(c) p,
#
# with u the errors of the joints, L and H their effect on the error against the reference,
# and p errors of the parameters. Commands enter by the joints that they ask for, along the
# principal axes of these over the workspace. There a full turn ends where it began, a tilt
# of zero has one direction, and the places near a singular pose, where errors change fast,
# lie far apart.

POSITION_TOLERANCE = 1e-9  #: what counts as an equal place, m or rad
#: slope over a twist from which on a component's error has no meaning: psi of an upright
#: tool
MAX_SLOPE = 1e3


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorRows:
    """Errors (n, k) of the driven components as functions of joints and parameters."""

    #: (n, a) joints along their principal axes, the workspace from -1 to 1
    positions: Array
    local: Array  #: (n, k, q) per error of each joint at the command, SI
    at_home: Array  #: (n, k, q) per error of each joint at home, SI
    #: (n, k, b) per standard deviation of b known directions of the parameters
    by_parameter: Array


@dataclasses.dataclass(frozen=True, eq=False)
class JointErrors:
    """Error rows of a machine over a workspace."""

    kinematics: Kinematics  #: of the machine
    command: Array  #: (n, n_dof) commands of the workspace, SI
    reference: Reference  #: against which errors are stated: home or absolute
    #: (np, b) of the parameters' errors, per standard deviation, SI; b = 0 where no
    #: parameter was estimated
    spread: Array

    @property
    def driven(self) -> tuple[Component, ...]:
        """Components (k,) that the joints drive."""
        return tuple(c for c in self.kinematics.machine.components if c.compensatable)

    @property
    def _driven(self) -> list[int]:
        components = self.kinematics.machine.components
        return [k for k, c in enumerate(components) if c.compensatable]

    @property
    def home_place(self) -> Array:
        """Where home lies (a,) among the places."""
        return np.asarray(self.positions(self.kinematics.machine.home_command[None])[0])

    def positions(self, command: Array) -> Array:
        """Joints at commands (n, n_dof), along their principal axes, scaled (n, a)."""
        middle, axes = self._axes
        return np.asarray((self.kinematics.inverse(command)[1] - middle) @ axes)

    @functools.cached_property
    def _axes(self) -> tuple[Array, Array]:
        """Middle (q,) and axes (q, a) that scale the workspace's joints to -1 to 1."""
        joints = self.kinematics.inverse(self.command)[1]
        count = int((np.ptp(self.command, axis=0) > POSITION_TOLERANCE).sum())
        axes = np.linalg.svd(joints - joints.mean(axis=0), full_matrices=False)[2].T
        along = joints @ axes[:, :count]
        low, high = along.min(axis=0), along.max(axis=0)
        middle = axes[:, :count] @ ((low + high) / 2.0)
        return middle, np.asarray(axes[:, :count] * 2.0 / (high - low))

    def rows(self, command: Array) -> ErrorRows:
        """The rows at commands (n, n_dof). Raises AssemblyError."""
        kinematics = self.kinematics
        machine = kinematics.machine
        driven = self._driven
        both = np.vstack([command, machine.home_command[None]])
        motion = self._twists(both)
        count = motion.shape[2]
        apart = np.zeros((len(both), 6, 2 * count))
        apart[:-1, :, :count] = motion[:-1]
        apart[-1, :, count:] = motion[-1]
        maps = ErrorMaps.of(
            kinematics, command, self.reference, further=(apart, apart)
        ).raw[:, driven]
        of_parameters = np.zeros((len(command), len(driven), 0))
        if self.spread.shape[1]:
            raw = ErrorMaps.of(kinematics, command, self.reference).raw[:, driven]
            of_parameters = raw @ self.spread
        return ErrorRows(
            positions=self.positions(command),
            local=maps[:, :, :count],
            at_home=maps[:, :, count:],
            by_parameter=of_parameters,
        )

    def meaningful(self, command: Array) -> Array:
        """Which components (n, k) have an error at commands (n, n_dof)."""
        jacobian = self.kinematics.error_components_jacobian(command)
        size = np.linalg.norm(jacobian[:, self._driven], axis=2)
        return np.asarray(np.isfinite(size) & (size < MAX_SLOPE))

    def fit(self, command: Array, errors: Array, sigma: Array) -> "ErrorField":
        """The field that readings `errors` (n, k) at commands make most probable.

        errors  SI, less what the parameters predict; NaN where none was read
        sigma   (n, k) noise of a reading, SI

        Raises ValueError for fewer commands than a trend needs, with one to spare.
        """
        rows = self.rows(command)
        needed = rows.positions.shape[1] + 2
        read = np.flatnonzero(~np.isnan(errors).ravel())
        rounded = np.round(command[read // errors.shape[1]], 9)
        nodes, node = np.unique(rounded, axis=0, return_inverse=True)
        if len(nodes) < needed:
            raise ValueError(f"{len(nodes)} nodes are too few: read {needed} or more")
        values, noise = errors.ravel()[read], sigma.ravel()[read]
        of_noise = joint_size(rows, np.where(np.isnan(errors), np.nan, sigma))
        size = max(joint_size(rows, errors), of_noise)
        prior = _Prior(self.home_place, TREND_SIZE * size, of_noise)
        kernel = expected_kernel(size, rows.positions.shape[1])
        expected = ErrorField(
            self, rows, read, node.ravel(), values, noise, kernel, prior
        )
        return expected.most_probable()

    def plan_nodes(
        self, candidates: Array, most: int, expected: Array, sigma: Array, target: Array
    ) -> "NodeDesign":
        """`design_nodes` for expected rms errors (k,), SI; NaN where none is stated."""
        rows = self.rows(self.command)
        size = joint_size(rows, np.broadcast_to(expected, rows.local.shape[:2]))
        kernel = expected_kernel(size, rows.positions.shape[1])
        design = design_nodes(self, candidates, most, kernel, sigma, target)
        stated = np.where(np.isnan(expected), design.expected, expected)
        return dataclasses.replace(design, expected=stated)

    def _twists(self, command: Array) -> Array:
        """Twists (n, 6, q) per error of each joint; of the struts where they are stated."""
        kinematics, machine = self.kinematics, self.kinematics.machine
        x, q = kinematics.inverse(command)
        by_joint = kinematics.slopes.pose_by_joint(x, q, machine.nominal)
        if machine.struts is not None:
            by_joint = by_joint * kinematics.struts(x, q, machine.nominal)[2][:, None]
        return np.asarray(kinematics.frames(x, NO_TOOL)[2] @ by_joint)


@dataclasses.dataclass(frozen=True)
class Kernel:
    """Covariance of the error of each joint, without its trend."""

    order: str  #: one of MATERN_ORDERS
    size: float  #: standard deviation, SI
    length: Array  #: (a,) correlation lengths, in half spans of the workspace

    def covariance(self, first: Array, second: Array) -> Array:
        """Covariance (n, m) between places (n, a) and (m, a)."""
        difference = (first[:, None] - second[None]) / self.length
        distance = np.sqrt((difference**2).sum(axis=-1))
        return self.size**2 * _correlation(self.order, distance)


def expected_kernel(size: float, axes: int) -> Kernel:
    """The kernel before any reading, of order 3/2, of an expected size, sd, SI."""
    return Kernel("3/2", size, np.full(axes, LENGTH_MEDIAN))


def _correlation(order: str, distance: Array) -> Array:
    if order == "5/2":
        scaled = np.sqrt(5.0) * distance
        return np.asarray((1.0 + scaled + scaled**2 / 3.0) * np.exp(-scaled))
    scaled = np.sqrt(3.0) * distance
    return np.asarray((1.0 + scaled) * np.exp(-scaled))


@dataclasses.dataclass(frozen=True, eq=False)
class _Prior:
    """Prior covariance of errors: of the joints' fields, of trends, and of what is known."""

    home: Array  #: (a,) place of home
    trend: float  #: standard deviation of the trends' coefficients, SI
    #: that of a joint error at home which the instrument's zero amounts to, SI
    noise: float

    def columns(self, rows: ErrorRows) -> Array:
        """Errors (n k, b) per standard deviation of trends and parameters."""
        here = np.column_stack([np.ones(len(rows.positions)), rows.positions])
        at_home = np.r_[1.0, self.home]
        gradients = np.einsum("nkq,na->nkqa", rows.local, here)
        gradients += np.einsum("nkq,a->nkqa", rows.at_home, at_home)
        n, k = rows.local.shape[:2]
        trends = self.trend * gradients.reshape(n * k, -1)
        return np.hstack([trends, rows.by_parameter.reshape(n * k, -1)])

    def zero(self, rows: ErrorRows) -> Array:
        """Readings (n k, q) per standard deviation of an error of the zero at home."""
        n, k = rows.local.shape[:2]
        return self.noise * rows.at_home.reshape(n * k, -1)

    def field(self, kernel: Kernel, first: ErrorRows, second: ErrorRows) -> Array:
        """Covariance (n k, m k) of the fields."""
        home = self.home[None]
        here = kernel.covariance(first.positions, second.positions)
        to_home = kernel.covariance(first.positions, home)[:, 0]
        from_home = kernel.covariance(home, second.positions)[0]
        value = _paired(first.local, second.local) * here[:, None, :, None]
        value += _paired(first.local, second.at_home) * to_home[:, None, None, None]
        value += _paired(first.at_home, second.local) * from_home[None, None, :, None]
        value += kernel.size**2 * _paired(first.at_home, second.at_home)
        n, k, m, _ = value.shape
        return np.asarray(value.reshape(n * k, m * k))

    def variance(self, kernel: Kernel, first: ErrorRows, second: ErrorRows) -> Array:
        """Covariance (n k, m k) of the errors."""
        columns = self.columns(first) @ self.columns(second).T
        return self.field(kernel, first, second) + columns


def _paired(first: Array, second: Array) -> Array:
    """Products (n, k, m, k) over the joints."""
    n, k, q = first.shape
    product = first.reshape(-1, q) @ second.reshape(-1, q).T
    return np.asarray(product.reshape(n, k, len(second), k))


@dataclasses.dataclass(frozen=True, eq=False)
class ErrorField:
    """Errors of the driven components, given readings."""

    model: JointErrors  #: of the errors
    rows: ErrorRows  #: (n, k) of the readings
    read: Index  #: (r,) which components of which rows were read, flat
    node: Index  #: (r,) number of the node of each reading; repeats are of one
    errors: Array  #: (r,) readings less what the parameters predict, SI
    sigma: Array  #: (r,) their noise, SI
    kernel: Kernel  #: of the joints' errors
    prior: _Prior  #: of trends

    def mean(self, command: Array) -> Array:
        """Expected errors (m, k) at commands, SI, beyond what the parameters predict."""
        cross = self._cross(self.model.rows(command))
        return np.asarray((cross @ self._weights).reshape(len(command), -1))

    def covariance(self, command: Array) -> Array:
        """Covariance (m k, m k) of the errors at commands, SI."""
        rows = self.model.rows(command)
        cross = self._cross(rows)
        reduction = cross @ linalg.cho_solve(self._factor, cross.T)
        return np.asarray(self.prior.variance(self.kernel, rows, rows) - reduction)

    def left_out(self) -> tuple[Array, Array]:
        """Readings less their prediction by other nodes, its sd (n, k), SI, or NaN."""
        inverse = linalg.cho_solve(self._factor, np.eye(len(self.errors)))
        residual, sd = np.full((2, *self.rows.local.shape[:2]), np.nan)
        for number in np.unique(self.node):
            members = np.flatnonzero(self.node == number)
            covariance = np.linalg.inv(inverse[np.ix_(members, members)])
            residual.ravel()[self.read[members]] = covariance @ self._weights[members]
            sd.ravel()[self.read[members]] = np.sqrt(np.diag(covariance))
        return residual, sd

    def _cross(self, rows: ErrorRows) -> Array:
        """Covariance (m k, r) of errors with the readings."""
        whole = self.prior.variance(self.kernel, rows, self.rows)
        return np.asarray(whole[:, self.read])

    @functools.cached_property
    def _factor(self) -> tuple[Array, bool]:
        """Of the covariance (r, r) of readings: errors, the instrument's zero, and noise."""
        rows, zero = self.rows, self.prior.zero(self.rows)
        whole = self.prior.variance(self.kernel, rows, rows) + zero @ zero.T
        whole = whole[np.ix_(self.read, self.read)]
        whole += np.diag(self.sigma**2 + NUGGET_SHARE * np.diag(whole))
        factor, lower = linalg.cho_factor(whole, lower=True)
        return np.asarray(factor), bool(lower)

    @functools.cached_property
    def _weights(self) -> Array:
        return np.asarray(linalg.cho_solve(self._factor, self.errors))

    def most_probable(self) -> "ErrorField":
        """The field with the kernel of largest posterior density among all orders."""
        size, axes = self.kernel.size, len(self.kernel.length)

        def of_kernel(point: Array, order: str) -> ErrorField:
            length = LENGTH_MEDIAN * np.exp(point[1:])
            kernel = Kernel(order, size * float(np.exp(point[0])), length)
            return dataclasses.replace(self, kernel=kernel)

        def cost(point: Array, order: str) -> float:
            field = of_kernel(point, order)
            try:
                log_root = float(np.log(np.diag(field._factor[0])).sum())
            except linalg.LinAlgError:
                return 1e10
            misfit = 0.5 * float(self.errors @ field._weights)
            return (
                misfit
                + log_root
                + 0.5 * float(np.sum((point[1:] / LENGTH_SPREAD) ** 2))
            )

        minima = []
        for order, start in itertools.product(MATERN_ORDERS, START_LENGTHS):
            solution = optimize.minimize(
                cost,
                np.r_[-1.0, np.full(axes, np.log(start))],
                args=(order,),
                method="L-BFGS-B",
                bounds=[(-8.0, 8.0), *[(-3.0, 3.0)] * axes],
            )
            minima.append((solution.fun, of_kernel(solution.x, order)))
        return min(minima, key=lambda minimum: minimum[0])[1]

    def forecast(
        self,
        predicted_errors: Callable[[Array], Array],
        axes: tuple[GridAxis, ...],
        largest: int,
        rng: np.random.Generator,
    ) -> "Forecast":
        """The table of an estimated field of errors.

        predicted_errors  errors (n, k) that the parameters predict, at commands, SI
        axes              of the table
        largest           number of its commands

        Raises AssemblyError where a place of the box is out of reach.
        """
        kinematics = self.model.kinematics
        workspace = self.model.command
        covariance = self.covariance(workspace)
        shape = (len(workspace), -1)
        variance = np.maximum(np.diag(covariance), 0.0).reshape(shape).mean(axis=0)

        def errors(command: Array) -> Array:
            return predicted_errors(command) + self.mean(command)

        def correction(command: Array) -> Array:
            inverse = np.linalg.pinv(joint_motion(kinematics, command))
            return np.asarray(
                -np.einsum("nqk,nk->nq", inverse, errors(command))[:, None]
            )

        grid = CommandGrid.choose(
            axes,
            correction,
            lambda command: joint_motion(kinematics, command),
            INTERPOLATION_SHARE * np.sqrt(variance),
            largest,
            rng,
        )
        interpolation = grid.errors.max(axis=0) ** 2
        drawn = _rms_draws(covariance, shape, rng)
        low, high = np.quantile(drawn**2 + interpolation, INTERVAL_LEVELS, axis=0)
        return Forecast(
            field=self,
            grid=grid,
            joints=correction(grid.commands)[:, 0],
            predicted=np.sqrt(variance + interpolation),
            interval=np.sqrt([low, high]),
        )


def joint_size(rows: ErrorRows, errors: Array) -> float:
    """Size of joint errors that make errors (n, k), SI, by the largest component."""
    per_joint = np.sqrt((rows.local**2).sum(axis=2).mean(axis=0))
    read = ~np.isnan(errors).all(axis=0)
    deviation = np.sqrt(np.nanmean(errors[:, read] ** 2, axis=0))
    return max(float(np.max(deviation / per_joint[read])), 1e-12)


@dataclasses.dataclass(frozen=True)
class NodeDesign:
    """Candidates to read."""

    indices: Index  #: chosen candidates, the most useful one first
    #: (k,) rms error that interpolation between these readings leaves, SI
    predicted: Array
    expected: Array  #: (k,) rms error before any reading, SI


def design_nodes(
    model: JointErrors,
    candidates: Array,
    most: int,
    kernel: Kernel,
    sigma: Array,
    target: Array,
) -> NodeDesign:
    """Choose candidates (n, n_dof), SI, until the wanted accuracy, `most` at most.

    sigma   (k,) noise of a reading, SI
    target  (k,) rms error that interpolation may leave, SI; NaN where none is stated.
            Without any, `most` are chosen

    Each lowers the variance of the errors over the workspace most.
    """
    readings, errors = _linear(model, kernel, candidates, sigma)
    blocks = readings / sigma[:, None]
    factors = errors.swapaxes(0, 1) / np.sqrt(len(errors))
    belief = Belief.build(np.eye(blocks.shape[2]), factors)
    chosen: list[int] = []
    while len(chosen) < most and belief.open_components(target):
        chosen.append(belief.best_candidate(blocks, target))
        belief = belief.after(blocks[chosen[-1]])
    local = model.rows(model.command).local
    expected = kernel.size * np.sqrt((local**2).sum(axis=2).mean(axis=0))
    return NodeDesign(np.array(chosen), np.sqrt(belief.variances), expected)


def _linear(
    model: JointErrors, kernel: Kernel, candidates: Array, sigma: Array
) -> tuple[Array, Array]:
    """Readings (n, k, b), errors (m, k, b), per sd of trends, modes and zeros."""
    both = model.rows(np.vstack([candidates, model.command]))
    noise = joint_size(both, np.broadcast_to(sigma, both.local.shape[:2]))
    prior = _Prior(model.home_place, TREND_SIZE * kernel.size, noise)
    zero = prior.zero(both)
    parts = [prior.columns(both), _modes(prior, kernel, both), zero]
    n, k = both.local.shape[:2]
    whole = np.hstack(parts).reshape(n, k, -1)
    errors = whole[len(candidates) :].copy()
    errors[:, :, -zero.shape[1] :] = 0.0
    return whole[: len(candidates)], errors


def _modes(prior: _Prior, kernel: Kernel, rows: ErrorRows) -> Array:
    """Errors (n k, b) per standard deviation of the fields' leading modes."""
    positions = np.vstack([rows.positions, prior.home[None]])
    values, vectors = np.linalg.eigh(kernel.covariance(positions, positions))
    values, vectors = np.maximum(values[::-1], 0.0), vectors[:, ::-1]
    needed = int(np.searchsorted(np.cumsum(values), ENERGY_SHARE * values.sum())) + 1
    size = min(needed, MAX_MODES)
    modes = vectors[:, :size] * np.sqrt(values[:size])
    gradients = np.einsum("nkq,na->nkqa", rows.local, modes[:-1])
    gradients += np.einsum("nkq,a->nkqa", rows.at_home, modes[-1])
    n, k = rows.local.shape[:2]
    return np.asarray(gradients.reshape(n * k, -1))


#: interpolation in the table may cost this share of the rms that the field leaves
INTERPOLATION_SHARE = 0.2
N_DRAWS = 400  #: draws of the field, for the interval of its rms
INTERVAL_LEVELS = (0.025, 0.975)  #: probabilities of the ends of that interval


@dataclasses.dataclass(frozen=True, eq=False)
class Forecast:
    """A controller's table and what it leaves."""

    field: ErrorField  #: of errors
    grid: CommandGrid  #: commands of the table
    joints: Array  #: (n, nq) to add to the joints at its commands, SI
    #: (k,) rms over the workspace, SI: of the field and of interpolation
    predicted: Array
    interval: Array  #: (2, k) 95 % interval of it, SI

    @property
    def table(self) -> InterpolationTable:
        """What to add to the joints, interpolated between the commands."""
        names = tuple(axis.name for axis in self.grid.axes)
        values = self.joints.reshape(*self.grid.counts, -1)
        return InterpolationTable(names, self.grid.knots, values, self.grid.turns)

    def checked(
        self, command: Array, errors: Array, sigma: Array
    ) -> "tuple[Forecast, Array, Array]":
        """The forecast as nodes (n, n_dof) that were not fitted widen it.

        errors, sigma  (n, k) and their noise, SI; NaN where none was read

        Errors there beyond those predicted, as of waves that the fitted nodes do not see,
        add to what is predicted: of n residuals of mean square s, that of the machine is
        within n s / chi2 of n degrees of freedom. Returns also what the table leaves
        there (n, k), and its predicted rms (k,).
        """
        motion = joint_motion(self.field.model.kinematics, command)
        residual = errors + np.einsum("nkq,nq->nk", motion, self.table.at(command))
        of_field = np.diag(self.field.covariance(command)).reshape(errors.shape)
        variance = (of_field + sigma**2).mean(axis=0)
        count = np.isfinite(residual).sum(axis=0)
        square = np.nansum(residual**2, axis=0)
        upper, lower = (special.chdtri(count, level) for level in INTERVAL_LEVELS)
        predicted, low, high = (
            np.sqrt(size**2 + np.maximum(square / freedom - variance, 0.0))
            for size, freedom in (
                (self.predicted, count),
                (self.interval[0], upper),
                (self.interval[1], lower),
            )
        )
        widened = dataclasses.replace(
            self, predicted=predicted, interval=np.array([low, high])
        )
        return widened, residual, np.sqrt(variance)


def _rms_draws(
    covariance: Array, shape: tuple[int, int], rng: np.random.Generator
) -> Array:
    """Rms (N_DRAWS, k) over the workspace of draws of what the field leaves."""
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    drawn = rng.standard_normal((N_DRAWS, len(values))) @ root.T
    return np.asarray(np.sqrt((drawn.reshape(N_DRAWS, *shape) ** 2).mean(axis=1)))
