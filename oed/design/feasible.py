"""Which candidate readings a machine and an instrument can take at all.

The limits are joint travel, singular poses, the instrument's travel and solid angle,
and collisions. Rules between the readings of one plan are in `oed.design.rules`.

Some instruments read only within a travel about a value they hold (a ball bar: +-1 mm
about its length). A machine with errors may move a reading out of this travel. With
theta ~ N(nominal, Sigma) and the reading's slope h, the reading is N(y, h Sigma h^T) to
first order, and stays within the travel with probability

    P = Phi((held + travel - y) / s) - Phi((held - travel - y) / s),        s^2 = h Sigma h^T.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.special import ndtr

from oed.base import Array, Mask
from oed.design.clearance import Clearance, Surroundings, cup_place
from oed.design.segments import Point3
from oed.measurement import Measurement, Series

#: share of a joint's limits that rounding may exceed
SLACK = 1e-9


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
    """Limits of a candidate reading; None: no limit. Lengths m, angles rad.

    joints         (lower, upper) of joints by name, in place of the machine's range
    singularity    least reciprocal condition number of phi_x (`Kinematics.singularity`)
    travel         largest distance of the nominal reading from the value held
    held           that value, where the instrument does not define it
    base_cone      directions of the line from the cup to the tool point, base frame
    platform_cone  directions of the line from the tool point to the cup, platform frame
    cup            (3,) other end of the line, base frame; None: from the set-up
                   (`clearance.cup_place`)
    surroundings   obstacles, and what must stay clear of them
    """

    joints: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    singularity: float | None = None
    travel: float | None = None
    held: float | None = None
    base_cone: DirectionCone | None = None
    platform_cone: DirectionCone | None = None
    cup: Point3 | None = None
    surroundings: Surroundings | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Feasibility:
    """Which of n candidate readings can be taken, and why the others cannot.

    allowed  (n,)
    refused  {reason: (n,)}; a candidate may have several reasons
    details  {quantity: (n,)} of the limits in use: singularity, travel (distance from
             the value held), base_cone and platform_cone (angles), clearance; SI
    """

    allowed: Mask
    refused: dict[str, Mask]
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


def check_readings(
    measurement: Measurement, series: Series, limits: ReadingLimits
) -> Feasibility:
    """Which readings of a series can be taken on the nominal machine.

    A reading may depend on a second pose (teach, reference of the run). This pose must
    be within joint travel, away from singular poses and clear of obstacles too.
    """
    x = measurement.expected_poses(series)
    refused: dict[str, Mask] = dict(_outside_joints(measurement, series, limits))
    details: dict[str, Array] = {}
    if limits.singularity is not None:
        margin = measurement.kinematics.slopes.reciprocal_condition(
            x, series.q, measurement.kinematics.held
        )
        details["singularity"] = margin[series.index].min(axis=1)
        too_near = details["singularity"] < limits.singularity
        refused["are too near a singular pose"] = too_near
    if limits.travel is not None:
        held = _held_value(measurement, series, limits.held)
        readings = measurement.expected_readings(series)
        distance = np.abs(_first_channel(measurement, series, readings) - held)
        details["travel"] = distance
        refused["leave the travel of the instrument"] = distance > limits.travel
    for name, angle, cone, reason in _cone_angles(measurement, series, x, limits):
        details[name] = angle
        refused[reason] = angle > cone.half_angle
    if limits.surroundings is not None:
        surroundings = limits.surroundings
        clearance = Clearance(measurement, series.setup, surroundings, limits.cup)
        details["clearance"] = clearance.at_readings(series, x)
        too_near = details["clearance"] < surroundings.margin
        refused["come too near an obstacle"] = too_near
    refused = {reason: mask for reason, mask in refused.items() if mask.any()}
    nobody = np.zeros(len(series), dtype=bool)
    allowed = ~np.any([*refused.values(), nobody], axis=0)
    return Feasibility(allowed, refused, details)


def within_travel(
    measurement: Measurement,
    series: Series,
    covariance: Array,
    travel: float,
    held: float | None = None,
) -> Array:
    """Probability (N,) that a reading's first channel stays within `travel`.

    The machine is drawn from N(nominal, covariance); first order in theta, SI.

    covariance  (n_theta, n_theta)
    travel      about the value held
    held        that value; by default what the instrument holds by design
    """
    theta = measurement.nominal
    if covariance.shape != (len(theta), len(theta)):
        raise ValueError(
            f"the covariance must be {len(theta)} x {len(theta)}, not of shape"
            f" {covariance.shape}"
        )
    held_value = _held_value(measurement, series, held)
    readings = measurement.readings([series], theta)
    error = _first_channel(measurement, series, readings) - held_value
    jacobian = measurement.jacobian([series], theta)
    rows = _first_channel(measurement, series, jacobian)
    variance = np.einsum("ni,ij,nj->n", rows, covariance, rows)
    sigma = np.sqrt(np.maximum(variance, 0.0))
    certain = sigma <= 0.0
    safe = np.where(certain, 1.0, sigma)
    probability = ndtr((travel - error) / safe) - ndtr((-travel - error) / safe)
    inside = np.abs(error) <= travel
    return np.asarray(np.where(certain, inside, probability), dtype=float)


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
        slack = SLACK * max([1.0, *sizes])
        q = series.q[:, column]
        outside: Mask = np.asarray((q < lower - slack) | (q > upper + slack))
        refused = np.asarray(outside[series.index].any(axis=1))
        yield f"leave the travel of joint {joint.name}", refused


def _held_value(measurement: Measurement, series: Series, held: float | None) -> float:
    if held is not None:
        return held
    setup = measurement.setups[series.setup]
    if setup.instrument.fixed_reading is None:
        raise ValueError(
            f"{setup.instrument.name} holds no reading by design: state the value that"
            " its travel is about"
        )
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
    cup = cup_place(measurement, series.setup, limits.cup)
    poses = x[series.index[:, 0]]
    rotation, tip, _ = measurement.kinematics.frames(poses, np.array(setup.tool))
    if limits.base_cone is not None:
        angle = limits.base_cone.angle(tip - cup)
        yield "base_cone", angle, limits.base_cone, "leave the cone at the cup"
    if limits.platform_cone is not None:
        direction = np.einsum("nji,nj->ni", rotation, cup - tip)
        angle = limits.platform_cone.angle(direction)
        yield "platform_cone", angle, limits.platform_cone, "leave the cone at the tool"
