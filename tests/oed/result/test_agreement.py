"""A result that contradicts itself is refused with its field; what records say of themselves."""

import functools
import json
import warnings
from collections.abc import Iterator
from typing import Any

import msgspec
import numpy as np
import pytest
import report_fixture
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from result_sample import Change, drop, put, rename, twice, whole, whole_once

from oed import result
from oed.result import (
    AnswerRecord,
    ComponentAccuracy,
    GapSection,
    GoodnessSection,
    SpreadRecord,
    StudyResult,
)
from oed.result.agreement import Breach, breaches, value_breaches
from oed.result.record import Record
from pkm_reports import sections
from pkm_reports.sections import answer_parts
from pkm_reports.view import PageView
from pkm_studies import catalogue
from pkm_studies.commands import main

#: keys that are missing or unknown, and other types
OTHER_TYPES: list[tuple[Change, str]] = [
    (drop("machine"), "machine"),
    (drop("machine/name"), "name"),
    (drop("estimate/residuals"), "residuals"),
    (drop("prediction/components/z/after"), "after"),
    (put("estimate/colour", "blue"), "colour"),
    (put("seed", "three"), "seed"),
    (put("headline", "a sentence"), "headline"),
    (put("estimate/residuals/3", None), "residuals"),
    (put("estimate/parameters", []), "parameters"),
    (put("prediction/poses", 1.5), "poses"),
    (put("prediction/components/z/after/rms", "nan"), "rms"),
    # values outside of their range
    (put("prediction/reference", "nonsense"), "prediction.reference"),
    (put("gap/verdict", "maybe"), "gap.verdict"),
    (put("gap/traces/0/kind", "spiral"), "gap.traces"),
    (put("gap/mixture/answers/0/probability", 1.5), "gap.mixture.answers"),
    (put("gap/mixture/parameters/da1y/within", -0.1), "gap.mixture.parameters"),
    (put("gap/closure/0/split", "half"), "gap.closure"),
    (put("identifiability/rank", -1), "identifiability.rank"),
    (put("prediction/components/z/after/rms", -2.0), "after.rms"),
    (put("acceptance/poses", []), "acceptance.poses"),
    (put("drawing/tool_points/0", [1.0]), "drawing.tool_points"),
    (put("drawing/lines/0/points/0", [1.0, 2.0]), "drawing.lines"),
    (put("gap/spots/0/at", []), "gap.spots"),
    (put("gap_before/table/absorbed/0", ["backlash"]), "gap_before.table.absorbed"),
]
CONTRADICTIONS: list[tuple[Change, str]] = [
    (drop("machine/parameters/0/name"), "machine.parameters[1].name"),
    (put("machine/parameters/0/tolerance", "much"), "machine.parameters[1].tolerance"),
    # lengths
    (drop("estimate/residuals/3"), "estimate.residuals"),
    (twice("estimate/residuals_before"), "estimate.residuals_before"),
    (drop("estimate/channels/0"), "estimate.residuals"),
    (put("estimate/covariance", [[1.0]]), "estimate.covariance"),
    (drop("posterior/directions/0"), "posterior.corner[1]"),
    (drop("posterior/corner/2/1"), "posterior.corner[3]"),
    (twice("identifiability/parameters"), "identifiability.parameters"),
    (put("identifiability/singular_values", []), "identifiability.rank"),
    (drop("kappa_maps/0/kappa/1"), "kappa_maps[1].kappa"),
    (drop("kappa_maps/1/kappa/1/4"), "kappa_maps[2].kappa[2]"),
    (twice("kappa_maps/0/points"), "kappa_maps[1].kappa[1]"),
    (drop("held_out/0/half_widths/5"), "held_out[1].half_widths"),
    (put("held_out/1/n", 3), "held_out[2].residuals"),
    (drop("drawing/reading_of/0"), "drawing.reading_of"),
    (drop("drawing/commands/2"), "drawing.commands"),
    (put("prediction/map/0/at", [1.0, 2.0]), "prediction.map[2].at"),
    (put("prediction/map/2/at", []), "prediction.map[3].at"),
    (twice("gap/traces/0/after"), "gap.traces[1].after"),
    (put("gap/answers/0/classes", [["a"], ["b"]]), "gap.answers[1].classes"),
    (drop("gap_before/table/apart/0"), "gap_before.table.apart"),
    (drop("gap_before/table/angles_deg/1/1"), "gap_before.table.angles_deg[2]"),
    (drop("corrected/tables/0/values/0"), "corrected.tables[1].table"),
    (drop("corrected/tables/0/joints/0"), "corrected.tables[1].table[1][1]"),
    (put("corrected/covariance", [[]]), "corrected.covariance"),
    (drop("gap/mixture/covariance/0"), "gap.mixture.covariance"),
    # names
    (put("estimate/channels/0", "angle"), "estimate.channels"),
    (rename("estimate/rms_after/length"), "estimate.rms_after"),
    (rename("estimate/units/length"), "estimate.channels"),
    (rename("identifiability/lost/0/da1y"), "identifiability.lost[1]"),
    (rename("prediction/unit/z"), "prediction.unit"),
    (rename("prediction/components/z"), "prediction.unit"),
    (rename("prediction/map/0/after/z"), "prediction.map[1].after"),
    (rename("prediction/map/1/command/z_mm"), "prediction.map[2]"),
    (put("prediction/wanted", {"nonsense": 1.0}), "prediction.wanted"),
    (put("design/poses/0/setup", "nonsense"), "design.poses[1].setup"),
    (put("drawing/reading_of/0", "nonsense"), "drawing.reading_of"),
    (put("gap/selected", ["nonsense"]), "gap.selected"),
    (put("gap/coefficients/0/effect", "gravity"), "gap.coefficients[1].effect"),
    (rename("gap/sizes/0/rms/length"), "gap.sizes[1].rms"),
    (rename("gap/rms_after/length"), "gap.rms_after"),
    (put("gap_before/table/names/0", "nonsense"), "gap_before.table.names"),
    (
        rename("corrected/constants/backlash"),
        "corrected.effects.backlash: leg 1.effect",
    ),
    (put("gap/mixture/controller", {"nonsense": 1.0}), "gap.mixture.controller"),
    (rename("gap/mixture/choices/0/rms/z"), "gap.mixture.choices[1].rms"),
    (rename("gap/mixture/prediction/unit/z"), "gap.mixture.prediction.unit"),
    (rename("acceptance/poses/1/z_mm"), "acceptance.poses[2]"),
    # values and units
    (put("gap/mixture/parameters/da1y/unit", "el"), "gap.mixture.parameters.da1y"),
    (put("estimate/units/length", "furlong"), "estimate.units.length"),
    (put("prediction/components/z/after/unit", "mm"), "prediction.components.z.after"),
    (put("identifiability/rank", 99), "identifiability.rank"),
    (put("estimate/chi2", 1e300), "estimate.chi2"),
    (put("estimate/dof", -1e300), "estimate.dof"),
]


def test_the_whole_result_agrees():
    """And so do the other samples; otherwise the refusals below would say nothing."""
    for build in (whole, report_fixture.sample, report_fixture.bare):
        assert not list(breaches(report_fixture.result_of(build())))


@pytest.mark.parametrize(("change", "field"), CONTRADICTIONS)
def test_a_contradiction_is_named_by_its_field(change, field):
    plain = whole()
    change(plain)
    result = msgspec.json.decode(msgspec.json.encode(plain), type=StudyResult)
    assert any(field in breach.field for breach in breaches(result))


def verdict(unit: str) -> dict[str, object]:
    sizes = dict.fromkeys(("rms", "max", "limit", "promised"), 1.0)
    return {**sizes, "unit": unit, "passed": True}


def positioning(unit: str) -> dict[str, object]:
    sizes = dict.fromkeys(("accuracy", "systematic", "repeatability"), 1.0)
    missing = dict.fromkeys(("mean", "reversal"))
    return {"targets": 5, "approaches": 5, **sizes, **missing, "unit": unit}


@pytest.mark.parametrize(("name", "shown", "field"), [
    ("z", "um", None),
    ("z", "furlong", "verification.positioning.z.unit"),
    ("y", "um", "verification.positioning"),
])  # fmt: skip
def test_positioning_is_of_the_components_in_a_known_unit(name, shown, field):
    plain = whole()
    plain["verification"] = {
        "passed": True,
        "readings": 9,
        "components": {"z": verdict("um")},
        "positioning": {name: positioning(shown)},
    }
    result = report_fixture.result_of(plain)
    found = [breach.field for breach in breaches(result)]
    assert found == ([] if field is None else [field])


def budget() -> dict[str, object]:
    """A budget of the components of the whole result, by two sources and two effects."""
    sizes = dict.fromkeys(whole()["prediction"]["components"], 1.0)
    parts = dict.fromkeys(("share", "size", "without", "halved"), sizes)
    effect = dict.fromkeys(("effect", "about", "expected", "remedy"), "gravity")
    effect |= dict.fromkeys(("size", "with_it", "far"), sizes)
    return {
        "predicted": sizes,
        "lines": [{"source": name, "kind": "instrument", **parts} for name in "ab"],
        "unmodelled": [effect, effect],
    }


@pytest.mark.parametrize("part", [
    *(f"lines/1/{name}" for name in ("share", "size", "without", "halved")),
    *(f"unmodelled/1/{name}" for name in ("size", "with_it", "far")),
])  # fmt: skip
def test_a_line_of_a_budget_is_named_by_its_number(part):
    plain = whole()
    plain["prediction"]["budget"] = json.loads(json.dumps(budget()))
    assert not list(breaches(report_fixture.result_of(plain)))
    put(f"prediction/budget/{part}", {"furlong": 1.0})(plain)
    found = fields(breaches(report_fixture.result_of(plain)))
    path = part.replace("/1/", "[2].")
    assert set(found) == {f"prediction.budget.{path}"}


@pytest.mark.parametrize(("change", "field"), OTHER_TYPES)
def test_another_type_is_refused_by_its_field(change, field):
    plain = whole()
    change(plain)
    with pytest.raises(msgspec.ValidationError, match=field):
        msgspec.json.decode(msgspec.json.encode(plain), type=StudyResult)


# -- values ----------------------------------------------------------------------------
def fields(found: Iterator[Breach]) -> list[str]:
    return [one.field for one in found]


def test_numbers_that_no_result_has_are_found_anywhere():
    tree = {"a": [1.0, {"b": float("inf")}], "c": (2.0, -1e101), "d": "text"}
    assert fields(value_breaches((), tree)) == ["a[2].b", "c[2]"]


@pytest.mark.parametrize("place", ["seconds", "estimate/chi2", "estimate/residuals/3"])
def test_the_field_of_a_number_that_no_result_has_is_its_place(place):
    """It is the whole path, and nothing stands before it."""
    plain = whole()
    put(place, 1e101)(plain)
    result = report_fixture.result_of(plain)
    path = place.replace("/", ".").replace(".3", "[4]")
    assert path in fields(breaches(result))


def test_the_message_has_both_sides():
    plain = whole()
    drop("estimate/residuals/3")(plain)
    (length,) = breaches(report_fixture.result_of(plain))
    count = len(whole()["estimate"]["residuals"])
    assert length.problem == f"{count - 1}, where estimate.channels has {count}"
    plain = whole()
    put("design/poses/1/setup", "nonsense")(plain)
    (name,) = breaches(report_fixture.result_of(plain))
    assert name.field == "design.poses[2].setup"
    assert "'nonsense' is not in setups.name" in name.problem


#: one of each kind; tests/oed/result has all
MUTATIONS: list[tuple[Change, str]] = [
    (drop("machine"), "machine"), (put("estimate/colour", "blue"), "colour"),
    (drop("machine/parameters/0/name"), "machine.parameters[1].name"),
    (put("seed", "three"), "seed"),
    (twice("gap/traces/0/after"), "gap.traces[1].after"),
    (rename("prediction/unit/z"), "prediction.unit"),
    (put("gap/verdict", "maybe"), "gap.verdict"),
    (put("identifiability/rank", 99), "identifiability.rank"),
    (put("estimate/chi2", 1e300), "estimate.chi2"),
]  # fmt: skip


@pytest.mark.parametrize(("change", "field"), MUTATIONS)
def test_a_contradiction_is_refused_with_its_field(change, field, tmp_path, capsys):
    plain = whole()
    change(plain)
    (tmp_path / "result.json").write_bytes(msgspec.json.encode(plain))
    assert main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert field in error
    assert str(tmp_path / "result.json") in error
    assert error.count("\n") == 1
    assert len(error) < 800
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_units_of_effects_are_known():
    """SI units of the catalogue, as products of base units, and not of others."""
    effects = [effect for _, effect in catalogue.named_items("effects").values()]
    written = {unit for effect in effects for unit in effect.units.values()}
    assert {"N2/m2", "1/K", "m/N", "s2"} <= written
    refused = [unit for unit in written if list(value_breaches((), {"unit": unit}))]
    assert refused == []
    assert list(value_breaches((), {"unit": "furlong/N2"}))


@pytest.mark.parametrize("text", ['{"schema": NaN}', '{"schema"', "[]", "nan"])
def test_a_file_that_is_no_result(text, tmp_path, capsys):
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    assert main(["report", str(tmp_path)]) == 2
    assert "this is no result" in capsys.readouterr().err


# -- at random -------------------------------------------------------------------------
def places(tree: Any, path: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """Paths of all entries of nested tables and lists."""
    keys = list(tree) if isinstance(tree, dict) else range(len(tree))
    found: list[tuple[Any, ...]] = []
    for key in keys:
        found.append((*path, key))
        if isinstance(tree[key], dict | list):
            found += places(tree[key], (*path, key))
    return found


@functools.cache
def _by_depth() -> dict[str, list[tuple[Any, ...]]]:
    """Places of the whole result by what stands there, so that each kind is drawn."""
    groups: dict[str, list[tuple[Any, ...]]] = {}
    for path in places(whole_once()):
        kind = ".".join("#" if isinstance(key, int) else key for key in path)
        groups.setdefault(kind, []).append(path)
    return groups


def mutate(tree: Any, draw: st.DataObject) -> None:
    """Drop, double, empty or replace an entry."""
    kind = draw.draw(st.sampled_from(sorted(_by_depth())))
    *way, key = draw.draw(st.sampled_from(_by_depth()[kind]))
    for step in way:
        tree = tree[step]
    value = tree[key]
    choices: list[Any] = ["drop", None, 0, -1, 1e308, "nonsense", [], {}]
    if isinstance(value, list) and value:
        choices += [value[:-1], [*value, value[-1]], value[::-1]]
    if isinstance(value, dict) and value:
        first = next(iter(value))
        choices += [{"nonsense" if k == first else k: v for k, v in value.items()}]
        choices += [{k: v for k, v in value.items() if k != first}]
    choice = draw.draw(st.sampled_from(choices))
    if choice == "drop":
        del tree[key]
    else:
        tree[key] = choice


@settings(
    max_examples=60,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
@given(st.data())
def test_what_is_not_refused_can_be_shown(draw):
    """All text of the report; its pictures take too long for so many."""
    plain = whole()
    mutate(plain, draw)
    try:
        result = msgspec.json.decode(msgspec.json.encode(plain), type=StudyResult)
    except msgspec.DecodeError:
        return
    if list(breaches(result)):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer_parts(result)
        sections.chapters(result)
        sections.appendix(result)
        PageView.from_result(result)


def test_what_no_drive_corrects_is_judged_by_its_unknown_part():
    sizes = [SpreadRecord(k, k, k, "um") for k in (1.0, 2.0, 3.0)]
    driven = ComponentAccuracy(True, *sizes, {})
    free = ComponentAccuracy(False, *sizes, {})
    assert (driven.judged.rms, free.judged.rms) == (2.0, 3.0)


def test_what_readings_cannot_show_is_no_visible_probability():
    answer = AnswerRecord(["play"], 0.7, unseen=0.2)
    assert answer.visible == pytest.approx(0.5)


def test_every_record_is_frozen_and_refuses_unknown_fields():
    """An edited file is never read in part."""
    assert result.StudyResult in Record.__subclasses__()
    records = [r for r in Record.__subclasses__() if r.__module__.startswith("oed.")]
    assert len(records) > 60
    for record in records:
        assert record.__struct_config__.frozen
        assert record.__struct_config__.forbid_unknown_fields


def test_missing_numbers_are_null_in_the_file():
    section = GoodnessSection(None, 3.0, None, np.nan)
    plain = msgspec.json.decode(msgspec.json.encode(section))
    assert (plain["chi2"], plain["dof"], plain["p_high"]) == (None, 3.0, None)


def test_no_gap_is_reported_from_where_both_errors_cost_as_much():
    """P times a test in vain is (1 - P) times a missed gap."""
    missed, p = GapSection.MISSED_GAP_COST, GapSection.NO_GAP_PROBABILITY
    assert missed * (1.0 - p) == pytest.approx(p)
