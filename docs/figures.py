"""Make the README's pictures from the results of studies.

make study && .venv/bin/oed run docs/gallery/a3_gap.study.toml
.venv/bin/python docs/figures.py out/a3_ball_bar out/a3_gap docs/img
"""

from __future__ import annotations

import sys
from pathlib import Path

from matplotlib.figure import Figure

from oed.result import StudyResult
from pkm_reports import style
from pkm_reports.sections import accuracy, gap, identifiability, machine_figures
from pkm_studies.results import load_result

DPI = 110


def pictures(result: StudyResult) -> dict[str, Figure]:
    """Figures of a result by the name of their file; of a diagnosis, its circles alone."""
    if result.gap is not None:
        return {"a3_gap": gap.draw_circles(result.gap.traces)}
    drawn: dict[str, Figure] = {}
    if result.drawing is not None:
        drawn["a3_plan"] = machine_figures.draw_machine(result.drawing)
    if result.kappa_maps:
        drawn["a3_kappa"] = identifiability.draw_kappa(result.kappa_maps)
    if result.prediction is not None:
        drawn["a3_accuracy"] = accuracy.draw_components(result.prediction)
    return drawn


def main(folder: Path, out: Path) -> None:
    """Write the pictures of the result in `folder` as PNG files into `out`."""
    out.mkdir(parents=True, exist_ok=True)
    with style.applied():
        for name, figure in pictures(load_result(folder)).items():
            path = out / f"{name}.png"
            figure.savefig(
                path, dpi=DPI, bbox_inches="tight", metadata={"Software": None}
            )


if __name__ == "__main__":
    for folder in sys.argv[1:-1]:
        main(Path(folder), Path(sys.argv[-1]))
