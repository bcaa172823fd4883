"""The picture of a gallery example: the machine to scale on the left, a plot beside it.

picture = _draw.Picture("Thirty readings", "Condition number")
picture.machine(kinematics)                  # its skeleton at home, or at a command (n_dof,)
picture.points(places, label="readings")     # (n, 3) in m
picture.plot.plot(...)                       # the axes on the right
picture.save(__file__, ["a finding to print"])
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed import units
from oed.base import Array
from oed.mechanism import Kinematics
from pkm_reports import style
from pkm_reports.sections import machine_figures

HEIGHT, DPI = 3.3, 100  # inches, pixels an inch
LARGEST = 60_000  # bytes of a picture


class Picture:
    """A figure with a 3-D scene (mm) on the left and `plot` on the right."""

    def __init__(self, left: str, right: str) -> None:
        with style.applied():
            self.figure = Figure(figsize=(style.FIGURE_WIDTH, HEIGHT))
            self.figure.set_layout_engine("none")
            place, solid = (0.0, 0.12, 0.5, 0.8), {"projection": "3d"}
            self.scene: Any = self.figure.add_axes(place, proj_type="ortho", **solid)
            self.plot: Axes = self.figure.add_axes((0.62, 0.15, 0.36, 0.76))
            for x, title in ((0.02, left), (0.53, right)):
                self.figure.text(x, 0.945, title, fontsize=8.5, fontweight="bold")
        self._clouds: list[Array] = []

    def machine(
        self, kinematics: Kinematics, command: Array | None = None, **look: Any
    ) -> None:
        """Draw the machine's skeleton at a command (n_dof,), SI, or at home."""
        at = kinematics.machine.home_command if command is None else command
        x, q = kinematics.inverse(np.atleast_2d(at))
        for line in kinematics.skeleton(x[0], q[0], kinematics.machine.nominal):
            self.line(line, **{"lw": 1.6, **look})

    def line(self, places: Array, **look: Any) -> None:
        """Draw a polyline through points (n, 3), m."""
        stroke = {"color": style.INK, "solid_capstyle": "round"}
        self.scene.plot(*self._in_mm(places).T, **{**stroke, **look})

    def points(self, places: Array, **look: Any) -> None:
        """Draw points (n, 3), m, as marks."""
        mark = {"color": style.BLUE, "marker": "o", "ms": 3.0, "mew": 0.0, "ls": ""}
        self.scene.plot(*self._in_mm(places).T, **{**mark, **look})

    def save(self, example: str, findings: Sequence[str] = ()) -> Path:
        """Write NAME.png for the example NAME.py, and print its findings.

        The folder is the one on the command line, or docs/img/gallery.
        """
        default = Path(__file__).parents[1] / "img" / "gallery"
        folder = Path(sys.argv[1]) if len(sys.argv) > 1 else default
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{Path(example).stem}.png"
        with style.applied():
            self._fit()
            self.figure.savefig(path, dpi=DPI, metadata={"Software": None})
        for finding in findings:
            print(finding)
        size = path.stat().st_size
        if size >= LARGEST:
            raise ValueError(
                f"{path.name} has {size} bytes, the limit is {LARGEST}: draw fewer"
                " points"
            )
        return path

    def _in_mm(self, places: Array) -> Array:
        """Points (n, 3) in mm, remembered for the limits of the scene."""
        points = units.from_si(np.atleast_2d(places), "mm")
        self._clouds.append(points)
        return points

    def _fit(self) -> None:
        """One scale on all axes, filling the left half; a legend below its labels."""
        box = machine_figures.box_around(np.vstack(self._clouds))
        marks, _ = self.scene.get_legend_handles_labels()
        if marks:
            place: Any = {"loc": "lower left", "borderaxespad": 0.3}
            self.figure.legend(handles=marks, ncols=2, **place)
        bottom = 0.10 if marks else 0.02
        machine_figures.set_axes(self.scene, box)
        machine_figures.fit_to(self.figure, self.scene, box, (0.02, bottom, 0.50, 0.92))
