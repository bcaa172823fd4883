"""One function for every verdict: against quantiles of a known distribution."""

import math
from statistics import NormalDist

import pytest
import report_fixture
from report_fixture import result_of

from oed.result import SpreadRecord
from oed.verdict import WITH_USUAL_EFFECTS, accuracy_verdicts, judge, overall

NORMAL = NormalDist(10.0, 2.0)
QUANTILES = [NORMAL.inv_cdf(p) for p in SpreadRecord.LEVELS]
SPREAD = SpreadRecord(10.2, 20.0, 30.0, "um", rms_quantiles=QUANTILES)


@pytest.mark.parametrize("limit", [6.0, 8.5, 10.0, 11.3, 13.29, 14.0])
def test_a_probability_is_that_of_the_distribution(limit):
    """Linear between stored quantiles: within 1 % of the normal distribution."""
    assert SPREAD.probability_within(limit) == pytest.approx(
        NORMAL.cdf(limit), abs=0.01
    )


def test_beyond_the_draws_nothing_is_certain():
    assert SPREAD.probability_within(1e6) == SpreadRecord.LEVELS[-1]
    assert SPREAD.probability_within(0.0) == SpreadRecord.LEVELS[0]
    constant = SpreadRecord(
        0.0, 0.0, 0.0, "um", rms_quantiles=[0.0] * len(SpreadRecord.LEVELS)
    )
    assert constant.probability_within(0.0) == SpreadRecord.LEVELS[-1]


def test_the_verdict_follows_the_quantiles():
    """pass where the 0.95 quantile is within what is wanted, fail where the 0.05 is not."""
    upper, lower = NORMAL.inv_cdf(0.95), NORMAL.inv_cdf(0.05)
    limits = {"pass": 1.001 * upper, "cannot tell": 0.99 * upper, "fail": 0.99 * lower}
    for stated, limit in limits.items():
        assert judge(SPREAD.probability_within(limit)) == stated
    assert judge(SPREAD.probability_within(1.01 * lower)) == "cannot tell"
    assert judge(1.0, can_pass=False) == "cannot tell"
    assert judge(0.0, can_pass=False) == "fail"


def test_the_worst_verdict_counts():
    assert overall([]) is None
    assert overall(["pass", "pass"]) == "pass"
    assert overall(["pass", "cannot tell"]) == "cannot tell"
    assert overall(["cannot tell", "fail", "pass"]) == "fail"


def verdict_of(mode: str, **changes: object) -> str:
    raw = report_fixture.sample()
    raw["prediction"] |= {"mode": mode, "wanted": {"z": 1e9}, "budget": None}
    raw |= {"held_out": [], **changes}
    return accuracy_verdicts(result_of(raw))["z"].judgement


def test_geometry_alone_never_passes():
    """However wide the limit is; what holds effects does."""
    assert verdict_of("corrected", corrected=None, gap=None) == "pass"
    assert verdict_of("identified", corrected=None, gap=None) == "cannot tell"
    assert verdict_of("plan", corrected=None, gap=None) == "cannot tell"


def test_a_file_adds_to_the_usual_effects():
    """Mean squares add up: 30 um with usual effects and 40 um of a file's digits are 50."""
    raw = report_fixture.sample()
    z = raw["prediction"]["components"]["z"]
    counted = z | {"after": z["after"] | {"rms": 3e4}}
    usual = {"effects": ["e"], "unmodelled": {"z": 4e4}, "fitted": {"z": 2e4}}
    usual["components"] = {"z": counted}
    budget = {"predicted": {}, "lines": [], "usual": usual}
    raw["prediction"] |= {"mode": "plan", "wanted": {}, "budget": budget}
    raw |= {"corrected": None, "gap": None}
    result = result_of(raw)
    [verdict] = accuracy_verdicts(result, {"z": math.inf}, added={"z": 4e4}).values()
    assert verdict.rms == pytest.approx(5e4)
    assert verdict.scope == WITH_USUAL_EFFECTS


def test_an_older_result_is_judged_by_its_interval():
    older = SpreadRecord(10.0, 20.0, 30.0, "um", rms_interval=(6.0, 14.0))
    assert older.probability_within(12.0) == pytest.approx(0.7375)
    assert SpreadRecord(10.0, 20.0, 30.0, "um").probability_within(1e9) == 0.5
    assert math.isfinite(older.probability_within(0.0))
