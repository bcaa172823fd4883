"""Heights of Marlin's G33 that are means over several places, as heights of one place.

With P3 and more G33 prints seven means: of readings about the middle, and of readings on
a ring, each of which counts to its two neighbours among six directions by the square of
a cosine (src/gcode/calibrate/G33.cpp). A mean less what a fitted delta has as its mean,
plus what that has at the place itself, is the height there. The fit is that of the
radius, two angles and three endstops to all means.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Sequence

import numpy as np
from scipy import optimize

from oed.base import Array
from pkm_printers.delta_geometry import DeltaGeometry
from pkm_printers.gcode import TextLine
from pkm_printers.probed_point import ProbedPoint

#: the six directions of G33's ring, in its order: degrees from x
DIRECTIONS = {"x": 210.0, "xy": 270.0, "y": 330.0, "yz": 30.0, "z": 90.0, "zx": 150.0}
#: radius of the inner ring over that of the outer one
INNER_RING = 0.1
#: places of the outer ring for a step of one direction, by P
FINENESS = {3: 1, 4: 2, 5: 3, 6: 5, 7: 7, 8: 3, 9: 4, 10: 5}
#: P from which on a ring has three circles, and those without a reading in the middle
CIRCLES_FROM, WITHOUT_MIDDLE = 8, (3, 6, 9)
#: P8 divides the sum of ten readings by eight
MISCOUNTED, MISCOUNT = 8, 10.0 / 8.0
#: P of Marlin's example configurations
USUAL_POINTS = 4
#: mm; the last digit that G33 prints
ROUNDING = 0.01
#: standard deviations of the delta's numbers about the firmware's, mm and deg, for a fit
#: to fewer means than unknowns
TOLERANCE = np.array([5.0, 2.0, 2.0, 5.0, 5.0, 5.0])


@dataclasses.dataclass(frozen=True)
class Contact:
    """A printed height, mm, and where it was probed.

    x, y      the place that it stands for, mm
    z         the height
    places    (n, 2) that were probed, mm
    weights   (n,) of them in the height
    is_probe  whether places are the probe's, and not the nozzle's
    unsure    line of a report whose P the log does not show; None where it is known
    """

    x: float
    y: float
    z: float
    places: Array
    weights: Array
    is_probe: bool
    unsure: TextLine | None = None

    @classmethod
    def at(cls, x: float, y: float, z: float, *, is_probe: bool) -> Contact:
        """A reading at one place."""
        return cls(x, y, z, np.array([[x, y]]), np.ones(1), is_probe)

    @property
    def is_mean(self) -> bool:
        """Whether the height is a mean over other places than its own."""
        return bool(np.abs(self.places - [self.x, self.y]).max() > 0.0)

    def of_nozzle(self, offset: tuple[float, float]) -> Contact:
        """The same with places of the nozzle, the probe at an offset from it."""
        if not self.is_probe:
            return self
        x, y = offset
        places = self.places - np.array(offset)
        return dataclasses.replace(
            self, x=self.x - x, y=self.y - y, places=places, is_probe=False
        )


def mean_contact(
    name: str,
    height: float,
    radius: float,
    points: int,
    circles: tuple[float, ...],
    *,
    is_probe: bool,
) -> Contact:
    """A height of G33's report.

    name     c, x, y, z, yz, zx or xy
    radius   of the ring, mm
    points   P of G33
    circles  radii of the three circles of P8 and more, over the ring's
    """
    if name == "c":
        places = _middle(points, radius)
        weights = np.full(len(places), 1.0 / len(places))
        height = height / MISCOUNT if points == MISCOUNTED else height
        return Contact(0.0, 0.0, height, places, weights, is_probe)
    direction = DIRECTIONS[name]
    x, y = _ring_points(direction, radius)
    if points not in FINENESS or points == min(FINENESS):
        return Contact.at(x, y, height, is_probe=is_probe)
    places, weights = _ring(direction, radius, points, circles)
    return Contact(x, y, height, places, weights, is_probe)


def _middle(points: int, radius: float) -> Array:
    """Places (n, 2) whose readings are averaged as that of the middle."""
    middle = [] if points in WITHOUT_MIDDLE else [(0.0, 0.0)]
    if points < min(FINENESS):
        return np.array(middle)
    count = 3 if points < 5 else 6 if points < CIRCLES_FROM else 9
    angles = [DIRECTIONS["x"] + 360.0 * k / count for k in range(count)]
    ring = [_ring_points(angle, INNER_RING * radius) for angle in angles]
    return np.array(middle + ring)


def _ring(
    direction: float, radius: float, points: int, circles: tuple[float, ...]
) -> tuple[Array, Array]:
    """Places (n, 2) whose readings count to a direction, and their weights (n,)."""
    fineness = FINENESS[points]
    factors = circles if points >= CIRCLES_FROM else (1.0,)
    shares = np.arange(1 - fineness, fineness) / fineness
    pairs = list(itertools.product(shares, factors))
    places = [
        _ring_points(direction + 60.0 * share, factor * radius)
        for share, factor in pairs
    ]
    weights = np.array([np.cos(0.5 * np.pi * share) ** 2 for share, _ in pairs])
    return np.array(places), weights / weights.sum()


def _ring_points(direction: float, radius: float) -> tuple[float, float]:
    angle = np.radians(direction)
    return float(radius * np.cos(angle)), float(radius * np.sin(angle))


def points_of_contacts(
    contacts: Sequence[Contact], geometry: DeltaGeometry
) -> tuple[list[ProbedPoint], list[str]]:
    """Heights at single places of the nozzle, and a sentence on what that took.

    geometry  that the firmware had

    Raises InputError where the places decide the heights, and are not known.
    """
    heights = np.array([contact.z for contact in contacts])
    means = [contact for contact in contacts if contact.is_mean]
    if means:
        heights = heights + _corrections(contacts, heights, geometry)
    points = [
        ProbedPoint(contact.x, contact.y, float(height))
        for contact, height in zip(contacts, heights, strict=True)
    ]
    if not means:
        return points, []
    moved = max(abs(p.z - c.z) for p, c in zip(points, contacts, strict=True))
    unsure = next((c.unsure for c in contacts if c.unsure is not None), None)
    if unsure is not None and moved > ROUNDING:
        raise unsure.error(
            "G33 averages its heights over places that P decides, and the log does not"
            " show P",
            "add a line G33 P4 above the report, with the P that was sent, or that of"
            " DELTA_CALIBRATION_DEFAULT_POINTS where none was",
        )
    most = max(len(contact.weights) for contact in means)
    sentence = (
        f"Heights: G33 averages {len(means)} of them over up to {most} places. Each is"
        " turned into the height at its own place, by"
        f" {1000.0 * moved:.0f} um at most, with the delta that fits the means."
    )
    if unsure is not None:
        sentence += f" P is not in the log; that of P{USUAL_POINTS} is as small."
    return points, [sentence]


def _corrections(
    contacts: Sequence[Contact], heights: Array, geometry: DeltaGeometry
) -> Array:
    """Height at each place less the mean (n,), mm, of the delta that fits the means."""
    places = np.concatenate([contact.places for contact in contacts])
    counts = [len(contact.places) for contact in contacts]
    means = np.zeros((len(contacts), len(places)))
    starts = np.cumsum([0, *counts[:-1]])
    for row, (start, contact) in enumerate(zip(starts, contacts, strict=True)):
        means[row, start : start + len(contact.weights)] = contact.weights
    travels = _to_bed(places, geometry)

    def believed(change: Array, travels: Array) -> Array:
        changed = geometry.changed(change)
        return -changed.tool_heights(travels)

    def misses(change: Array) -> Array:
        misfit = (means @ believed(change, travels) - heights) / ROUNDING
        return np.concatenate([misfit, change / TOLERANCE])

    change = optimize.least_squares(misses, np.zeros(len(TOLERANCE))).x
    single = np.array([[contact.x, contact.y] for contact in contacts])
    at_place = believed(change, _to_bed(single, geometry))
    return at_place - means @ believed(change, travels)


def _to_bed(places: Array, geometry: DeltaGeometry) -> Array:
    """Travels (n, 3) to z = 0 at places (n, 2), mm."""
    return geometry.travels(np.pad(places, ((0, 0), (0, 1))))
