"""Studies: every number in SI where it belongs, every refusal with field and remedy."""

from __future__ import annotations

import fnmatch
import math
from pathlib import Path

import numpy as np
import pytest
import sample
from hypothesis import given
from hypothesis import strategies as st

from oed import units
from pkm_studies import catalogue, schemas, study, template
from pkm_studies.errors import InputError, Place, SourceAbsentError
from pkm_studies.resolve import quantities
from pkm_studies.resolve.resolved import resolve

HERE = Place("x.study.toml")


def refused(text: str, *changes: tuple[str, str], folder: Path = Path()) -> InputError:
    with pytest.raises(InputError) as error:
        sample.resolved(sample.changed(text, *changes), folder)
    assert len(str(error.value)) <= 600
    assert "\n" not in str(error.value)
    return error.value


# -- numbers with units ----------------------------------------------------------------

name = st.from_regex(r"[a-z]+[0-9]?(_[xyz])?", fullmatch=True)


@given(name=name, unit=st.sampled_from(sorted(units.UNITS)), value=st.floats(-1e6, 1e6))
def test_a_key_gives_its_value_in_si(name: str, unit: str, value: float) -> None:
    found = quantities.read_values(
        {f"{name}_{unit}": value}, {name: units.si_unit(unit)}, HERE
    )
    assert found == {name: pytest.approx(value * units.factor(unit), rel=1e-15)}


@given(
    name=name,
    unit=st.sampled_from(sorted(units.UNITS)),
    kind=st.sampled_from(sorted(units.DISPLAY)),
)
def test_a_unit_of_another_kind_is_refused_with_those_that_fit(
    name: str, unit: str, kind: str
) -> None:
    if units.si_unit(unit) == kind:
        return
    with pytest.raises(InputError) as error:
        quantities.read_values({f"{name}_{unit}": 1.0}, {name: kind}, HERE)
    assert all(
        f"{name}_{u}" in str(error.value) for u in quantities.allowed_units(kind)
    )


@pytest.mark.parametrize(
    ("key", "words"),
    [
        ("length", "unit is missing in the name"),
        ("length_kg", '"kg" is no unit for length'),
        ("lenght_mm", "did you mean length_mm"),
        ("length_deg", "length_um"),
    ],
)
def test_a_key_that_fits_nothing(key: str, words: str) -> None:
    with pytest.raises(InputError, match=words):
        quantities.read_values({key: 1.0}, {"length": "m"}, HERE)


def test_a_quantity_given_twice_is_refused() -> None:
    with pytest.raises(InputError, match="given twice"):
        quantities.read_values(
            {"length_mm": 1.0, "length_um": 1.0}, {"length": "m"}, HERE
        )


# -- the file --------------------------------------------------------------------------

BROKEN = {
    "unknown table": (("[noise]", "[noize]"), "noize", "did you mean noise"),
    "unknown field": (('criterion = "D"', 'criterium = "D"'), "design.criterium", "did you mean criterion"),
    "unknown setting": (("length_mm = 300.0", "lenth_mm = 300.0"), "setup[1].lenth_mm", "did you mean length_mm"),
    "coordinate": (("psi_deg = { from", "phi_deg = { from"), "design.candidates[1].phi_deg", "did you mean psi_deg"),
    "nan": (("length_mm = 300.0", "length_mm = nan"), "setup[1].length_mm", "not a finite number"),
    "infinite": (("length_um = 0.5", "length_um = inf"), "noise.length_um", "not a finite number"),
    "beyond floats": (("length_um = 0.5", f"length_um = 1{'0' * 400}"), "noise.length_um", "not a finite number"),
    "text for a number": (("length_mm = 300.0", 'length_mm = "300"'), "setup[1].length_mm", "a number is wanted"),
    "number for text": (('name = "small"', "name = 3"), "name", "text is wanted"),
    "half a reading": (("readings = 21", "readings = 2.5"), "design.readings", "a whole number"),
    "no reading": (("readings = 21", "readings = 0"), "design.readings", ">= 1"),
    "name with a slash": (('name = "small"', 'name = "a/b"'), "name", "letters, digits"),
    "criterion": (('criterion = "D"', 'criterion = "F"'), "design.criterion", "allowed: D, Ds, A, c, I, G"),
    "version": (("schema = 1", "schema = 2"), "schema", "schema = 1"),
    "no version": (("schema = 1\n", ""), "schema", "missing"),
    "one bracket": (("[[setup]]", "[setup]"), "setup", "two brackets"),
    "no machine": (('[machine]\nmodel = "a3_head"', ""), "machine", "missing"),
    "machine": (('"a3_head"', '"a3_haed"'), "machine.model", "did you mean a3_head"),
    "instrument": (('"ball_bar"', '"ball_baar"'), "setup[1].instrument", "did you mean ball_bar"),
    "module": (('"a3_head"', '"no.such:machine"'), "machine.model", "was not found"),
    "attribute": (('"a3_head"', '"pkm_models.machines.a3_head:m"'), "machine.model", "there is: machine"),
    "no user file": (('"a3_head"', '"mine.py:machine"'), "machine.model", "no such file"),
    "unit of noise": (("length_um = 0.5", "length_kg = 0.5"), "noise.length_kg", "length_um"),
    "no noise": (("length_um = 0.5", "length_um = 0"), "noise.length_um", "above 0"),
    "noise of nothing": (("length_um = 0.5", "height_um = 1"), "noise.height_um", "allowed: length_mm"),
    "noise of no set-up": (("[noise]", "[noise.cop]"), "noise.cop", "did you mean cup"),
    "teach missing": (("teach =", "# teach ="), "setup[1].teach", "teach = { z_mm"),
    "teach coordinate": ((", theta_deg = 0.0 }", " }"), "setup[1].teach.theta_deg", "every coordinate"),
    "teach out of reach": (("z_mm = 1286.0", "z_mm = 128600.0"), "setup[1].teach", "joint"),
    "teach unit": (("psi_deg = 0.0,", "psi_mm = 0.0,"), "setup[1].teach.psi_mm", "psi_deg"),
    "out of the workspace": (("from = 1066.0", "from = 966.0"), "design.candidates[1].z_mm", "1066 mm to 1266 mm"),
    "no coordinate": (("psi_deg = { from", "# psi_deg = { from"), "design.candidates[1].psi_deg", "missing"),
    "held by nothing": (('theta = "hold"', 'theta = "hold"\npsi = "hold"\n#'), "design.candidates[1]", "held|twice"),
    "unknown word": (('theta = "hold"', 'theta = "held"'), "design.candidates[1].theta", "did you mean hold"),
    "empty list": (('theta = "hold"', "theta_deg = []"), "design.candidates[1].theta_deg", "empty"),
    "too many values": (("count = 4 ", "count = 400000 "), "design.candidates[1].z_mm.count", "too many values"),
    "too many poses": (("count = 12", "count = 90000"), "design.candidates[1]", "fewer values"),
    "no bar long enough": (("length_mm = 300.0", "length_mm = 5.0"), "design.candidates[1].theta", "another bar"),
    "set-up of a grid": (('setup = "cup"', 'setup = "cap"'), "design.candidates[1].setup", "did you mean cup"),
    "runs": (('theta = "hold"', 'theta = "hold"\nruns_by = "y"'), "design.candidates[1].runs_by", "z, psi, theta"),
    "empty claim": ((", equals = 18", ""), "expect.rank", "equals, min, max or contains"),
    "fixed": (('"a3_head"', '"a3_head"\nfixed = ["dc*"]'), "machine.fixed[1]", "no parameter"),
    "nominal": (('"a3_head"', '"a3_head"\nnominal = { dq1_deg = 1 }'), "machine.nominal.dq1_deg", "dq1_mm"),
}  # fmt: skip


@pytest.mark.parametrize("name", BROKEN)
def test_refused_with_field_and_remedy(name: str) -> None:
    change, field, words = BROKEN[name]
    error = refused(sample.STUDY, change)
    assert error.field.startswith(field)
    assert error.file == "small.study.toml"
    assert any(w in str(error) for w in words.split("|")), str(error)


ADDED = {
    "set-up twice": ('[[setup]]\nname = "cup"\ninstrument = "calliper"', "setup[2].name", "used twice"),
    "prior unit": ('[[prior.tolerance]]\nparameters = ["*q*"]\nsigma_kg=1', "prior.tolerance[1].sigma_kg", "sigma_mm"),
    "prior kinds": ('[[prior.tolerance]]\nparameters = ["*"]\nsigma_mm = 1', "prior.tolerance[1].parameters", "kind"),
    "prior of nothing": ('[[prior.tolerance]]\nparameters = ["x"]\nsigma_mm=1', "prior.tolerance[1]", "no parameter"),
    "prior below 0": ('[[prior.tolerance]]\nparameters = ["dq*"]\nsigma_mm = -1', "prior.tolerance[1]", ">= 0"),
    "prior without": ('[[prior.tolerance]]\nparameters = ["dq*"]', "prior.tolerance[1].sigma_mm", "missing"),
    "no readings": ("[readings]", "readings", "simulate = true"),
    "two readings": ('[readings]\nsimulate = true\nfiles = ["a.csv"]', "readings", "files and simulate"),
    "no such file": ('[readings]\nfiles = ["a.csv"]', "", "no such file"),
    "no such source": ('[readings]\nsource = "delta_v40"', "readings.source", "did you mean delta_v400"),
    "truth": ("[readings]\nsimulate = true\ntruth = { dq1_deg = 1 }", "readings.truth.dq1_deg", "dq1_mm"),
    "truth of none": ("[readings]\nsimulate = true\n[readings.truth.cop]", "readings.truth.cop", "did you mean cup"),
    "fit": ('[readings]\nsimulate = true\nfit = ["cap"]', "readings.fit[1]", "did you mean cup"),
    "stages": ('[identify]\nstages = [["dq*"], ["dx*"]]', "identify.stages[2][1]", "no parameter"),
    "prediction": ("[prediction]\nz_mm = 1100\npsi_deg = 0\ntheta_deg = 50", "prediction.theta_deg", "0 deg to 40 deg"),
    "kappa": ('[[kappa]]\nsetup = "cup"\ncircles = [2]\npoints = [9]', "kappa[1]", "one range"),
    "kappa range": (
        '[[kappa]]\nsetup = "cup"\ncircles = [2]\npoints = [9]\nz_mm = { from = 0, to = 1266 }\ncoordinate = "theta"',
        "kappa[1].z_mm",
        "1066 mm to 1266 mm",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ADDED)
def test_tables_refused_with_field_and_remedy(name: str) -> None:
    text, field, words = ADDED[name]
    error = refused(sample.STUDY + "\n" + text + "\n")
    assert error.field.startswith(field), str(error)
    assert words in str(error)


def test_a_pose_that_does_not_close_is_told() -> None:
    text = (
        sample.DELTA
        + "[[design.candidates]]\nsetup = 'probe'\nx_mm = [0, 100]\ny_mm = 0\nz_mm ="
        " 20\n"
    )
    error = refused(
        text, ('"linear_delta"', '"linear_delta"\nnominal = { arm1_mm = 200 }')
    )
    assert error.field == "design.candidates[1]"
    assert "cannot be assembled" in str(error)


def test_entries_count_from_1() -> None:
    error = refused(
        sample.STUDY,
        ("teach = { z_mm = 1286.0", "tool_mm = [0.0, 1.0]\nteach = { z_mm = 1286.0"),
    )
    assert error.field == "setup[1].tool_mm"


# -- what it means ---------------------------------------------------------------------


def test_the_grid_varies_its_first_coordinate_slowest() -> None:
    found = sample.resolved()
    (series,) = found.candidates
    command = series.reading_commands()
    assert len(series) == 48
    np.testing.assert_allclose(command[:12, 0], 1.066)
    np.testing.assert_allclose(
        command[:12, 1], np.radians(np.arange(0, 360, 30)), atol=1e-12
    )
    reading = found.measurement.readings(found.candidates, found.measurement.nominal)
    np.testing.assert_allclose(reading, 0.300, rtol=1e-9)


def test_numbers_of_the_study_reach_the_kernel() -> None:
    text = (
        sample.STUDY
        + """
[[setup]]
name = "long"
instrument = "ball_bar"
tool_mm = [0.0, 0.0, -100.0]
teach = { z_mm = 1286.0, psi_deg = 0.0, theta_deg = 0.0 }
tolerance = { cup_x_um = 5 }

[noise.long]
length_um = 2

[[prior.tolerance]]
parameters = ["dq*", "*.cup_?"]
sigma_um = 300

[[prior.tolerance]]
parameters = ["dq3"]
sigma_mm = 2
"""
    )
    found = sample.resolved(
        sample.changed(
            text,
            (
                '"a3_head"',
                (
                    '"a3_head"\nfixed = ["db?z", "beta1", "cup.cup_z"]\nnominal = {'
                    " dq2_mm = 8 }"
                ),
            ),
        )
    )
    cup, long = found.setups["cup"], found.setups["long"]
    assert (cup.sigma, long.sigma) == ((0.5e-6,), (2e-6,))
    assert long.tool == (0.0, 0.0, -0.1)
    assert cup.settings == {"length": 0.3}
    by_name = {p.name: p for p in found.measurement_with(["cup", "long"]).parameters}
    assert by_name["dq2"].nominal == pytest.approx(8e-3)
    assert by_name["dq1"].tolerance == pytest.approx(300e-6)
    assert by_name["dq3"].tolerance == pytest.approx(2e-3)
    assert by_name["long.cup_x"].tolerance == pytest.approx(5e-6)
    assert by_name["long.cup_y"].tolerance == pytest.approx(300e-6)
    assert by_name["cup.cup_z"].tolerance == 0.0
    assert found.machine.frame == ("db1z", "db2z", "db3z", "beta1")


def test_a_set_up_that_only_a_reference_names_stays_out() -> None:
    text = (
        sample.STUDY
        + """
[[setup]]
name = "other"
instrument = "calliper"

[[design.reference]]
name = "both"
setup = "cup"
z_mm = [1146, 1266]
psi_deg = [0, 90]
theta = "hold"
runs_by = "z"

[[design.reference]]
name = "both"
setup = "other"
z_mm = [1146, 1266]
psi_deg = 0
theta_deg = 5
"""
    )
    found = sample.resolved(text)
    assert list(found.measurement.setups) == ["cup"]
    (plan,) = found.reference_plans
    assert plan.setups == ("cup", "other")
    assert list(plan.series[0].run) == ["z=1146mm", "z=1146mm", "z=1266mm", "z=1266mm"]
    assert [len(s) for s in plan.series] == [4, 1]
    assert list(found.measurement_with(plan.setups).setups) == ["cup", "other"]


def test_pairs_are_runs_of_two() -> None:
    text = (
        sample.DELTA
        + """
[[design.candidates]]
setup = "calliper"
pairs_mm = [[[0, 0, 20], [50, 0, 20]], [[0, 0, 20], [0, 50, 20]], [[0, 0, 20], [-50, 0, 20]]]
"""
    )
    found = sample.resolved(text)
    np.testing.assert_allclose(
        found.measurement.readings(found.candidates, found.measurement.nominal),
        0.050,
        rtol=1e-9,
    )
    assert "outside the workspace" in str(
        refused(text, ("[50, 0, 20]", "[500, 0, 20]"))
    )
    assert "two poses" in str(refused(text, ('setup = "calliper"', 'setup = "probe"')))


def test_candidates_that_cannot_be_held_are_left_out_and_told() -> None:
    found = sample.resolved(
        sample.changed(sample.STUDY, ("length_mm = 300.0", "length_mm = 100.0"))
    )
    assert 0 < len(found.candidates[0]) < 48
    assert "left out" in found.warnings[0]


def test_circles_are_spaced_over_the_range() -> None:
    text = (
        sample.STUDY
        + """
[[kappa]]
setup = "cup"
circles = [1, 2]
points = [15]
z_mm = { from = 1146.0, to = 1266.0 }
coordinate = "theta"
"""
    )
    (circles,) = sample.resolved(text).kappa_circles
    heights = circles.series(2, 15).reading_commands()[:, 0]
    np.testing.assert_allclose(np.unique(np.round(heights, 9)), [1.146, 1.266])
    np.testing.assert_allclose(circles.series(1, 15).reading_commands()[:, 0], 1.206)
    # 2 circles of 15 points, taught cup: condition number 3748 over the 18 identifiable
    # directions
    measurement = circles.measurement
    columns = (
        measurement.jacobian([circles.series(2, 15)], measurement.nominal)
        / measurement.length_factors
    )
    values = np.linalg.svd(columns[:, measurement.free], compute_uv=False)
    assert values[0] / values[17] == pytest.approx(3748, rel=1e-3)


def test_truth_is_in_si_and_names_the_set_up() -> None:
    text = (
        sample.STUDY + "[readings]\nsimulate = true\n[readings.truth]\nbeta1_deg ="
        ' 0.5\n"cup.cup_y_um" = 3\n'
    )
    found = sample.resolved(text + "[readings.truth.cup]\ncup_x_mm = 0.1\n")
    assert found.true_parameters == {
        "beta1": pytest.approx(math.radians(0.5)),
        "cup.cup_y": pytest.approx(3e-6),
        "cup.cup_x": pytest.approx(1e-4),
    }


def test_readings_of_a_study_are_relative_to_it(tmp_path: Path) -> None:
    (tmp_path / "a.csv").write_text(sample.READINGS, encoding="utf-8")
    text = sample.STUDY + '[readings]\nfiles = ["a.csv"]\n'
    found = sample.resolved(text, tmp_path)
    assert found.dataset is not None
    assert len(found.dataset) == 3
    assert resolve(study.parse(text, tmp_path / "x.toml"), readings=()).dataset is None
    error = refused(text + 'fit = ["cup"]\npredict = ["cup"]\n', folder=tmp_path)
    assert error.field == "readings.predict"


def test_an_absent_source_has_an_error_of_its_own(tmp_path: Path) -> None:
    text = sample.DELTA + '[readings]\nsource = "delta_v400"\npath = "nowhere"\n'
    with pytest.raises(SourceAbsentError, match="nowhere"):
        sample.resolved(text, tmp_path)


def test_a_source_becomes_readings(tmp_path: Path) -> None:
    (tmp_path / "sessions.json").write_text(
        '[{"session": "S1", "step_distance_mm": [0.01, 0.01, 0.02]}]'
    )
    (tmp_path / "heights.csv").write_text(
        "session,i,height_mm,steps_a,steps_b,steps_c\nS1,0,18.1,40000,40100,20050\n"
    )
    (tmp_path / "distances.csv").write_text(
        "session,i,distance_mm,p1_a,p1_b,p1_c,p2_a,p2_b,p2_c\nS1,0,64.9,41000,40000,20000,38000,40000,21000\n"
    )
    text = sample.changed(
        sample.DELTA, ('"probe"', '"S1_probe"'), ('"calliper"', '"S1_calliper"')
    )
    found = sample.resolved(
        text + '[readings]\nsource = "delta_v400"\npath = "."\n', tmp_path
    ).dataset
    assert found is not None
    np.testing.assert_allclose(found.y, [0.0181, 0.0649])
    np.testing.assert_allclose(found.series[0].q[0], [0.400, 0.401, 0.401])
    np.testing.assert_allclose(
        found.series[1].q[found.series[1].index[0]],
        [[0.38, 0.40, 0.42], [0.41, 0.40, 0.40]],
    )


# -- models of one's own ---------------------------------------------------------------


def test_a_machine_from_a_file(tmp_path: Path) -> None:
    (tmp_path / "mine.py").write_text(
        '"""Mine."""\nimport dataclasses\nfrom pkm_models.machines.a3_head import'
        ' machine as base\nmachine = dataclasses.replace(base, name="mine")\nhead ='
        " machine\n"
    )
    for reference in ("mine.py", "mine.py:head", "./mine.py:machine"):
        text = sample.changed(sample.STUDY, ('"a3_head"', f'"{reference}"'))
        assert sample.resolved(text, tmp_path).machine.name == "mine"
    error = refused(sample.STUDY, ('"a3_head"', '"mine.py:other"'), folder=tmp_path)
    assert "there is: base, machine, head" in str(error)


@pytest.mark.parametrize(
    ("source", "words"),
    [("1/0", "ZeroDivisionError"), ("(", "SyntaxError"), ("exit()", "SystemExit")],
)
def test_a_file_that_fails_is_told(source: str, words: str, tmp_path: Path) -> None:
    (tmp_path / "bad.py").write_text(source)
    assert words in str(
        refused(sample.STUDY, ('"a3_head"', '"bad.py"'), folder=tmp_path)
    )


def test_an_instrument_that_cannot_read_the_machine_is_told(tmp_path: Path) -> None:
    error = refused(
        sample.STUDY,
        ('instrument = "ball_bar"', 'instrument = "redundancy"'),
        folder=tmp_path,
    )
    assert (
        "it cannot read a3_head: it takes one joint more than degrees of freedom, here"
        " are 0 more" in str(error)
    )


@pytest.mark.parametrize("kind", catalogue.KINDS)
def test_the_catalogue_gives_its_sources(kind: str) -> None:
    entries = catalogue.listing(kind)
    assert all(e.name and e.about and e.source for e in entries)
    assert len({e.name for e in entries}) == len(entries)
    assert entries


@pytest.mark.parametrize(
    "instrument", [e.name for e in catalogue.listing("instruments")]
)
@pytest.mark.parametrize("machine", [e.name for e in catalogue.listing("machines")])
def test_a_new_study_is_sound(machine: str, instrument: str, tmp_path: Path) -> None:
    if (instrument, machine == "cable_robot") == ("redundancy", False):
        with pytest.raises(InputError, match=f"it cannot read {machine}"):
            template.write("fresh", machine, instrument, tmp_path)
        assert not list(tmp_path.iterdir())
        return
    path = template.write("fresh", machine, instrument, tmp_path)
    found = resolve(study.load(path))
    assert 20 <= len(found.candidates[0]) <= 1000
    assert found.prediction_commands is not None
    assert len(found.prediction_commands) <= 1000
    # what is commented out is right as well
    text = path.read_text(encoding="utf-8")
    lines = [
        line.removeprefix("# ") if fnmatch.fnmatch(line, "# [[a-z]*[]=]*") else line
        for line in text.splitlines()
    ]
    sample.resolved("\n".join(lines), tmp_path)
    with pytest.raises(InputError, match="of this name"):
        template.write("fresh", machine, instrument, tmp_path)


def test_the_schema_knows_tables_with_fields_of_free_name() -> None:
    made = schemas.study()
    table = made["$defs"]["SetupTable"]
    assert table["additionalProperties"] == {"type": "number"}
    assert "settings" not in table["properties"]
    assert made["$defs"]["DesignTable"]["additionalProperties"] is False
