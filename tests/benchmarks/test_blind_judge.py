"""The blind benchmark's judge: right answers and places count, wrong ones do not;
intervals are as in textbooks.
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable
from types import SimpleNamespace

import numpy as np
import pytest
from blind_labels import answer, case, entries_of, result
from scipy import stats


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The scorer's modules."""
    return blind_modules("entries", "intervals", "judge", "measures", "row")


# -- intervals -------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("hits", "count"), [(0, 73), (1, 75), (37, 40), (40, 40), (3, 4)]
)
def test_wilson_is_that_of_scipy(blind, hits, count):
    interval = stats.binomtest(hits, count).proportion_ci(method="wilson")
    assert blind.intervals.wilson(hits, count) == pytest.approx(
        (interval.low, interval.high), abs=1e-12
    )


def test_no_alarm_in_73_clean_sets_is_what_proves_five_per_cent(blind):
    assert blind.intervals.wilson(0, 73)[1] <= 0.05 < blind.intervals.wilson(0, 72)[1]


def test_mcnemar_counts_the_discordant_pairs(blind):
    assert blind.intervals.mcnemar(9, 1) == pytest.approx(2 * (1 + 10) / 2**10)
    assert blind.intervals.mcnemar(0, 0) == 1.0
    with pytest.raises(ValueError, match="-1"):
        blind.intervals.mcnemar(-1, 3)


def test_median_interval_covers_as_told(blind):
    assert blind.intervals.median([float(k) for k in range(1, 11)]) == (
        5.5,
        2.0,
        9.0,
    )  # order statistics 2 and 9 of 10
    assert blind.intervals.median([1.0, 2.0, 3.0])[1:] == (-math.inf, math.inf)
    drawn = np.random.default_rng(1).exponential(size=(400, 25))
    inside = [
        low <= math.log(2) <= high
        for _, low, high in map(blind.intervals.median, drawn)
    ]
    assert (
        stats.binomtest(sum(inside), 400, 0.957).pvalue > 1e-3
    )  # P(8 <= B(25, 1/2) <= 17) = 0.957


def test_mean_interval_is_students(blind):
    values = [0.2, 0.9, 1.0, 0.4]
    interval = stats.t.interval(0.95, 3, np.mean(values), stats.sem(values))
    assert blind.intervals.mean(values)[1:] == pytest.approx(interval)
    assert math.isnan(blind.intervals.mean([])[0])


def test_proved_is_what_the_worse_end_of_the_interval_reaches(blind):
    def row(hits: int, count: int) -> tuple[str, bool]:
        share = blind.row.share(
            "",
            "",
            [True] * hits + [False] * (count - hits),
            sense="<=",
            must=0.05,
            aim=0.02,
        )
        return share.status, share.proved

    assert row(0, 73) == ("aim", True)
    assert row(0, 72) == ("aim", False)
    assert row(3, 75) == ("must", False)
    assert row(4, 75) == ("no", False)


# -- one answer ------------------------------------------------------------------------


@pytest.mark.parametrize(
    ("effects", "classes", "truth", "count", "exact"),
    [
        (["a"], [], ["a"], 1, True),
        (["a"], [["a", "b"]], ["b"], 1, True),
        (["a"], [], ["b"], 0, False),
        (["a", "b"], [], ["a"], 1, False),
        (
            ["a"],
            [["a", "b"]],
            ["a", "b"],
            1,
            False,
        ),  # one class cannot stand for two effects
        (
            ["a", "c"],
            [["a", "b"], ["c", "a"]],
            ["a", "b"],
            2,
            True,
        ),  # only if the first class takes b
        (["a", "c"], [["a", "b"], ["c"]], ["a", "b"], 1, False),
        ([], [], [], 0, True),
        (["a", "unknown"], [["a"]], ["a"], 1, True),
        (["a", "b", "c"], [], ["c", "a"], 2, False),
    ],
)
def test_effects_found_by_an_answer(blind, effects, classes, truth, count, exact):
    stated = blind.judge.parse_answer(
        {"effects": effects, "classes": classes, "probability": 1.0}
    )
    assert blind.judge.count_true(stated, truth) == count
    assert blind.judge.names_exactly(stated, truth) is exact
    assert blind.judge.count_false(stated, truth) == len(stated.classes) - count


def test_right_as_a_whole(blind):
    def right(effects, truth, unknown):
        return blind.judge.is_right(
            blind.judge.parse_answer(answer(*effects)), truth, unknown
        )

    assert right([], [], False)
    assert not right(["unknown"], [], False)
    assert right(["unknown"], [], True)
    assert not right([], [], True)
    assert right(["a", "unknown"], ["a"], False)
    assert not right(["unknown"], ["a"], False)
    assert not right(["a"], [], True)


def test_classes_that_do_not_fit_are_refused(blind):
    with pytest.raises(ValueError, match="other classes"):
        blind.judge.parse_answer({"effects": ["a"], "classes": [["b"]]})


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
    assert blind.judge.same_place(one, other) is same
    assert blind.judge.same_place(other, one) is same


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
    for ties, right in (
        ([["leg 1", "leg 2"]], True),
        ([["leg 1", "leg 3"]], False),
        ([], False),
    ):
        figures = {
            **entry.oracle,
            "effects": [{**entry.oracle["effects"][0], "tied": ties}],
        }
        tied = dataclasses.replace(entry, oracle=figures)
        assert blind.judge.located(place, tied.blocks, "leg") == right
        assert "time 0-9" in tied.blocks


def test_a_time_that_the_readings_do_not_tell_is_no_place(blind):
    """A stretch of the session is not asked of readings without a clock, a leg of
    theirs is.
    """
    label = case(
        "single", {"backlash": 6.0}, blocks=("leg 2", "time 0-9", "direction +1")
    )
    for columns, blocks in (
        (["time_s", "direction"], {"leg 2", "time 0-9", "direction +1"}), (["direction"], {"leg 2", "direction +1"}),
        ([], {"leg 2"}),
    ):  # fmt: skip
        (entry,) = entries_of(
            blind, (label | {"columns": columns}, result(answer("backlash")))
        )
        assert set(entry.blocks) == blocks
