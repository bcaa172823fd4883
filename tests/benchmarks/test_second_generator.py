"""The second generator as a world: its files and its noise laws."""

import json
import math
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.harness.diagnosis import prepare
from benchmarks.second import __main__ as command
from benchmarks.second import world
from oed.noise import Laws, NoiseLaw


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
