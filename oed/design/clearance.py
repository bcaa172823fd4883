"""How far machine and bar stay from what stands around them, at poses and along moves.

Everything is a capsule: a segment with a radius (a sphere is one of no length). The
machine's skeleton moves with capsules along its lines, the bar reaches from its cup to
the tool point. Clearance is the least distance between the segments less both radii,
negative in collision. The distance of two segments, |a + s u - b - t v| over 0 <= s, t
<= 1, is a convex quadratic: its least value is at the free minimum, where that is
inside, or on an edge, where it is the distance of an end point to the other segment.

A move is looked at in intervals. Within one no point of a segment moves farther than
the ends of that segment do; where the clearances of a segment at both ends of the
interval are c_0 and c_1 and its ends move by d at the most, on a way that is nearly
straight, its clearance in between is at least (c_0 + c_1 - d) / 2. Intervals that this
leaves open are halved.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from functools import partial

import casadi as ca
import numpy as np

from oed.arrays import Array, Index, Mask
from oed.batch import Batched
from oed.kinematics import AssemblyError, Kinematics, symbols
from oed.measurement import Measurement, Series

Point = tuple[float, float, float]
#: puts commands (n, n_dof) where an instrument leads the tool, and tells where (n,) it
#: can
Lead = Callable[[Array], tuple[Array, Mask]]
#: intervals in which a move is looked at first
INTERVALS = 8
#: a step of the ends (m) below which an interval still open counts as blocked
RESOLUTION = 1e-5
#: share of a move below which it does so too
SHORTEST = 1e-6


@dataclasses.dataclass(frozen=True, slots=True)
class Capsule:
    """A fixed obstacle in the base frame, m: all points within `radius` of the segment
    from `start` to `end`.
    """

    start: Point
    end: Point
    radius: float


def sphere(centre: Point, radius: float) -> Capsule:
    """A fixed sphere in the base frame, m."""
    return Capsule(centre, centre, radius)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Surroundings:
    """What moves, and what it must not touch; m.

    obstacles  fixed capsules in the base frame; what the cup stands on touches the bar:
               let it end short of the cup
    links      radius of the capsules along the lines of the machine's skeleton; None:
               they are not looked at
    bar        radius of the bar from its cup to the tool point; None: there is none
    margin     clearance that is to be kept
    ignore     numbers of skeleton lines that are left out (a base that stands where it
               stands)
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
                "nothing that moves is looked at: give a radius to the links, to the"
                " bar, or to both"
            )


def point_distance(point: Array, start: Array, end: Array) -> Array:
    """Distance (...) of points (..., 3) to segments from `start` to `end` (..., 3);
    arguments broadcast.
    """
    along = end - start
    square = np.asarray((along**2).sum(-1))
    share = ((point - start) * along).sum(-1) / np.where(square > 0.0, square, 1.0)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * along
    return np.asarray(np.linalg.norm(point - nearest, axis=-1))


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Distance (...) between segments a0 a1 and b0 b1 (..., 3); arguments broadcast,
    segments may be points.
    """
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    det = uu * vv - uv**2
    skew = det > 1e-12 * uu * vv  # parallel ones come nearest at an end point too
    s = (uv * vw - vv * uw) / np.where(skew, det, 1.0)
    t = (uu * vw - uv * uw) / np.where(skew, det, 1.0)
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    free = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    ends = [point_distance(a0, b0, b1), point_distance(a1, b0, b1)]
    ends += [point_distance(b0, a0, a1), point_distance(b1, a0, a1)]
    return np.minimum(np.minimum.reduce(ends), np.where(inside, free, np.inf))


class Skeleton:
    """The lines of a machine's skeleton as segments, over many poses at once."""

    def __init__(
        self, kinematics: Kinematics, tool: Sequence[float], ignore: Sequence[int] = ()
    ) -> None:
        machine = kinematics.machine
        if machine.skeleton is None:
            raise ValueError(
                f"{machine.name} has no skeleton: its links cannot be looked at"
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
        if any(tool):
            rotation, point = machine.platform(xs)
            lines.append(
                [point, point + rotation @ ca.DM(list(tool))]
            )  # a longer tool than the one drawn
        pairs = [
            (a, b)
            for i, line in enumerate(lines)
            if i not in ignore
            for a, b in itertools.pairwise(line)
        ]
        self._count = len(pairs)
        ends = ca.vertcat(*[ca.vertcat(ca.vec(a), ca.vec(b)) for a, b in pairs])
        self._ends = Batched("skeleton_ends", [x, q, p], [ends])

    def segments(self, x: Array, q: Array, p: Array) -> Array:
        """Segments (n, k, 2, 3) of poses x (n, nx) with joints q (n, nq), m."""
        return np.asarray(self._ends(x, q, p)[0].reshape(len(x), self._count, 2, 3))


def cup_place(
    measurement: Measurement, setup: str, cup: Sequence[float] | None = None
) -> Array:
    """Where the bar of a set-up is held (3,), base frame, m: `cup` if given, its place
    settings at_x, at_y, at_z, or the tool point at its teach pose; raises ValueError
    where nothing tells.
    """
    if cup is not None:
        return np.asarray(cup, dtype=float)
    chosen = measurement.setups[setup]
    if {"at_x", "at_y", "at_z"} <= set(chosen.settings):
        return np.array([chosen.settings[f"at_{n}"] for n in "xyz"])
    if chosen.teach is None:
        raise ValueError(
            f"set-up {setup}: {chosen.instrument.name} does not tell where its other"
            " end is: give its cup"
        )
    tool = np.array(chosen.tool)
    x, _ = measurement.kinematics.inverse(np.array(chosen.teach)[None], None, tool)
    return np.asarray(measurement.kinematics.frames(x, tool)[1][0])


class Clearance:
    """Clearance of one set-up on the nominal machine."""

    def __init__(
        self,
        measurement: Measurement,
        setup: str,
        surroundings: Surroundings,
        cup: Sequence[float] | None = None,
    ) -> None:
        self._measurement, self._setup, self._about = measurement, setup, surroundings
        self._tool = np.array(measurement.setups[setup].tool)
        self._links = None
        if surroundings.links is not None:
            self._links = Skeleton(
                measurement.kinematics,
                measurement.setups[setup].tool,
                surroundings.ignore,
            )
        self._cup = (
            None if surroundings.bar is None else cup_place(measurement, setup, cup)
        )
        self._fixed = np.array([[o.start, o.end] for o in surroundings.obstacles])
        self._radii = np.array([o.radius for o in surroundings.obstacles])

    def at(self, x: Array, q: Array, *, bar: bool = True) -> Array:
        """Clearance (n,) at poses x (n, nx) with joints q (n, nq), m; `bar` = False:
        with the bar taken off.
        """
        return np.asarray(
            self._gaps(*self._moving(x, q, bar)).min(axis=1, initial=np.inf)
        )

    def series(self, series: Series, x: Array) -> Array:
        """Clearance (N,) at the readings of a series with poses x (m, nx), m; at
        reference poses without the bar.
        """
        links_only = np.full(len(x), np.inf)
        if self._links is not None:
            links_only = self.at(x, series.q, bar=False)
        read = series.index[:, 0]
        return np.asarray(
            np.minimum(
                self.at(x[read], series.q[read]), links_only[series.index].min(axis=1)
            )
        )

    def free(self, before: Array, after: Array, lead: Lead | None = None) -> Mask:
        """Whether straight moves in command space, `before` (k, n_dof) to `after`, keep
        the margin (k,).

        `lead` puts commands where an instrument leads the tool, and tells where it can
        (a bar of fixed length: `functools.partial(measurement.hold, setup,
        coordinate=...)`). Moves through poses out of reach or in another assembly mode
        are blocked, and moves that keep no more than `RESOLUTION` over the margin may
        be.
        """
        sample = partial(self._sample, before, after, lead)
        blocked = np.zeros(len(before), dtype=bool)
        moves, place = np.arange(len(before)), np.linspace(0.0, 1.0, INTERVALS + 1)
        row = [sample(moves, np.full(len(moves), t)) for t in place]
        left, right = _Samples.joined(row[:-1]), _Samples.joined(row[1:])
        blocked[
            np.concatenate(
                [s.move[s.gap.min(axis=1) < self._about.margin] for s in row]
            )
        ] = True
        while True:
            step = np.linalg.norm(right.ends - left.ends, axis=-1).max(axis=2)
            lowest = 0.5 * (left.gap + right.gap - step).min(axis=1)
            open_ = (lowest < self._about.margin) & ~blocked[left.move]
            # a way with a jump in it never gets short steps
            fine = open_ & (
                (step.max(axis=1) < RESOLUTION) | (right.place - left.place < SHORTEST)
            )
            blocked[left.move[fine]] = True
            todo = np.flatnonzero(open_ & ~blocked[left.move])
            if not todo.size:
                return ~blocked
            left, right = left.take(todo), right.take(todo)
            middle = sample(left.move, 0.5 * (left.place + right.place))
            blocked[middle.move[middle.gap.min(axis=1) < self._about.margin]] = True
            left, right = (
                _Samples.joined([left, middle]),
                _Samples.joined([middle, right]),
            )

    def _sample(
        self, before: Array, after: Array, lead: Lead | None, move: Index, place: Array
    ) -> _Samples:
        command = before[move] + place[:, None] * (after[move] - before[move])
        led = np.ones(len(command), dtype=bool)
        if lead is not None:
            command, led = lead(command)
        x, q, reached = reach(self._measurement.kinematics, command, self._tool)
        ends, radii = self._moving(x, q)
        gap = np.where((led & reached)[:, None], self._gaps(ends, radii), -np.inf)
        return _Samples(
            move, place, np.where(reached[:, None, None, None], ends, 0.0), gap
        )

    def _moving(self, x: Array, q: Array, bar: bool = True) -> tuple[Array, Array]:
        """Moving segments (n, k, 2, 3) and their radii (k,)."""
        parts, radii = [np.empty((len(x), 0, 2, 3))], [np.empty(0)]
        if self._links is not None:
            assert self._about.links is not None
            parts.append(self._links.segments(x, q, self._measurement.machine.nominal))
            radii.append(np.full(parts[-1].shape[1], self._about.links))
        if bar and self._cup is not None:
            assert self._about.bar is not None
            tip = self._measurement.kinematics.frames(x, self._tool)[1]
            parts.append(
                np.stack([np.broadcast_to(self._cup, tip.shape), tip], axis=1)[:, None]
            )
            radii.append(np.array([self._about.bar]))
        return np.concatenate(parts, axis=1), np.concatenate(radii)

    def _gaps(self, moving: Array, radii: Array) -> Array:
        """Clearance (n, k) of each moving segment."""
        gaps = np.full(moving.shape[:2], np.inf)
        for (start, end), radius in zip(self._fixed, self._radii, strict=True):
            gaps = np.minimum(
                gaps,
                segment_distance(moving[:, :, 0], moving[:, :, 1], start, end)
                - radii
                - radius,
            )
        return gaps


@dataclasses.dataclass(frozen=True, eq=False)
class _Samples:
    """Places (n,) between 0 and 1 along moves (n,), the moving segments' ends (n, k, 2,
    3) and clearances (n, k).
    """

    move: Index
    place: Array
    ends: Array
    gap: Array

    def take(self, rows: Index) -> _Samples:
        return _Samples(
            self.move[rows], self.place[rows], self.ends[rows], self.gap[rows]
        )

    @classmethod
    def joined(cls, parts: Sequence[_Samples]) -> _Samples:
        return cls(
            np.concatenate([p.move for p in parts]),
            np.concatenate([p.place for p in parts]),
            np.concatenate([p.ends for p in parts]),
            np.concatenate([p.gap for p in parts]),
        )


def reach(
    kinematics: Kinematics, command: Array, tool: Array
) -> tuple[Array, Array, Mask]:
    """Poses (n, nx), joints (n, nq) and which of the commands (n, n_dof) can be
    reached; NaN where not.
    """
    good = np.arange(len(command))
    x = np.full((len(command), len(kinematics.machine.pose)), np.nan)
    q = np.full((len(command), len(kinematics.machine.joints)), np.nan)
    while good.size:
        try:
            x[good], q[good] = kinematics.inverse(command[good], None, tool)
            break
        except AssemblyError as error:
            good = np.delete(good, error.indices)
    return x, q, np.isin(np.arange(len(command)), good)
