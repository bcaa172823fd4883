"""Distance of machine and bar to obstacles, at poses.

Everything is a capsule (`oed.design.segments`); a sphere is one of no length. The
machine's skeleton moves with capsules along its lines, and the bar reaches from its cup
to the tool point. Clearance is the least distance between the segments less both radii,
negative in collision.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import casadi as ca
import numpy as np

from oed.base import Array
from oed.design.segments import Capsule, segment_distance
from oed.measurement import Measurement, Series
from oed.mechanism.batch import BatchedFunction
from oed.mechanism.kinematics import Kinematics
from oed.model.expressions import symbols


@dataclasses.dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Obstacles, and what moves between them; m.

    obstacles  fixed capsules in the base frame; the stand of the cup touches the bar:
               let it end short of the cup
    links      radius of the capsules along the lines of the machine's skeleton; None:
               links are not checked
    bar        radius of the bar from its cup to the tool point; None: there is none
    margin     clearance to be kept
    ignore     numbers of skeleton lines that are left out (such as a fixed base)
    """

    obstacles: tuple[Capsule, ...]
    links: float | None = None
    bar: float | None = None
    margin: float = 0.0
    ignore: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.obstacles:
            raise ValueError("surroundings need at least one obstacle")
        if self.links is None and self.bar is None:
            raise ValueError(
                "nothing that moves is checked: give a radius to the links, to the"
                " bar, or to both"
            )


class Skeleton:
    """The lines of a machine's skeleton as segments, over many poses at once."""

    def __init__(
        self, kinematics: Kinematics, tool: Sequence[float], ignore: Sequence[int] = ()
    ) -> None:
        machine = kinematics.machine
        if machine.skeleton is None:
            raise ValueError(
                f"{machine.name} has no skeleton: its links cannot be checked"
            )
        x, xs = symbols("x", machine.pose)
        q, qs = symbols("q", machine.joints)
        p, ps = symbols("p", machine.parameters)
        lines = [list(line) for line in machine.skeleton(xs, qs, ps)]
        unknown = set(ignore) - set(range(len(lines)))
        if unknown:
            raise ValueError(
                f"{machine.name}: its skeleton has lines 0 to {len(lines) - 1}, not"
                f" {sorted(unknown)}"
            )
        if any(tool):  # a longer tool than the skeleton's
            rotation, point = machine.platform(xs)
            lines.append([point, point + rotation @ ca.DM(list(tool))])
        checked = [line for i, line in enumerate(lines) if i not in ignore]
        pairs = [pair for line in checked for pair in itertools.pairwise(line)]
        self._count = len(pairs)
        ends = ca.vertcat(*[ca.vertcat(ca.vec(a), ca.vec(b)) for a, b in pairs])
        self._ends = BatchedFunction("skeleton_ends", [x, q, p], [ends])

    def segments(self, x: Array, q: Array, p: Array) -> Array:
        """Segments (n, k, 2, 3) of poses x (n, nx) with joints q (n, nq), m."""
        return self._ends(x, q, p)[0].reshape(len(x), self._count, 2, 3)


def cup_place(
    measurement: Measurement, setup: str, cup: Sequence[float] | None = None
) -> Array:
    """Where the bar of a set-up is held (3,), base frame, m.

    That is `cup` if given, else its place settings at_x, at_y, at_z, else the tool
    point at its teach pose. Raises ValueError where none of these is known.
    """
    if cup is not None:
        return np.asarray(cup, dtype=float)
    mounted = measurement.setups[setup]
    if {"at_x", "at_y", "at_z"} <= set(mounted.settings):
        return np.array([mounted.settings[f"at_{axis}"] for axis in "xyz"])
    if mounted.teach is None:
        raise ValueError(
            f"set-up {setup}: {mounted.instrument.name} does not state where its other"
            " end is: give its cup"
        )
    tool = np.array(mounted.tool)
    x, _ = measurement.kinematics.inverse(np.array(mounted.teach)[None], None, tool)
    return np.asarray(measurement.kinematics.frames(x, tool)[1][0])


@dataclasses.dataclass(frozen=True, eq=False)
class _Links:
    """The machine's links: lines of its skeleton, and their radius, m."""

    skeleton: Skeleton
    radius: float


@dataclasses.dataclass(frozen=True, eq=False)
class _Bar:
    """The bar: where it is held (3,), base frame, and its radius, m."""

    cup: Array
    radius: float


class Clearance:
    """Clearance of one set-up on the nominal machine."""

    def __init__(
        self,
        measurement: Measurement,
        setup: str,
        surroundings: Surroundings,
        cup: Sequence[float] | None = None,
    ) -> None:
        self._measurement, self._surroundings = measurement, surroundings
        tool = measurement.setups[setup].tool
        self._tool = np.array(tool)
        self._links: _Links | None = None
        if surroundings.links is not None:
            skeleton = Skeleton(measurement.kinematics, tool, surroundings.ignore)
            self._links = _Links(skeleton, surroundings.links)
        self._bar: _Bar | None = None
        if surroundings.bar is not None:
            place = cup_place(measurement, setup, cup)
            self._bar = _Bar(place, surroundings.bar)

    def at_poses(self, x: Array, q: Array, *, bar: bool = True) -> Array:
        """Clearance (n,) at poses x (n, nx) with joints q (n, nq), m.

        `bar` = False: with the bar taken off.
        """
        ends, radii = self._moving_segments(x, q, bar)
        by_segment = self._segment_clearances(ends, radii)
        return np.asarray(by_segment.min(axis=1, initial=np.inf))

    def at_readings(self, series: Series, x: Array) -> Array:
        """Clearance (N,) at the readings of a series with poses x (m, nx), m.

        At reference poses the bar is off.
        """
        without_bar = np.full(len(x), np.inf)
        if self._links is not None:
            without_bar = self.at_poses(x, series.q, bar=False)
        read = series.index[:, 0]
        with_bar = self.at_poses(x[read], series.q[read])
        others = without_bar[series.index].min(axis=1)
        return np.asarray(np.minimum(with_bar, others))

    def _moving_segments(
        self, x: Array, q: Array, bar: bool = True
    ) -> tuple[Array, Array]:
        """Moving segments (n, k, 2, 3) and their radii (k,)."""
        parts, radii = [np.empty((len(x), 0, 2, 3))], [np.empty(0)]
        nominal = self._measurement.machine.nominal
        if self._links is not None:
            links = self._links.skeleton.segments(x, q, nominal)
            parts.append(links)
            radii.append(np.full(links.shape[1], self._links.radius))
        if bar and self._bar is not None:
            tip = self._measurement.kinematics.frames(x, self._tool)[1]
            cup = np.broadcast_to(self._bar.cup, tip.shape)
            parts.append(np.stack([cup, tip], axis=1)[:, None])
            radii.append(np.array([self._bar.radius]))
        return np.concatenate(parts, axis=1), np.concatenate(radii)

    def _segment_clearances(self, moving: Array, radii: Array) -> Array:
        """Clearance (n, k) of each moving segment."""
        clearances = np.full(moving.shape[:2], np.inf)
        for obstacle in self._surroundings.obstacles:
            start, end = np.array(obstacle.start), np.array(obstacle.end)
            distance = segment_distance(moving[:, :, 0], moving[:, :, 1], start, end)
            clearances = np.minimum(clearances, distance - radii - obstacle.radius)
        return clearances
