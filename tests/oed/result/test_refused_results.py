"""A result.json that contradicts itself is refused at the door, with its field."""

import functools
import warnings
from typing import Any

import msgspec
import pytest
from hypothesis import HealthCheck, Phase, given, settings
from hypothesis import strategies as st
from result_sample import Change, drop, put, rename, twice, whole, whole_once

from oed.result import StudyResult
from oed.result.agreement import breaches, value_breaches
from pkm_reports import sections
from pkm_reports.sections import answer_parts
from pkm_reports.view import PageView
from pkm_studies import catalogue
from pkm_studies.commands import main

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
