"""Sets of the blind benchmark: what they contain, and that they depend on the seed alone."""

from __future__ import annotations

import dataclasses
import hashlib
import json
from collections import Counter
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from blind_stage import stage_of

ROOT = Path(__file__).resolve().parents[2]
BLIND = ROOT / "benchmarks" / "blind"
NAMES = (
    "cases",
    "effects",
    "effects.base",
    "effects.thermal",
    "noise",
    "plans",
    "scene",
    "severity",
    "write",
)


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The generator's modules, and those of its effects."""
    return blind_modules(*(f"generator.{n}" for n in NAMES))


def test_a_thousand_cases_hold_what_the_scores_need(blind):
    roles = [blind.cases.role(1, "blind", k) for k in range(1000)]
    laws = Counter(r.law for r in roles if r.kind == "null")
    assert set(laws) == set(blind.noise.LAWS)
    assert min(laws.values()) >= 73
    assert set(Counter(r.kind for r in roles)) == set(blind.cases.KINDS)
    machines = Counter(r.machine for r in roles if r.kind not in ("null", "exact"))
    assert min(machines.values()) > 100
    assert {r.machine for r in roles if r.kind == "exact"} == {"a3"}
    dev = [blind.cases.role(1, "dev", k) for k in range(400)]
    assert {r.machine for r in dev} == {"a3", "planar", "delta"}


def test_set_six_has_the_hexaglide_alone_and_leaves_the_others_as_they_were(blind):
    roles = [blind.cases.role(7, "six", k) for k in range(200)]
    assert {r.machine for r in roles} == {"hexaglide"}
    assert {r.plan for r in roles} == {"full", "poor"}
    kinds = Counter(r.kind for r in roles)
    assert kinds == {
        "null": 75,
        "single": 65,
        "pair": 25,
        "unknown": 20,
        "known_unknown": 15,
    }  # of the exact class none
    for name, digest in (("dev", "444e20a361a0"), ("blind", "459754dcb789")):
        text = repr(
            [dataclasses.astuple(blind.cases.role(1, name, k)) for k in range(400)]
        )
        assert hashlib.sha256(text.encode()).hexdigest().startswith(digest)


def test_what_a_bar_does_is_in_its_readings_alone(blind):
    bench = stage_of(blind, "hexaglide", "full")
    bar = np.array(
        [
            bench.plan.setups[k].name == "cup"
            for k in bench.plan.setup[bench.scene.layout.row]
        ]
    )
    assert 0 < bar.sum() < len(bar)
    for name in ("bar_length", "bar_thermal"):
        dy = (
            blind.effects.KNOWN[name](np.random.default_rng(1), bench.stage)
            .push(1e-6)
            .dy
        )
        assert not dy[~bar].any()
        assert dy[bar].any()
    poor = stage_of(
        blind, "hexaglide", "poor"
    )  # it has no bar: such a case draws another effect
    with pytest.raises(ArithmeticError, match="does nothing"):
        blind.effects.KNOWN["bar_length"](np.random.default_rng(1), poor.stage)


def test_a_case_depends_on_its_number_alone_and_files_are_taken_up_again(
    blind, tmp_path
):
    assert (
        blind.write.generate(
            tmp_path / "a", name="dev", count=4, seed=2, machines=["planar"]
        )
        == 4
    )
    assert (
        blind.write.generate(
            tmp_path / "a", name="dev", count=4, seed=2, machines=["planar"]
        )
        == 0
    )
    assert (
        blind.write.generate(
            tmp_path / "b",
            name="dev",
            count=2,
            seed=2,
            machines=["planar"],
            kinds=["null"],
        )
        == 2
    )
    labels = {}
    for folder in ("a", "b"):
        lines = (
            (tmp_path / folder / "labels.jsonl")
            .read_text(encoding="utf-8")
            .splitlines()
        )
        labels[folder] = {v["id"]: v for v in map(json.loads, lines)}
    common = set(labels["a"]) & set(labels["b"])
    assert common
    for key in common:
        texts = [
            (tmp_path / f / "cases" / f"{key}.readings.csv").read_bytes()
            for f in ("a", "b")
        ]
        assert texts[0] == texts[1]
        assert labels["a"][key] == labels["b"][key]
    for key, label in labels["b"].items():
        assert label["effects"] == []
        truth = np.load(tmp_path / "b" / "truth" / f"{key}.npz")
        assert np.array_equal(truth["clean"], truth["y0"])


def test_manifest_gives_no_hint(blind, tmp_path):
    blind.write.generate(tmp_path, name="dev", count=6, seed=3, machines=["planar"])
    lines = [
        json.loads(v)
        for v in (tmp_path / "manifest.jsonl").read_text(encoding="utf-8").splitlines()
    ]
    assert [v["id"] for v in lines] == sorted(v["id"] for v in lines)
    for line in lines:
        assert set(line) == {"id", "study", "readings"}
        assert (BLIND / line["study"]).is_file()
        head = (
            (tmp_path / line["readings"])
            .read_text(encoding="utf-8")
            .splitlines()[0]
            .split(",")
        )
        assert set(head) <= {
            "setup", "run", "order", "y_mm", "z_mm", "time_s", "direction", "feed_mm_min", "payload_N",
            "temp_leg_C", "temp_frame_C", "repeat", "dy_mm", "dz_mm",
        }  # fmt: skip


def test_the_command_writes_a_set_and_refuses_what_is_not_there(
    blind, tmp_path, capsys
):
    out = str(tmp_path / "x")
    assert (
        blind.main(
            [
                "generate",
                "--out",
                out,
                "--set",
                "dev",
                "--cases",
                "1",
                "--machines",
                "planar",
            ]
        )
        == 0
    )
    assert len(list((tmp_path / "x" / "cases").iterdir())) == 1
    assert (
        blind.main(["generate", "--out", out, "--set", "dev", "--machines", "hexapod"])
        == 2
    )
    assert "hexapod" in capsys.readouterr().err
