"""`oed import` of ball-bar traces, tracker points and any CSV, against the oracles."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np
import pytest
from oracles import planar_cables
from oracles.delta_trilateration import nozzle, travel_to
from scipy.spatial.transform import Rotation

import oed
from oed import units
from pkm_studies import csv_table
from pkm_studies.cli import main
from pkm_studies.errors import InputError
from pkm_studies.importers import session, thinning

#: the shipped delta, and a true one: mm and rad
NOMINAL = (161.75, [345.0] * 3, np.radians([210.0, 330.0, 90.0]), [420.0] * 3)
TRUE = (161.75, [345.2, 344.9, 345.0], np.radians([210.1, 330, 90]), [420.1, 420, 420])
CENTRE, RADIUS = np.array([0.0, 10.0, 60.0]), 100.0
MAP = """\
machine = "linear_delta"
[circle]
centre_mm = [0, 10, 60]
radius_mm = 100
feed_mm_min = 1000
"""


def true_points(commanded: np.ndarray) -> np.ndarray:
    """Where the true delta puts its tool at commands (n, 3), mm."""
    return nozzle(travel_to(commanded, *NOMINAL), *TRUE)


def trace(rng: np.random.Generator, sense: int, correlation: float) -> np.ndarray:
    """Angle in deg and deviation in um of 2000 points, with correlated noise."""
    degrees = 0.0 + sense * np.linspace(0.0, 360.0, 2000)
    angle = np.radians(degrees)
    circle = np.column_stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)])
    tool = true_points(CENTRE + RADIUS * circle)
    deviation = 1000.0 * (np.linalg.norm(tool - CENTRE, axis=1) - RADIUS)
    noise = np.zeros(2000)
    for k in range(1, 2000):
        innovation = np.sqrt(1.0 - correlation**2) * rng.normal()
        noise[k] = correlation * noise[k - 1] + innovation
    return np.column_stack([degrees, deviation + noise])


def write_trace(path: Path, runs: list[np.ndarray]) -> Path:
    """A file as ball-bar software of a German office writes it."""
    lines = ["Ballbar test 7", "Operator;Muster", "", "Angle (deg);Deviation (µm)"]
    for run in runs:
        lines += [f"{a:.4f};{d:.3f}".replace(".", ",") for a, d in run]
    path.write_text("\n".join(lines) + "\n", encoding="utf-8")
    return path


def test_a_trace_of_4000_points_both_ways(
    tmp_path: Path, rng: np.random.Generator
) -> None:
    forward, backward = trace(rng, 1, 0.9), trace(rng, -1, 0.9)
    backward[:, 0] += 360.0
    path = write_trace(tmp_path / "bar.csv", [forward, backward])
    (tmp_path / "my.toml").write_text(MAP)
    study, imported = session.import_files(
        "ballbar", [path], tmp_path / "out", column_map=tmp_path / "my.toml"
    )
    runs = {row["run"] for row in imported.rows}
    assert runs == {"circle 1 ccw", "circle 2 cw"}
    assert [row["direction"] for row in imported.rows[:1]] == ["1"]
    assert imported.rows[-1]["direction"] == "-1"
    first = imported.rows[0]
    angle = np.radians(np.mean(forward[: 2000 // 117, 0]))  # means of 17 points
    at = CENTRE + RADIUS * np.array([np.cos(angle), np.sin(angle), 0.0])
    assert [float(first[f"{n}_mm"]) for n in "xyz"] == pytest.approx(at, abs=1e-4)
    loaded = oed.load_study(study)
    assert oed.identify(oed.read_readings(loaded)).section.readings == len(
        imported.rows
    )
    again = session.import_files(
        "ballbar", [path], tmp_path / "b", column_map=tmp_path / "out" / "bar.map.toml"
    )
    assert again[1].rows == imported.rows  # the map that was written is complete


def test_means_have_the_noise_that_correlation_leaves(rng: np.random.Generator) -> None:
    """AR(1) by its closed form: variance and lag-one covariance of block means."""
    rho, block, spread = 0.9, 20, []
    for _ in range(40):
        noise = trace(rng, 1, rho)
        residual = noise[:, 1] - trace(rng, 1, 0.0)[:, 1]  # no geometry; white added
        thinned = thinning.thin(
            np.radians(noise[:, 0]), 1e-6 * residual, np.zeros(2000), 100
        )
        assert thinned.block == block
        spread.append(thinned.sigma)
    lags = np.arange(1, block)
    mean = (1.0 + 2.0 * np.sum((1.0 - lags / block) * rho**lags)) / block
    wanted = 1e-6 * np.sqrt(mean + 1.0 / block)
    # slow noise is partly taken for harmonics, so a little less is left
    assert 0.8 * wanted < np.mean(spread) < 1.02 * wanted
    assert np.mean(spread) > 1.5 * 1e-6 * np.sqrt(
        2.0 / block
    )  # not that of white noise


def test_tracker_points_in_a_frame_of_their_own(tmp_path: Path) -> None:
    """The true delta, seen by a tracker 3 m away and turned by 70 degrees."""
    grid = np.linspace(-80.0, 80.0, 4)
    mesh = np.meshgrid(grid, grid, [20.0, 150.0], indexing="ij")
    commanded = np.column_stack([m.ravel() for m in mesh])
    turned = Rotation.from_euler("zyx", [70.0, 5.0, -3.0], degrees=True)
    shift = np.array([3000.0, -500.0, 800.0])
    seen = turned.apply(true_points(commanded)) + shift
    lines = ["x_mm,y_mm,z_mm,X,Y,Z"]
    pairs = np.hstack([commanded, seen])
    lines += [",".join(f"{value:.6f}" for value in row) for row in pairs]
    path = tmp_path / "points.csv"
    path.write_text("\n".join(lines))
    study, imported = session.import_files(
        "tracker", [path], tmp_path / "out", machine="linear_delta"
    )
    assert any("best fit to the nominal poses" in s for s in imported.statements)
    estimate = oed.identify(oed.read_readings(oed.load_study(study))).section
    assert max(estimate.rms_after.values()) < 2.0  # um
    # lengths of arms are seen whatever the frame
    entry = estimate.parameters["arm1"]
    arm = units.number(float(units.to_si(entry.value, entry.unit)), "mm")
    assert arm == pytest.approx(TRUE[1][0], abs=0.02)
    path.write_text("\n".join(lines).replace("X,Y,Z", "X,Z,Y"))
    with pytest.raises(InputError, match="left-handed"):
        session.import_files("tracker", [path], tmp_path / "b", machine="linear_delta")
    shuffled = [lines[0], *lines[20:], *lines[1:20]]
    poses = [",".join(line.split(",")[:3]) for line in lines]
    (tmp_path / "poses.csv").write_text("\n".join(poses))
    path.write_text("\n".join(",".join(line.split(",")[3:]) for line in shuffled))
    with pytest.raises(InputError, match="in one order"):
        session.import_files(
            "tracker",
            [path, tmp_path / "poses.csv"],
            tmp_path / "c",
            machine="linear_delta",
        )


def test_columns_by_a_map_that_is_kept(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(
        "# made by hand\nname|X set|Y set|Z set|touch|remark\n"
        "1|0|0|10|0,02|good\n2|50|0|10||\n3|0|50|10|-0,01|fine\n"
    )
    (tmp_path / "m.toml").write_text(
        'machine = "linear_delta"\ninstrument = "height_probe"\n[columns]\n'
        'x_mm = "X set"\ny_mm = "Y set"\nz_mm = "Z set"\nheight_mm = "touch"\n'
    )
    given = (tmp_path / "m.toml").read_text()
    (tmp_path / "typo.toml").write_text(given.replace("x_mm", "xx_mm"))
    with pytest.raises(
        InputError, match=r"columns\.xx_mm: no column of readings.*x_mm"
    ):
        session.import_files(
            "columns", [tmp_path / "a.csv"], tmp_path, column_map=tmp_path / "typo.toml"
        )
    study, imported = session.import_files(
        "columns", [tmp_path / "a.csv"], tmp_path, column_map=tmp_path / "m.toml"
    )
    assert "Not used: name, remark." in imported.statements
    assert [row["height_mm"] for row in imported.rows] == ["0.02", "", "-0.01"]
    readings = oed.read_readings(oed.load_study(study))
    assert readings.state.readings is not None
    np.testing.assert_allclose(readings.state.readings.y, [2e-5, -1e-5])


LARGE = (1200.0, [2600.0] * 3, np.radians([210.0, 330.0, 90.0]), [1900.0] * 3)
LARGE_MAP = """\
[machine]
model = "delta"

[machine.geometry]
radius_mm = 1200
arm_mm = 2600
endstop_mm = 1900
"""
LARGE_STUDY = (
    'schema = 1\nname = "large"\n'
    + LARGE_MAP
    + """
[[setup]]
name = "tracker"
instrument = "pose_tracker_position"
"""
)


def write_large_points(path: Path, noise: np.ndarray) -> None:
    """Points of a delta of 1.2 m with endstops 1 mm off, in a frame of their own."""
    grid = np.meshgrid([-500.0, 0.0, 500.0], [-500.0, 0.0, 500.0], [100.0, 600.0])
    commanded = np.column_stack([axis.ravel() for axis in grid])
    true = (*LARGE[:3], [1901.0, 1900.0, 1899.0])
    points = nozzle(travel_to(commanded, *LARGE), *true)
    turned = Rotation.from_euler("zyx", [130.0, 4.0, -7.0], degrees=True)
    seen = turned.apply(points) + np.array([4210.0, -1533.0, 612.0]) + noise
    rows = np.hstack([commanded, seen])
    lines = [",".join(f"{v:.6f}" for v in row) for row in rows]
    path.write_text("\n".join(["x_mm,y_mm,z_mm,X,Y,Z", *lines]))


@pytest.mark.parametrize("by_map", [True, False])
def test_points_of_a_machine_of_any_size(
    by_map: bool, tmp_path: Path, rng: np.random.Generator
) -> None:
    """The map has the machine's table, or --machine a study with it."""
    path = tmp_path / "points.csv"
    write_large_points(path, 0.01 * rng.standard_normal((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP)
    (tmp_path / "large.study.toml").write_text(LARGE_STUDY)
    study, imported = session.import_files(
        "tracker",
        [path],
        tmp_path / "out",
        machine=None if by_map else str(tmp_path / "large.study.toml"),
        column_map=tmp_path / "m.toml" if by_map else None,
    )
    loaded = oed.load_study(study)
    assert loaded.machine.geometry["arm_mm"] == 2600
    assert loaded.prediction.reference == "best_fit"  # the machine's place is unknown
    estimate = oed.identify(oed.read_readings(loaded)).section
    assert max(estimate.rms_after.values()) < 20.0  # um
    # the map that was written is complete
    kept = tmp_path / "out" / "points.map.toml"
    again = session.import_files("tracker", [path], tmp_path / "b", column_map=kept)[1]
    assert again.rows == imported.rows


@pytest.mark.parametrize(
    ("registration", "words", "tolerance", "errors"),
    [
        ("free", "free within 10 mm and 20 mrad", 10.0, "best_fit"),
        ("best_fit", "held there", 0.0, "best_fit"),
        ("known", "taken to be in the machine's frame", 0.0, "home"),
    ],
)
def test_a_frame_is_free_held_or_known(
    registration: str, words: str, tolerance: float, errors: str, tmp_path: Path
) -> None:
    path = tmp_path / "points.csv"
    write_large_points(path, np.zeros((18, 3)))
    text = f'registration = "{registration}"\n' + LARGE_MAP
    (tmp_path / "m.toml").write_text(text)
    study, imported = session.import_files(
        "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
    )
    assert any(words in sentence for sentence in imported.statements)
    loaded = oed.load_study(study)
    assert loaded.setup[0].tolerance["shift_z_mm"] == tolerance
    assert loaded.prediction.reference == errors
    measured = [[float(row[f"read_{a}_mm"]) for a in "xyz"] for row in imported.rows]
    moved = np.abs(np.array(measured) - _commanded(imported.rows)).max()
    assert (moved > 1000.0) == (registration == "known")  # mm


def _commanded(rows: Sequence[Mapping[str, str]]) -> np.ndarray:
    return np.array([[float(row[f"{a}_mm"]) for a in "xyz"] for row in rows])


@pytest.mark.parametrize(
    ("noise", "code", "words"),
    [(0.03, 0, "the noise was understated"), (0.5, 1, "The fit is bad")],
)
def test_a_tracker_noisier_than_its_data_sheet(
    noise: float,
    code: int,
    words: str,
    tmp_path: Path,
    rng: np.random.Generator,
    capsys: pytest.CaptureFixture[str],
) -> None:
    """The importer states 10 um as a guess: more is estimated, far more is refused."""
    path = tmp_path / "points.csv"
    write_large_points(path, noise * rng.standard_normal((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP)
    study, _ = session.import_files(
        "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
    )
    readings = tmp_path / "out" / "points.readings.csv"
    assert main(["check", str(study), str(readings)]) == code
    assert words in "".join(capsys.readouterr())


def test_a_machine_table_that_does_not_fit_names_its_field(tmp_path: Path) -> None:
    path = tmp_path / "points.csv"
    write_large_points(path, np.zeros((18, 3)))
    (tmp_path / "m.toml").write_text(LARGE_MAP.replace("arm_mm", "arms_mm"))
    with pytest.raises(
        InputError, match=r"m\.toml: machine\.geometry\.arms_mm.*arm_mm"
    ):
        session.import_files(
            "tracker", [path], tmp_path / "out", column_map=tmp_path / "m.toml"
        )


CABLES_MAP = """\
instrument = "redundancy"
[machine]
model = "cables_planar"
[machine.geometry]
anchor_mm = [[-1000, -800], [1000, -800], [1000, 800], [-1000, 800]]
tolerance_mm = 5
[noise]
gap1_um = 50
gap2_um = 50
[columns]
q1_mm = "A"
q2_mm = "B"
q3_mm = "C"
q4_mm = "D"
"""


def test_cable_lengths_alone_come_in(tmp_path: Path, rng: np.random.Generator) -> None:
    """Recorded joints of a machine with two spare ones are its readings."""
    robot = planar_cables.drawn(rng)
    wanted = rng.uniform(-0.5, 0.5, (30, 2))
    noise = np.full(4, 1e-4)
    drums = 1e3 * planar_cables.recorded(robot, wanted, noise, rng)
    lines = [",".join(f"{v:.6f}" for v in row) for row in drums]
    (tmp_path / "l.csv").write_text("\n".join(["A,B,C,D", *lines]))
    (tmp_path / "m.toml").write_text(CABLES_MAP)
    study, imported = session.import_files(
        "columns", [tmp_path / "l.csv"], tmp_path, column_map=tmp_path / "m.toml"
    )
    assert "The readings are 0: the machine's closure." in imported.statements
    loaded = oed.load_study(study)
    assert loaded.prediction.reference == "best_fit"
    after = oed.identify(oed.read_readings(loaded)).section.rms_after
    assert sorted(after) == ["gap1", "gap2"]
    assert max(after.values()) < 100.0  # um: half the drums' noise
    wrong = CABLES_MAP.replace("gap1_um", "gap_um")
    (tmp_path / "m.toml").write_text(wrong)
    with pytest.raises(InputError, match=r"noise\.gap_um.*gap1_mm"):
        session.import_files(
            "columns",
            [tmp_path / "l.csv"],
            tmp_path / "b",
            column_map=tmp_path / "m.toml",
        )


def test_channels_that_were_not_read_are_left_out(tmp_path: Path) -> None:
    """A camera that looks from above reads x and y; z is missing, not 0."""
    (tmp_path / "c.csv").write_text(
        "x_mm,y_mm,z_mm,read_x_mm,read_y_mm\n0,0,10,0.1,0.0\n50,0,10,50.1,0.1\n"
    )
    (tmp_path / "m.toml").write_text('machine = "linear_delta"\ninstrument = "camera"')
    study, imported = session.import_files(
        "columns", [tmp_path / "c.csv"], tmp_path, column_map=tmp_path / "m.toml"
    )
    assert "Not read: read_z; these channels count nothing." in imported.statements
    (setup,) = oed.load_study(study).setup
    assert setup.channels == ["read_x", "read_y"]
    readings = oed.read_readings(oed.load_study(study)).state.readings
    assert readings is not None
    assert readings.y.size == 4


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("angle;deviation\n1;2\n2;3;4\n", "line 3: 3 cells"),
        ("angle;deviation\n1;2\n2;far\n3;4\n4;5\n", "line 3, column deviation = far"),
        ("angle;deviation\n1;2\n2;99000\n3;4\n4;5\n", "more than 5 % of the radius"),
        ("angle;angle\n1;2\n2;3\n", "two columns of this name"),
        ("angle;error 1;error 2\n1;2;3\n2;3;4\n", "two columns of deviations"),
        ("angle;deviation\n1;2\nlow;lower\n3;4\n4;5\n", "line 3, column angle"),
        ("nothing here\n", "no line of numbers"),
        ("angle;radius\n1;2\n2;3\n", "no column for deviation"),
        ("angle;deviation\n1;2\n2;3\n", "the run from here has 2 points"),
    ],
)
def test_bad_traces_name_line_and_remedy(text: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "my.toml").write_text(MAP)
    with pytest.raises(InputError) as raised:
        session.import_files(
            "ballbar",
            [tmp_path / "a.csv"],
            tmp_path / "out",
            column_map=tmp_path / "my.toml",
        )
    assert words in str(raised.value)


@pytest.mark.parametrize(
    ("text", "header"),
    [
        ("a,b\n1,2\n3,4\n", ("a", "b")),
        ("a\tb\n1\t2\n3\t4\n", ("a", "b")),
        ("1 2.5\n3 4\n", ("1", "2")),
        ("Test 5\n\na; b\n1,5;2\n3;4\n", ("a", "b")),
        ("Machine,M\nFeed,1500\n\na,b\n1,2\n3,4\n", ("a", "b")),
        ("a,b\n1,2\na,b\n3,4\n", ("a", "b")),
    ],
)
def test_tables_of_any_separator(
    text: str, header: tuple[str, ...], tmp_path: Path
) -> None:
    (tmp_path / "t.csv").write_text(text)
    table = csv_table.read(tmp_path / "t.csv")
    assert table.header == header
    assert len(table) == 2
    assert table.numbers(header[1])[1] == 4.0
