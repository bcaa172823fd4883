"""Which candidate readings can be taken at all: joint travel, singular poses, the
instrument's travel and solid angle, collisions. Rules that hold between the readings of
one plan are in `oed.design.rules`.

A reading that an instrument can only take within a travel about a held value (a ball
bar: +-1 mm about its length) is out of reach on a machine whose errors move it farther.
With theta ~ N(nominal, Sigma) and the reading's slope h, the reading is N(y, h Sigma
h^T) to first order, and stays within the travel with probability

    P = Phi((held + travel - y) / s) - Phi((held - travel - y) / s),        s^2 = h Sigma h^T.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator, Mapping

import numpy as np
from scipy.special import ndtr

from oed.arrays import Array, Mask
from oed.design.clearance import Clearance, Point, Surroundings, cup_place
from oed.measurement import Measurement, Series

#: share of a joint's limits that rounding may exceed
SLACK = 1e-9


@dataclasses.dataclass(frozen=True, slots=True)
class Cone:
    """Directions within `half_angle` (rad) of `axis` (any length)."""

    axis: Point
    half_angle: float

    def __post_init__(self) -> None:
        if not np.linalg.norm(self.axis) > 0.0:
            raise ValueError("a cone needs an axis that is not zero")

    def angle(self, direction: Array) -> Array:
        """Angle (n,) of directions (n, 3) to the axis, rad; exact near 0 and pi as
        well.
        """
        axis = np.asarray(self.axis, dtype=float)
        across = np.linalg.norm(np.cross(direction, axis), axis=1)
        return np.asarray(np.arctan2(across, direction @ axis))


@dataclasses.dataclass(frozen=True, kw_only=True)
class Limits:
    """What a candidate must keep; None: not asked. Lengths m, angles rad.

    joints         (lower, upper) of joints by name, in place of the machine's own range
    singularity    least reciprocal condition number of phi_x (`Kinematics.singularity`)
    travel         largest distance of the nominal reading from the value that the
                   instrument holds
    held           that value, where the instrument does not tell it
    base_cone      where the line from the cup to the tool point may point, in the base
                   frame
    platform_cone  where the line from the tool point to the cup may point, in the
                   platform frame
    cup            (3,) other end of the line, base frame; None: from the set-up
                   (`clearance.cup_place`)
    surroundings   obstacles, and what must stay clear of them
    """

    joints: Mapping[str, tuple[float, float]] = dataclasses.field(default_factory=dict)
    singularity: float | None = None
    travel: float | None = None
    held: float | None = None
    base_cone: Cone | None = None
    platform_cone: Cone | None = None
    cup: Point | None = None
    surroundings: Surroundings | None = None


@dataclasses.dataclass(frozen=True, eq=False)
class Feasible:
    """Which of n candidate readings can be taken.

    allowed  (n,)
    reasons  {reason: number of candidates that it refuses}; a candidate may have
             several reasons
    refused  {reason: (n,)}
    details  {quantity: (n,)} of what was asked: singularity, travel (distance from the
             held value), base_cone and platform_cone (angles), clearance; SI
    """

    allowed: Mask
    reasons: dict[str, int]
    refused: dict[str, Mask]
    details: dict[str, Array]

    @property
    def words(self) -> list[str]:
        """One sentence a reason, most refusals first: "37 of 1512 candidates leave the
        travel of joint q2".
        """
        ranked = sorted(self.reasons.items(), key=lambda item: -item[1])
        return [
            f"{count} of {len(self.allowed)} candidates {reason}"
            for reason, count in ranked
        ]


def check(measurement: Measurement, series: Series, limits: Limits) -> Feasible:
    """Which readings of a series can be taken on the nominal machine.

    A reading that depends on a second pose (teach, reference of the run) needs that
    pose within joint travel, away from singular poses and clear of obstacles too.
    """
    x = measurement.poses(series, measurement.nominal)
    refused: dict[str, Mask] = dict(_joints(measurement, series, limits))
    details: dict[str, Array] = {}
    if limits.singularity is not None:
        margin = measurement.kinematics.singularity(
            x, series.q, measurement.machine.nominal
        )
        details["singularity"] = margin[series.index].min(axis=1)
        refused["are too near a singular pose"] = (
            details["singularity"] < limits.singularity
        )
    if limits.travel is not None:
        held = _held(measurement, series, limits.held)
        details["travel"] = np.abs(
            _first(
                measurement, series, measurement.readings([series], measurement.nominal)
            )
            - held
        )
        refused["leave the travel of the instrument"] = (
            details["travel"] > limits.travel
        )
    for name, angle, cone, reason in _cones(measurement, series, x, limits):
        details[name] = angle
        refused[reason] = angle > cone.half_angle
    if limits.surroundings is not None:
        clearance = Clearance(
            measurement, series.setup, limits.surroundings, limits.cup
        )
        details["clearance"] = clearance.series(series, x)
        refused["come too near an obstacle"] = (
            details["clearance"] < limits.surroundings.margin
        )
    refused = {reason: mask for reason, mask in refused.items() if mask.any()}
    allowed = ~np.any([*refused.values(), np.zeros(len(series), dtype=bool)], axis=0)
    return Feasible(
        allowed,
        {reason: int(mask.sum()) for reason, mask in refused.items()},
        refused,
        details,
    )


def within_travel(
    measurement: Measurement,
    series: Series,
    covariance: Array,
    travel: float,
    held: float | None = None,
    at: Array | None = None,
) -> Array:
    """Probability (N,) that a reading's first channel stays within `travel` (SI) of the
    held value on a machine drawn from N(at, covariance), to first order in theta.

    covariance (n_theta, n_theta), SI; `at` (n_theta,) defaults to nominal. `held` (SI)
    defaults to what the instrument holds by design.
    """
    theta = measurement.nominal if at is None else at
    if covariance.shape != (len(theta), len(theta)):
        raise ValueError(
            f"the covariance must be {len(theta)} x {len(theta)}, not of shape"
            f" {covariance.shape}"
        )
    wanted = _held(measurement, series, held)
    off = _first(measurement, series, measurement.readings([series], theta)) - wanted
    rows = _first(measurement, series, measurement.jacobian([series], theta))
    spread = np.sqrt(np.maximum(np.einsum("ni,ij,nj->n", rows, covariance, rows), 0.0))
    known = spread <= 0.0
    safe = np.where(known, 1.0, spread)
    chance = ndtr((travel - off) / safe) - ndtr((-travel - off) / safe)
    return np.asarray(np.where(known, np.abs(off) <= travel, chance), dtype=float)


def _joints(
    measurement: Measurement, series: Series, limits: Limits
) -> Iterator[tuple[str, Mask]]:
    names = [c.name for c in measurement.machine.joints]
    unknown = set(limits.joints) - set(names)
    if unknown:
        raise ValueError(
            f"{measurement.machine.name} has no joint {sorted(unknown)}; it has {names}"
        )
    for column, joint in enumerate(measurement.machine.joints):
        lower, upper = limits.joints.get(joint.name, (joint.lower, joint.upper))
        slack = SLACK * max([1.0, *(abs(v) for v in (lower, upper) if np.isfinite(v))])
        q = series.q[:, column]
        outside: Mask = np.asarray((q < lower - slack) | (q > upper + slack))
        yield (
            f"leave the travel of joint {joint.name}",
            np.asarray(outside[series.index].any(axis=1)),
        )


def _held(measurement: Measurement, series: Series, held: float | None) -> float:
    if held is not None:
        return held
    setup = measurement.setups[series.setup]
    if setup.instrument.holds is None:
        raise ValueError(
            f"{setup.instrument.name} holds no reading by design: say about which value"
            " its travel lies"
        )
    return float(setup.instrument.holds(setup.settings))


def _first(measurement: Measurement, series: Series, values: Array) -> Array:
    """Values (N, ...) of the first channel of each reading, out of those of all
    channels.
    """
    return values[:: len(measurement.setups[series.setup].sigma)]


def _cones(
    measurement: Measurement, series: Series, x: Array, limits: Limits
) -> Iterator[tuple[str, Array, Cone, str]]:
    if limits.base_cone is None and limits.platform_cone is None:
        return
    setup = measurement.setups[series.setup]
    cup = cup_place(measurement, series.setup, limits.cup)
    rotation, tip, _ = measurement.kinematics.frames(
        x[series.index[:, 0]], np.array(setup.tool)
    )
    if limits.base_cone is not None:
        yield (
            "base_cone",
            limits.base_cone.angle(tip - cup),
            limits.base_cone,
            "leave the cone at the cup",
        )
    if limits.platform_cone is not None:
        local = np.einsum("nji,nj->ni", rotation, cup - tip)
        yield (
            "platform_cone",
            limits.platform_cone.angle(local),
            limits.platform_cone,
            "leave the cone at the tool",
        )
