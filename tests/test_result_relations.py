"""A result.json that contradicts itself is refused at the door, with its field."""

from __future__ import annotations

import copy
import functools
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import msgspec
import pytest
import report_fixture
import report_fixture_plan
import report_fixture_view
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st

from oed.result import StudyResult, relations
from pkm_reports import sections
from pkm_reports.sections import answer
from pkm_reports.view import scene
from pkm_studies.commands import cli

Change = Callable[[Any], None]


def gap() -> dict[str, Any]:
    """A diagnosis of two channels, as small as it can be."""
    trace = {
        "setup": "short tool",
        "run": "1",
        "base": "1",
        "channel": "length",
        "unit": "um",
        "kind": "circle",
        **{
            name: [0.0, 1.0, 2.0]
            for name in ("at", "before", "explained", "unexplained", "after")
        },
    }
    coefficient = {"effect": "backlash", "name": "play", "label": "leg 1", "unit": "m"}
    closure = dict.fromkeys(("value", "low", "high", "p_worse", "s0", "s1", "s_noise"))
    return {
        "verdict": "effect",
        "answers": [
            {"effects": ["backlash"], "probability": 0.9, "classes": [["backlash"]]}
        ],
        "set95": [{"effects": ["backlash"], "probability": 0.9}],
        "where": [{"block": "leg 1", "p_value": 0.01}],
        "closure": [{**closure, "split": "within", "n": 30}],
        "not_testable": [],
        "confusable": [],
        "selected": ["backlash"],
        "tried": ["backlash", "gravity"],
        "marginal": {"backlash": 0.9, "gravity": 0.05},
        "coefficients": [{**coefficient, "value": 1e-6, "sd": 1e-7, "prior_sd": 1e-5}],
        "sizes": [
            {"effect": "backlash", "rms": {"length": 3.0}, "detectability": 20.0}
        ],
        "units": {"length": "um"},
        "rms_before": {"length": 3.0},
        "rms_after": {"length": 0.5},
        "traces": [trace],
        "spots": [{"at": [0.0, 0.0, 0.0], "before": 1.0, "after": 0.5}],
    }


def corrected() -> dict[str, Any]:
    fitted = report_fixture.sample()["estimate"]
    table = {
        "effect": "backlash",
        "state": "direction",
        "joint_wise": True,
        "values": [-1.0, 1.0],
        "joints": ["q1_mm", "q2_mm"],
        "commands": [{"z_mm": 1.0}, {"z_mm": 2.0}, {"z_mm": 3.0}],
        "table": [[[0.0, 0.0]] * 3] * 2,
    }
    effect = {"value": 1.0, "sd": 0.1, "unit": "um", "effect": "backlash"}
    count = len(fitted["parameters"])
    return {
        "parameters": fitted["parameters"],
        "effects": {"backlash: leg 1": {**effect, "prior_sd": 10.0}},
        "constants": {"backlash": {}},
        "conditions": ["the direction is known"],
        "origin": "diagnosis",
        "rms_after": {"length": 0.5},
        "units": {"length": "um"},
        "readings": 30,
        "chi2": 9.0,
        "dof": 8.0,
        "covariance": [[0.0] * count] * count,
        "tables": [table],
    }


def gap_before() -> dict[str, Any]:
    record = {
        "about": "",
        "columns": 1,
        "detectability": 5.0,
        "low": 4.0,
        "high": 6.0,
        "power": 0.9,
        "visible": True,
        "signature": {"length": 1.0},
        "absorbed": 0.2,
        "least": {"length": 0.5},
        "median": {"length": 0.6},
        "sizes": {},
        "rivals": [],
        "not_testable": None,
    }
    names = ["backlash", "gravity"]
    return {
        "table": {
            "readings": 30,
            "effects": [{"name": name, **record} for name in names],
            "names": names,
            "apart": [[5.0, 1.0], [2.0, 4.0]],
            "angles_deg": [[90.0, 20.0], [20.0, 90.0]],
            "classes": [names],
            "absorbed": [names],
            "exact": [],
        },
        "units": {"length": "um"},
        "chosen": None,
        "words": ["Both can be found."],
    }


def acceptance() -> dict[str, Any]:
    demand = {"promised": 1.0, "limit": 2.0, "power": 0.9, "uncertainty": 0.1}
    return {
        "poses": [{"z_mm": 1.0}, {"z_mm": 2.0}],
        "components": {"z": {**demand, "unit": "um"}},
        "reference": "home",
        "miss": 1.3,
        "false_alarm": 0.05,
    }


@functools.cache
def _whole() -> dict[str, Any]:
    plain = report_fixture_view.sample()
    plain |= {
        "plan": report_fixture_plan.plan(),
        "gap": gap(),
        "gap_before": gap_before(),
        "acceptance": acceptance(),
        "corrected": corrected(),
    }
    decoded: dict[str, Any] = msgspec.json.decode(msgspec.json.encode(plain))
    return decoded


def whole() -> dict[str, Any]:
    """A result with all sections, which agree."""
    return copy.deepcopy(_whole())


def at(tree: Any, path: str) -> tuple[Any, Any]:
    """Container and key of a dotted path; numbers are indices."""
    *way, last = [int(k) if k.isdigit() else k for k in path.split("/")]
    for key in way:
        tree = tree[key]
    return tree, last


def drop(path: str) -> Change:
    def change(tree: Any) -> None:
        container, key = at(tree, path)
        del container[key]

    return change


def put(path: str, value: Any) -> Change:
    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container[key] = value

    return change


def rename(path: str) -> Change:
    """Another name for an entry of a table."""

    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container["nonsense"] = container.pop(key)

    return change


def twice(path: str) -> Change:
    """The last entry of a list once more."""

    def change(tree: Any) -> None:
        container, key = at(tree, path)
        container[key].append(container[key][-1])

    return change


MUTATIONS: list[tuple[Change, str]] = [
    # keys that are missing, and unknown ones
    (drop("machine"), "machine"),
    (drop("machine/name"), "name"),
    (drop("estimate/residuals"), "residuals"),
    (drop("prediction/components/z/after"), "after"),
    (put("estimate/colour", "blue"), "colour"),
    (drop("machine/parameters/0/name"), "machine.parameters[1].name"),
    (put("machine/parameters/0/tolerance", "much"), "machine.parameters[1].tolerance"),
    # types
    (put("seed", "three"), "seed"),
    (put("headline", "a sentence"), "headline"),
    (put("estimate/residuals/3", None), "residuals"),
    (put("estimate/parameters", []), "parameters"),
    (put("prediction/poses", 1.5), "poses"),
    (put("prediction/components/z/after/rms", "nan"), "rms"),
    # lengths
    (drop("estimate/residuals/3"), "estimate.residuals"),
    (twice("estimate/residuals_before"), "estimate.residuals_before"),
    (drop("estimate/channels/0"), "estimate.residuals"),
    (put("estimate/covariance", [[1.0]]), "estimate.covariance"),
    (drop("posterior/directions/0"), "posterior.corner[1]"),
    (drop("posterior/corner/2/1"), "posterior.corner[3]"),
    (twice("identifiability/parameters"), "identifiability.parameters"),
    (put("identifiability/singular_values", []), "identifiability.singular_values"),
    (drop("kappa_maps/0/kappa/1"), "kappa_maps[1].kappa"),
    (drop("kappa_maps/1/kappa/1/4"), "kappa_maps[2].kappa[2]"),
    (twice("kappa_maps/0/points"), "kappa_maps[1].kappa[1]"),
    (drop("held_out/0/half_widths/5"), "held_out[1].half_widths"),
    (put("held_out/1/n", 3), "held_out[2].residuals"),
    (drop("drawing/reading_of/0"), "drawing.reading_of"),
    (drop("drawing/commands/2"), "drawing.commands"),
    (put("drawing/tool_points/0", [1.0]), "drawing.tool_points[1]"),
    (put("drawing/lines/0/points/0", [1.0, 2.0]), "drawing.lines[1].points[1]"),
    (put("prediction/map/0/at", [1.0, 2.0]), "prediction.map[1].at"),
    (put("prediction/map/2/at", []), "prediction.map[3].at"),
    (twice("gap/traces/0/after"), "gap.traces[1].after"),
    (put("gap/answers/0/classes", [["a"], ["b"]]), "gap.answers[1].classes"),
    (put("gap/spots/0/at", []), "gap.spots[1]"),
    (drop("gap_before/table/apart/0"), "gap_before.table.apart"),
    (drop("gap_before/table/angles_deg/1/1"), "gap_before.table.angles_deg[2]"),
    (put("gap_before/table/absorbed/0", ["backlash"]), "gap_before.table.absorbed[1]"),
    (drop("corrected/tables/0/values/0"), "corrected.tables[1].table"),
    (drop("corrected/tables/0/joints/0"), "corrected.tables[1].table[1][1]"),
    (put("corrected/covariance", [[]]), "corrected.covariance"),
    (put("acceptance/poses", []), "acceptance.poses"),
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
    (rename("acceptance/poses/1/z_mm"), "acceptance.poses[2]"),
    # values and units
    (put("prediction/reference", "nonsense"), "prediction.reference"),
    (put("gap/verdict", "maybe"), "gap.verdict"),
    (put("gap/traces/0/kind", "spiral"), "gap.traces[1].kind"),
    (put("gap/closure/0/split", "half"), "gap.closure[1].split"),
    (put("estimate/units/length", "furlong"), "estimate.units.length"),
    (put("prediction/components/z/after/unit", "mm"), "prediction.components.z.after"),
    (put("identifiability/rank", 99), "identifiability.rank"),
    (put("identifiability/rank", -1), "identifiability.rank"),
    (
        put("prediction/components/z/after/rms", -2.0),
        "prediction.components.z.after.rms",
    ),
    (put("estimate/chi2", 1e300), "estimate.chi2"),
    (put("estimate/dof", -1e300), "estimate.dof"),
]


def test_the_whole_result_agrees() -> None:
    """And so do the other samples; otherwise the refusals below would say nothing."""
    for build in (whole, report_fixture.sample, report_fixture.bare):
        assert not list(relations.breaches(report_fixture.result_of(build())))


@pytest.mark.parametrize(("change", "field"), MUTATIONS)
def test_a_contradiction_is_refused_with_its_field(
    change: Change,
    field: str,
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:
    plain = whole()
    change(plain)
    (tmp_path / "result.json").write_bytes(msgspec.json.encode(plain))
    assert cli.main(["report", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert field in error
    assert str(tmp_path / "result.json") in error
    assert error.count("\n") == 1
    assert len(error) < 800
    assert [path.name for path in tmp_path.iterdir()] == ["result.json"]


def test_there_are_enough_of_them() -> None:
    assert len(MUTATIONS) >= 40


@pytest.mark.parametrize("text", ['{"schema": NaN}', '{"schema"', "[]", "nan"])
def test_a_file_that_is_no_result(
    text: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "result.json").write_text(text, encoding="utf-8")
    assert cli.main(["report", str(tmp_path)]) == 2
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
    for path in places(_whole()):
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
    max_examples=150,
    deadline=None,
    phases=[Phase.explicit, Phase.reuse, Phase.generate],
    suppress_health_check=[HealthCheck.too_slow],
)
@given(st.data())
def test_what_is_not_refused_can_be_shown(draw: st.DataObject) -> None:
    """All text of the report; its pictures take too long for so many."""
    plain = whole()
    mutate(plain, draw)
    try:
        result = msgspec.json.decode(msgspec.json.encode(plain), type=StudyResult)
    except msgspec.DecodeError:
        return
    if list(relations.breaches(result)):
        return
    with warnings.catch_warnings():
        warnings.simplefilter("error")
        answer.parts(result)
        sections.chapters(result)
        sections.appendix(result)
        scene.build(result)
