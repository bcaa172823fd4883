"""Make the README's pictures from the result of the A3 study.

make study && .venv/bin/python docs/figures.py out/a3_ball_bar docs/img
"""

from __future__ import annotations

import json
import sys
from pathlib import Path

from pkm_reports import style
from pkm_reports.figures import accuracy, kappa, machine


def main(folder: Path, out: Path) -> None:
    """Write the plan, the condition number and the accuracy as PNG."""
    result = json.loads((folder / "result.json").read_text(encoding="utf-8"))
    out.mkdir(parents=True, exist_ok=True)
    with style.applied():
        for name, figure in (
            ("a3_plan", machine.draw(result["drawing"])),
            ("a3_kappa", kappa.draw(result["kappa_maps"])),
            ("a3_accuracy", accuracy.draw(result["prediction"])),
        ):
            figure.savefig(out / f"{name}.png", dpi=110, metadata={"Software": None})


if __name__ == "__main__":
    main(Path(sys.argv[1]), Path(sys.argv[2]))
