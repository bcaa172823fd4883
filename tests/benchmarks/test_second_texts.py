"""Printed answers of the second generator's cases: their words, choice and truths."""

from __future__ import annotations

from pathlib import Path

from matplotlib.figure import Figure

from benchmarks.second import adapter, cases, texts
from pkm_reports.blocks import Items, Paragraph, Picture, Table, TableColumn


def test_the_words_of_blocks_in_lines() -> None:
    blocks = [
        Items(["It comes from friction."]),
        Table(
            [TableColumn("Cause"), TableColumn("Probability")],
            [["friction", "90 %"]],
            "T",
        ),
        Picture("causes", Figure, "A figure."),
        Paragraph("The rms residual falls."),
    ]
    assert texts.block_lines(blocks) == [
        "- It comes from friction.",
        "T",
        "Cause | Probability",
        "friction | 90 %",
        "A figure.",
        "The rms residual falls.",
    ]


def test_some_cases_of_each_machine_in_an_order_that_the_seed_gives(
    tmp_path: Path,
) -> None:
    for machine in adapter.MACHINES:
        folder = tmp_path / "cases" / machine
        folder.mkdir(parents=True)
        for number in range(9):
            (folder / f"case_{number:03d}.json").touch()
    first = texts.chosen(tmp_path, seed=3)
    assert len(set(first)) == 4 * texts.READ
    counts = [sum(c.machine == m for c in first) for m in adapter.MACHINES]
    assert counts == [texts.READ] * 4
    assert first == texts.chosen(tmp_path, seed=3)
    assert first != texts.chosen(tmp_path, seed=4)
    assert all(case in _all_cases(tmp_path) for case in first)


def _all_cases(folder: Path) -> list[cases.Case]:
    return [
        cases.Case(folder, machine, name)
        for machine in adapter.MACHINES
        for name in cases.names(folder, machine)
    ]


def test_a_truth_in_one_line() -> None:
    acting = {
        "effect": "friction",
        "classes": ["backlash", "friction"],
        "sqrt_lambda": 9.96,
        "out_of_span": 2.0,
        "where": {"legs": [2]},
    }
    label = {"kind": "single", "law": {"law": "white"}, "effects": [acting]}
    assert texts.truth(label) == (
        "single: friction, or backlash (10.0, given others 2.0; {'legs': [2]}) | noise:"
        " white"
    )
    repeats = {"law": "repeats", "repeat_over_sigma": 0.71}
    assert texts.truth({"kind": "null", "law": repeats, "effects": []}) == (
        "null: nothing | noise: repeats, 0.7 of the stated"
    )
