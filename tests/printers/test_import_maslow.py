"""`oed import maslow`: anchors from the configuration, belts from the calibration's log."""

import tomllib
from pathlib import Path

import numpy as np
import pytest
from scipy.optimize import least_squares

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import import_files

YAML = """\
board: Maslow
Maslow_vertical: false
maslow_calibration_grid_size: 9
Maslow_tlX: -20.0
Maslow_tlY: 2000.0
Maslow_tlZ: 116.0
Maslow_trX: 3010.0
Maslow_trY: 2010.0
Maslow_trZ: 69.0
Maslow_blX: 0
Maslow_blY: 0
Maslow_blZ: 38
Maslow_brX: 3000.0
Maslow_brY: 0
Maslow_brZ: 89
Maslow_Scale_Y: 1.0
"""
#: anchors tl, tr, br, bl of the true frame, mm
TRUE = np.array([(-8.0, 2031.0), (2987.0, 2019.0), (2990.0, 0.0), (0.0, 0.0)])
#: free coordinates: tlX, tlY, trX, trY, brX
FREE = [(0, 0), (0, 1), (1, 0), (1, 1), (2, 0)]


def belts() -> np.ndarray:
    """Lengths (n, 4) over the sheet, with errors of half a millimetre."""
    x, y = np.meshgrid(np.linspace(600.0, 2400.0, 6), np.linspace(400.0, 1600.0, 5))
    sled = np.column_stack([x.ravel(), y.ravel()])
    lengths = np.linalg.norm(sled[:, None] - TRUE, axis=2)
    return lengths + np.random.default_rng(1).normal(0.0, 0.5, lengths.shape)


def log(lengths: np.ndarray) -> str:
    rows = [
        f"{{bl:{bl:.2f},   br:{br:.2f},   tr:{tr:.2f},   tl:{tl:.2f}}},"
        for tl, tr, br, bl in lengths
    ]
    # the first waypoints are sent twice
    return f"[MSG:INFO] CLBM:[{''.join(rows[:6])}]\nCLBM:[{''.join(rows)}]\n"


def taken(files: dict[str, str], folder: Path) -> tuple[Path, str, list]:
    folder.mkdir(exist_ok=True)
    for name, text in files.items():
        (folder / name).write_text(text)
    paths = [folder / name for name in files]
    path, imported = import_files("maslow", paths, folder / "out", name="m")
    return path, " ".join(imported.statements), list(imported.rows)


def test_belts_calibrate_the_anchors_as_scipy_does(tmp_path):
    lengths = np.round(belts(), 2)
    files = {"maslow.yaml": YAML, "log.txt": log(lengths)}
    path, sentences, rows = taken(files, tmp_path)
    assert len(rows) == 30
    assert "6 waypoints that the log prints again" in sentences
    assert "Maslow tlZ (line 6)" in sentences
    assert "Maslow Scale_Y (line 16)" in sentences
    assert "no part of the geometry: board." in sentences
    check_anchors(path, lengths)


#: the same as newer versions have it: keys in a section, the origin left out
SECTION = """\
board: Maslow
kinematics:
  MaslowKinematics:
    tlX: -20.0
    tlY: 2000.0

    # the right side
    trX: 3010.0
    trY: 2010.0
    brX: 3000.0
    beltEndExtension: 30.0
axes:
  x:
    tlX: 7.0
"""
STALE = "Maslow_tlX: -400.0\nMaslow_brX: 3300.0\nMaslow_brY: 9.0\n"


@pytest.mark.parametrize("beside", ["", STALE])
def test_the_section_of_newer_versions_wins_over_old_keys(beside, tmp_path):
    lengths = np.round(belts(), 2)
    for k, text in enumerate((beside + SECTION, SECTION + beside)):
        files = {"maslow.yaml": text, "log.txt": log(lengths)}
        path, sentences, _ = taken(files, tmp_path / str(k))
        assert "anchors tl -20, 2000; tr 3010, 2010; br 3000, 0; bl 0, 0" in sentences
        assert ("does not read keys of older ones" in sentences) == bool(beside)
        assert ("old key tlX" in sentences) == bool(beside)
    check_anchors(path, lengths)


def test_a_log_with_the_path_of_the_section_is_read(tmp_path):
    values = {"tlX": -20, "tlY": 2000, "trX": 3010, "trY": 2010, "brX": 3000}
    lines = [f"$/kinematics/MaslowKinematics/{k}={v}" for k, v in values.items()]
    text = "\n".join([*lines, "$/Maslow_tlX=-400", log(belts())])
    _, sentences, _ = taken({"log.txt": text}, tmp_path)
    assert "anchors tl -20, 2000; tr 3010, 2010;" in sentences
    assert "old key tlX (line 6)" in sentences


def check_anchors(path: Path, lengths: np.ndarray) -> None:
    """The study's anchors are those of scipy's least squares, and the true ones."""

    def misfit(v: np.ndarray) -> np.ndarray:
        anchors = np.array(
            [(-20.0, 2000.0), (3010.0, 2010.0), (3000.0, 0.0), (0.0, 0.0)]
        )
        for (i, k), value in zip(FREE, v[:5], strict=True):
            anchors[i, k] = value
        sled = v[5:].reshape(-1, 2)
        return (np.linalg.norm(sled[:, None] - anchors, axis=2) - lengths).ravel()

    start = np.r_[-20.0, 2000.0, 3010.0, 2010.0, 3000.0, np.tile([1500.0, 1000.0], 30)]
    right = least_squares(misfit, start).x[:5]
    study = oed.load_study(path)
    estimate = oed.identify(oed.read_readings(study)).section.parameters
    names = [f"anchor{i + 1}{'xy'[k]}" for i, k in FREE]
    assert set(estimate) == set(names)
    values = [estimate[name].value for name in names]
    np.testing.assert_allclose(values, right, atol=0.3)
    np.testing.assert_allclose(values, [TRUE[i, k] for i, k in FREE], atol=3.0)


@pytest.mark.parametrize(("yaml", "text", "problem"), [
    (YAML.replace("Maslow_trY: 2010.0", ""), None, "Maslow_trY"),
    (YAML.replace("tlX: -20.0", "tlX: wide"), None, "no number"),
    (YAML.replace("blX: 0", "blX: 12"), None, "lower left anchor"),
    (YAML, "ok\n", "no belts"),
    (YAML, "CLBM:[{bl:1.0, br:2.0, tr:3.0},]\n", "four belts"),
    (YAML.replace("tlX: -20.0", "tlX: nan"), None, "no number"),
    (YAML.replace("tlY: 2000.0", "tlY: 2e300"), None, "no number"),
    (YAML, log(belts())[:-40], "the line is cut off"),
    (YAML, log(belts() / 1000.0), "do not meet"),
    (YAML, log(-belts()), "do not meet"),
    (YAML.replace("tlY: 2000.0", "tlY: 2_000"), None, "no number"),
    (YAML, log(belts()).replace(".", ","), "four belts"),
    (YAML, log(belts()).replace("br:2", "br:2_"), "four belts"),
    (YAML, log(belts()).replace("br:2", "br:2e12", 1), "four belts"),
    (YAML, log(belts()[:, [1, 0, 2, 3]]), "do not meet"),
])  # fmt: skip
def test_what_is_missing_or_wrong_is_refused(yaml, text, problem, tmp_path):
    files = {"m.yaml": yaml, "log.txt": log(belts()) if text is None else text}
    with pytest.raises(InputError, match=problem):
        taken(files, tmp_path)


@pytest.mark.parametrize("option", ["machine", "column_map", "mesh"])
def test_an_option_that_is_not_read_is_refused(option, tmp_path):
    given = {"machine": "delta", "column_map": tmp_path / "no", "mesh": "readings"}
    with pytest.raises(InputError, match="need no --m"):
        import_files(
            "maslow", [tmp_path / "m.yaml"], tmp_path, **{option: given[option]}
        )


def test_four_readings_of_a_belt_give_the_noise(tmp_path):
    """A length is the mean of four, and a gap a combination of four lengths over 2."""
    labels = ("Top Left", "Top Right", "Bottom Right", "Bottom Left")
    rng = np.random.default_rng(5)
    readings = 2000.0 + rng.normal(0.0, 0.2, (3, 4, 4)).round(3)
    lines = "".join(
        "".join(f"[MSG:INFO: {name} {v:.3f}]\n" for v in belt)
        + f"[MSG:INFO: Measured waypoint {k}]\n" * (name == labels[-1])
        for k, waypoint in enumerate(readings)
        for name, belt in zip(labels, waypoint, strict=True)
    )
    files = {"maslow.yaml": YAML, "cal.log": lines + log(belts())}
    path, statements, _ = taken(files, tmp_path)
    spread = np.sqrt(readings.var(axis=2, ddof=1).mean())
    noise = tomllib.loads(path.read_text())["noise"]
    assert noise["gap1_mm"] == pytest.approx(spread / 4.0, abs=1e-6)
    assert "assumed" not in noise
    assert "at 12 places" in statements
    assert "36 degrees of freedom" in statements
    path, statements, _ = taken(files | {"cal.log": log(belts())}, tmp_path / "b")
    assert "no single readings of the belts, so 0.5 mm is assumed" in statements
