"""The blind benchmark's scorer: right answers count, wrong ones do not, and intervals are those of the textbooks."""

from __future__ import annotations

import dataclasses
import importlib
import json
import math
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from scipy import stats

ROOT = Path(__file__).resolve().parents[1]
NAMES = ("confusion", "entries", "intervals", "judge", "measures", "score", "table")
LIBRARY = ("backlash", "friction", "gravity", "bar_length", "encoder_scale", "step")


@pytest.fixture(scope="module")
def blind() -> Iterator[SimpleNamespace]:
    """The benchmark's modules; they live in the project's folder, which is not installed."""
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        found = {n: importlib.import_module(f"benchmarks.blind.{n}") for n in NAMES}
        found["main"] = importlib.import_module("benchmarks.blind.__main__").main
        yield SimpleNamespace(**found)


# -- hand-made labels, oracles and results -----------------------------------------------------------------


def case(
    kind: str, effects: dict[str, float], *, machine: str = "a3", law: str = "white", blocks: tuple[str, ...] = ()
) -> dict:
    told = [
        {"name": n, "unknown": n not in LIBRARY, "target": s, "sqrt_lambda": s, "blocks": list(blocks)}
        for n, s in effects.items()
    ]
    exact = ["encoder_scale", "bar_length"] if kind == "exact" else []
    return {"id": "x", "machine": machine, "kind": kind, "noise": {"name": law}, "effects": told, "class": exact}


def known(
    label: dict, *, apart: float = 10.0, beyond: float = 10.0, own: float = 2.0, testable: tuple[str, ...] = LIBRARY
) -> dict:
    told = [{"name": e["name"], "apart": apart, "beyond": beyond, "own": own} for e in label["effects"]]
    square = {"value": 0.9, "s0": 3.0, "s1": 1.0, "n": 100}
    closure = [{"split": s, "expected_gain": 50.0, "same_law": square} for s in ("within", "whole")]
    return {"testable": list(testable), "effects": told, "closure": closure}


def answer(*effects: str, p: float = 0.96, classes: list[list[str]] | None = None) -> dict:
    named = [[e] for e in effects if e != "unknown"]
    return {"effects": list(effects), "probability": p, "classes": named if classes is None else classes}


def result(*answers: dict, baseline: list[str] | None = None, **more: object) -> dict:
    told: dict = {"answers": list(answers), "set95": list(answers[:1]), "where": [], "closure": []}
    if baseline is not None:
        told["baselines"] = {"harmonic": baseline, "stepwise": baseline}
    return told | more


def entries_of(blind: SimpleNamespace, *cases: tuple[dict, dict]) -> list:
    return [blind.entries.entry(label, known(label), said) for label, said in cases]


def by_key(rows) -> dict:
    return {r.key: r for r in rows}


# -- intervals ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize(("hits", "count"), [(0, 73), (1, 75), (37, 40), (40, 40), (3, 4)])
def test_wilson_is_that_of_scipy(blind, hits, count):
    told = stats.binomtest(hits, count).proportion_ci(method="wilson")
    assert blind.intervals.wilson(hits, count) == pytest.approx((told.low, told.high), abs=1e-12)


def test_no_alarm_in_73_clean_sets_is_what_proves_five_per_cent(blind):
    assert blind.intervals.wilson(0, 73)[1] <= 0.05 < blind.intervals.wilson(0, 72)[1]


def test_mcnemar_counts_the_discordant_pairs(blind):
    assert blind.intervals.mcnemar(9, 1) == pytest.approx(2 * (1 + 10) / 2**10)
    assert blind.intervals.mcnemar(0, 0) == 1.0
    with pytest.raises(ValueError, match="-1"):
        blind.intervals.mcnemar(-1, 3)


def test_median_interval_covers_as_told(blind):
    assert blind.intervals.median([float(k) for k in range(1, 11)]) == (5.5, 2.0, 9.0)  # order statistics 2 and 9 of 10
    assert blind.intervals.median([1.0, 2.0, 3.0])[1:] == (-math.inf, math.inf)
    drawn = np.random.default_rng(1).exponential(size=(400, 25))
    inside = [low <= math.log(2) <= high for _, low, high in map(blind.intervals.median, drawn)]
    assert stats.binomtest(sum(inside), 400, 0.957).pvalue > 1e-3  # P(8 <= B(25, 1/2) <= 17) = 0.957


def test_mean_interval_is_students(blind):
    values = [0.2, 0.9, 1.0, 0.4]
    told = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert blind.intervals.mean(values)[1:] == pytest.approx(told)
    assert math.isnan(blind.intervals.mean([])[0])


def test_proved_is_what_the_worse_end_of_the_interval_reaches(blind):
    def row(hits: int, count: int) -> tuple[str, bool]:
        told = blind.measures.share("", "", [True] * hits + [False] * (count - hits), sense="<=", must=0.05, aim=0.02)
        return told.status, told.proved

    assert row(0, 73) == ("aim", True)
    assert row(0, 72) == ("aim", False)
    assert row(3, 75) == ("must", False)
    assert row(4, 75) == ("no", False)


# -- one answer --------------------------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effects", "classes", "truth", "found", "exact"),
    [
        (["a"], [], ["a"], 1, True),
        (["a"], [["a", "b"]], ["b"], 1, True),
        (["a"], [], ["b"], 0, False),
        (["a", "b"], [], ["a"], 1, False),
        (["a"], [["a", "b"]], ["a", "b"], 1, False),  # one class cannot stand for two effects
        (["a", "c"], [["a", "b"], ["c", "a"]], ["a", "b"], 2, True),  # only if the first class takes b
        (["a", "c"], [["a", "b"], ["c"]], ["a", "b"], 1, False),
        ([], [], [], 0, True),
        (["a", "unknown"], [["a"]], ["a"], 1, True),
        (["a", "b", "c"], [], ["c", "a"], 2, False),
    ],
)
def test_effects_found_by_an_answer(blind, effects, classes, truth, found, exact):
    said = blind.judge.said({"effects": effects, "classes": classes, "probability": 1.0})
    assert blind.judge.found(said, truth) == found
    assert blind.judge.exactly(said, truth) is exact
    assert blind.judge.false_effects(said, truth) == len(said.classes) - found


def test_right_as_a_whole(blind):
    def right(effects, truth, unknown):
        return blind.judge.right(blind.judge.said(answer(*effects)), truth, unknown)

    assert right([], [], False)
    assert not right(["unknown"], [], False)
    assert right(["unknown"], [], True)
    assert not right([], [], True)
    assert right(["a", "unknown"], ["a"], False)
    assert not right(["unknown"], ["a"], False)
    assert not right(["a"], [], True)


def test_classes_that_do_not_fit_are_refused(blind):
    with pytest.raises(ValueError, match="other classes"):
        blind.judge.said({"effects": ["a"], "classes": [["b"]]})


@pytest.mark.parametrize(
    ("one", "other", "same"),
    [
        ("leg 2", "leg 2", True),
        ("leg 2", "leg 3", False),
        ("run R01", "run R10", False),
        ("time 100-200", "time 150-250", True),  # a third in common
        ("time 100-200", "time 151-251", False),
        ("phase 350-20", "phase 0-30", True),  # over the full turn: 20 of 40 deg
        ("phase 100-130", "phase 350-20", False),
        ("direction +1", "direction -1", False),
        ("time 0-10", "phase 0-10", False),
    ],
)
def test_same_place(blind, one, other, same):
    assert blind.judge.same(one, other) is same
    assert blind.judge.same(other, one) is same


def test_place_is_that_of_the_likeliest_claimed_block(blind):
    where = [
        {"block": "leg 1", "p_value": 0.03, "strength": 0.9},
        {"block": "leg 2", "p_value": 0.001, "strength": 0.2},
        {"block": "time 0-9", "p_value": 0.2, "strength": 1.0},
    ]
    assert blind.judge.located(where, ["leg 2"], "leg")
    assert not blind.judge.located(where, ["leg 1"], "leg")
    assert not blind.judge.located(where, ["time 0-9"], "time")  # not claimed
    assert not blind.judge.located([], ["leg 1"], "leg")


def test_a_leg_that_nothing_tells_from_the_true_one_is_right(blind):
    place = [{"block": "leg 1", "p_value": 0.001, "strength": 1.0}]
    label = case("single", {"backlash": 6.0}, blocks=("leg 2", "time 0-9"))
    (entry,) = entries_of(blind, (label, result(answer("backlash"), where=place)))
    assert not blind.judge.located(place, entry.blocks, "leg")
    for ties, right in (([["leg 1", "leg 2"]], True), ([["leg 1", "leg 3"]], False), ([], False)):
        told = {**entry.oracle, "effects": [{**entry.oracle["effects"][0], "tied": ties}]}
        tied = dataclasses.replace(entry, oracle=told)
        assert blind.judge.located(place, tied.blocks, "leg") == right
        assert "time 0-9" in tied.blocks


def test_a_time_that_the_readings_do_not_tell_is_no_place(blind):
    """A stretch of the session is not asked of readings without a clock, a leg of theirs is."""
    label = case("single", {"backlash": 6.0}, blocks=("leg 2", "time 0-9", "direction +1"))
    for columns, kept in (
        (["time_s", "direction"], {"leg 2", "time 0-9", "direction +1"}), (["direction"], {"leg 2", "direction +1"}),
        ([], {"leg 2"}),
    ):  # fmt: skip
        (entry,) = entries_of(blind, (label | {"columns": columns}, result(answer("backlash"))))
        assert set(entry.blocks) == kept


# -- measures ----------------------------------------------------------------------------------------------


def good(blind) -> list:
    """Cases of every kind, all answered right."""
    one = {"split": "whole", "s0": 3.0, "s1": 1.0}
    place = [{"block": "leg 2", "p_value": 0.001, "strength": 1.0}]
    pairs = [(case("null", {}, law=law), result(answer())) for law in blind.measures.LAWS]
    for machine in ("a3", "hexapod"):
        label = case("single", {"backlash": 6.0}, machine=machine, blocks=("leg 2",))
        closure = [one, one | {"split": "within"}]
        pairs.append((label, result(answer("backlash"), where=place, closure=closure)))
    pairs.append((case("single", {"gravity": 20.0}), result(answer("gravity", "unknown"), closure=closure)))
    two = case("pair", {"gravity": 10.0, "backlash": 6.0})
    pairs.append((two, result(answer("backlash", "gravity"), closure=closure)))
    exact = answer("bar_length", classes=[["bar_length", "encoder_scale"]])
    pairs.append((case("exact", {"encoder_scale": 6.0}), result(exact, closure=closure)))
    pairs.append((case("unknown", {"pump": 10.0}), result(answer("unknown"))))
    pairs.append((case("known_unknown", {"gravity": 6.0, "pump": 10.0}), result(answer("gravity", "unknown"))))
    return entries_of(blind, *pairs)


def test_right_answers_reach_every_aim(blind):
    found = good(blind)
    rows = by_key([*blind.measures.rows(found), *blind.measures.own_rows(found)])
    wanted = {k: r for k, r in rows.items() if r.sense}
    assert {k: r.status for k, r in wanted.items() if k != "set95"} == dict.fromkeys(set(wanted) - {"set95"}, "aim")
    assert rows["set95"].value == 1.0
    assert rows["set95"].count == len(found)
    assert rows["set95"].status == "above"
    assert rows["closure whole"].value == pytest.approx(1.0)
    assert rows["closure whole"].count == 5  # neither null nor unknown cases
    assert rows["right class"].count == 2
    assert rows["right class unseen"].count == 1


def test_an_idle_diagnosis_raises_no_alarm_and_finds_nothing(blind):
    idle = [blind.entries.entry(e.label, e.oracle, result(answer())) for e in good(blind)]
    rows = by_key([*blind.measures.rows(idle), *blind.measures.own_rows(idle)])
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
        blind.entries.entry(e.label, e.oracle, told)
        for e, told in zip(
            [e for e in good(blind) if e.blocks],
            (
                result(answer()),
                result(answer("backlash"), where=[{"block": "leg 1", "p_value": 0.001, "strength": 1.0}]),
            ),
            strict=True,
        )
    )
    rows = by_key(blind.measures.own_rows([*good(blind), lost, wrong]))
    assert (rows["place"].hits, rows["place"].count) == (2, 4)
    assert (rows["place seen"].hits, rows["place seen"].count) == (2, 3)


def test_a_failed_diagnosis_is_wrong_in_every_count(blind):
    failed = [blind.entries.entry(e.label, e.oracle, {"error": "x"}) for e in good(blind)]
    rows = by_key([*blind.measures.rows(failed), *blind.measures.own_rows(failed)])
    bad = {k for k, r in rows.items() if r.sense and r.status != "no"}
    assert bad == {"set95 size"}  # an empty set is small


def test_what_is_counted_where(blind):
    far, near = case("single", {"backlash": 20.0}), case("single", {"friction": 2.0})
    hidden, exact = case("single", {"gravity": 10.0}), case("exact", {"bar_length": 6.0})
    unseen = case("unknown", {"pump": 20.0})
    found = [
        blind.entries.entry(far, known(far, apart=3.0), result(answer("friction"))),
        blind.entries.entry(near, known(near), result(answer("unknown"))),
        blind.entries.entry(hidden, known(hidden, testable=("backlash",)), result(answer("unknown"))),
        blind.entries.entry(exact, known(exact), result(answer("bar_length"))),
        blind.entries.entry(unseen, known(unseen, beyond=2.0), result(answer("step", "gravity"))),
    ]
    rows = by_key(blind.measures.rows(found))
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


@pytest.mark.parametrize(("own", "counted"), [(2.0, 1), (7.9, 1), (8.1, 0), (12.0, 0)])
def test_the_librarys_form_shows_an_effect_where_it_explains_more_than_any_rivals(blind, own, counted):
    """Of 10 a rival leaves all: the own form must leave less than 8 for 6 more to be explained."""
    label = case("single", {"backlash": 20.0})
    entry = blind.entries.entry(label, known(label, own=own), result(answer("backlash")))
    rows = by_key(blind.measures.rows([entry]))
    assert (rows["right class"].count, rows["right class shown"].count) == (1, counted)
    assert rows["right class shown"].sense == ""
    assert entry.shown == pytest.approx(math.sqrt(max(100.0 - own**2, 0.0)))


def test_a_pair_counts_where_both_can_be_told_apart(blind):
    label = case("pair", {"backlash": 6.0, "gravity": 10.0})
    near = known(label)
    near["effects"][1]["apart"] = 2.0
    found = [blind.entries.entry(label, o, result(answer("backlash", "gravity"))) for o in (known(label), near)]
    rows = by_key(blind.measures.rows(found))
    assert rows["pairs"].count == 1
    assert rows["pairs 6"].count == 2


def test_padded_classes_show(blind):
    label = case("single", {"backlash": 10.0})
    padded = answer("friction", classes=[list(LIBRARY)])
    (entry,) = entries_of(blind, (label, result(padded)))
    rows = by_key([*blind.measures.rows([entry]), *blind.measures.own_rows([entry])])
    assert rows["right class"].value == 1.0
    assert rows["class size"].value == len(LIBRARY)


def test_probability_sums_over_answers_that_name_the_effect(blind):
    label = case("single", {"backlash": 10.0})
    told = [answer("backlash", p=0.5), answer("backlash", "unknown", p=0.2), answer("backlash", "step", p=0.2)]
    rows = by_key(blind.measures.own_rows(entries_of(blind, (label, result(*told)))))
    assert rows["probability"].value == pytest.approx(0.7)


def test_closure_is_over_the_oracles_and_only_where_something_is_to_be_gained(blind):
    label = case("single", {"backlash": 10.0})
    half = [{"split": "whole", "s0": 6.0, "s1": 4.0}]  # at another level: S0 is twice the oracle's
    one = blind.entries.entry(label, known(label), result(answer("backlash"), closure=half))
    little = known(label)
    little["closure"][1]["expected_gain"] = 35.0
    other = blind.entries.entry(label, little, result(answer("backlash"), closure=half))
    assert blind.measures.closure_ratios([one, other], "whole") == pytest.approx([0.5])


def test_paired_comparison_with_a_baseline(blind):
    right = [(case("single", {"backlash": 6.0}), result(answer("backlash"), baseline=["friction"]))] * 9
    wrong = [(case("single", {"backlash": 6.0}), result(answer(), baseline=["backlash"]))]
    told = {p.measure: p for p in blind.measures.compared(entries_of(blind, *right, *wrong), "harmonic")}
    same = told["detection at sqrt(lambda) >= 6"]
    assert (same.diagnosis, same.other, same.only_diagnosis, same.only_other) == (9, 10, 0, 1)
    assert same.verdict == "no difference"
    classes = told["right class at sqrt(lambda) >= 6"]
    assert (classes.only_diagnosis, classes.only_other) == (9, 1)
    assert classes.p_value == pytest.approx(22 / 1024)
    more = entries_of(blind, *right, *right, *wrong)
    better = {p.measure: p.verdict for p in blind.measures.compared(more, "harmonic")}
    assert better["right class at sqrt(lambda) >= 6"] == "diagnosis"


def test_withheld_effects_are_to_be_unknown(blind):
    label = case("single", {"backlash": 10.0})
    told = [result(answer("unknown")), result(answer("friction", "unknown")), result(answer("friction"))]
    rows = by_key(blind.measures.withheld_rows(entries_of(blind, *[(label, r) for r in told])))
    assert rows["withheld alone"].hits == 1
    assert rows["withheld flagged"].hits == 2
    assert rows["withheld imitated"].count == 0


# -- what is written ---------------------------------------------------------------------------------------


def test_confusion_matrix(blind):
    found = [*good(blind), *entries_of(blind, (case("single", {"backlash": 6.0}), result(answer("friction"))))]
    found += entries_of(blind, (case("single", {"backlash": 6.0}), result(answer("friction", "gravity"))))
    found += entries_of(blind, (case("single", {"backlash": 4.0}), result(answer("gravity"))))  # too small to count
    counts = blind.confusion.confusion(found).counts
    assert (
        counts.loc["backlash"].to_dict() | {"backlash": 2, "friction": 1, "several": 1}
        == counts.loc["backlash"].to_dict()
    )
    assert counts.loc["backlash"].sum() == 4
    assert counts.loc["encoder_scale", "encoder_scale"] == 1  # its class was named by the other member
    assert counts.loc["(pump)", "unknown"] == 1
    assert counts.loc["none", "none"] == 5
    printed = blind.confusion.text(blind.confusion.confusion(found))
    assert "(pump)" in printed
    assert "several" in printed


def test_more_pairs_count_where_they_can_be_told_from_every_rival_and_nowhere_else(blind):
    found = good(blind)
    label = case("pair", {"gravity": 10.0, "friction": 6.0})
    wrong = result(answer("gravity", "backlash"))
    more = [blind.entries.entry(label, known(label, apart=apart), wrong) for apart in (6.0, 6.0, 5.0)]
    before, after = (by_key(blind.score.score(found, more=some).rows) for some in ((), more))
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {"pairs", "false effects pairs"}
    assert (before["pairs"].hits, before["pairs"].count) == (1, 1)
    assert (after["pairs"].hits, after["pairs"].count) == (1, 3)
    assert after["false effects pairs"].value == pytest.approx(2.0 / 3.0)
    assert blind.score.score(found, more=more).about["more"] == 2


def test_score_is_written_whole(blind, tmp_path):
    found = [
        blind.entries.entry(e.label, e.oracle, e.result | {"baselines": {"harmonic": [], "stepwise": ["step"]}})
        for e in good(blind)
    ]
    made = blind.score.score(found, [("backlash", found[5])])
    blind.score._write(made, tmp_path)
    told = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert told["about"]["cases"] == len(found)
    assert {"confusion.png", "confusion.csv", "confusion_stepwise.png", "rows.csv", "paired.csv"} <= {
        p.name for p in tmp_path.iterdir()
    }
    text = blind.table.markdown(made.rows, made.beside, made.paired, made.machines, made.about)
    line = next(t for t in text.splitlines() if t.startswith("| false alarm, white noise"))
    cells = [c.strip() for c in line.replace("\\|", "").strip("|").split("|")]
    assert cells[1:] == ["0.0 %", "0.0 to 79.3 %", "0/1", "≤ 5 %", "≤ 2 %", "aim reached", "0.0 %", "100.0 %"]
    widths = {block.count("|") for block in text.replace("\\|", "").splitlines() if block.startswith("| ---")}
    assert all(t.replace("\\|", "").count("|") in widths for t in text.splitlines() if t.startswith("| "))


def test_what_would_be_were_the_noise_known_stands_beside_the_same_cases(blind):
    found = good(blind)
    idle = [blind.entries.entry(e.label, e.oracle, result(answer())) for e in found]
    for informed, last in ((idle, "0.00"), (idle[:-1], ""), ((), None)):
        made = blind.score.score(found, informed=informed)
        text = blind.table.markdown(made.rows, made.beside, made.paired, made.machines, made.about)
        head = next(t for t in text.splitlines() if t.startswith("| measure"))
        line = next(t for t in text.splitlines() if t.startswith("| false effects a case, all cases"))
        assert head.endswith("| noise known |") == (last is not None)
        if last is not None:
            assert line.split("|")[-2].strip() == last
        assert not any(p.baseline == "noise known" for p in made.paired)


def test_no_results_is_told_with_a_remedy(blind, tmp_path, capsys):
    assert blind.main(["score", "--cases", str(tmp_path), "--results", str(tmp_path)]) == 2
    assert "`generate` wrote" in capsys.readouterr().err
    line = {"id": "x", "study": "a3_full.study.toml", "readings": "cases/x.readings.csv"}
    (tmp_path / "manifest.jsonl").write_text(json.dumps(line), encoding="utf-8")
    (tmp_path / "labels.jsonl").write_text(json.dumps(case("null", {})), encoding="utf-8")
    assert blind.main(["score", "--cases", str(tmp_path), "--results", str(tmp_path)]) == 2
    assert "with `run`" in capsys.readouterr().err
