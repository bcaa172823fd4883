"""Studies with a mistake: every refusal names field, value and remedy in one line."""

import pytest
import sample

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
    "criterion": (('criterion = "D"', 'criterion = "F"'), "design.criterion", "allowed: A, c, D, Ds, E, G"),
    "index": (('criterion = "D"', 'indices = ["D"]'), "design.indices[1]", "allowed: kappa"),
    "version": (("schema = 1", "schema = 2"), "schema", "schema = 1"),
    "no version": (("schema = 1\n", ""), "schema", "missing"),
    "one bracket": (("[[setup]]", "[setup]"), "setup", "two brackets"),
    "no machine": (('[machine]\nmodel = "a3_head"', ""), "machine", "missing"),
    "machine": (('"a3_head"', '"a3_haed"'), "machine.model", "did you mean a3_head"),
    "instrument": (('"ball_bar"', '"ball_baar"'), "setup[1].instrument", "did you mean ball_bar"),
    "module": (('"a3_head"', '"no.such:machine"'), "machine.model", "belongs to no installed"),
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
def test_refused_with_field_and_remedy(name):
    change, field, words = BROKEN[name]
    error = sample.refused(sample.STUDY, change)
    assert error.field.startswith(field)
    assert error.file == "small.study.toml"
    assert any(word in str(error) for word in words.split("|")), str(error)


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
    "kappa with": (
        '[[kappa]]\nsetup = "cup"\ncircles = [2]\npoints = [9]\nwith = "home"\nz_mm = { from = 1146, to = 1266 }\ncoordinate = "theta"',
        "kappa[1].with",
        "no such reference plan",
    ),
}  # fmt: skip


@pytest.mark.parametrize("name", ADDED)
def test_tables_refused_with_field_and_remedy(name):
    text, field, words = ADDED[name]
    error = sample.refused(sample.STUDY + "\n" + text + "\n")
    assert error.field.startswith(field), str(error)
    assert words in str(error)


def test_a_pose_that_does_not_close_is_refused():
    grid = "setup = 'probe'\nx_mm = [0, 100]\ny_mm = 0\nz_mm = 20\n"
    text = f"{sample.DELTA}[[design.candidates]]\n{grid}"
    short_arm = '"linear_delta"\nnominal = { arm1_mm = 200 }'
    error = sample.refused(text, ('"linear_delta"', short_arm))
    assert error.field == "design.candidates[1]"
    assert "1 pose cannot be reached, the first at x = 100 mm, y = 0 mm, z = 20 mm" in (
        str(error)
    )


@pytest.mark.parametrize(("old", "new", "words"), [
    ("z_mm = { from = 1066.0, to = 1266.0, count = 4 }", "z_um = [1066000.0, 2000000.0]",
     "2000000 um is outside the workspace of a3_head; z goes from"),
    ('"a3_head"', '"a3_head"\nhome = { z_um = 2000000.0 }',
     "home has z = 2000000 um, outside the workspace; state a home pose inside"),
    ("[noise]", '[[prior.bounds]]\nparameters = ["dq1"]\nlower_um = 5.0\n[noise]',
     "the nominal value of dq1, 0 um, is not within"),
])  # fmt: skip
def test_limits_are_stated_in_the_unit_of_their_field(old, new, words):
    error = sample.refused(sample.STUDY, (old, new))
    assert words in str(error)
    assert " mm" not in str(error).partition("; ")[0]


def test_entries_count_from_1():
    error = sample.refused(
        sample.STUDY,
        ("teach = { z_mm = 1286.0", "tool_mm = [0.0, 1.0]\nteach = { z_mm = 1286.0"),
    )
    assert error.field == "setup[1].tool_mm"
