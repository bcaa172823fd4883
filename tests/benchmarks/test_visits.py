"""Second visits and the second generator: machines in both visits, files and noise laws."""

import json
import math
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from benchmarks.harness.diagnosis import prepare
from benchmarks.second import __main__ as command
from benchmarks.second import world
from benchmarks.second.world import GENERATOR
from benchmarks.visits import cases, later
from oed.noise import Laws, NoiseLaw

NO_GENERATOR = not (GENERATOR / "make.py").is_file()


@pytest.mark.skipif(NO_GENERATOR, reason="needs the second generator")
def test_a_run_that_is_read_again_reads_the_same():
    """A null case without noise at the poses of its own first run of the planar machine."""
    make = later.modules(GENERATOR)
    first = later.draw(make, "planar", "null", "white", 0.0, (7, 1))
    case = first.case
    k = next(i for i, run in enumerate(case.runs) if run["dir"] > 0)
    rows = np.flatnonzero(case.run == k)
    run = {
        "setup": int(case.setup[rows[0]]),
        "poses": {name: np.asarray(v)[rows] for name, v in case.cmd.items()},
        "dir": 1,
        "feed": case.feed[rows[0]],
        "payload": case.payload[rows[0]],
    }
    y, clock = later.visit_again(make, first, [run])
    before = first.y[np.isin(case.row, rows)]
    scatter = np.std(y - before) / case.sigma[0]
    assert scatter < 3.0
    assert np.ptp(y) > 1e4 * case.sigma[0]
    assert clock.min() > case.t.max()


def record(before: bool, after: bool | None, predicted: float = 0.9) -> dict[str, Any]:
    def answer(right: bool) -> dict[str, Any]:
        flags = ("class", "right", "likeliest_right")
        return {**dict.fromkeys(flags, right), "clear": True, "both_visible": False}

    found = {"kind": "single", "first": answer(before), "readings": 100}
    if after is None:
        return {**found, "visited": False}
    second = {"second": answer(after), "further": 25, "now": 0.5}
    return {**found, "visited": True, "predicted": predicted, **second}


def test_the_answer_that_stands_is_the_last_one():
    cases_of = [record(True, None), record(False, True), record(False, False)]
    text = cases.table([*cases_of, {"failure": "out of reach"}])
    assert "4 cases, 1 left out, 2 visited again" in text
    row = next(line for line in text.splitlines() if line.startswith("| right class |"))
    assert row.split("|")[2].strip().startswith("0.33")
    assert row.split("|")[3].strip().startswith("0.67")
    last = text.splitlines()[-1]
    assert "| 2 | 0.50 | 0.90 | 0.00" in last
    assert "| 0.50 (" in last


def test_without_the_generator_the_command_says_so(tmp_path, capsys, monkeypatch):
    monkeypatch.setattr(world, "GENERATOR", tmp_path / "nowhere")
    assert command.main(["generate", "--out", str(tmp_path)]) == 0
    assert "the second generator is not there" in capsys.readouterr().out


def test_a_set_has_so_many_cases(tmp_path):
    setting = {"folder": str(tmp_path), "machine": "a3"}
    file = world.labels_file(tmp_path, "a3")
    file.parent.mkdir()
    file.write_text('{"case_000": {}}', encoding="utf-8")
    with pytest.raises(ValueError, match="the set has 1 cases of a3: give"):
        world.draw(setting, 1, tmp_path)


@pytest.mark.skipif(
    not world.GENERATOR.is_dir(), reason="the second generator is not there"
)
def test_a_case_becomes_readings_that_the_nominal_machine_nearly_has(tmp_path):
    machine = "delta"
    world.generate(tmp_path, 11, 1, [machine])
    setting = {"folder": str(tmp_path), "machine": machine}
    case = world.draw(setting, 0, tmp_path / "study")
    problem, effects = prepare(case.study, case.readings)
    file = tmp_path / "cases" / machine / f"{case.name}.json"
    stated = json.loads(file.read_text(encoding="utf-8"))
    assert len(problem.names) >= len(stated["tolerances"])
    assert {"screw_cyclic", "encoder_subdivision"} <= {e.name for e in effects}
    # the fit leaves a few times the noise, whatever acts: geometry and units agree
    absorbed, *_ = np.linalg.lstsq(problem.slopes, problem.residual, rcond=None)
    rest = problem.residual - problem.slopes @ absorbed
    assert math.sqrt(np.mean(rest**2)) < 5.0


def test_the_true_law_has_the_labels_sizes():
    """In units of what single readings scatter by, which is the stated noise."""
    one = np.ones(1)
    stated = Laws(
        scale=np.ones((1, 1)),
        correlated=0.0 * one,
        reach=one,
        level=0.0 * one,
        seat=0.0 * one,
    )
    problem = SimpleNamespace(stated_law=NoiseLaw(stated))
    label = {"repeat_over_sigma": 0.8, "rho": 0.9, "ar_over_sigma": 0.5}
    law = world.true_law(problem, label).law
    scale, carried = law.scale[0, 0], law.correlated[0]
    assert scale * math.sqrt(1.0 - carried) == pytest.approx(1.0)
    assert scale * math.sqrt(carried) == pytest.approx(0.5)
    assert scale * law.level[0] == pytest.approx(0.8)
    assert math.exp(-1.0 / law.reach[0]) == pytest.approx(0.9)
