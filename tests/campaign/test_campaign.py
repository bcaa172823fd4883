"""Campaigns: every combination and seed once, resumed where they were interrupted."""

import csv
import json
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import sample

from oed import compensate
from oed.mechanism import pose_error
from pkm_campaign import report, runner, tables
from pkm_studies.base import InputError
from pkm_studies.commands import main

STUDY = sample.changed(
    sample.STUDY,
    (
        "[report]",
        "[prediction]\nz_mm = [1166.0]\npsi_deg = [0.0, 120.0]\ntheta_deg = [20.0]\n\n[report]",
    ),
)
CAMPAIGN = """\
schema = 1
name = "small_campaign"
study = "small.study.toml"
seeds = 3

[vary]
"noise.length_um" = [0.5, 2.0]
"setup.cup.length_mm" = [300.0, 302.0]
"""


@pytest.fixture
def campaign(tmp_path: Path) -> Path:
    (tmp_path / "small.study.toml").write_text(STUDY, encoding="utf-8")
    path = tmp_path / "small.campaign.toml"
    path.write_text(CAMPAIGN, encoding="utf-8")
    return path


def run(path: Path, out: Path, *options: str) -> int:
    return main(
        [
            "campaign", str(path), "--out", str(out), "--workers", "1", "--quiet",
            *options,
        ]
    )  # fmt: skip


def assert_refused(
    path: Path, out: Path, words: str, capsys: pytest.CaptureFixture[str]
) -> None:
    """A campaign ends with exit code 2 and these words, without a traceback."""
    assert run(path, out) == 2
    error = capsys.readouterr().err
    assert words in error
    assert "Traceback" not in error


@pytest.mark.slow
def test_a_campaign_interrupted_ends_as_an_unbroken_one(campaign, tmp_path, capsys):
    whole, broken = tmp_path / "whole", tmp_path / "broken"
    assert run(campaign, whole) == 0
    printed = capsys.readouterr().out
    assert "12 virtual machines in 4 combinations; 0 could not be fitted." in printed
    loaded = tables.load_campaign(campaign)

    def stop(share: float) -> None:
        if share > 0.5:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        runner.run_cases(loaded, broken, workers=1, progress=stop)
    there = [path for path in runner.case_paths(loaded, broken) if path.is_file()]
    assert 0 < len(there) < 12
    times = {path: path.stat().st_mtime_ns for path in there}
    assert run(campaign, broken) == 0
    assert times == {path: path.stat().st_mtime_ns for path in there}
    for name in ("cases.csv", "report.html"):
        assert (whole / name).read_bytes() == (broken / name).read_bytes()
    table = pd.read_parquet(whole / "cases.parquet")
    assert len(table) == 12
    assert len(table.drop_duplicates()) == 12
    assert (table["seed"].to_numpy() == np.tile([1, 2, 3], 4)).all()
    # Four times the noise: the truth is that of the same seed, the error is not.
    quiet = table[table["noise.length_um"] == 0.5]["predicted_z_um"].mean()
    noisy = table[table["noise.length_um"] == 2.0]["predicted_z_um"].mean()
    assert quiet < noisy


@pytest.mark.slow
def test_the_realised_error_is_that_of_the_compensated_machine(campaign, tmp_path):
    """One case again, step by step, by the notebook's functions."""
    import oed

    campaign.write_text(sample.changed(CAMPAIGN, ("seeds = 3", "seeds = 1")), "utf-8")
    loaded = tables.load_campaign(campaign)
    runner.run_cases(loaded, tmp_path / "out", workers=1)
    row = report.read_table(loaded, tmp_path / "out").iloc[0]
    study = loaded.study_with(loaded.settings()[0])
    design = oed.choose_design(study)
    state = design.state.replace(seed=int(row["seed"]))
    estimate = oed.identify(oed.simulate(type(design)(state))).state.estimate
    readings = oed.simulate(type(design)(state)).state.readings
    assert row["chi2"] == pytest.approx(estimate.chi2, rel=1e-9)
    measurement, command = state.measurement, state.resolved.prediction.command
    kinematics, count = measurement.kinematics, len(measurement.machine.parameters)
    home = measurement.machine.home_command[None]
    z = []
    for at in (*command[:, None], home):
        q = compensate.compensated_joints(kinematics, at, estimate.theta[:count])
        z.append(pose_error(kinematics, at, q, readings.truth[:count])[0, 2])
    expected = 1e6 * np.sqrt(np.mean((np.array(z[:-1]) - z[-1]) ** 2))
    assert row["realised_z_um"] == pytest.approx(expected, rel=1e-6)


def test_a_summary_counts_failures_and_means(campaign):
    loaded = tables.load_campaign(campaign)
    rows = []
    for setting in loaded.settings():
        cells = {
            k: json.dumps(v) if isinstance(v, list) else v for k, v in setting.items()
        }
        for seed, inside in ((1, 0.9), (2, 1.0), (3, np.nan)):
            failed = np.isnan(inside)
            figures = {"inside_95": inside, "nees": inside, "p_value": 0.5}
            figures["trusted"] = inside > 0.9
            figures |= {"predicted_z_um": 3.0, "realised_z_um": 4.0}
            row = {k: np.nan if failed else v for k, v in figures.items()}
            rows.append({**cells, "seed": seed, "error": "no" if failed else "", **row})
    summary = report.summarise(loaded, pd.DataFrame(rows))
    assert len(summary) == 4
    first = summary.iloc[0]
    assert (first["cases"], first["failed"]) == (3, 1)
    assert first["inside_95"] == pytest.approx(0.95)
    assert first["inside_95_low"] == pytest.approx(0.95 - 1.959964 * 0.05)
    assert first["inside_95_high"] == 1.0
    assert first["realised_z_um"] == pytest.approx(4.0)
    assert first["not_trusted"] == pytest.approx(0.5)


@pytest.mark.parametrize(("old", "new", "words"), [
    ('"noise.length_um"', '"noise.lenght_um"', "lenght_um"),
    ("setup.cup.length", "setup.cap.length", "no entry 'cap'"),
    ("[0.5, 2.0]", "[]", "no values"),
    ("[0.5, 2.0]", "[0.5, -2.0]", "length_um"),
    ("seeds = 3", "seeds = 0", "seeds"),
    ("seeds = 3", "seeds = 900000", "stay below"),
    ("small.study.toml", "none.study.toml", "none.study.toml"),
    ("schema = 1", "schema = 2", "unknown version"),
    ("[vary]", "[vary", "no TOML"),
])  # fmt: skip
def test_bad_campaigns_are_refused_by_field(
    campaign, tmp_path, capsys, old, new, words
):
    campaign.write_text(sample.changed(CAMPAIGN, (old, new)), encoding="utf-8")
    assert_refused(campaign, tmp_path / "out", words, capsys)
    assert not (tmp_path / "out").exists()


FUNCTION = """\
import numpy as np

def figures(setting, seed):
    if setting["case"] == "bug" and seed == 3:
        raise KeyError("nothing there")
    if setting["case"] == "singular" and seed == 3:
        raise np.linalg.LinAlgError("singular")
    if setting["case"] == "taken":
        return {"seed": 1}
    rng = np.random.default_rng([setting["stream"], seed])
    return {"value": rng.normal(), "positive": np.True_, "text": "abc"}

def spread(cases, setting):
    return {"sd": float(cases["value"].std()), "case of": setting["case"]}
"""
OWN = """\
schema = 1
name = "own"
case = "own.py:figures"
seeds = 6
first_seed = 2

[vary]
case = ["plain", "singular"]
stream = [4]
"""


@pytest.fixture
def own(tmp_path: Path) -> Path:
    """A campaign whose cases are those of a function."""
    (tmp_path / "own.py").write_text(FUNCTION, encoding="utf-8")
    path = tmp_path / "own.campaign.toml"
    path.write_text(OWN, encoding="utf-8")
    return path


def test_cases_of_a_function_have_their_rows_and_means(own, tmp_path, capsys):
    out = tmp_path / "out"
    assert run(own, out) == 0
    assert "12 cases in 2 combinations; 1 failed." in capsys.readouterr().out
    table = pd.read_parquet(out / "cases.parquet")
    values = [np.random.default_rng([4, seed]).normal() for seed in range(2, 8)]
    plain = table[table["case"] == "plain"]
    assert plain["seed"].to_list() == [2, 3, 4, 5, 6, 7]
    np.testing.assert_allclose(plain["value"], values)
    failed = table[table["error"] != ""]
    assert failed[["case", "seed", "error"]].to_numpy().tolist() == [
        ["singular", 3, "singular"]
    ]
    summary = pd.read_csv(out / "summary.csv")
    assert summary["failed"].to_list() == [0, 1]
    half = 1.959964 * np.std(values, ddof=1) / np.sqrt(6)
    assert summary["value"][0] == pytest.approx(np.mean(values))
    assert summary["value_low"][0] == pytest.approx(np.mean(values) - half)
    assert summary["positive"][0] == 1.0
    # The first seeds only, from what is there already.
    assert run(own, out, "--seeds", "2") == 0
    assert len(pd.read_csv(out / "cases.csv")) == 4
    assert run(own, out, "--seeds", "7") == 2
    assert "--seeds 7" in capsys.readouterr().err


def test_a_summary_of_a_user_s_own(own, tmp_path):
    text = sample.changed(OWN, ("seeds = 6", 'summary = "own.py:spread"\nseeds = 6'))
    own.write_text(text, encoding="utf-8")
    assert run(own, tmp_path / "out") == 0
    summary = pd.read_csv(tmp_path / "out" / "summary.csv")
    assert summary["case of"].to_list() == ["plain", "singular"]
    values = [np.random.default_rng([4, seed]).normal() for seed in range(2, 8)]
    assert summary["sd"][0] == pytest.approx(np.std(values, ddof=1))


@pytest.mark.parametrize(("old", "new", "words"), [
    ("own.py:figures", "own.py:figure", "did you mean figures"),
    ("own.py:figures", "other.py:figures", "no such file"),
    ("own.py:figures", "no_such_module:figures", "belongs to no installed"),
    ("own.py:figures", "own.py", "names no function"),
    ("seeds = 6", 'study = "a3_ball_bar"\nseeds = 6', "one of them"),
    ('case = "own.py:figures"\n', "", "one of them"),
    ("seeds = 6", "diagnose = true\nseeds = 6", "only machines of a study"),
    ("stream = [4]", "seed = [4]", "names another column"),
    ('"singular"', '"bug"', "case = 'bug', stream = 4, seed = 3"),
    ('"singular"', '"taken"', "'seed', which names another column"),
])  # fmt: skip
def test_bad_case_functions_are_refused(own, tmp_path, capsys, old, new, words):
    own.write_text(sample.changed(OWN, (old, new)), encoding="utf-8")
    assert_refused(own, tmp_path / "out", words, capsys)


@pytest.mark.parametrize("content", [
    b"", b'{"case": "plain", "str', b"[1]", b"\xff\xfe", b"{}", b'{"seed": 3}', "other",
])  # fmt: skip
def test_a_broken_case_is_set_aside_and_computed_again(own, tmp_path, capsys, content):
    out = tmp_path / "out"
    assert run(own, out) == 0
    whole = (out / "cases.csv").read_bytes()
    path = out / "cases" / "0001-000003.json"
    other = path.with_name("0001-000004.json").read_bytes()
    broken = other if isinstance(content, str) else content
    path.write_bytes(broken)
    capsys.readouterr()
    assert run(own, out) == 0
    printed = capsys.readouterr().out
    assert f"Warning: {path} is no whole case: it is now 0001-000003-broken.json" in (
        printed
    )
    assert (out / "cases" / "0001-000003-broken.json").read_bytes() == broken
    assert (out / "cases.csv").read_bytes() == whole
    assert run(own, out) == 0
    assert "no whole case" not in capsys.readouterr().out


def test_no_text_of_a_case_is_a_formula(own, tmp_path):
    """A spreadsheet would evaluate it; Parquet keeps it as it is."""
    changes = (
        ('["plain", "singular"]', '["=cmd()"]'),
        ("stream = [4]", '"@field" = ["+x"]'),
    )
    own.write_text(sample.changed(OWN, *changes), encoding="utf-8")
    function = "def figures(setting, seed):\n    return {'=f()': '-text', 'n': -1.5}\n"
    (own.parent / "own.py").write_text(function, encoding="utf-8")
    out = tmp_path / "out"
    assert run(own, out) == 0
    for name in ("cases.csv", "summary.csv"):
        header, row, *_ = csv.reader(
            (out / name).read_text(encoding="utf-8").splitlines()
        )
        for cell in (*header, *row):
            assert not cell.startswith(("=", "@", "+")), cell
    assert "-1.5" in row or "-1.5" in (out / "cases.csv").read_text()
    table = pd.read_parquet(out / "cases.parquet")
    assert table["case"].to_list() == ["=cmd()"] * 6
    assert "'-text" in (out / "cases.csv").read_text()


def test_a_failure_in_another_process_is_the_user_s_too(own, tmp_path, capsys):
    own.write_text(sample.changed(OWN, ('"singular"', '"bug"')), encoding="utf-8")
    assert run(own, tmp_path / "out", "--workers", "2") == 2
    assert "KeyError" in capsys.readouterr().err


def test_a_folder_of_another_campaign_is_left_alone(own, tmp_path):
    loaded = tables.load_campaign(own)
    out = tmp_path / "out"
    runner.run_cases(loaded, out, workers=1)
    before = {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}
    own.write_text(sample.changed(OWN, ("[4]", "[5]")), encoding="utf-8")
    with pytest.raises(InputError, match="another campaign"):
        runner.run_cases(tables.load_campaign(own), out, workers=1)
    assert before == {p: p.read_bytes() for p in sorted(out.rglob("*")) if p.is_file()}


def test_a_scheduler_that_is_not_there_is_said(campaign, tmp_path, capsys):
    assert run(campaign, tmp_path / "out", "--scheduler", "no address") == 2
    assert "--scheduler" in capsys.readouterr().err


@pytest.mark.slow
def test_processes_and_a_cluster_give_the_same_table(campaign, tmp_path):
    import distributed  # takes a second to import

    loaded = tables.load_campaign(campaign)
    runner.run_cases(loaded, tmp_path / "one", workers=1)
    runner.run_cases(loaded, tmp_path / "two", workers=2)
    with distributed.LocalCluster(
        n_workers=2, threads_per_worker=1, dashboard_address=None
    ) as cluster:
        address = cluster.scheduler_address
        runner.run_cases(loaded, tmp_path / "dask", workers=1, scheduler=address)
    one, two, dask = (
        report.read_table(loaded, tmp_path / name) for name in ("one", "two", "dask")
    )
    pd.testing.assert_frame_equal(one, two)
    pd.testing.assert_frame_equal(one, dask)
