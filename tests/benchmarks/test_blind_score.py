"""The blind benchmark's scorer: each measure counts the cases it is about, and what is
written is whole.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from blind_labels import LIBRARY, answer, by_key, case, entries_of, good, known, result


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The scorer's modules."""
    return blind_modules(
        "confusion",
        "diagnosis_measures",
        "entries",
        "judge",
        "measures",
        "paired",
        "score",
        "table",
    )


def test_right_answers_reach_every_aim(blind):
    entries = good(blind)
    rows = by_key(
        [
            *blind.measures.rows(entries),
            *blind.diagnosis_measures.diagnosis_rows(entries),
        ]
    )
    wanted = {k: r for k, r in rows.items() if r.sense}
    assert {k: r.status for k, r in wanted.items() if k != "set95"} == dict.fromkeys(
        set(wanted) - {"set95"}, "aim"
    )
    assert rows["set95"].value == 1.0
    assert rows["set95"].count == len(entries)
    assert rows["set95"].status == "above"
    assert rows["closure whole"].value == pytest.approx(1.0)
    assert rows["closure whole"].count == 5  # neither null nor unknown cases
    assert rows["right class"].count == 2
    assert rows["right class unseen"].count == 1


def test_an_idle_diagnosis_raises_no_alarm_and_finds_nothing(blind):
    idle = [
        blind.entries.entry(e.label, e.oracle, result(answer())) for e in good(blind)
    ]
    rows = by_key(
        [*blind.measures.rows(idle), *blind.diagnosis_measures.diagnosis_rows(idle)]
    )
    assert rows["alarm white"].status == "aim"
    for key in (
        "detection 6",
        "detection 10",
        "right class",
        "pairs",
        "unknown",
        "probability",
        "closure whole",
        "place",
    ):
        assert rows[key].value == 0.0
        assert rows[key].status == "no"
    assert rows["set95"].hits == len(blind.measures.LAWS)
    assert (rows["place"].count, rows["place seen"].count) == (2, 0)


def test_place_is_told_apart_where_a_gap_is_seen(blind):
    lost, wrong = (
        blind.entries.entry(e.label, e.oracle, outcome)
        for e, outcome in zip(
            [e for e in good(blind) if e.blocks],
            (
                result(answer()),
                result(
                    answer("backlash"),
                    where=[{"block": "leg 1", "p_value": 0.001, "strength": 1.0}],
                ),
            ),
            strict=True,
        )
    )
    rows = by_key(blind.diagnosis_measures.diagnosis_rows([*good(blind), lost, wrong]))
    assert (rows["place"].hits, rows["place"].count) == (2, 4)
    assert (rows["place seen"].hits, rows["place seen"].count) == (2, 3)


def test_a_failed_diagnosis_is_wrong_in_every_count(blind):
    failed = [
        blind.entries.entry(e.label, e.oracle, {"error": "x"}) for e in good(blind)
    ]
    rows = by_key(
        [*blind.measures.rows(failed), *blind.diagnosis_measures.diagnosis_rows(failed)]
    )
    bad = {k for k, r in rows.items() if r.sense and r.status != "no"}
    assert bad == {"set95 size"}  # an empty set is small


def test_what_is_counted_where(blind):
    far, near = case("single", {"backlash": 20.0}), case("single", {"friction": 2.0})
    hidden, exact = (
        case("single", {"gravity": 10.0}),
        case("exact", {"bar_length": 6.0}),
    )
    unseen = case("unknown", {"pump": 20.0})
    entries = [
        blind.entries.entry(far, known(far, apart=3.0), result(answer("friction"))),
        blind.entries.entry(near, known(near), result(answer("unknown"))),
        blind.entries.entry(
            hidden, known(hidden, testable=("backlash",)), result(answer("unknown"))
        ),
        blind.entries.entry(exact, known(exact), result(answer("bar_length"))),
        blind.entries.entry(
            unseen, known(unseen, beyond=2.0), result(answer("step", "gravity"))
        ),
    ]
    rows = by_key(blind.measures.rows(entries))
    assert rows["right class"].count == 1  # `near` alone: apart, and testable
    assert rows["right class 6"].count == 1  # `far` alone: neither small nor untestable
    assert (rows["detection 10"].hits, rows["detection 10"].count) == (2, 2)
    assert rows["called unknown"].count == 1
    assert rows["called unknown"].hits == 0
    assert rows["exact class"].hits == 1
    assert rows["unknown"].count == 0
    assert rows["unknown"].status == "-"
    assert rows["unknown 6"].hits == 0
    assert rows["false effects"].value == pytest.approx((1 + 0 + 0 + 0 + 2) / 5)
    assert rows["untestable named"].hits == 0


@pytest.mark.parametrize(
    ("by_library", "counted"), [(2.0, 1), (7.9, 1), (8.1, 0), (12.0, 0)]
)
def test_the_librarys_form_shows_an_effect_where_it_explains_more_than_any_rivals(
    blind, by_library, counted
):
    """Of 10 a rival leaves all: the own form must leave less than 8 for 6 more to be
    explained.
    """
    label = case("single", {"backlash": 20.0})
    entry = blind.entries.entry(
        label, known(label, by_library=by_library), result(answer("backlash"))
    )
    rows = by_key(blind.measures.rows([entry]))
    assert (rows["right class"].count, rows["right class shown"].count) == (1, counted)
    assert rows["right class shown"].sense == ""
    assert entry.shown == pytest.approx(math.sqrt(max(100.0 - by_library**2, 0.0)))


@pytest.mark.parametrize(
    ("other", "shown"),
    [(9.0, 8.0), (5.0, math.sqrt(8.0)), (3.0, 0.0), (None, math.sqrt(83.0))],
)
def test_a_leg_is_shown_where_a_form_in_it_explains_more_than_any_in_another(
    blind, other, shown
):
    """Of 10 a form in the right leg leaves sqrt(17); without a form in another leg all
    of 10 is left there.
    """
    label = case("single", {"backlash": 10.0}, blocks=("leg 1",))
    figures = known(label)
    figures["effects"][0]["legs"] = {"leg 1": math.sqrt(17.0)} | (
        {} if other is None else {"leg 2": other, "leg 3": 9.9}
    )
    where = [{"block": "leg 2", "p_value": 0.001, "strength": 1.0}]
    entry = blind.entries.entry(label, figures, result(answer("backlash"), where=where))
    rows = by_key(blind.diagnosis_measures.diagnosis_rows([entry]))
    counts = [
        (rows[key].hits, rows[key].count) for key in ("leg shown", "leg not shown")
    ]
    assert entry.leg_shown == pytest.approx(shown)
    assert counts == ([(0, 1), (0, 0)] if shown >= 6.0 else [(0, 0), (0, 1)])
    assert rows["leg shown"].sense == ""


def test_a_pair_counts_where_both_can_be_told_apart(blind):
    label = case("pair", {"backlash": 6.0, "gravity": 10.0})
    near = known(label)
    near["effects"][1]["apart"] = 2.0
    entries = [
        blind.entries.entry(label, o, result(answer("backlash", "gravity")))
        for o in (known(label), near)
    ]
    rows = by_key(blind.measures.rows(entries))
    assert rows["pairs"].count == 1
    assert rows["pairs 6"].count == 2


def test_padded_classes_show(blind):
    label = case("single", {"backlash": 10.0})
    padded = answer("friction", classes=[list(LIBRARY)])
    (entry,) = entries_of(blind, (label, result(padded)))
    rows = by_key(
        [
            *blind.measures.rows([entry]),
            *blind.diagnosis_measures.diagnosis_rows([entry]),
        ]
    )
    assert rows["right class"].value == 1.0
    assert rows["class size"].value == len(LIBRARY)


def test_probability_sums_over_answers_that_name_the_effect(blind):
    label = case("single", {"backlash": 10.0})
    answers = [
        answer("backlash", p=0.5),
        answer("backlash", "unknown", p=0.2),
        answer("backlash", "step", p=0.2),
    ]
    rows = by_key(
        blind.diagnosis_measures.diagnosis_rows(
            entries_of(blind, (label, result(*answers)))
        )
    )
    assert rows["probability"].value == pytest.approx(0.7)


def test_closure_is_over_the_oracles_and_only_where_something_is_to_be_gained(blind):
    label = case("single", {"backlash": 10.0})
    half = [
        {"split": "whole", "s0": 6.0, "s1": 4.0}
    ]  # at another level: S0 is twice the oracle's
    one = blind.entries.entry(
        label, known(label), result(answer("backlash"), closure=half)
    )
    little = known(label)
    little["closure"][1]["expected_gain"] = 35.0
    other = blind.entries.entry(label, little, result(answer("backlash"), closure=half))
    assert blind.diagnosis_measures.closure_ratios(
        [one, other], "whole"
    ) == pytest.approx([0.5])


def test_paired_comparison_with_a_baseline(blind):
    right = [
        (
            case("single", {"backlash": 6.0}),
            result(answer("backlash"), baseline=["friction"]),
        )
    ] * 9
    wrong = [
        (case("single", {"backlash": 6.0}), result(answer(), baseline=["backlash"]))
    ]
    by_measure = {
        p.measure: p
        for p in blind.paired.compare(entries_of(blind, *right, *wrong), "harmonic")
    }
    same = by_measure["detection at sqrt(lambda) >= 6"]
    assert (same.diagnosis, same.other, same.only_diagnosis, same.only_other) == (
        9,
        10,
        0,
        1,
    )
    assert same.verdict == "no difference"
    classes = by_measure["right class at sqrt(lambda) >= 6"]
    assert (classes.only_diagnosis, classes.only_other) == (9, 1)
    assert classes.p_value == pytest.approx(22 / 1024)
    more = entries_of(blind, *right, *right, *wrong)
    better = {p.measure: p.verdict for p in blind.paired.compare(more, "harmonic")}
    assert better["right class at sqrt(lambda) >= 6"] == "diagnosis"


def test_withheld_effects_are_to_be_unknown(blind):
    label = case("single", {"backlash": 10.0})
    outcomes = [
        result(answer("unknown")),
        result(answer("friction", "unknown")),
        result(answer("friction")),
    ]
    rows = by_key(
        blind.diagnosis_measures.withheld_rows(
            entries_of(blind, *[(label, r) for r in outcomes])
        )
    )
    assert rows["withheld alone"].hits == 1
    assert rows["withheld flagged"].hits == 2
    assert rows["withheld imitated"].count == 0
