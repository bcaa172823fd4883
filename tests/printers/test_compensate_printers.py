"""`oed compensate` for delta printers: the firmware of the oracle reads what is printed."""

from pathlib import Path

import compensation_sample as sample
import numpy as np
import pytest
from delta_sessions import fitted, heights_of, measurement, sessions
from oracles import delta_trilateration as delta
from oracles.firmware import marlin, rrf
from oracles.firmware.geometry import Firmware
from oracles.firmware.klipper import Klipper, example
from shipped_models import delta as delta_family
from shipped_models import linear_delta

from oed.compensate import compensated_joints
from oed.mechanism import Kinematics
from pkm_studies.commands import main

#: an identified delta: radius, arms, angles, endstops
DELTA = linear_delta.machine.nominal + np.array(
    [3e-4, -5e-4, -6e-4, 4e-4, 1e-3, -2e-3, 0.0, 2e-4, 1.2e-3, -1e-4]
)
SUFFIXES = {"klipper": ".cfg", "marlin": ".gcode", "rrf": ".g"}


@pytest.fixture
def delta_folder(tmp_path: Path) -> Path:
    return sample.save(tmp_path / "d", sample.result(linear_delta.machine, DELTA))


def points(rng: np.random.Generator) -> np.ndarray:
    return np.column_stack([rng.uniform(-0.09, 0.09, (40, 2)), rng.uniform(0, 0.3, 40)])


def written(folder: Path, kind: str) -> str:
    return (folder / f"compensation{SUFFIXES[kind]}").read_text("utf-8")


def firmware(kind: str, text: str) -> Firmware:
    if kind == "klipper":
        return Klipper(example()).apply(text)
    return rrf.RepRapFirmware(text) if kind == "rrf" else marlin.Marlin(text)


@pytest.mark.parametrize("kind", SUFFIXES)
def test_the_firmware_reproduces_the_compensated_pose(kind, oed, delta_folder, rng):
    code, out, _ = oed("compensate", delta_folder, "--to", kind)
    assert code == 0
    assert "printed digits cost at most x 0.0" in out
    command = points(rng)
    q = 1e-3 * firmware(kind, written(delta_folder, kind)).travel(1e3 * command)
    digits = 5e-9 if kind == "klipper" else 5e-7
    tool = delta.nozzle(q, DELTA[0], DELTA[1:4], DELTA[4:7], DELTA[7:])
    assert np.abs(tool - command).max() < digits
    exact = compensated_joints(Kinematics(linear_delta.machine), command, DELTA)
    assert np.abs(q - exact).max() < digits


def test_adjustments_are_those_that_every_version_takes(oed, delta_folder):
    """Marlin's are far enough below zero to be moves; RepRapFirmware's have no mean."""
    for kind in ("marlin", "rrf"):
        assert oed("compensate", delta_folder, "--to", kind)[0] == 0
    stops = marlin.words_of(written(delta_folder, "marlin"), "M666")[0].values()
    assert max(stops) == pytest.approx(-0.2)
    adjust = rrf.RepRapFirmware(written(delta_folder, "rrf")).adjust
    assert adjust.sum() == pytest.approx(0.0, abs=2e-4)


# -- versions of Marlin ----------------------------------------------------------------
def letters(folder: Path) -> set[str]:
    """Letters of M665 in the export of a folder."""
    return set(marlin.words_of(written(folder, "marlin"), "M665")[0])


def test_marlin_names_its_version_and_spares_the_calibration_radius(
    oed, delta_folder, tmp_path
):
    """B is the trim of a rod from 2.0.6 on; it was the radius of calibration in 1.1."""
    code, out, _ = oed("compensate", delta_folder, "--to", "marlin")
    assert code == 0
    assert "For Marlin 2.0.6 or later" in out
    assert "name the version with --firmware" in out
    assert letters(delta_folder) == set("LRHXYZABC")
    # the version is not known: the user stores it
    assert "\nM500" not in written(delta_folder, "marlin")
    call = ("compensate", delta_folder, "--to", "marlin", "--firmware")
    assert oed(*call, "2.1.2")[0] == 0
    assert letters(delta_folder) == set("LRHXYZABC")
    assert "\nM500 ; store\n" in written(delta_folder, "marlin")
    for version in ("1.1.8", "2.0.5"):
        code, _, err = oed(*call, version)
        assert code == 2
        assert "one rod length, and the arms differ; set DELTA_DIAGONAL_ROD" in err
    alike = DELTA.copy()
    alike[1:4] = 0.345
    same_rods = sample.save(tmp_path / "s", sample.result(linear_delta.machine, alike))
    for version in (None, "1.1.0", "1.1.8", "2.0.5", "2.0.6"):
        option = [] if version is None else ["--firmware", version]
        assert oed("compensate", same_rods, "--to", "marlin", *option)[0] == 0
        assert ("B" in letters(same_rods)) == (version == "2.0.6")
        assert "\nM500 ; store\n" in written(same_rods, "marlin")


@pytest.mark.parametrize(("kind", "version", "said"), [
    ("marlin", "1.0.2", "has no M665 H"),
    ("marlin", "1.1.0-RC8", "has no M665 H"),
    ("marlin", "new", "no version of Marlin"),
    ("csv", "2.0.5", "csv is the same for all versions"),
])  # fmt: skip
def test_versions_that_cannot_be_written_for(kind, version, said, oed, delta_folder):
    code, _, err = oed("compensate", delta_folder, "--to", kind, "--firmware", version)
    assert code == 2
    assert said in err


@pytest.mark.parametrize(("version", "offset", "said"), [
    ("1.1.0", 0.0, ""),
    ("1.1.8", 0.1, ""),
    ("1.1.9", 0.0, "take them off H"),
    ("2.0.5", 0.0, "take them off H"),
    ("2.1.2", 0.0, "need M851 Z added to it"),
])  # fmt: skip
def test_the_height_at_home_is_that_of_the_version(
    version, offset, said, oed, tmp_path
):
    """Of a study that has no Marlin log: what is not known of H is in the file."""
    alike = DELTA.copy()
    alike[1:4] = 0.345
    folder = sample.save(tmp_path / "s", sample.result(linear_delta.machine, alike))
    _, out, _ = oed("compensate", folder, "--to", "marlin", "--firmware", version)
    words = marlin.words_of(written(folder, "marlin"), "M665")[0]
    lowest = 1e3 * alike[7:].min()
    assert words["H"] == pytest.approx(lowest - 0.2 - offset, abs=1e-4)
    assert said in out
    assert ("need M851 Z added to it" in out) == (version in ("2.0.5", "2.1.2"))


# -- the family of deltas --------------------------------------------------------------
def family(**changes: float) -> np.ndarray:
    """A delta with a radius for each tower, all alike, and upright towers."""
    machine = delta_family.machine
    offsets = dict(
        zip(
            [p.name for p in linear_delta.machine.parameters],
            DELTA - linear_delta.machine.nominal,
            strict=True,
        )
    )
    values = machine.nominal.copy()
    for k, parameter in enumerate(machine.parameters):
        stem = "radius" if parameter.name.startswith("radius") else parameter.name
        values[k] += offsets.get(stem, 0.0) + changes.get(parameter.name, 0.0)
    return values


def family_folder(folder: Path, **changes: float) -> Path:
    return sample.save(folder, sample.result(delta_family.machine, family(**changes)))


def test_the_family_is_written_where_its_parameters_allow(oed, tmp_path, rng):
    folder = family_folder(tmp_path / "upright")
    command, values = points(rng), family()
    for kind in SUFFIXES:
        assert oed("compensate", folder, "--to", kind)[0] == 0
        q = 1e-3 * firmware(kind, written(folder, kind)).travel(1e3 * command)
        reached = delta.nozzle(q, values[0], values[3:6], values[6:9], values[9:12])
        assert np.abs(reached - command).max() < 5e-7
    leaning = family_folder(tmp_path / "leaning", lean2=1.5e-3, tip1=-0.8e-3)
    code, _, err = oed("compensate", leaning, "--to", "klipper")
    assert code == 2
    assert "lean2 1.5, tip1 -0.8 mrad" in err
    assert 'fixed = ["lean1", "lean2", "lean3", "tip1", "tip2", "tip3", ...]' in err
    uneven = family_folder(tmp_path / "uneven", radius3=3e-4)
    code, _, err = oed("compensate", uneven, "--to", "klipper")
    assert code == 2
    assert "the towers have three: radius1 162.050, radius2 162.050" in err
    assert "linear_delta" in err
    assert oed("compensate", uneven, "--to", "csv")[0] == 0


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
