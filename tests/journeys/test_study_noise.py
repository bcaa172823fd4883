"""`[noise]` of a study: amounts that are stated, what they change, what is refused."""

import json

import bad_fit_sample
import bar_readings
import pytest
import sample

from pkm_studies.commands import main

NOISE = "length_um = 0.5"


def noise(*lines: str) -> str:
    """The small study with lines in [noise]."""
    return sample.changed(sample.STUDY, (NOISE, "\n".join([NOISE, *lines])))


def test_amounts_reach_the_set_up_in_si():
    stated = ("seating_um = 0.3", "length_run_um = 0", "carried = 0.2")
    more = ("reach_readings = 5", "outlier_share = 0.01")
    (setup,) = sample.resolved(noise(*stated, *more)).setups.values()
    statement = setup.statement
    assert statement.seating == pytest.approx(0.3e-6)
    assert statement.levels == {"length"}
    assert setup.instrument.channels[0].shared == 0.0
    assert (statement.correlated, statement.reach) == (0.2, 5.0)
    assert (statement.student_dof, statement.outlier_share) == (None, 0.01)


def test_a_number_for_one_set_up_goes_before_one_for_all():
    text = noise("seating_um = 0.3", "[noise.cup]", "seating_um = 0")
    (setup,) = sample.resolved(text).setups.values()
    assert setup.statement.seating == 0.0


REFUSED = {
    "seating_um = -0.1": "an amount of noise is a standard deviation",
    "length_run_um = -1.0": "an amount of noise is a standard deviation",
    "seating = 0.1": "the unit is missing", "seating_deg = 0.1": "no unit for seating",
    "carried = 1.2": "carried = 1.2", "carried = -0.1": "carried = -0.1",
    "reach_readings = 0": "reach_readings = 0", "student_dof = 2": "student_dof = 2",
    "outlier_share = 0.6": "outlier_share = 0.6",
    "carried = 0.0\nreach_readings = 3": "nothing is carried along",
    "student_dof = 4\noutlier_share = 0.01": "states the tails already",
}  # fmt: skip


@pytest.mark.parametrize("lines", list(REFUSED))
def test_what_cannot_be_is_refused(lines):
    error = sample.refused(noise(lines))
    assert error.field.startswith("noise.")
    assert REFUSED[lines] in str(error)


def test_seating_is_refused_where_nothing_is_seated():
    text = sample.changed(
        sample.DELTA, ("[[setup]]", "[noise]\nseating_um = 1\n\n[[setup]]")
    )
    error = sample.refused(text)
    assert error.field == "noise.seating_um"
    assert "no run of probe, calliper seats anything anew" in error.problem


def test_a_stated_law_is_narrower_and_reported(tmp_path):
    """Intervals of a bar whose cup stays, and the numbers of the law that are left."""
    readings, results = bar_readings.a3_readings(0), {}
    stated = (
        "seating_um = 0", "length_run_um = 0", "carried = 0", "course = false",
        "outlier_share = 0",
    )  # fmt: skip
    for name, lines in (("wide", ()), ("stated", stated)):
        study = sample.changed(
            bad_fit_sample.WITHOUT_REPORT,
            (NOISE, "\n".join([NOISE, "estimate = true", *lines])),
        )
        folder = tmp_path / name
        folder.mkdir()
        path, table = bad_fit_sample.write(folder, readings)
        path.write_text(study, encoding="utf-8")
        out = folder / "fit"
        main(["identify", str(path), "--readings", str(table), "--out", str(out)])
        results[name] = json.loads((out / "result.json").read_text(encoding="utf-8"))
    kinds = {
        k: {r["kind"] for r in v["goodness"]["noise"].values()}
        for k, v in results.items()
    }
    assert kinds["wide"] == {"reading", "run", "seat", "course", "carried", "reach"}
    assert kinds["stated"] == {"reading"}
    wide, narrow = (
        [c["sd"] for c in results[name]["estimate"]["combinations"]]
        for name in ("wide", "stated")
    )
    pairs = list(zip(wide, narrow, strict=True))
    assert all(stated < 1.05 * unknown for unknown, stated in pairs)
    assert sum(stated < 0.95 * unknown for unknown, stated in pairs) >= 3
