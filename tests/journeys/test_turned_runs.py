"""A run driven the other way than its rows say is the first line on the terminal."""

from pathlib import Path

import numpy as np
from bad_fit_sample import STUDY

from kernel import a3_machines, a3_plans
from pkm_studies.commands import main

ONE_SETUP = STUDY.partition('[[setup]]\nname = "long_tool"')
TEXT = ONE_SETUP[0] + "[noise]" + ONE_SETUP[2].partition("[noise]")[2]


def write(folder: Path, runs: list[str]) -> tuple[Path, Path]:
    """Study and readings of an A3 head with play; some runs' rows are turned."""
    m = a3_plans.measurement()
    rng = np.random.default_rng(26)
    series, rows = a3_machines.planned(m)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    y = a3_machines.read(series, rows, truth, rng)
    z, psi, theta = series.reading_commands().T
    table = a3_machines.turned(rows, runs).drop(columns=["temp_leg1", "temp_leg3"])
    table = table.rename(columns={"time": "time_s", "temp_leg2": "temp_leg2_C"})
    table["z_mm"], table["psi_deg"] = 1e3 * z, np.rad2deg(psi)
    table["theta_deg"], table["length_mm"] = np.rad2deg(theta), 1e3 * y
    study, readings = folder / "loud.study.toml", folder / "r.csv"
    study.write_text(TEXT, encoding="utf-8")
    table.to_csv(readings, index=False)
    return study, readings


def test_check_names_runs_whose_order_and_direction_contradict(tmp_path, capsys):
    study, readings = write(tmp_path, ["80-1"])
    assert main(["check", str(study), str(readings)]) == 1
    out = capsys.readouterr().out
    wanted = "The runs 80-0 and 80-1 pass the same poses in the same order, but have"
    assert wanted in out
