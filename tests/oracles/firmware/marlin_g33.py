"""G33 of Marlin: seven means of heights, and the calibration that it makes of them.

After src/gcode/calibrate/G33.cpp of 1.1.9 and later. A reading of the ring counts to its
two neighbours among six directions, from 210 degrees on, by the square of a cosine.
"""

import numpy as np

from oracles.firmware.geometry import Probe
from oracles.firmware.marlin import Marlin

POINTS = ("c", "x", "xy", "y", "yz", "z", "zx")
STEPS = {3: 1, 4: 1 / 2, 5: 1 / 3, 6: 1 / 5, 7: 1 / 7, 8: 1 / 9, 9: 1 / 12, 10: 1 / 15}


def places(points: int, radius: float) -> tuple[list, list]:
    """Middle and ring of P: number of a direction (1 to 6.99) and radius of each place."""
    middle = [] if points in (3, 6, 9) else [(0.0, 0.0)]
    if points >= 3:
        if points >= 8:
            start, step = 6 + 1 / 3, 2 / 3
        else:
            start, step = (6.0, 1.0) if points >= 5 else (5.0, 2.0)
        count = round((start - 1) / step) + 1
        middle += [(start - k * step, 0.1 * radius) for k in range(count)]
    circles = [0.8, 0.9, 1.0] if points >= 8 else [1.0]
    step = STEPS.get(points, 2.0) * len(circles)
    count = int(5.9999 / step) + 1
    ring = [(1 + k * step, f * radius) for k in range(count) for f in circles]
    return middle, ring


def means(
    firmware: Marlin,
    real,
    probe: Probe,
    points: int,
    radius: float,
    rng=None,
    at_probe=False,
) -> dict[str, float]:
    """The heights of a report by point."""
    middle, ring = places(points, radius)
    number, away = np.array(middle + ring).T
    angle = np.radians(210.0 + 60.0 * (number - 1))
    xy = away[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])
    z = firmware.readings(real, probe, xy - firmware.probe[:2] * at_probe, rng)
    out = np.zeros(7)
    divisor = 1 if points < 3 else 7 if points == 5 else points
    out[0] = z[: len(middle)].sum() / divisor
    for (place, _), value in zip(ring, z[len(middle) :], strict=True):
        low, part = int(place + 1e-6), (place + 1e-6) % 1
        out[(low + 5) % 6 + 1] += value * np.cos(np.radians(90 * part)) ** 2
        out[low % 6 + 1] += value * np.sin(np.radians(90 * part)) ** 2
    if points >= 4:
        out[1:] *= STEPS[points]
    heights = dict(zip(POINTS, out, strict=True))
    return heights if points > 2 else {k: heights[k] for k in "cxyz"}


def settings(firmware: Marlin) -> str:
    """What G33 prints of the geometry that is in force, as 1.1.9 and later do."""
    w, a = firmware.words, firmware.adjust
    return (
        f".Height:{w['H']:.2f}  Ex:{a[0]:+.2f}  Ey:{a[1]:+.2f}  Ez:{a[2]:+.2f}"
        f"  Radius:{w['R']:.2f}\n.{' ' * 13}"
        f"  Tx:{w['X']:+.2f}  Ty:{w['Y']:+.2f}  Tz:{w['Z']:+.2f}\n"
    )


def report(z: dict[str, float], digits=2) -> str:
    """The heights as G33 prints them."""
    rows = ((".      ", "cxyz"), (f".{' ' * 13}", ("yz", "zx", "xy")))
    return "".join(
        start + "".join(f"  {k}:{z[k]:+.{digits}f}" for k in names if k in z) + "\n"
        for start, names in rows
    )


def g33(
    firmware: Marlin,
    real,
    probe: Probe,
    radius: float,
    words="P4 V3",
    changes=(),
    rng=None,
    digits=2,
    *,
    shown=True,
) -> str:
    """The log of a G33 with some words.

    changes  geometries that it sets, one after the other; it probes before each one, and
             after the last
    shown    whether the log has the command itself
    """
    points = int(words.partition("P")[2].split()[0])
    log = f"Send: G33 {words}\n" if shown else ""
    log += "Recv: G33 Auto Calibrate\n"
    log += f"Recv: Checking... AC at radius:{radius:.2f}\n"
    for change in ("", *changes):
        firmware.apply(change)
        z = means(firmware, real, probe, points, radius, rng, "O" in words)
        rows = (settings(firmware) + report(z, digits)).splitlines()
        log += "".join(f"Recv: {row}\n" for row in rows)
    return log
