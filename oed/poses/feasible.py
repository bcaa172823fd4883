"""Which candidate readings a machine and an instrument can take at all.

The limits are joint travel, singular poses, the instrument's travel and solid angle,
and collisions. Rules between the readings of one plan are in `oed.design.rules`.

Some instruments read only within a travel about a value they hold (a ball bar: +-1 mm
about its length). A machine with errors may move a reading out of this travel. With
theta ~ N(nominal, Sigma) and the reading's slope h, the reading is N(y, h Sigma h^T) to
first order, and stays within the travel with probability

    P = Phi((held + travel - y) / s) - Phi((held - travel - y) / s),        s^2 = h Sigma h^T.

For clearance everything is a capsule, all points within a radius of a segment; a sphere is one of no length. The
machine's skeleton moves with capsules along its lines, and the bar reaches from its cup
to the tool point. Clearance is the least distance between the segments less both radii,
negative in collision.

The formula is written out because it runs over all poses at once. The collision
libraries python-fcl and coal give the same distances, to 2e-15 m, but take one pair a
call: 100,000 pairs last 14 and 10 times as long. coal also lacks wheels for Windows.
"""

import dataclasses
import itertools
from collections.abc import Iterator, Mapping

import casadi as ca
import numpy as np

from oed.base import Array, Mask
from oed.instrument import Setup
from oed.measurement import Measurement, Series
from oed.mechanism import BatchedFunction

Point3 = tuple[float, float, float]
#: sine^2 of the angle between two segments below which they count as parallel
PARALLEL_TOLERANCE = 1e-12


@dataclasses.dataclass(frozen=True, slots=True)
class Capsule:
    """A fixed obstacle in the base frame, m: points within `radius` of a segment."""

    start: Point3
    end: Point3
    radius: float


def sphere(centre: Point3, radius: float) -> Capsule:
    """A fixed sphere in the base frame, m."""
    return Capsule(centre, centre, radius)


def point_distance(point: Array, start: Array, end: Array) -> Array:
    """Distance (...) of points (..., 3) to segments (..., 3); arguments broadcast."""
    direction = end - start
    square = np.asarray((direction**2).sum(-1))
    projection = ((point - start) * direction).sum(-1)
    share = projection / np.where(square > 0.0, square, 1.0)
    nearest = start + np.clip(share, 0.0, 1.0)[..., None] * direction
    return np.asarray(np.linalg.norm(point - nearest, axis=-1))


def segment_distance(a0: Array, a1: Array, b0: Array, b1: Array) -> Array:
    """Distance (...) of segments (..., 3) or points; the arguments broadcast."""
    u, v, w = a1 - a0, b1 - b0, a0 - b0
    uu, uv, vv = (u * u).sum(-1), (u * v).sum(-1), (v * v).sum(-1)
    uw, vw = (u * w).sum(-1), (v * w).sum(-1)
    determinant = uu * vv - uv**2
    # parallel segments are nearest at an end point too
    skew = determinant > PARALLEL_TOLERANCE * uu * vv
    divisor = np.where(skew, determinant, 1.0)
    s = (uv * vw - vv * uw) / divisor
    t = (uu * vw - uv * uw) / divisor
    inside = skew & (s >= 0.0) & (s <= 1.0) & (t >= 0.0) & (t <= 1.0)
    free = np.linalg.norm(w + s[..., None] * u - t[..., None] * v, axis=-1)
    ends = [
        point_distance(a0, b0, b1),
        point_distance(a1, b0, b1),
        point_distance(b0, a0, a1),
        point_distance(b1, a0, a1),
    ]
    return np.minimum(np.minimum.reduce(ends), np.where(inside, free, np.inf))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Surroundings:
    """Obstacles, and what moves between them; m."""

    #: fixed capsules in the base frame; the stand of the cup touches the bar: let it
    #: end short of the cup
    obstacles: tuple[Capsule, ...]
    #: radius of the capsules along the lines of the machine's skeleton; None: links are
    #: not checked
    links: float | None = None
    #: radius of the bar from its cup to the tool point; None: there is none
    bar: float | None = None
    margin: float = 0.0  #: clearance to be kept
    #: numbers of skeleton lines that are left out (such as a fixed base)
    ignore: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if not self.obstacles:
            raise ValueError("surroundings need at least one obstacle")
        if self.links is None and self.bar is None:
            raise ValueError(
                "nothing that moves is checked: give a radius to the links, to the bar, or to both"
            )


#: settings that tell where the other end of an instrument is
CUP_SETTINGS = ("at_x", "at_y", "at_z")


def has_cup(setup: Setup) -> bool:
    """Whether a set-up states where the other end of its instrument is."""
    return setup.teach is not None or setup.settings.keys() >= {*CUP_SETTINGS}


def cup_position(measurement: Measurement, setup: str) -> Array:
    """Where the bar of a set-up is held (3,), base frame, m.

    That is at its place settings, else the tool point at its teach pose. Raises ValueError
    where neither is known.
    """
    mounted = measurement.setups[setup]
    if not has_cup(mounted):
        raise ValueError(
            f"set-up {setup}: {mounted.instrument.name} does not state where its other"
            " end is: its bar and cones cannot be checked"
        )
    if mounted.settings.keys() >= {*CUP_SETTINGS}:
        return np.array([mounted.settings[name] for name in CUP_SETTINGS])
    tool = np.array(mounted.tool)
    x, _ = measurement.kinematics.inverse(np.array(mounted.teach)[None], None, tool)
    return np.asarray(measurement.kinematics.frames(x, tool)[1][0])


class Clearance:
    """Clearance of one set-up on the nominal machine."""

    def __init__(
        self, measurement: Measurement, setup: str, surroundings: Surroundings
    ) -> None:
        self._measurement, self._surroundings = measurement, surroundings
        self._tool = np.array(measurement.setups[setup].tool)
        if surroundings.links is not None:
            self._links = self._link_function()
        if surroundings.bar is not None:
            self._cup = cup_position(measurement, setup)

    def _link_function(self) -> BatchedFunction:
        """Both ends of the lines of the machine's skeleton, one column an end."""
        kinematics, ignore = self._measurement.kinematics, self._surroundings.ignore
        machine, e = kinematics.machine, kinematics.expressions
        if machine.skeleton is None:
            raise ValueError(
                f"{machine.name} has no skeleton: its links cannot be checked"
            )
        lines = [ca.horzsplit(line) for line in e.lines]
        unknown = set(ignore) - set(range(len(lines)))
        if unknown:
            raise ValueError(
                f"{machine.name}: its skeleton has lines 0 to {len(lines) - 1}, not"
                f" {sorted(unknown)}"
            )
        if self._tool.any():  # a longer tool than the skeleton's
            _, point = machine.platform(e.x_by_name)
            lines.append([point, point + e.rotation @ ca.DM(self._tool)])
        checked = [line for i, line in enumerate(lines) if i not in ignore]
        pairs = [pair for line in checked for pair in itertools.pairwise(line)]
        ends = ca.horzcat(*itertools.chain(*pairs))
        return BatchedFunction("link_ends", [e.x, e.q, e.p], [ends])

    def pose_clearance(self, x: Array, q: Array, *, bar: bool = True) -> Array:
        """Clearance (n,), m, at x (n, nx), q (n, nq), with the bar or without."""
        ends, radii = self._segments(x, q, bar)
        by_segment = np.full(ends.shape[:2], np.inf)
        for obstacle in self._surroundings.obstacles:
            start, end = np.array(obstacle.start), np.array(obstacle.end)
            distance = segment_distance(ends[:, :, 0], ends[:, :, 1], start, end)
            by_segment = np.minimum(by_segment, distance - radii - obstacle.radius)
        return np.asarray(by_segment.min(axis=1, initial=np.inf))

    def at_readings(self, series: Series, x: Array) -> Array:
        """Clearance (N,), m, of readings at x (m, nx); no bar at references."""
        without_bar = self.pose_clearance(x, series.q, bar=False)
        read = series.index[:, 0]
        with_bar = self.pose_clearance(x[read], series.q[read])
        others = without_bar[series.index].min(axis=1)
        return np.asarray(np.minimum(with_bar, others))

    def _segments(self, x: Array, q: Array, bar: bool) -> tuple[Array, Array]:
        """Moving segments (n, k, 2, 3) and their radii (k,)."""
        parts, radii = [np.empty((len(x), 0, 2, 3))], [np.empty(0)]
        moving = self._surroundings
        if moving.links is not None:
            ends = self._links(x, q, self._measurement.machine.nominal)[0]
            links = ends.swapaxes(1, 2).reshape(len(x), -1, 2, 3)
            parts.append(links)
            radii.append(np.full(links.shape[1], moving.links))
        if bar and moving.bar is not None:
            tip = self._measurement.kinematics.frames(x, self._tool)[1]
            cup = np.broadcast_to(self._cup, tip.shape)
            parts.append(np.stack([cup, tip], axis=1)[:, None])
            radii.append(np.array([moving.bar]))
        return np.concatenate(parts, axis=1), np.concatenate(radii)


JOINT_SLACK = 1e-9  #: share of a joint's limits that rounding may exceed


@dataclasses.dataclass(frozen=True, slots=True)
class DirectionCone:
    """Directions within `half_angle` (rad) of `axis` (any length)."""

    axis: Point3
    half_angle: float

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.axis) > 0.0:
            raise ValueError("a cone needs an axis that is not zero")

    def angle(self, direction: Array) -> Array:
        """Angle (n,) of directions (n, 3) to the axis, rad; exact near 0 and pi too."""
        axis = np.asarray(self.axis, dtype=float)
        across = np.linalg.norm(np.cross(direction, axis), axis=1)
        return np.asarray(np.arctan2(across, direction @ axis))


@dataclasses.dataclass(frozen=True, kw_only=True)
class ReadingLimits:
    """Limits of a candidate reading; None: no limit. Lengths m, angles rad."""

    #: (lower, upper) of joints by name, in place of the machine's range
    joints: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    #: least reciprocal condition number of phi_x (`Kinematics.singularity`)
    singularity: float | None = None
    #: largest distance of the nominal reading from the value held
    travel: float | None = None
    #: directions of the line from the cup to the tool point, base frame
    base_cone: DirectionCone | None = None
    #: directions of the line from the tool point to the cup, platform frame
    platform_cone: DirectionCone | None = None
    #: obstacles, and what must stay clear of them
    surroundings: Surroundings | None = None

    def for_setup(self, setup: Setup) -> "ReadingLimits":
        """Those that apply to a set-up: cones and bar where it has a cup, the travel
        where its instrument holds a reading.
        """
        limits, about = self, self.surroundings
        if setup.instrument.fixed_reading is None:
            limits = dataclasses.replace(limits, travel=None)
        if has_cup(setup):
            return limits
        if about is not None and about.bar is not None:
            links_alone = about.links is not None
            about = dataclasses.replace(about, bar=None) if links_alone else None
        return dataclasses.replace(
            limits, base_cone=None, platform_cone=None, surroundings=about
        )

    def check(self, measurement: Measurement, series: Series) -> "Feasibility":
        """Which readings of a series can be taken on the nominal machine.

        A reading may depend on a second pose (teach, reference of the run). This pose must
        be within joint travel, away from singular poses and clear of obstacles too.
        """
        x = measurement.expected_poses(series)
        refused: dict[str, Mask] = dict(_outside_joints(measurement, series, self))
        details: dict[str, Array] = {}
        if self.singularity is not None:
            margin = measurement.kinematics.slopes.reciprocal_condition(
                x, series.q, measurement.kinematics.held
            )
            details["singularity"] = margin[series.index].min(axis=1)
            too_near = details["singularity"] < self.singularity
            refused["are too near a singular pose"] = too_near
        if self.travel is not None:
            held_value = _held_value(measurement, series)
            readings = measurement.expected_readings(series)
            first = _first_channel(measurement, series, readings)
            details["travel"] = distance = np.abs(first - held_value)
            refused["leave the travel of the instrument"] = distance > self.travel
        for name, angle, cone, reason in _cone_angles(measurement, series, x, self):
            details[name] = angle
            refused[reason] = angle > cone.half_angle
        if self.surroundings is not None:
            clearance = Clearance(measurement, series.setup, self.surroundings)
            details["clearance"] = clearance.at_readings(series, x)
            too_near = details["clearance"] < self.surroundings.margin
            refused["come too near an obstacle"] = too_near
        refused = {reason: mask for reason, mask in refused.items() if mask.any()}
        nobody = np.zeros(len(series), dtype=bool)
        allowed = ~np.any([*refused.values(), nobody], axis=0)
        return Feasibility(allowed, refused, details)

    def travel_probability(
        self, measurement: Measurement, series: Series, covariance: Array
    ) -> Array:
        """Probability (N,) that a reading's first channel stays within the travel, of
        machines N(nominal, covariance), SI. Raises ValueError without one.
        """
        from scipy.special import ndtr  # takes a tenth of a second to import

        if self.travel is None:
            raise ValueError("no travel is stated")
        theta = measurement.nominal
        if covariance.shape != (len(theta), len(theta)):
            raise ValueError(
                f"the covariance must be {len(theta)} x {len(theta)}, not of shape"
                f" {covariance.shape}"
            )
        held_value = _held_value(measurement, series)
        readings = measurement.readings([series], theta)
        error = _first_channel(measurement, series, readings) - held_value
        jacobian = measurement.jacobian([series], theta)
        rows = _first_channel(measurement, series, jacobian)
        variance = np.einsum("ni,ij,nj->n", rows, covariance, rows)
        sigma = np.sqrt(np.maximum(variance, 0.0))
        certain = sigma <= 0.0
        safe = np.where(certain, 1.0, sigma)
        probability = ndtr((self.travel - error) / safe) - ndtr(
            (-self.travel - error) / safe
        )
        inside = np.abs(error) <= self.travel
        return np.asarray(np.where(certain, inside, probability), dtype=float)


@dataclasses.dataclass(frozen=True, eq=False)
class Feasibility:
    """Which of n candidate readings can be taken, and why the others cannot."""

    allowed: Mask  #: (n,)
    refused: dict[str, Mask]  #: {reason: (n,)}; a candidate may have several reasons
    #: {quantity: (n,)} of the limits in use: singularity, travel (distance from the
    #: value held), base_cone and platform_cone (angles), clearance; SI
    details: dict[str, Array]

    @property
    def refusal_counts(self) -> dict[str, int]:
        """{reason: number of candidates that it refuses}."""
        return {reason: int(mask.sum()) for reason, mask in self.refused.items()}

    @property
    def sentences(self) -> list[str]:
        """One sentence a reason, most refusals first.

        For example "37 of 1512 candidates leave the travel of joint q2".
        """
        ranked = sorted(self.refusal_counts.items(), key=lambda item: -item[1])
        total = len(self.allowed)
        return [f"{count} of {total} candidates {reason}" for reason, count in ranked]


def _outside_joints(
    measurement: Measurement, series: Series, limits: ReadingLimits
) -> Iterator[tuple[str, Mask]]:
    """(reason, readings refused) of each joint."""
    names = [c.name for c in measurement.machine.joints]
    unknown = set(limits.joints) - set(names)
    if unknown:
        raise ValueError(
            f"{measurement.machine.name} has no joint {sorted(unknown)}; it has {names}"
        )
    for column, joint in enumerate(measurement.machine.joints):
        lower, upper = limits.joints.get(joint.name, (joint.lower, joint.upper))
        sizes = [abs(end) for end in (lower, upper) if np.isfinite(end)]
        slack = JOINT_SLACK * max([1.0, *sizes])
        q = series.q[:, column]
        outside: Mask = np.asarray((q < lower - slack) | (q > upper + slack))
        refused = np.asarray(outside[series.index].any(axis=1))
        yield f"leave the travel of joint {joint.name}", refused


def _held_value(measurement: Measurement, series: Series) -> float:
    setup = measurement.setups[series.setup]
    if setup.instrument.fixed_reading is None:
        raise ValueError(f"{setup.instrument.name} holds no reading by design")
    return float(setup.instrument.fixed_reading(setup.settings))


def _first_channel(measurement: Measurement, series: Series, values: Array) -> Array:
    """Values (N, ...) of the first channel, out of those of all channels."""
    return values[:: len(measurement.setups[series.setup].sigma)]


def _cone_angles(
    measurement: Measurement, series: Series, x: Array, limits: ReadingLimits
) -> Iterator[tuple[str, Array, DirectionCone, str]]:
    """(name, angles, cone, reason) of each cone."""
    if limits.base_cone is None and limits.platform_cone is None:
        return
    setup = measurement.setups[series.setup]
    cup = cup_position(measurement, series.setup)
    poses = x[series.index[:, 0]]
    rotation, tip, _ = measurement.kinematics.frames(poses, np.array(setup.tool))
    if limits.base_cone is not None:
        angle = limits.base_cone.angle(tip - cup)
        yield "base_cone", angle, limits.base_cone, "leave the cone at the cup"
    if limits.platform_cone is not None:
        direction = np.einsum("nji,nj->ni", rotation, cup - tip)
        angle = limits.platform_cone.angle(direction)
        yield "platform_cone", angle, limits.platform_cone, "leave the cone at the tool"
