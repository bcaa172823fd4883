"""`oed adjust`: the search against all lists, files, refusals, and the way to a controller."""

import contextlib
import csv
import io
import itertools
import json
import shutil
import tomllib
from pathlib import Path

import numpy as np
import pytest
import sample
import xarray as xr

from oed.adjustment import StepProblem, choose_steps, sizes_without
from pkm_studies.commands import main
from pkm_studies.resolve import study_machine
from pkm_studies.study import Study

STUDIES = Path(__file__).resolve().parents[3] / "studies"
QUICK = "[report]\nhtml = false\npdf = false\n\n[expect]"


def problem(rng: np.random.Generator, step: float, most: float) -> StepProblem:
    slopes = rng.standard_normal((30, 5)) @ np.diag([1.0, 1.0, 0.5, 0.2, 0.02])
    slopes[:, 1] = slopes[:, 0] + 0.3 * slopes[:, 1]  # nearly alike
    known = slopes @ np.array([3.0, -2.0, 1.0, 0.0, 1.0])
    known += 0.3 * rng.standard_normal(30)
    return StepProblem(
        errors=known,
        gradients=slopes,
        floor=0.1,
        scatter=np.full(5, 1e-3),
        step=np.full(5, step),
        most=np.full(5, most),
    )


def best_of_all(p: StepProblem, reach: int) -> dict[int, float]:
    """Smallest error of the lists of each length, over all whole steps."""
    steps = range(-reach, reach + 1)
    every = np.array(list(itertools.product(steps, repeat=5))) * p.step
    residuals = p.errors + every @ p.gradients.T
    squares = (residuals**2).sum(axis=1) + (every != 0.0) @ p.scatter + p.floor
    lengths = (every != 0.0).sum(axis=1)
    return {k: float(np.sqrt(squares[lengths == k].min())) for k in range(6)}


@pytest.mark.parametrize(
    "seed", [*range(3), *(pytest.param(k, marks=pytest.mark.slow) for k in range(3, 8))]
)
def test_the_list_is_that_of_an_exhaustive_search(seed):
    p = problem(np.random.default_rng(seed), step=0.5, most=3.0)
    amounts = choose_steps(p)
    best = best_of_all(p, 6)
    lines = int((amounts != 0.0).sum())
    assert p.size(amounts) <= 1.02 * best[lines]
    assert p.size(amounts) <= 1.05**2 * min(best.values())
    assert np.abs(amounts).max() <= 3.0
    np.testing.assert_allclose(amounts / 0.5, np.rint(amounts / 0.5), atol=1e-12)
    without = sizes_without(p, amounts)
    assert (without > 1.05 * p.size(amounts)).all()


def test_no_line_where_little_is_known():
    p = problem(np.random.default_rng(1), step=0.5, most=3.0)
    unknown = StepProblem(p.errors, p.gradients, 1e5, p.scatter, p.step, p.most)
    assert not choose_steps(unknown).any()


def test_no_line_where_the_hand_errs_more_than_it_corrects():
    p = problem(np.random.default_rng(1), step=0.5, most=3.0)
    clumsy = StepProblem(p.errors, p.gradients, 0.1, np.full(5, 1e4), p.step, p.most)
    assert not choose_steps(clumsy).any()


@pytest.fixture(scope="module")
def session(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The result of the shipped study, without its report."""
    folder = tmp_path_factory.mktemp("adjust")
    study = folder / "prs.study.toml"
    text = (STUDIES / "prs_adjust.study.toml").read_text(encoding="utf-8")
    study.write_text(text.replace("[expect]", QUICK), encoding="utf-8")
    assert main(["run", str(study), "--out", str(folder / "out"), "--quiet"]) == 0
    return folder / "out"


@pytest.fixture
def folder(session: Path, tmp_path: Path) -> Path:
    return Path(shutil.copytree(session, tmp_path / "out"))


@pytest.fixture(scope="module")
def adjusted_session(
    session: Path, tmp_path_factory: pytest.TempPathFactory
) -> tuple[Path, str]:
    """The same after `oed adjust`, and what it said."""
    folder, said = tmp_path_factory.mktemp("adjusted") / "out", io.StringIO()
    shutil.copytree(session, folder)
    with contextlib.redirect_stdout(said):
        assert main(["adjust", str(folder)]) == 0
    return folder, said.getvalue()


@pytest.fixture
def adjusted(adjusted_session: tuple[Path, str], tmp_path: Path) -> Path:
    return Path(shutil.copytree(adjusted_session[0], tmp_path / "adjusted"))


def test_the_files_say_the_same(adjusted_session):
    folder, out = adjusted_session
    section = json.loads((folder / "result.json").read_text("utf-8"))["adjustment"]
    lines = section["lines"]
    with (folder / "adjust.csv").open(encoding="utf-8", newline="") as file:
        rows = list(csv.DictReader(file))
    assert [row["parameter"] for row in rows[1:]] == [a["parameter"] for a in lines]
    for row, line, record in zip(rows[1:], lines, section["accuracy"][1:], strict=True):
        assert float(row["amount"]) == pytest.approx(0.02 * int(row["steps"]))
        assert float(row["amount"]) == line["amount"]
        assert float(row["total"]) == pytest.approx(record["total"], rel=1e-5)
        assert line["without"] > 1.05 * section["accuracy"][-1]["total"]
        assert f"{line['by']}: {line['amount']:+.6g} mm" in out
        assert f"whole list without this line: total {line['without']:.4g} um" in out
        assert row["total_unit"] == section["total_unit"] == "um"
    assert (folder / "adjustment.pdf").read_bytes().startswith(b"%PDF")


def test_total_and_what_software_leaves(adjusted):
    result = json.loads((adjusted / "result.json").read_text("utf-8"))
    records = result["adjustment"]["accuracy"]
    lever, arcsec = 0.340722, np.pi / 648000.0
    scale = [1.0, 1.0, 1.0, *[lever * arcsec * 1e6] * 3]
    for record in records:
        parts = np.array(list(record["corrected"].values())) * scale
        assert record["total"] == pytest.approx(np.sqrt((parts**2).sum()))
    # the readings are virtual: the prediction is that of a plan, so only what is known
    # of y, of which software corrects nothing, is near the error that stays
    assert records[0]["corrected"]["y"] > 90.0
    assert records[-1]["total"] < 0.06 * records[0]["total"]
    # without software the columns and struts stay
    assert records[-1]["plain"]["z"] > 50.0


def test_the_next_study_takes_the_adjusted_machine(adjusted):
    result = json.loads((adjusted / "result.json").read_text("utf-8"))
    table = tomllib.loads((adjusted / "adjusted.toml").read_text("utf-8"))
    nominal = table["machine"]["nominal"]
    moved = {a["parameter"]: a["amount"] for a in result["adjustment"]["lines"]}
    for name, p in result["estimate"]["parameters"].items():
        if "." not in name:
            value = p["value"] + moved.get(name, 0.0)
            assert nominal[f"{name}_mm"] == pytest.approx(value, rel=1e-8, abs=1e-9)
    text = (STUDIES / "prs_adjust.study.toml").read_text("utf-8")
    block = (adjusted / "adjusted.toml").read_text("utf-8")
    text = text.replace("[[setup]]", f"{block}\n[[setup]]")
    machine = study_machine(Study.parse(text, adjusted / "next.study.toml"))
    assert machine.nominal[machine.index("db1z")] == pytest.approx(
        1e-3 * nominal["db1z_mm"]
    )


def test_a_controller_gets_the_adjusted_machine(folder, adjusted, oed):
    code, _, error = oed("compensate", folder, "--to", "json", "--adjusted")
    assert code == 2
    assert "oed adjust DIR" in error
    table = tomllib.loads((adjusted / "adjusted.toml").read_text("utf-8"))
    call = ("compensate", adjusted, "--to", "csv", "--commands", 60)
    code, out, _ = oed(*call, "--adjusted")
    assert code == 0
    assert "after all adjustments of adjust.csv" in out
    assert "the fitter's own error comes on top" in out
    path = adjusted / "compensation_parameters.csv"
    lines = path.read_text("utf-8").splitlines()
    rows = csv.DictReader(line for line in lines if not line.startswith("#"))
    values = {row["name"]: float(row["value"]) for row in rows}
    expected = table["machine"]["nominal"]["db1z_mm"]
    assert values["db1z"] == pytest.approx(expected, rel=1e-6)


def test_the_fitters_own_notes_stay(adjusted, oed):
    path = adjusted / "adjust.csv"
    notes = path.read_text("utf-8") + "done by the late shift\n"
    path.write_text(notes, encoding="utf-8")
    code, out, _ = oed("adjust", adjusted)
    assert code == 0
    assert path.read_text("utf-8") == notes
    assert "adjust-2.csv" in out


def test_the_report_has_the_chapter(adjusted, oed):
    assert oed("report", adjusted)[0] == 0
    page = (adjusted / "report.html").read_text("utf-8")
    assert "Adjustments at the machine" in page
    assert "shim under ball joint 1" in page


def test_a_section_that_contradicts_itself_is_refused(adjusted, oed):
    path = adjusted / "result.json"
    result = json.loads(path.read_text("utf-8"))
    for field, change in {
        "adjustment.accuracy": lambda s: s["accuracy"].pop(),
        "adjustment.lines[1].unit": lambda s: s["lines"][0].update(unit="furlong"),
        "adjustment.accuracy[2].plain": lambda s: s["accuracy"][1]["plain"].pop("x"),
    }.items():
        broken = json.loads(json.dumps(result))
        change(broken["adjustment"])
        path.write_text(json.dumps(broken), encoding="utf-8")
        code, _, error = oed("report", adjusted)
        assert code == 2
        assert field in error


def test_what_is_wanted_counts_and_a_thread_has_no_steps(folder, oed):
    text = (folder.parent / "out" / "result.json").read_text("utf-8")
    study = folder.parent / "wanted.study.toml"
    words = json.loads(text)["study_text"].replace("step_mm = 0.02\n", "")
    study.write_text(words, encoding="utf-8")
    call = ("adjust", folder, "--study", study, "--wanted", "gamma_arcsec=5")
    code, out, _ = oed(*call)
    assert code == 0
    assert (
        "over the wanted ones (gamma_arcsec=5); x, y, z, alpha, beta count for" in out
    )
    section = json.loads((folder / "result.json").read_text("utf-8"))["adjustment"]
    for record in section["accuracy"]:
        assert record["total"] == pytest.approx(record["corrected"]["gamma"] / 5.0)
        assert f"total {record['total']:.4g} times what is wanted" in out
    assert section["lines"]
    for line in section["lines"]:
        assert (line["steps"], line["sd"]) == (None, 0.0)
        assert line["amount"] == pytest.approx(round(line["amount"], 3), abs=1e-9)


def test_the_reports_limits_do_not_change_the_adjustment(adjusted, tmp_path, oed):
    """[prediction] wanted is for a verdict: lines and total stay as without it."""
    path = adjusted / "result.json"
    result = json.loads(path.read_text("utf-8"))
    before = result["adjustment"]
    study = tmp_path / "limits.study.toml"
    limits = "[prediction]\nwanted = { gamma_arcsec = 5.0 }"
    text = result["study_text"].replace("[prediction]", limits)
    study.write_text(text, encoding="utf-8")
    code, out, _ = oed("adjust", adjusted, "--study", study)
    assert code == 0
    assert json.loads(path.read_text("utf-8"))["adjustment"] == before
    total = before["accuracy"][0]["total"]
    assert f"As it is: total {total:.4g} um (x " in out


def test_the_posterior_of_the_folder_counts(adjusted, oed):
    """Draws that scatter more than the normal approximation leave more unknown."""
    path = adjusted / "result.json"
    sections = [json.loads(path.read_text("utf-8"))["adjustment"]]
    with xr.open_dataset(
        adjusted / "posterior.nc", group="posterior", engine="h5netcdf"
    ) as data:
        wide = data.load()
    middle = wide["theta"].mean(("chain", "draw"))
    wide["theta"] = 10.0 * (wide["theta"] - middle) + middle
    (adjusted / "posterior.nc").unlink()
    wide.to_netcdf(adjusted / "posterior.nc", group="posterior", engine="h5netcdf")
    oed("adjust", adjusted)
    sections.append(json.loads(path.read_text("utf-8"))["adjustment"])
    driven = [s["accuracy"][0]["corrected"]["alpha"] for s in sections]
    assert driven[1] == pytest.approx(10.0 * driven[0], rel=0.05)


def test_a_bad_fit_is_refused(folder, oed):
    path = folder / "result.json"
    result = json.loads(path.read_text("utf-8"))
    for section in ("estimate", "goodness"):
        if result[section] is not None:
            result[section]["chi2"] = 100.0 * result[section]["dof"]
    if result["goodness"] is not None:
        result["goodness"] |= {"p_high": 0.0, "bad_fit": True}
    path.write_text(json.dumps(result), encoding="utf-8")
    code, _, error = oed("adjust", folder)
    assert code == 1
    assert "oed diagnose" in error


def test_a_plan_alone_adjusts_nothing(tmp_path, oed):
    (tmp_path / "a.study.toml").write_text(sample.STUDY, encoding="utf-8")
    out = tmp_path / "out"
    assert oed("run", tmp_path / "a.study.toml", "--out", out, "--quiet")[0] == 0
    code, _, error = oed("adjust", out)
    assert code == 2
    assert "no estimate" in error


def test_software_corrects_what_the_drives_reach(folder, oed):
    """Struts of another length are no work for a fitter."""
    text = json.loads((folder / "result.json").read_text("utf-8"))["study_text"]
    start, end = text.index("[[machine.adjust]]"), text.index("[[setup]]")
    table = '[[machine.adjust]]\nparameters = ["dl*"]\nby = "strut {i}"\n\n'
    study = folder.parent / "struts.study.toml"
    study.write_text(text[:start] + table + text[end:], encoding="utf-8")
    code, words, error = oed("adjust", folder, "--study", study)
    assert code == 0, error
    assert words.startswith("No adjustment is worth its work")
    assert not (folder / "adjustment.pdf").exists()


TABLE = '\n[[machine.adjust]]\nparameters = ["{}"]\nby = "shim {{i}}"\n{}\n'


@pytest.mark.parametrize(("names", "amounts", "words"), [
    ("db4x", "", "no parameter has this name"),
    ("d*", "step_deg = 1.0", '"deg" is no unit for step'),
    ("*", "", "parameters of different kinds"),
    ("db2x", "step_mm = -0.1", "no such amount"),
    ("db2x", "most_mm = 0.0", "no such amount"),
    ("db2x", "pitch_mm = 0.1", "unknown field"),
    ("db2y", "", "only chooses the base frame"),
])  # fmt: skip
def test_what_cannot_be_is_refused(names, amounts, words, tmp_path, oed):
    text = sample.STUDY.replace(
        '[[setup]]\nname = "cup"',
        f'{TABLE.format(names, amounts)}\n[[setup]]\nname = "cup"',
    )
    if names == "d*":
        text = text.replace('["d*"]', '["dq*"]')
    (tmp_path / "a.study.toml").write_text(text, encoding="utf-8")
    code, _, error = oed("check", tmp_path / "a.study.toml")
    assert code == 2
    assert words in error
    assert "machine.adjust" in error


def test_the_study_replaces_the_models_adjustments():
    text = sample.STUDY.replace(
        "[[setup]]",
        TABLE.format("db2x", "step_um = 5.0\nsd_um = 2.0") + "\n[[setup]]",
        1,
    )
    model = study_machine(Study.parse(sample.STUDY, Path("a.study.toml")))
    machine = study_machine(Study.parse(text, Path("a.study.toml")))
    stated = {p.name: p.adjust for p in machine.parameters if p.adjust is not None}
    assert list(stated) == ["db2x"]
    assert (stated["db2x"].by, stated["db2x"].step) == ("shim 2", pytest.approx(5e-6))
    assert stated["db2x"].error == pytest.approx(2e-6)
    by_model = {p.name for p in model.parameters if p.adjust is not None}
    assert {"beta1", "db3x"} <= by_model
    none = sample.STUDY.replace('"a3_head"', '"a3_head"\nadjust = []')
    machine = study_machine(Study.parse(none, Path("a.study.toml")))
    assert not any(p.adjust for p in machine.parameters)
