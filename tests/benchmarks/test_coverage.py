"""Coverage on readings of the oracles: a small campaign of `benchmarks.coverage`."""

import importlib
import re
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import numpy as np
import pandas as pd
import pytest

from oed.accuracy import ErrorMaps, driven_errors, predict
from pkm_studies.commands import main

ROOT = Path(__file__).resolve().parents[2]
NAMES = ("a3_30", "a3_60", "a3_circles", "planar", "delta", "hexapod")


@pytest.fixture(scope="module", autouse=True)
def benchmarks() -> Iterator[None]:
    with pytest.MonkeyPatch.context() as patch:
        patch.syspath_prepend(ROOT)
        yield


def module(name: str) -> ModuleType:
    return importlib.import_module(f"benchmarks.coverage.{name}")


@pytest.mark.parametrize("name", NAMES)
def test_oracle_and_toolkit_read_the_same_machine(name):
    """Readings, and pose errors after a compensation that is off, to rounding."""
    bench = module("machines").configuration(name)
    m = bench.measurement
    rng = np.random.default_rng(3)
    truth = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    readings = m.readings(bench.series, truth)
    assert np.abs(bench.read(truth) - readings).max() < 1e-12
    keep = len(m.machine.parameters)
    believed = m.nominal[:keep] + 0.9 * (truth - m.nominal)[:keep]
    errors = driven_errors(
        m.kinematics, bench.command, truth[:keep], "home", believed=believed
    )
    exact = bench.errors(believed, truth[:keep])
    assert np.abs(exact).max() > 1e-5
    assert np.abs(errors - exact).max() < 1e-9


def test_laws_of_the_noise_are_as_stated():
    noise = module("noise")
    chain = np.repeat(np.arange(4000), 15)
    sigma, shared = np.full(len(chain), 2.0), np.zeros(len(chain))
    layout = noise.Layout(chain, sigma, shared)
    rng = np.random.default_rng(1)
    errors = {
        law: noise.draw(law, layout, rng).reshape(-1, 15) / 2.0 for law in noise.LAWS
    }
    assert errors["white"].var() == pytest.approx(1.0, abs=0.03)
    assert errors["t4"].var() == pytest.approx(1.0, abs=0.1)
    assert (np.abs(errors["t4"]) > 4.0).mean() == pytest.approx(0.0048, abs=0.001)
    between = errors["offsets"].mean(axis=1).var()
    assert between == pytest.approx(4.0 + 1.0 / 15.0, rel=0.1)
    follows = (errors["ar1"][:, 1:] * errors["ar1"][:, :-1]).mean()
    assert follows == pytest.approx(0.9, abs=0.03)
    assert errors["ar1"].var() == pytest.approx(1.0, abs=0.05)
    assert (np.abs(errors["outliers"]) > 5.0).mean() == pytest.approx(0.02, abs=0.003)
    shared += 3.0
    common = noise.draw("white", noise.Layout(chain, sigma, shared), rng)
    level = common.reshape(-1, 15).mean(axis=1).var()
    assert level == pytest.approx(9.0 + 4.0 / 15.0, rel=0.1)


def run_campaign(name: str, tmp_path: Path, changes: dict[str, str]) -> Path:
    """The shipped campaign of this name, reduced; the folder of its cases."""
    text = (ROOT / "benchmarks" / f"{name}.campaign.toml").read_text(encoding="utf-8")
    for field, values in changes.items():
        line = rf"^{field} = .*$"
        text, count = re.subn(line, f"{field} = {values}", text, flags=re.MULTILINE)
        assert count == 1
    path = tmp_path / f"{name}.campaign.toml"
    for part in ("intervals", "ranks"):
        functions = f"from benchmarks.coverage.{part} import *\n"
        (tmp_path / f"{part}.py").write_text(functions, encoding="utf-8")
    path.write_text(text.replace('"coverage/', '"'), encoding="utf-8")
    options = ["--out", str(tmp_path / name), "--workers", "1", "--quiet"]
    assert main(["campaign", str(path), *options]) == 0
    return tmp_path / name


def test_the_campaign_of_intervals_has_a_table(tmp_path, capsys):
    few = {"seeds": "2", "configuration": '["planar"]', "law": '["white"]'}
    folder = run_campaign("coverage", tmp_path, few)
    cases = pd.read_parquet(folder / "cases.parquet")
    bench = module("machines").configuration("planar")
    for number, row in enumerate(cases.to_dict("records")):
        outcome = module("intervals").one_machine(bench, "white", number, 1)
        assert outcome.as_json().items() <= row.items()
    options = ["coverage", "--campaign", str(folder)]
    assert importlib.import_module("benchmarks.harness.__main__").main(options) == 0
    assert "| planar | white | 2 |" in capsys.readouterr().out


def test_cells_count_what_holds():
    """20 combinations of 100 machines: one of them is outside in every second machine."""
    cells = module("intervals").share_cells(["1" * 20] * 50 + ["0" + "1" * 19] * 50)
    assert cells == ["0.975 ± 0.005", "0.50 (0.87)"]


def test_what_compensation_leaves_is_predicted_exactly():
    """Against the oracle; to first order, x and y of the A3 are micrometres off."""
    bench = module("machines").configuration("a3_30")
    m = bench.measurement
    rng = np.random.default_rng(4)
    identified = (m.tolerance * rng.standard_normal(len(m.nominal)))[:24]
    exact = bench.errors(identified, identified)
    known = driven_errors(
        m.kinematics, bench.command, identified, "home", believed=identified
    )
    maps = ErrorMaps.of(m.kinematics, bench.command, "home")
    nothing = np.zeros((24, 24))
    figures = {
        "exact": predict(maps, nothing, nothing, rng, mean=identified, known=known),
        "linear": predict(maps, nothing, nothing, rng, mean=identified),
    }
    off = {n: np.abs(f.sd_after - np.abs(exact)) for n, f in figures.items()}
    assert off["exact"].max() < 1e-9
    assert off["linear"][:, :2].max() > 5e-6
    rms = np.sqrt(np.mean(exact[:, 0] ** 2))
    assert figures["exact"].after["x"].rms == pytest.approx(rms, rel=1e-6)
    largest = np.abs(exact[:, 0]).max()
    assert figures["exact"].after["x"].largest == pytest.approx(largest, rel=1e-6)


def test_ranks_of_uniform_values_pass_and_of_narrow_ones_fail():
    joint_probability = module("ranks").joint_probability
    rng = np.random.default_rng(8)
    uniform = rng.integers(0, 100, (200, 6))
    assert joint_probability(uniform, 1) > 0.01
    narrow = uniform.copy()
    narrow[:, 2] = 30 + narrow[:, 2] * 2 // 5
    assert joint_probability(narrow, 1) < 1e-4


def test_ranks_are_of_the_laws_that_a_fit_of_few_readings_has():
    """Twelve readings beyond the unknowns: no course through the session."""
    bench = module("machines").configuration("a3_30")
    ranks = module("ranks").one_machine(bench, 0, 1)
    assert len(ranks) == 18 + 5
    assert "course of the session" not in ranks
