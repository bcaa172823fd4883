"""Grids of commands, as fine as the interpolation of corrections between them needs.

The axis whose error has the largest product with the whole error, in the worst
component, gets the next nodes: along all axes that product falls at the same rate per
node.
"""

import dataclasses
import math
from collections.abc import Callable

import casadi as ca
import numpy as np
import scipy  # its parts load when first used: checks need no interpolation

from oed.base import Array, Mask, grid_nodes
from oed.mechanism import NO_TOOL, BatchedFunction, Kinematics, symbols
from oed.model import Machine

FULL_TURN = 2.0 * math.pi
MIN_NODES = 2  #: nodes along an axis: its ends
#: nodes round a full turn: one at each quarter, and the first once more
MIN_NODES_ROUND = 5
GROWTH_SHARE = 1.0 / 16.0  #: an axis grows by this share of its nodes at a time
#: places in the box over which errors are averaged: a Latin hypercube
N_POSITIONS = 512
POSITION_TOLERANCE = 1e-9  #: what counts as equal places, m or rad


@dataclasses.dataclass(frozen=True)
class GridAxis:
    """A command coordinate of a table, from `lower` to `upper`, SI."""

    name: str
    unit: str
    lower: float
    upper: float
    #: whether that is a full turn: the last node then repeats the first one, so that
    #: interpolation goes on over the end
    turn: bool = False
    #: ends of the part in which interpolation errors count; all of it by default
    counted: tuple[float, float] | None = None

    @property
    def evaluated(self) -> tuple[float, float]:
        """Ends of the part in which interpolation errors count."""
        return self.counted or (self.lower, self.upper)

    def holds(self, position: float) -> bool:
        """Whether a place is on the axis."""
        return (
            self.turn
            or self.lower - POSITION_TOLERANCE
            <= position
            <= self.upper + POSITION_TOLERANCE
        )

    def knots(self, count: int) -> Array:
        """So many evenly spaced places, SI."""
        return np.linspace(self.lower, self.upper, count)

    @property
    def fewest(self) -> int:
        """Least number of nodes."""
        if self.upper <= self.lower:
            return 1
        return MIN_NODES_ROUND if self.turn else MIN_NODES

    def shrunk(self, share: float) -> "GridAxis":
        """The axis with this share of what counts, about its middle; turns stay whole."""
        if self.turn or share == 1.0:
            return self
        low, high = self.evaluated
        middle, half = (low + high) / 2.0, (high - low) / 2.0
        lower, upper = middle - share * half, middle + share * half
        return dataclasses.replace(self, lower=lower, upper=upper, counted=None)

    def reaching(self, position: float) -> "GridAxis":
        """The axis extended to a place, where errors do not count."""
        if self.holds(position):
            return self
        lower, upper = min(self.lower, position), max(self.upper, position)
        return dataclasses.replace(
            self, lower=lower, upper=upper, counted=self.evaluated
        )

    @staticmethod
    def box_axes(machine: Machine, command: Array) -> "tuple[GridAxis, ...]":
        """Axes of the box of commands (n, n_dof), SI.

        An angle after which the pose repeats is a full turn, if the commands lie round it:
        no further apart over its end than elsewhere.
        """
        periodic = _repeats_after_a_turn(machine)
        axes = []
        for k, c in enumerate(machine.command):
            positions = np.unique(command[:, k])
            low = float(positions[0])
            high = float(positions[-1])
            turn = False
            if periodic[k] and len(positions) > 1:
                over_end = low + FULL_TURN - high
                turn = bool(
                    over_end <= np.diff(positions).max() * (1.0 + POSITION_TOLERANCE)
                )
            if turn:
                holds_first_turn = low <= 0.0 and high >= FULL_TURN * (
                    1.0 - POSITION_TOLERANCE
                )
                low = 0.0 if holds_first_turn else low
                high = low + FULL_TURN
            axes.append(GridAxis(c.name, c.unit, low, high, turn))
        return tuple(axes)


@dataclasses.dataclass(frozen=True)
class CommandGrid:
    """A rectilinear grid with equal steps along each axis."""

    axes: tuple[GridAxis, ...]
    counts: tuple[int, ...]  #: (a,) nodes along each axis
    #: (s, k) rms errors that interpolation leaves in the box, SI, by state and
    #: component
    errors: Array
    is_fine: bool  #: whether they are within what was asked for

    @property
    def knots(self) -> tuple[Array, ...]:
        """Places along each axis, SI."""
        pairs = zip(self.axes, self.counts, strict=True)
        return tuple(axis.knots(count) for axis, count in pairs)

    @property
    def commands(self) -> Array:
        """Commands (n, a) of the nodes, the last axis running fastest."""
        return grid_nodes(self.knots)

    @property
    def turns(self) -> tuple[bool, ...]:
        """Which axes are a full turn."""
        return tuple(axis.turn for axis in self.axes)

    @classmethod
    def choose(
        cls,
        axes: tuple[GridAxis, ...],
        correction: Callable[[Array], Array],
        motion: Callable[[Array], Array],
        target: Array,
        largest: int,
        rng: np.random.Generator,
    ) -> "CommandGrid":
        """The grid with about the fewest commands whose interpolation costs at most `target`.

        correction  (n, s, nq) of the joints in s states, at commands; tabled at the nodes
        motion      (n, k, nq) of the components per unit of each joint, at commands
        target      (k,) largest rms error by interpolation in any state, SI
        largest     number of commands

        Raises AssemblyError where a place of the box is out of reach.
        """
        low, high = np.array([axis.evaluated for axis in axes]).T
        positions = low + (high - low) * _latin_hypercube(N_POSITIONS, len(axes), rng)
        exact = correction(positions)
        motion_per_target = motion(positions) / target[:, None]

        def error_along(k: int, count: int) -> Array:
            """Errors (n, s, k) over the target of interpolation along one axis."""
            if count == 1:
                return np.zeros((*exact.shape[:2], len(target)))
            lines = _interpolated(positions, k, axes[k].knots(count), correction)
            return np.asarray(
                np.einsum("nkj,nsj->nsk", motion_per_target, lines - exact)
            )

        counts = [axis.fewest for axis in axes]
        along = [error_along(k, count) for k, count in enumerate(counts)]
        while True:
            whole = np.sum(along, axis=0)
            size = np.sqrt(np.mean(whole**2, axis=0))
            is_fine = bool(size.max() <= 1.0)
            state, worst = np.unravel_index(int(np.argmax(size)), size.shape)
            of_worst = [np.mean((whole * e)[:, state, worst]) for e in along]
            k = int(np.argmax(of_worst))
            grown = _grown(counts, k, largest)
            if is_fine or grown is None:
                return cls(axes, tuple(counts), size * target, is_fine)
            counts = grown
            along[k] = error_along(k, counts[k])


def _repeats_after_a_turn(machine: Machine) -> Mask:
    """Which command coordinates (n_dof,) are angles that hold the same pose after a turn."""
    c, by_name = symbols("c", machine.command)
    target = BatchedFunction("target", [c], [ca.vertcat(*machine.target(by_name))])
    rng = np.random.default_rng(0)
    positions = machine.home_command + rng.uniform(0.1, 0.5, (4, len(machine.command)))
    values = target(positions)[0]
    repeats = []
    for k, coordinate in enumerate(machine.command):
        turned = positions.copy()
        turned[:, k] += FULL_TURN
        same = np.allclose(target(turned)[0], values, rtol=0.0, atol=POSITION_TOLERANCE)
        repeats.append(coordinate.unit == "rad" and same)
    return np.array(repeats)


def joint_motion(kinematics: Kinematics, command: Array) -> Array:
    """Motion (n, k, nq) of the k components that the joints drive, at commands.

    It is that per unit of each joint, of the nominal machine. Raises AssemblyError.
    """
    machine = kinematics.machine
    driven = [k for k, c in enumerate(machine.components) if c.compensatable]
    x, q = kinematics.inverse(command)
    by_joint = kinematics.slopes.pose_by_joint(x, q, machine.nominal)
    twist = kinematics.frames(x, NO_TOOL)[2] @ by_joint
    motion_per_target = kinematics.error_components_jacobian(command)
    return (motion_per_target @ twist)[:, driven]


def _latin_hypercube(count: int, axes: int, rng: np.random.Generator) -> Array:
    """Places (count, axes) between 0 and 1, one in each of `count` slices of an axis."""
    slices = rng.permuted(np.tile(np.arange(count), (axes, 1)), axis=1).T
    return (slices + rng.uniform(size=slices.shape)) / count


def _grown(counts: list[int], k: int, largest: int) -> list[int] | None:
    """Numbers of nodes with more of them along axis k; None where that is too many."""
    for more in (max(1, int(GROWTH_SHARE * counts[k])), 1):
        grown = [*counts[:k], counts[k] + more, *counts[k + 1 :]]
        if math.prod(grown) <= largest:
            return grown
    return None


def _interpolated(
    positions: Array, k: int, knots: Array, correction: Callable[[Array], Array]
) -> Array:
    """Corrections (n, s, nq) at places, in straight lines between the knots of axis k."""
    index = np.clip(np.searchsorted(knots, positions[:, k]) - 1, 0, len(knots) - 2)
    low, high = positions.copy(), positions.copy()
    low[:, k], high[:, k] = knots[index], knots[index + 1]
    share = (positions[:, k] - low[:, k]) / (high[:, k] - low[:, k])
    share = share[:, None, None]
    return (1.0 - share) * correction(low) + share * correction(high)


@dataclasses.dataclass(frozen=True)
class InterpolationTable:
    """Values on a rectilinear grid; beyond the grid its border values hold."""

    axes: tuple[str, ...]  #: names of the coordinates or states
    knots: tuple[Array, ...]  #: ascending places along each axis, SI
    values: Array  #: (n_1, ..., n_a, m), SI
    #: axes that are a full turn, whose last knot repeats the first; none by default
    turns: tuple[bool, ...] = ()

    def __post_init__(self) -> None:
        shape = tuple(len(positions) for positions in self.knots)
        if self.values.shape[:-1] != shape or len(self.axes) != len(shape):
            raise ValueError(
                f"a table over {self.axes} with {shape} knots needs values of that"
                f" shape and one axis more, not {self.values.shape}"
            )
        for name, positions in zip(self.axes, self.knots, strict=True):
            if not (np.diff(positions) > 0.0).all():
                raise ValueError(f"the knots of {name} must ascend")

    def at(self, positions: Array) -> Array:
        """Interpolated values (n, m) at places (n, a)."""
        low = np.array([axis[0] for axis in self.knots])
        high = np.array([axis[-1] for axis in self.knots])
        inside = np.clip(self._reduce_turns(positions, low, high), low, high)
        varied = [k for k, axis in enumerate(self.knots) if len(axis) > 1]
        if not varied:
            return np.repeat(self.values.reshape(1, -1), len(positions), axis=0)
        knots = [self.knots[k] for k in varied]
        shape = [len(axis) for axis in knots]
        values = self.values.reshape(*shape, self.values.shape[-1])
        interpolator = scipy.interpolate.RegularGridInterpolator(knots, values)
        return np.asarray(interpolator(inside[:, varied]))

    def _reduce_turns(self, positions: Array, low: Array, high: Array) -> Array:
        """Places with the angles of full turns between the ends of their axes."""
        reduced = np.array(positions, dtype=float)
        for k in np.flatnonzero(self.turns):
            reduced[:, k] = low[k] + np.mod(reduced[:, k] - low[k], high[k] - low[k])
        return reduced
