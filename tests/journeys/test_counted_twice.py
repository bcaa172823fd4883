"""A session's readings count once, in whatever order and file they come again."""

import json
from collections.abc import Callable
from pathlib import Path

import pandas as pd
import pytest

Run = Callable[..., tuple[int, str, str]]

STUDY = """\
schema = 1
name = "counted"
seed = {seed}
[machine]
model = "planar_2dof"
[[setup]]
name = "tracker"
instrument = "camera"
channels = ["read_y", "read_z"]
{prior}
[identify]
effects = "none"
[posterior]
enabled = false
[report]
html = false
pdf = false
[readings]
simulate = true
[design]
[[design.reference]]
name = "grid"
setup = "tracker"
y_mm = [-1200.0, -400.0, 400.0, 1200.0]
z_mm = [100.0, 700.0, 1400.0]
"""


def study(folder: Path, seed: int, prior: str = "") -> Path:
    path = folder / f"s{seed}{'p' if prior else ''}.study.toml"
    path.write_text(STUDY.format(seed=seed, prior=prior))
    return path


@pytest.fixture
def session(tmp_path: Path, oed: Run, own_folder: None) -> Path:
    """A folder with the result of a first session, and the readings of two."""
    for seed in (1, 2):
        code, _, error = oed(
            "simulate", study(tmp_path, seed), "--out", f"r{seed}.readings.csv"
        )
        assert code == 0, error
    first = ("--readings", "r1.readings.csv", "--out", "first", "--quiet")
    assert oed("identify", study(tmp_path, 1), *first)[0] == 0
    return tmp_path


def variants(folder: Path) -> list[str]:
    """Files with the first session's readings in another guise."""
    one, two = (pd.read_csv(folder / f"r{k}.readings.csv") for k in (1, 2))
    turned = one.iloc[::-1, ::-1].assign(remark="again", run="other", time_s=0.0)
    turned["time_s"] = range(len(turned))
    turned["order"] = range(1, len(turned) + 1)
    inches = one.copy()
    for name in [c for c in one.columns if c.startswith("read_")]:
        inches[name.replace("_mm", "_in")] = inches.pop(name) / 25.4
    both = pd.concat([one.assign(run="a"), two.assign(run="b")])
    tables = {"turned": turned, "part": one.head(6), "both": both}
    if list(inches.columns) != list(one.columns):
        tables["inches"] = inches
    for name, table in tables.items():
        table.to_csv(folder / f"{name}.readings.csv", index=False, float_format="%.12g")
    return [f"{name}.readings.csv" for name in tables]


def test_the_prior_has_the_readings_already(session, oed):
    again = study(session, 2, '[prior]\nearlier = "first"')
    for name in variants(session):
        for command in ("identify", "diagnose"):
            line = (command, again, "--readings", name, "--out", "again", "--quiet")
            code, _, error = oed(*line)
            assert (code, "would count twice" in error) == (2, True), (name, error)
            assert "prior.earlier" in error
    line = ("--readings", "r2.readings.csv", "--out", "second", "--quiet")
    assert oed("identify", again, *line)[0] == 0
    known = [
        json.loads((session / name / "result.json").read_text())["readings"]
        for name in ("first", "second")
    ]
    assert len(known[0]) == 12 * 2
    assert set(known[0]) < set(known[1])
    # the first session is behind the second one's prior
    third = study(session, 3, '[prior]\nearlier = "second"')
    line = ("--readings", "r1.readings.csv", "--out", "third", "--quiet")
    code, _, error = oed("identify", third, *line)
    assert (code, "would count twice" in error) == (2, True), error


def test_a_diagnosis_after_another(session, oed):
    given = ("diagnose", study(session, 1), "--quiet", "--readings")
    assert oed(*given, "r1.readings.csv", "--out", "d1")[0] == 0
    for name in variants(session):
        code, _, error = oed(*given, name, "--after", "d1", "--out", "d2")
        assert (code, "would count twice" in error) == (2, True), (name, error)
