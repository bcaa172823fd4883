"""Real readings through `oed diagnose`: the verdict names nothing that the readings
cannot support.

What the residual plots of the two reports show:

Delta V400 (session S04, 7 heights and 12 distances). Heights rise nearly in the order
in which they were read, from -82 to +76 um, with an rms of 54 um against 30 um stated.
A drift of the probe, a step, or a field over the bed would all look so: without a time
column the first two cannot be tested, and seven heights do not tell a field. Distances
scatter by 65 um about zero without order (stated 60 um); by place, neighbouring points
have small and large residuals side by side. The fit has p = 0.01 against the stated
noise, which is a guess. The verdict, a static error that could be any of many at odds of
some six to one, with no gap as a rival, says as much: prior odds are two to one, so that
the readings themselves raise them threefold.

Hangprinter HP4 (nine poses). x and y scatter by 0.6 and 0.7 mm, z by 0.4 mm (1 mm
stated), the lines by 0.2 mm (0.5 mm stated), with no order in the readings or in place.
No effect could be seen under such noise: none is tested.
"""

import json
from pathlib import Path
from typing import Any

import pytest
from typer.testing import CliRunner

from pkm_studies.commands.cli import app

pytestmark = pytest.mark.slow
STUDIES = Path(__file__).resolve().parents[2] / "studies"
#: effects that need a covariate which neither file has: time, direction, feed
UNSUPPORTED = {
    "backlash", "friction", "servo_lag", "leg_thermal", "frame_thermal", "bar_thermal", "mount_drift", "step",
}  # fmt: skip


@pytest.fixture(scope="module", params=["delta_v400", "hangprinter_hp4"])
def gap(
    request: pytest.FixtureRequest,
    shared_data: Path,
    tmp_path_factory: pytest.TempPathFactory,
) -> dict[str, Any]:
    """The result's section `gap`."""
    name = str(request.param)
    if not (shared_data / name).is_dir():
        pytest.skip(f"the folder {name} with real measurements is not there")
    out = tmp_path_factory.mktemp(name)
    done = CliRunner().invoke(
        app,
        ["diagnose", str(STUDIES / f"{name}.study.toml"), "--out", str(out), "--quiet"],
    )
    assert done.exit_code == 0, done.output
    assert "gap" in (out / "report.html").read_text(encoding="utf-8")
    result: dict[str, Any] = json.loads(
        (out / "result.json").read_text(encoding="utf-8")
    )["gap"]
    return result | {"study": name}


def test_nothing_is_named_that_the_covariates_cannot_support(gap):
    """In no answer, no class and no odds; each with the column that is missing."""
    named = {
        n for a in gap["answers"] for c in [a["effects"], *a["classes"]] for n in c
    }
    assert not UNSUPPORTED & (named | set(gap["marginal"]))
    assert set(gap["not_testable"]) >= UNSUPPORTED
    wanted = {
        "servo_lag": "feed",
        "step": "time",
        "backlash": "direction",
        "leg_thermal": "time",
    }
    for effect, column in wanted.items():
        assert column in gap["about"][effect]["column"]


def test_the_verdict_is_what_the_plots_can_bear(gap):
    """No cause is claimed, and no certainty on the delta: see the module."""
    if gap["study"] == "delta_v400":
        (answer, *_) = gap["answers"]
        assert gap["verdict"] == "class"
        assert answer["probability"] < 0.7
        assert len(answer["classes"][0]) >= 5
        none = [a["probability"] for a in gap["answers"] if not a["effects"]]
        assert 0.1 < none[0] < 0.9
        assert 25.0 < gap["rms_before"]["height"] < 65.0
        assert 50.0 < gap["rms_before"]["length"] < 80.0
        return
    assert gap["verdict"] == "none"
    assert gap["where"] == []
    assert gap["rms_after"] == gap["rms_before"]


def test_closure_is_reported_even_if_nil(gap):
    """Of both splits; where no gap is claimed it is that of the likeliest effect, if
    any, and is not proved.
    """
    closures = {c["split"]: c for c in gap["closure"]}
    assert set(closures) == {"within", "whole"}
    for c in closures.values():
        assert c["n"] >= 0
        if c["n"] and c["value"] is not None and not gap["selected"]:
            assert c["low"] is None or c["low"] < 0.5
