"""Make the README's pictures from the results of studies.

make study && .venv/bin/oed run docs/gallery/a3_gap.study.toml
.venv/bin/python docs/figures.py out/a3_ball_bar out/a3_gap docs/img
"""

from __future__ import annotations

import json
import sys
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

from matplotlib.figure import Figure

from pkm_reports import style
from pkm_reports.figures import accuracy, kappa, machine
from pkm_reports.figures.gap import polar as gap_polar

#: pictures by the section of the result that they show
PICTURES: Mapping[str, tuple[str, Callable[[Any], Figure]]] = {
    "drawing": ("a3_plan", machine.draw),
    "kappa_maps": ("a3_kappa", kappa.draw),
    "prediction": ("a3_accuracy", accuracy.draw),
    "gap": ("a3_gap", lambda gap: gap_polar.draw(gap["traces"])),
}


def main(folder: Path, out: Path) -> None:
    """Write what a result has as PNG; of a diagnosis, nothing else."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    wanted = ["gap"] if result.get("gap") else ["drawing", "kappa_maps", "prediction"]
    with style.applied():
        for section in wanted:
            name, draw = PICTURES[section]
            draw(result[section]).savefig(
                out / f"{name}.png", dpi=110, metadata={"Software": None}
            )


if __name__ == "__main__":
    for folder in sys.argv[1:-1]:
        main(Path(folder), Path(sys.argv[-1]))
