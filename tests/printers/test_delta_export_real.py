"""Real readings of a delta printer, exported for Klipper: its own formula on the file."""

import compensation_sample as sample
import numpy as np
import pytest
from delta_sessions import fitted, heights_of, measurement, sessions
from oracles.firmware.klipper import Klipper, example
from shipped_models import linear_delta

from pkm_studies.commands import main

machine = linear_delta.machine

__all__ = ["measurement", "sessions"]  # fixtures


@pytest.mark.parametrize("name", ["S03", "S04"])
def test_klippers_residuals_agree_to_the_printed_digits(
    measurement, sessions, tmp_path, name
):
    """The heights that Klipper, with our file, believes in where its carriages were."""
    session = sessions[name]
    fit = fitted(measurement, session)
    folder = sample.save(tmp_path, sample.result(machine, fit.theta[:10]))
    assert main(["compensate", str(folder), "--to", "klipper"]) == 0
    text = (folder / "compensation.cfg").read_text("utf-8")
    printer = Klipper(example()).apply(text).geometry
    point = printer.tool(1e3 * session.contacts)
    offset = fit.theta[list(measurement.names).index(f"{name}_probe.offset")]
    read = measurement.readings([heights_of(measurement, session)], fit.theta)
    assert point[:, 2] == pytest.approx(1e3 * (read - offset), abs=3e-6)
    # the residuals are those of a good fit, not of a wrong geometry
    residual = 1e3 * session.heights - point[:, 2]
    assert np.std(residual) < 0.06
