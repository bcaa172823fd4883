"""Oracle for the shipped nodes of forecast compensation: what a machine would read.

The planar machine is the gantry that bends, after a step calibration by RM 4 and RM 5 of
its own; the A3 head yields. It must never import the toolkit. SI units (m, rad).
"""

import dataclasses
import functools
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from oracles import forecast_machines, planar_gantry, planar_geometry

#: noise of y and z of a reading, m; largest deviation after calibration, m
SIGMA, LEFT = np.array([1e-6, 3e-6]), 0.07e-3
PLANAR_SEED, A3_SEED = 7, 5
#: noise of z, psi and theta, m and rad
A3_SIGMA = np.array([2e-6, np.radians(2.0 / 3600.0), np.radians(1.0 / 3600.0)])


@dataclasses.dataclass(frozen=True)
class Calibrated:
    """A gantry whose controller has calibrated parameters p (7,)."""

    gantry: planar_gantry.Gantry
    p: NDArray

    def joints(self, command: NDArray) -> NDArray:
        """Scale readings (n, 2) that put the tool point there: sliders on tilted guides."""
        foot = np.array([-self.p[0] / 2.0, self.p[0] / 2.0])
        tilt, length = self.p[5:7], self.p[3:5]
        across = command[:, :1] - foot
        along = -across * np.sin(tilt) + command[:, 1:] * np.cos(tilt)
        beside = across * np.cos(tilt) + command[:, 1:] * np.sin(tilt)
        return along + np.sqrt(length**2 - beside**2) - self.p[1:3]

    def errors(self, command: NDArray) -> NDArray:
        """Errors (n, 2) against home."""
        both = np.vstack([command, [[0.0, 0.0]]])
        error = self.gantry.pose(self.joints(both)) - both
        return error[:-1] - error[-1]

    def deviation(self) -> NDArray:
        """Largest relative errors (2,) along the paper's horizontal lines."""
        pose, line = planar_geometry.lines(5)
        return np.abs(planar_geometry.relative(self.errors(pose), line)).max(axis=0)


def calibrated(rng: np.random.Generator) -> Calibrated:
    """A gantry that calibration leaves with errors of LEFT at most."""
    gantry = planar_gantry.draw(rng)
    share = LEFT / Calibrated(gantry, _calibrate(gantry, rng)).deviation().max()
    gantry = dataclasses.replace(
        gantry,
        factors=gantry.factors * [1.0, share, share, share],
        mismatch=gantry.mismatch * share,
    )
    return Calibrated(gantry, _calibrate(gantry, rng))


def _calibrate(gantry: planar_gantry.Gantry, rng: np.random.Generator) -> NDArray:
    """Parameters by Gauss and Newton from RM 4 and RM 5, the shortest step each time."""
    runs = [(planar_geometry.lines(4), [0]), (planar_geometry.lines(5), [0, 1])]
    read = []
    for (pose, line), channels in runs:
        y = gantry.pose(planar_geometry.inverse(pose))
        y = y + SIGMA * rng.standard_normal(y.shape)
        read.append(planar_geometry.relative(y, line)[:, channels] / SIGMA[channels])
    y = np.concatenate([r.ravel() for r in read])

    def predicted(p: NDArray) -> NDArray:
        parts = []
        for (pose, line), channels in runs:
            at = planar_geometry.forward(planar_geometry.inverse(pose), p)
            part = planar_geometry.relative(at, line)[:, channels] / SIGMA[channels]
            parts.append(part.ravel())
        return np.concatenate(parts)

    p = planar_geometry.NOMINAL.copy()
    for _ in range(5):
        columns = [
            (predicted(p + step) - predicted(p - step)) / 2e-6
            for step in 1e-6 * np.eye(7)
        ]
        p = p + np.linalg.lstsq(np.stack(columns, -1), y - predicted(p), rcond=1e-7)[0]
    return p


@functools.cache
def planar() -> Calibrated:
    """The shipped gantry."""
    return calibrated(np.random.default_rng(PLANAR_SEED))


def a3() -> forecast_machines.Yielding:
    """The shipped head."""
    return forecast_machines.draw(forecast_machines.A3, np.random.default_rng(A3_SEED))


def table(header: list[str], rows: NDArray) -> str:
    """CSV of rows in the header's units."""
    lines = [",".join(header)]
    lines += [",".join(f"{value:.6g}" for value in row) for row in rows]
    return "\n".join([*lines, ""])


def write(
    path: Path, header: list[str], command: NDArray, errors: NDArray, units: NDArray
) -> None:
    """Commands and errors, each over its unit in SI."""
    path.write_text(table(header, np.hstack([command, errors]) / units))


def main(folder: Path) -> None:
    """Fill in the nodes `NAME.nodes.csv` that a plan asks for, and draw check nodes."""
    studies = {
        "planar_forecast": (
            planar().errors,
            ["y_mm", "z_mm", "error_y_um", "error_z_um"],
            np.array([1e-3, 1e-3, 1e-6, 1e-6]),
            SIGMA,
            (np.array([-1.5, 0.0]), np.array([1.5, 1.5])),
        ),
        "a3_forecast": (
            a3().errors,
            [
                *("z_mm", "psi_deg", "theta_deg"),
                *("error_z_um", "error_psi_arcsec", "error_theta_arcsec"),
            ],
            np.array([1e-3, *np.radians([1, 1]), 1e-6, *np.radians([1, 1]) / 3600]),
            A3_SIGMA,
            (forecast_machines.A3.low, forecast_machines.A3.high),
        ),
    }
    for name, (errors, header, units, sigma, box) in studies.items():
        rng = np.random.default_rng(11)
        file = folder / f"{name}.nodes.csv"
        count = len(header) // 2
        sheet = np.genfromtxt(file, delimiter=",", comments="#", skip_header=0)
        nodes = sheet[1:, :count] * units[:count]
        places = np.round(rng.uniform(*box, (40, count)) / units[:count], 1)
        for path, command in (
            (file, nodes),
            (folder / f"{name}.check.csv", places * units[:count]),
        ):
            read = errors(command)
            read = read + sigma * rng.standard_normal(read.shape)
            write(path, header, command, read, units)


if __name__ == "__main__":
    main(Path(__file__).parents[2] / "studies")
