"""What the blind benchmark's scorer writes: confusion matrix, tables, remedies."""

from __future__ import annotations

import json
from collections.abc import Callable
from types import SimpleNamespace

import pytest
from blind_labels import answer, by_key, case, entries_of, good, known, result


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


def test_confusion_matrix(blind):
    entries = [
        *good(blind),
        *entries_of(
            blind, (case("single", {"backlash": 6.0}), result(answer("friction")))
        ),
    ]
    entries += entries_of(
        blind,
        (case("single", {"backlash": 6.0}), result(answer("friction", "gravity"))),
    )
    entries += entries_of(
        blind, (case("single", {"backlash": 4.0}), result(answer("gravity")))
    )  # too small to count
    counts = blind.confusion.confusion(entries).counts
    assert (
        counts.loc["backlash"].to_dict() | {"backlash": 2, "friction": 1, "several": 1}
        == counts.loc["backlash"].to_dict()
    )
    assert counts.loc["backlash"].sum() == 4
    assert (
        counts.loc["encoder_scale", "encoder_scale"] == 1
    )  # its class was named by the other member
    assert counts.loc["(pump)", "unknown"] == 1
    assert counts.loc["none", "none"] == 5
    printed = blind.confusion.text(blind.confusion.confusion(entries))
    assert "(pump)" in printed
    assert "several" in printed


def test_more_pairs_count_where_they_can_be_told_from_every_rival_and_nowhere_else(
    blind,
):
    entries = good(blind)
    label = case("pair", {"gravity": 10.0, "friction": 6.0})
    wrong = result(answer("gravity", "backlash"))
    more = [
        blind.entries.entry(label, known(label, apart=apart), wrong)
        for apart in (6.0, 6.0, 5.0)
    ]
    before, after = (
        by_key(blind.score.score(entries, more=some).rows) for some in ((), more)
    )
    changed = {key for key in before if before[key] != after[key]}
    assert changed == {"pairs", "false effects pairs"}
    assert (before["pairs"].hits, before["pairs"].count) == (1, 1)
    assert (after["pairs"].hits, after["pairs"].count) == (1, 3)
    assert after["false effects pairs"].value == pytest.approx(2.0 / 3.0)
    assert blind.score.score(entries, more=more).about["more"] == 2


def test_score_is_written_whole(blind, tmp_path):
    entries = [
        blind.entries.entry(
            e.label,
            e.oracle,
            e.result | {"baselines": {"harmonic": [], "stepwise": ["step"]}},
        )
        for e in good(blind)
    ]
    scored = blind.score.score(entries, [("backlash", entries[5])])
    blind.score._write(scored, tmp_path)
    score_file = json.loads((tmp_path / "score.json").read_text(encoding="utf-8"))
    assert score_file["about"]["cases"] == len(entries)
    assert {
        "confusion.png",
        "confusion.csv",
        "confusion_stepwise.png",
        "rows.csv",
        "paired.csv",
    } <= {p.name for p in tmp_path.iterdir()}
    text = blind.table.markdown(
        scored.rows, scored.methods, scored.paired, scored.machines, scored.about
    )
    line = next(
        t for t in text.splitlines() if t.startswith("| false alarm, white noise")
    )
    cells = [c.strip() for c in line.replace("\\|", "").strip("|").split("|")]
    assert cells[1:] == [
        "0.0 %",
        "0.0 to 79.3 %",
        "0/1",
        "≤ 5 %",
        "≤ 2 %",
        "aim reached",
        "0.0 %",
        "100.0 %",
    ]
    widths = {
        block.count("|")
        for block in text.replace("\\|", "").splitlines()
        if block.startswith("| ---")
    }
    assert all(
        t.replace("\\|", "").count("|") in widths
        for t in text.splitlines()
        if t.startswith("| ")
    )


def test_what_would_be_were_the_noise_known_stands_beside_the_same_cases(blind):
    entries = good(blind)
    idle = [blind.entries.entry(e.label, e.oracle, result(answer())) for e in entries]
    for informed, last in ((idle, "0.00"), (idle[:-1], ""), ((), None)):
        scored = blind.score.score(entries, informed=informed)
        text = blind.table.markdown(
            scored.rows, scored.methods, scored.paired, scored.machines, scored.about
        )
        head = next(t for t in text.splitlines() if t.startswith("| measure"))
        line = next(
            t
            for t in text.splitlines()
            if t.startswith("| false effects a case, all cases")
        )
        assert head.endswith("| noise known |") == (last is not None)
        if last is not None:
            assert line.split("|")[-2].strip() == last
        assert not any(p.baseline == "noise known" for p in scored.paired)


def test_no_diagnoses_is_an_error_with_a_remedy(blind, tmp_path, capsys):
    arguments = ["score", "--folder", str(tmp_path), "--known-noise", str(tmp_path)]
    assert blind.main(arguments) == 2
    assert (
        "run `oed campaign benchmarks/blind.campaign.toml`" in capsys.readouterr().err
    )
    row = {"part": "all", "diagnosed": True, "id": "x"}
    (tmp_path / "cases").mkdir()
    (tmp_path / "cases" / "0001-000000.json").write_text(json.dumps(row), "utf-8")
    assert blind.main(arguments) == 2
    assert "`generate` writes it" in capsys.readouterr().err
