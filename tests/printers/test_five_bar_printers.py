"""Five-bars of RepRapFirmware: measured places in, an M669 that puts the nozzle right out."""

from __future__ import annotations

import dataclasses

import numpy as np
import pytest
from oracles.firmware.five_bar import FiveBar, five_bar

from pkm_studies.base import InputError
from printers.delta_printer import compensate, said, take

NOISE = 0.02
CONFIGS = {
    # in mode 1 both knees are behind their lines to the nozzle, in mode 2 both are outward
    "1": "M669 K9 X-50:50 Y0:0 P150:150 D200:200:0:0 L1 B60:30 A20:160:0:360:0:360\n",
    "2": "M669 K9 X-50:50 Y10:-10 P150:160 D200:210:0:0 L2 S100\n",
}
GRID = [complex(x, y) for x in (-60, -30, 0, 30, 60) for y in (180, 210, 240, 270)]


def real_linkage(believed: FiveBar) -> FiveBar:
    """A linkage off by what assembly leaves."""
    return dataclasses.replace(
        believed,
        centres=[
            believed.centres[0] + (0.4 - 0.3j),
            believed.centres[1] + (-0.2 + 0.5j),
        ],
        cranks=[believed.cranks[0] + 0.6, believed.cranks[1] - 0.4],
        struts=[believed.struts[0] - 0.5, believed.struts[1] + 0.7],
        switches=[believed.switches[0] + 0.8, believed.switches[1] - 0.5],
    )


def reached(firmware: FiveBar, real: FiveBar, places: list[complex]) -> np.ndarray:
    return np.array([real.tool(firmware.turns(place)) for place in places])


def table(config: str) -> str:
    """Places as a scanner with a frame of its own reads them."""
    rng, believed = np.random.default_rng(4), five_bar(config)
    tools = reached(believed, real_linkage(believed), GRID)
    read = tools * np.exp(0.03j) + (20 - 10j)
    read += NOISE * (rng.normal(size=len(read)) + 1j * rng.normal(size=len(read)))
    rows = zip(GRID, read, strict=True)
    cells = (f"{c.real},{c.imag},{r.real:.4f},{r.imag:.4f}" for c, r in rows)
    return "\n".join(["x,y,read_x,read_y", *cells, ""])


def misfit(tools: np.ndarray, places: list[complex]) -> np.ndarray:
    """Distances from the places, after the best shift and turn."""
    wanted = np.array(places) - np.mean(places)
    turned = tools - tools.mean()
    turn = np.vdot(turned, wanted)
    return np.abs(turned * turn / abs(turn) - wanted)


@pytest.mark.parametrize("mode", CONFIGS)
def test_places_put_the_nozzle_right(mode, tmp_path):
    config = CONFIGS[mode]
    believed = five_bar(config)
    real = real_linkage(believed)
    assert misfit(reached(believed, real, GRID), GRID).max() > 0.5
    study, imported = take(
        "rrf", {"config.g": config, "m.csv": table(config)}, tmp_path
    )
    assert "20 places" in said(imported)
    known = "estimate = false\nread_x_mm = 0.02\nread_y_mm = 0.02\n[readings]"
    head, _, rest = study.read_text().partition("assumed = true")
    study.write_text(head + known + rest.partition("[readings]")[2])
    export = compensate(study, "rrf")
    between = [complex(x, y) for x in (-50, -10, 40) for y in (190, 225, 260)]
    for places in (GRID, between):
        tools = reached(five_bar(config + export), real, places)
        assert misfit(tools, places).max() < 2.0 * NOISE
    kept = config.split("L1" if mode == "1" else "L2")[1].split("B60:30")[-1].strip()
    assert kept in export


@pytest.mark.parametrize(("before", "after", "problem"), [
    ("L1", "L3", "line 1, M669 L.*modes 1, 2 and 4"),
    ("D200:200:0:0", "D200:200:0:40", "line 1, M669 D.*beyond the joint"),
    ("D200:200:0:0", "D200", "line 1, M669 D.*1 numbers, where 2 or 4"),
    ("P150:150 ", "", "M669 has no P"),
    ("S100", "", "line 5, column x.*do not reach"),
    ("A20:", "U20:", "line 1, M669 U.*does not know this word"),
    ("M669 K9", "M666 X1\nM669 K9", "line 1, M666.*of linear deltas"),
])  # fmt: skip
def test_what_the_model_has_not_is_refused(before, after, problem, tmp_path):
    rows = table(CONFIGS["1"])
    if before == "S100":
        rows = rows.replace("-60.0,270.0,", "-600.0,270.0,")
    files = {"config.g": CONFIGS["1"].replace(before, after), "m.csv": rows}
    with pytest.raises(InputError, match=problem):
        take("rrf", files, tmp_path)


def test_places_are_asked_for(tmp_path):
    with pytest.raises(InputError, match="one CSV with x, y, read_x, read_y"):
        take("rrf", {"config.g": CONFIGS["1"]}, tmp_path)
