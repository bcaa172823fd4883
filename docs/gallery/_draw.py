"""What the examples of the gallery share: a picture of the machine to scale, beside a
plot, in the look of the reports.

picture = _draw.Picture("Thirty readings", "Condition number")
picture.machine(kinematics)                      # its skeleton at home, or at a command
                                                 (n_dof,)
picture.points(places, label="readings")         # (n, 3) in m
picture.plot.plot(...)                           # the axes on the right
picture.save(__file__, ["what was found"])
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from oed.arrays import Array
from oed.kinematics import Kinematics
from pkm_reports import style
from pkm_reports.figures import machine as drawing

HEIGHT, DPI = 3.3, 100  # inches, pixels an inch
LARGEST = 60_000  # bytes of a picture


class Picture:
    """A figure with a 3-D scene (mm) on the left and `plot` on the right."""

    def __init__(self, left: str, right: str) -> None:
        with style.applied():
            self.figure = Figure(figsize=(style.WIDTH, HEIGHT))
            self.figure.set_layout_engine("none")
            self.scene: Any = self.figure.add_axes(
                (0.0, 0.12, 0.5, 0.8), projection="3d", proj_type="ortho"
            )
            self.plot: Axes = self.figure.add_axes((0.62, 0.15, 0.36, 0.76))
            for place, text in ((0.02, left), (0.53, right)):
                self.figure.text(place, 0.945, text, fontsize=8.5, fontweight="bold")
        self._clouds: list[Array] = []

    def machine(
        self, kinematics: Kinematics, command: Array | None = None, **look: Any
    ) -> None:
        """The machine's skeleton at a command (n_dof,), SI, or at home."""
        at = kinematics.machine.home_command if command is None else command
        x, q = kinematics.inverse(np.atleast_2d(at))
        for line in kinematics.skeleton(x[0], q[0], kinematics.machine.nominal):
            self.line(line, **{"lw": 1.6, **look})

    def line(self, places: Array, **look: Any) -> None:
        """A polyline through points (n, 3), m."""
        self._clouds.append(1e3 * np.atleast_2d(places))
        self.scene.plot(
            *self._clouds[-1].T, solid_capstyle="round", **{"color": style.INK, **look}
        )

    def points(self, places: Array, **look: Any) -> None:
        """Points (n, 3), m, as marks."""
        self._clouds.append(1e3 * np.atleast_2d(places))
        mark = {"color": style.BLUE, "marker": "o", "ms": 3.0, "mew": 0.0, "ls": ""}
        self.scene.plot(*self._clouds[-1].T, **{**mark, **look})

    def save(self, example: str, findings: Sequence[str] = ()) -> Path:
        """Writes NAME.png for the example NAME.py, into the folder on the command line
        or docs/img/gallery.
        """
        folder = (
            Path(sys.argv[1])
            if len(sys.argv) > 1
            else Path(__file__).parents[1] / "img" / "gallery"
        )
        folder.mkdir(parents=True, exist_ok=True)
        path = folder / f"{Path(example).stem}.png"
        with style.applied():
            self._fit()
            self.figure.savefig(path, dpi=DPI, metadata={"Software": None})
        for text in findings:
            print(text)
        size = path.stat().st_size
        if size >= LARGEST:
            raise ValueError(
                f"{path.name} has {size} bytes, the limit is {LARGEST}: draw fewer"
                " points"
            )
        return path

    def _fit(self) -> None:
        """Equal scale on all axes, filling the left half; a legend below where
        something has a label.
        """
        cloud = np.vstack(self._clouds)
        low, high = cloud.min(axis=0), cloud.max(axis=0)
        size = np.maximum(high - low, 0.3 * max(float(np.max(high - low)), 1.0)) * 1.06
        box = (low + high - size) / 2.0, (low + high + size) / 2.0
        marks, _ = self.scene.get_legend_handles_labels()
        if marks:
            self.figure.legend(
                handles=marks, loc="lower left", ncols=2, borderaxespad=0.3
            )
        drawing._frame(self.scene, box)
        drawing._fit(
            self.figure, self.scene, box, (0.02, 0.10 if marks else 0.02, 0.50, 0.92)
        )
