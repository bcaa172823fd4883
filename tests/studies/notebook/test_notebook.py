"""The public face: what `import oed` offers, and results that show themselves."""

import dataclasses
import re
from pathlib import Path
from types import SimpleNamespace

import msgspec
import numpy as np
import pandas as pd
import pytest
import report_fixture
import report_fixture_plan
import sample
from fresh_process import printed_by
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from report_fixture import result_of

import oed
from oed.result import DesignSection, StudyResult
from pkm_studies import stages
from pkm_studies.notebook import axes
from pkm_studies.notebook.views import EstimateView
from pkm_studies.results import load_result
from pkm_studies.stages.run_state import WithheldError

#: what the small study leaves to a default that takes longer
SMALL = """
[readings]
simulate = true
[posterior]
enabled = false
[prediction]
z_mm = 1146.0
psi_deg = [0.0, 120.0]
theta_deg = 20.0
"""
README = Path(__file__).resolve().parents[3] / "README.md"


@pytest.fixture(scope="module")
def readings():
    """Readings of a virtual machine at the poses of a shipped study."""
    return oed.simulate(oed.load_study("planar_step_calibration"))


@pytest.fixture(scope="module")
def estimate(readings):
    return oed.identify(readings)


def test_every_public_name_is_there():
    assert 20 <= len(oed.__all__) <= 32
    for name in oed.__all__:
        assert getattr(oed, name) is not None
        assert name in dir(oed)


def test_an_unknown_name_is_an_attribute_error():
    with pytest.raises(AttributeError, match="no attribute 'fit_everything'"):
        oed.fit_everything  # noqa: B018


def test_importing_the_face_imports_nothing_heavy():
    code = (
        "import sys, oed; print(sorted({'casadi', 'pandas', 'scipy'} & {*sys.modules}))"
    )
    assert printed_by(code) == ["[]"]


def test_the_stub_names_the_same(tmp_path):
    stub = Path(oed.__file__).with_suffix(".pyi").read_text(encoding="utf-8")
    assert {*re.findall(r"import \w+ as (\w+)", stub), "__version__"} == {*oed.__all__}


def test_the_ten_lines_of_the_readme_run(tmp_path, monkeypatch):
    """With a small study in place of the shipped one."""
    text = README.read_text(encoding="utf-8")
    (code,) = re.findall(r"```python\n(import oed\n.*?)```", text, re.DOTALL)
    assert '"a3_ball_bar"' in code
    small_study(tmp_path)
    code = code.replace('"a3_ball_bar"', '"small.study.toml"')
    lines = [line for line in code.splitlines() if line.strip()]
    assert len(lines) <= 10
    monkeypatch.chdir(tmp_path)
    names: dict = {}
    exec(compile(code, "README.md", "exec"), names)
    assert names["design"].section.efficiency > 0.94  # certified, by the example
    assert names["accuracy"].to_pandas().loc["z", "after_rms"] > 0.0
    assert (tmp_path / "out" / "report.html").is_file()


def test_a_view_shows_itself_as_html(estimate):
    page = estimate._repr_html_()
    assert "<table" in page
    assert "rms residual" in page
    assert estimate.title in repr(estimate)


def test_warnings_are_shown_and_escaped(estimate):
    warned = type(estimate)(estimate.state.add_warnings("sd < 1 mm"))
    assert "sd &lt; 1 mm" in warned._repr_html_()


def test_tables_hold_what_the_section_says(readings, estimate):
    table = estimate.to_pandas()
    for name, parameter in estimate.section.parameters.items():
        assert table.loc[name, "value"] == parameter.value
        assert table.loc[name, "sd"] == parameter.sd
    assert len(readings.to_pandas()) >= estimate.section.readings / 2
    assert estimate.to_xarray().sizes["index"] == len(table)


def test_a_study_is_built_from_tables():
    study = oed.build_study(
        {
            "name": "gauge",
            "machine": {"model": "planar_2dof"},
            "setup": [{"name": "rm4", "instrument": "rm4"}],
            "readings": {"simulate": True},
            "design": {
                "reference": [
                    {
                        "name": "lines", "setup": "rm4", "runs_by": "y",
                        "y_mm": [-1500.0, 0.0, 1500.0], "z_mm": [0.0, 300.0, 600.0],
                    }
                ]
            },
        }
    )  # fmt: skip
    estimate = oed.identify(oed.simulate(study))
    assert estimate.section.readings == 6
    assert 'model = "planar_2dof"' in study.text


def test_a_wrong_table_names_field_value_and_remedy():
    with pytest.raises(oed.InputError, match="machine"):
        oed.build_study({"name": "gauge", "machine": {"modell": "planar_2dof"}})
    with pytest.raises(oed.InputError, match="no TOML form"):
        oed.build_study({"name": "gauge", "machine": None})


def test_what_a_study_lacks_is_said():
    study = oed.load_study("planar_step_calibration")
    with pytest.raises(oed.InputError, match="no candidates"):
        oed.choose_design(study)
    with pytest.raises(oed.InputError, match="lists no measurement"):
        oed.plan(study)


def test_readings_of_a_file_are_those_of_the_command(readings, tmp_path):
    path = tmp_path / "mine.readings.csv"
    readings.to_pandas().to_csv(path, index=False)
    again = oed.read_readings(readings.state.study, path).to_pandas()
    place = ["setup", "run", "order"]
    written, read = (
        table.set_index(place).sort_index() for table in (readings.to_pandas(), again)
    )
    pd.testing.assert_frame_equal(read[written.columns], written, check_dtype=False)


def test_the_studies_names_are_entry_points():
    from importlib.metadata import entry_points

    offered = {point.name for point in entry_points(group=oed.ENTRY_POINTS)}
    assert offered == {*oed._STUDIES}


def test_a_name_that_no_package_offers_says_what_to_install(monkeypatch):
    monkeypatch.setattr(oed, "ENTRY_POINTS", "oed.nothing")
    with pytest.raises(AttributeError, match="pip install pkm-oed"):
        oed.__getattr__("load_study")


def test_an_estimate_is_arrays(estimate):
    reported = estimate.section.parameters  # of the machine; those of set-ups follow
    count = len(reported)
    assert estimate.names[:count] == tuple(reported)
    scale = {"mm": 1e-3, "um": 1e-6, "mrad": 1e-3, "deg": np.pi / 180}
    units = np.array([scale[row.unit] for row in reported.values()])
    values = np.array([row.value for row in reported.values()])
    sd = np.array([row.sd for row in reported.values()])
    assert estimate.theta[:count] == pytest.approx(values * units, rel=1e-9)
    assert estimate.sd[:count] == pytest.approx(sd * units, rel=1e-9)
    assert np.diag(estimate.covariance) == pytest.approx(estimate.sd**2)


def test_a_fit_begins_where_it_is_told_to(readings, estimate):
    name = estimate.names[0]
    tolerance = readings.state.measurement.tolerance[0]
    begin = {name: estimate.theta[0] + tolerance}
    again = oed.identify(readings, start=begin)
    assert again.theta == pytest.approx(estimate.theta, abs=1e-6 * tolerance)
    assert again.state.estimate.residuals_before != pytest.approx(
        estimate.state.estimate.residuals_before
    )
    with pytest.raises(ValueError, match="'leg' is no parameter; they are"):
        oed.identify(readings, start={"leg": 1.0})


def test_options_of_a_fit_are_those_of_the_study(readings, estimate):
    estimated = oed.identify(readings, estimate_noise=True)
    assert estimate.state.estimate.noise_posterior is None
    assert estimated.state.estimate.noise_posterior is not None
    first = [estimate.names[0]]
    staged = oed.identify(readings, stages=[first, ["*"]])
    assert [list(s.patterns) for s in staged.state.estimate.stages] == [first, ["*"]]
    assert staged.theta == pytest.approx(estimate.theta)


def test_a_posterior_goes_to_arviz(estimate):
    posterior = oed.sample(estimate)
    tree = posterior.to_arviz()
    draws = tree["posterior"]["theta"]
    assert list(draws["parameter"].values) == list(posterior.names)
    mean = draws.mean(["chain", "draw"]).values
    assert posterior.theta == pytest.approx(mean)
    assert np.abs(posterior.theta - estimate.theta).max() < estimate.sd.max()
    assert posterior.sd == pytest.approx(draws.std(["chain", "draw"]).values, rel=0.01)


# -- without readings; at the machine --------------------------------------------------
def small_study(folder: Path) -> Path:
    """The file of the small study, in a folder."""
    path = folder / "small.study.toml"
    path.write_text(sample.STUDY + SMALL, encoding="utf-8")
    return path


def test_a_study_is_no_readings(tmp_path):
    study = oed.load_study(small_study(tmp_path))
    with pytest.raises(oed.InputError, match=r"no readings .*oed\.read_readings"):
        oed.identify(study)  # type: ignore[arg-type]
    with pytest.raises(oed.InputError, match="no readings"):
        oed.diagnose(oed.choose_design(study))  # type: ignore[arg-type]


def test_the_acceptance_test_is_a_function(tmp_path):
    oed.run(oed.load_study(small_study(tmp_path)), tmp_path / "run")
    test = oed.verify(tmp_path / "run")
    assert len(test.outcome.poses) > 0
    assert (tmp_path / "run" / "acceptance.csv").is_file()


def _drawn(draw, *sections) -> Axes:
    figure = Figure().subplots()
    draw(*sections, figure)
    return figure


def test_other_sections_are_drawn_too():
    full = result_of(report_fixture.sample())
    dots = np.vstack(
        [line.get_xydata() for line in _drawn(axes.design, full.design).lines[1::2]]
    )
    assert len(dots) == len(full.design.poses)
    residuals = _drawn(axes.residuals, full.estimate).lines[0].get_ydata()
    np.testing.assert_array_equal(residuals, full.estimate.residuals)
    bars = _drawn(axes.accuracy, full.prediction).containers[1]
    after = [c.after.rms for c in full.prediction.components.values()]
    assert [bar.get_height() for bar in bars] == after
    drawn = _drawn(axes.posterior, full.posterior, full.estimate.parameters)
    name = drawn.get_yticklabels()[0].get_text()
    marginal, p = full.posterior.marginals[name], full.estimate.parameters[name]
    low, high = drawn.lines[0].get_xdata()
    assert low * p.prior_sd + p.nominal == pytest.approx(marginal.q025)
    assert high * p.prior_sd + p.nominal == pytest.approx(marginal.q975)
    plan = result_of(report_fixture.bare() | {"plan": report_fixture_plan.plan()}).plan
    shares = _drawn(axes.stages, plan).lines[0].get_ydata()
    key = next(iter(plan.start_accuracy))
    assert shares[0] == 1.0
    assert shares[-1] * plan.start_accuracy[key] == pytest.approx(
        plan.stages[-1].accuracy[key]
    )


def test_what_cannot_be_drawn_says_why():
    design = result_of(report_fixture.sample()).design
    assert isinstance(design, DesignSection)
    import msgspec

    empty = msgspec.structs.replace(design, poses=[])
    with pytest.raises(ValueError, match="no commands"):
        _drawn(axes.design, empty)


TABLES = {
    "name": "scaled",
    "machine": {"model": "planar_2dof"},
    "setup": [{"name": "rm4", "instrument": "rm4"}],
    "noise": {"dy_um": 3.0},
    "posterior": {"enabled": False},
    "prediction": {"y_mm": [-1000.0, 0.0, 1000.0], "z_mm": [300.0, 900.0]},
    "gap": {"effects": ["encoder_scale"]},
    "report": {"html": False, "pdf": False},
}
VIRTUAL = {
    "design": {
        "reference": [
            {
                "name": "lines", "setup": "rm4", "runs_by": "y",
                "y_mm": [-1500.0, 0.0, 1500.0],
                "z_mm": {"from": 0.0, "to": 1500.0, "count": 7},
            }
        ]
    },
    "readings": {"simulate": True, "draw": True},
    "gap": TABLES["gap"]
    | {
        "acting": [
            {"effect": "encoder_scale", "size": 1.5, "coefficients": {"leg 1": 1.0}}
        ]
    },
}  # fmt: skip


@pytest.fixture(scope="module")
def scaled(tmp_path_factory) -> tuple[oed.Study, Path]:
    """A study without readings, and readings of a machine with a wrong scale."""
    path = tmp_path_factory.mktemp("scaled") / "scaled.readings.csv"
    readings = oed.simulate(oed.build_study({**TABLES, **VIRTUAL}))
    readings.to_pandas().to_csv(path, index=False)
    return oed.build_study(TABLES), path


@pytest.fixture(scope="module")
def commanded(scaled, tmp_path_factory) -> StudyResult:
    """What `oed diagnose` writes."""
    study, path = scaled
    folder = tmp_path_factory.mktemp("out")
    stages.diagnose_study(study, [path], folder)
    return load_result(folder)


def of_file(section):
    """A section as result.json stores it."""
    return msgspec.json.decode(msgspec.json.encode(section))


@pytest.mark.slow
def test_a_notebook_has_the_diagnosis_of_the_command(scaled, commanded):
    study, path = scaled
    view = oed.diagnose(oed.identify(oed.read_readings(study, path)))
    assert commanded.gap.mixture is not None
    assert commanded.corrected is not None
    found = view.state.result
    for name in ("gap", "corrected", "estimate", "goodness", "identifiability"):
        told = of_file(getattr(commanded, name))
        assert of_file(getattr(found, name)) == told, name
    assert view.section.mixture == found.gap.mixture
    assert view.corrected == found.corrected
    assert set(commanded.warnings) == set(view.warnings)


def test_a_refused_step_says_why():
    estimate = oed.identify(oed.simulate(oed.build_study({**TABLES, **VIRTUAL})))
    # as a check leaves recorded readings that look mistaken
    state = estimate.state
    recorded = dataclasses.replace(state.readings, truth=None)
    bad = msgspec.structs.replace(state.goodness, bad_fit=True)
    checked = SimpleNamespace(mistaken=True, bad_fit=True, findings=())
    state = state.replace(readings=recorded, checked=checked)
    refused = EstimateView(state.add_sections(goodness=bad))
    with pytest.raises(WithheldError, match=r"prediction: .* rest on a bad fit"):
        oed.predict(refused)
    with pytest.raises(WithheldError, match=r"gap: .* a mistake in the readings"):
        oed.diagnose(refused)
    with pytest.raises(WithheldError, match=r"posterior: \[posterior\] enabled"):
        oed.sample(refused)
