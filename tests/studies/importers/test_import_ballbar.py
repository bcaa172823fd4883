"""`oed import` of ball-bar traces, against the oracle of the delta."""

from pathlib import Path

import numpy as np
import pytest
from oracles.delta_trilateration import nozzle, travel_to

import oed
from pkm_studies.base import InputError
from pkm_studies.importers import ImportedSession, ballbar, import_files

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


def test_a_trace_of_4000_points_both_ways(tmp_path, rng):
    forward, backward = trace(rng, 1, 0.9), trace(rng, -1, 0.9)
    backward[:, 0] += 360.0
    path = write_trace(tmp_path / "bar.csv", [forward, backward])
    (tmp_path / "my.toml").write_text(MAP)
    study, imported = import_files(
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
    again = import_files(
        "ballbar", [path], tmp_path / "b", column_map=tmp_path / "out" / "bar.map.toml"
    )
    assert again[1].rows == imported.rows  # the map that was written is complete


HIGH = np.array([0.0, 10.0, 160.0])
PLANE_AXES = {"xy": (0, 1), "yz": (1, 2), "zx": (2, 0)}


def circle_trace(
    rng: np.random.Generator,
    centre: np.ndarray,
    plane: str,
    sense: int,
    cup: np.ndarray,
) -> np.ndarray:
    """Angle in deg and deviation in um of 600 points; the bar is as long as nominal."""
    degrees = np.linspace(0.0, 360.0, 600)[::sense]
    points = np.zeros((600, 3))
    first, second = PLANE_AXES[plane]
    points[:, first], points[:, second] = (
        RADIUS * f(np.radians(degrees)) for f in (np.cos, np.sin)
    )
    nominal = np.linalg.norm(centre + points - cup, axis=1)
    tool = true_points(centre + points)
    deviation = 1000.0 * (np.linalg.norm(tool - cup, axis=1) - nominal[0])
    return np.column_stack([degrees, deviation + 0.3 * rng.standard_normal(600)])


CIRCLES = """\
machine = "linear_delta"
[[circles]]
files = ["ccw.csv", "cw.csv"]
centre_mm = [0, 10, 60]
radius_mm = 100
[[circles]]
files = ["vertical.csv"]
runs = [1]
centre_mm = [0, 10, 160]
radius_mm = 100
plane = "zx"
[[circles]]
files = ["vertical.csv"]
runs = [2]
centre_mm = [0, 10, 160]
radius_mm = 100
plane = "yz"
"""


@pytest.fixture
def circles(tmp_path: Path, rng: np.random.Generator) -> list[Path]:
    """A circle both ways in two files, and two circles about one cup in a third."""
    low = CENTRE
    vertical = [
        circle_trace(rng, HIGH, "zx", 1, HIGH),
        circle_trace(rng, HIGH, "yz", -1, HIGH),
    ]
    return [
        write_trace(tmp_path / "ccw.csv", [circle_trace(rng, low, "xy", 1, low)]),
        write_trace(tmp_path / "cw.csv", [circle_trace(rng, low, "xy", -1, low)]),
        write_trace(tmp_path / "vertical.csv", vertical),
    ]


def _import_circles(
    tmp_path: Path, paths: list[Path], text: str, out: str = "out"
) -> tuple[Path, ImportedSession]:
    (tmp_path / "my.toml").write_text(text)
    return import_files(
        "ballbar", paths, tmp_path / out, column_map=tmp_path / "my.toml"
    )


def test_several_circles_each_have_their_centre_and_plane(tmp_path, circles):
    study, imported = _import_circles(tmp_path, circles, CIRCLES)
    runs = {row["run"]: row["setup"] for row in imported.rows}
    assert runs == {
        "circle 1 ccw": "setup1",
        "circle 2 cw": "setup1",
        "circle 3 ccw": "setup2",  # about one cup: one set-up
        "circle 4 cw": "setup2",
    }
    axes = {"1": (2, CENTRE), "3": (1, HIGH), "4": (0, HIGH)}
    for number, (normal, centre) in axes.items():
        rows = [r for r in imported.rows if r["run"].startswith(f"circle {number} ")]
        at = np.array([[float(r[f"{n}_mm"]) for n in "xyz"] for r in rows]) - centre
        assert np.abs(at[:, normal]).max() < 1e-6
        assert np.linalg.norm(at, axis=1) == pytest.approx(RADIUS, abs=1e-6)
    estimate = oed.identify(oed.read_readings(oed.load_study(study))).section
    assert estimate.readings == len(imported.rows)
    # the noise of the means is far below the errors of the machine
    assert estimate.rms_before["length"] > 20.0 * estimate.rms_after["length"]
    assert estimate.rms_after["length"] < 0.3
    kept = tmp_path / "out" / "ccw.map.toml"
    again = _import_circles(tmp_path, circles, kept.read_text(), "again")
    assert again[1].rows == imported.rows  # the map that was written is complete


def test_circles_without_names_of_files_are_one_in_each(tmp_path, circles):
    table = "[[circles]]\ncentre_mm = [0, 10, 60]\nradius_mm = 100\n"
    text = f'machine = "linear_delta"\n{table}setup = "a"\n{table}setup = "b"\n'
    _, imported = _import_circles(tmp_path, circles[:2], text)
    assert {row["setup"] for row in imported.rows} == {"a", "b"}


@pytest.mark.parametrize(
    ("old", "new", "words"),
    [
        ('"cw.csv"', '"other.csv"', "this file is not imported"),
        (', "cw.csv"', "", "cw.csv belongs to no circle"),
        ("runs = [2]", "runs = [3]", "vertical.csv has no such run"),
        ("runs = [2]", "", "run 1 of vertical.csv belongs to another circle"),
        ('plane = "yz"', 'plane = "yz"\nsetup = "setup1"', "its cup or bar elsewhere"),
        ('files = ["ccw.csv", "cw.csv"]\n', "", "3 circles are in 3 files"),
        ("[[circles]]", "[circle]\ncentre_mm = [0, 0, 0]\nradius_mm = 9\n[[circles]]", "as well")
    ],
)  # fmt: skip
def test_runs_that_belong_to_no_circle_or_two_are_refused(
    tmp_path, circles, old, new, words
):
    text = CIRCLES.replace(old, new, 1)
    assert text != CIRCLES
    with pytest.raises(InputError) as raised:
        _import_circles(tmp_path, circles, text)
    assert words in str(raised.value)


def test_a_run_of_a_file_must_not_be_forgotten(tmp_path, circles):
    with pytest.raises(InputError, match=r"run 2 of .* belongs to no circle"):
        _import_circles(tmp_path, circles, CIRCLES[: CIRCLES.rindex("[[circles]]")])


def test_means_have_the_noise_that_correlation_leaves(rng):
    """AR(1) by its closed form: variance and lag-one covariance of block means."""
    rho, block, spread = 0.9, 20, []
    for _ in range(40):
        noise = trace(rng, 1, rho)
        residual = noise[:, 1] - trace(rng, 1, 0.0)[:, 1]  # no geometry; white added
        thinned = ballbar.thin(
            np.radians(noise[:, 0]), 1e-6 * residual, np.zeros(2000), 100
        )
        assert thinned.block == block
        spread.append(thinned.sigma)
    lags = np.arange(1, block)
    mean = (1.0 + 2.0 * np.sum((1.0 - lags / block) * rho**lags)) / block
    wanted = 1e-6 * np.sqrt(mean + 1.0 / block)
    # slow noise is partly taken for harmonics, so a little less is left
    assert 0.8 * wanted < np.mean(spread) < 1.02 * wanted
    # not that of white noise
    assert np.mean(spread) > 1.5 * 1e-6 * np.sqrt(2.0 / block)


@pytest.mark.parametrize(("text", "words"), [
    ("angle;deviation\n1;2\n2;3;4\n", "line 3: 3 cells"),
    ("angle;deviation\n1;2\n2;far\n3;4\n4;5\n", "line 3, column deviation = far"),
    ("angle;deviation\n1;2\n2;99000\n3;4\n4;5\n", "more than 5 % of the radius"),
    ("angle;angle\n1;2\n2;3\n", "two columns of this name"),
    ("angle;error 1;error 2\n1;2;3\n2;3;4\n", "two columns of deviations"),
    ("angle;deviation\n1;2\nlow;lower\n3;4\n4;5\n", "line 3, column angle"),
    ("nothing here\n", "no line of numbers"),
    ("angle;radius\n1;2\n2;3\n", "no column for deviation"),
    ("angle;deviation\n1;2\n2;3\n", "the run from here has 2 points"),
])  # fmt: skip
def test_bad_traces_name_line_and_remedy(text, words, tmp_path):
    (tmp_path / "a.csv").write_text(text)
    (tmp_path / "my.toml").write_text(MAP)
    with pytest.raises(InputError) as raised:
        import_files(
            "ballbar",
            [tmp_path / "a.csv"],
            tmp_path / "out",
            column_map=tmp_path / "my.toml",
        )
    assert words in str(raised.value)
