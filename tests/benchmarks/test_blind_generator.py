"""The blind benchmark's generator: apart from the toolkit, yet of the same machines;
sizes and noise are as told.
"""

from __future__ import annotations

import ast
import dataclasses
import json
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from blind_stage import stage_of

from oed import dataset
from pkm_studies import study
from pkm_studies.resolve import resolved as resolve

ROOT = Path(__file__).resolve().parents[2]


BLIND = ROOT / "benchmarks" / "blind"


TOOLKIT = {
    "oed",
    "pkm_models",
    "pkm_studies",
    "pkm_reports",
    "pkm_campaign",
    "pkm_page",
    "pkm_certificate",
    "pkm_printers",
}


NAMES = (
    "cases",
    "effects",
    "effects.base",
    "effects.motion",
    "effects.thermal",
    "noise",
    "plans",
    "scene",
    "severity",
    "textbook",
    "write",
)


STUDIES = [
    (m, p)
    for m in ("a3", "planar", "delta", "hexapod", "hexaglide")
    for p in ("full", "poor")
]


STUDIES.append(("a3", "single"))


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The generator's modules, and those of its effects."""
    return blind_modules(*(f"generator.{n}" for n in NAMES))


def measurement_of(name: str):
    resolved = resolve.resolve(study.load(BLIND / name), readings=[])
    return resolved.measurement_with(resolved.setups)


def test_generator_imports_nothing_of_the_toolkit():
    paths = sorted((BLIND / "generator").rglob("*.py"))
    assert len(paths) > 10
    for path in paths:
        for node in ast.walk(ast.parse(path.read_text(encoding="utf-8"))):
            names = [a.name for a in node.names] if isinstance(node, ast.Import) else []
            if isinstance(node, ast.ImportFrom):
                assert not node.level, path
                names = [node.module or ""]
            for name in names:
                assert name.split(".")[0] not in TOOLKIT, f"{path}: {name}"
                if name.startswith("benchmarks"):
                    assert name.startswith("benchmarks.blind.generator"), (
                        f"{path}: {name}"
                    )


@pytest.mark.parametrize(("machine", "plan"), STUDIES)
def test_files_load_with_their_study_and_mean_the_same_machine(
    blind, tmp_path, machine, plan
):
    rng = np.random.default_rng(7)
    plan_drawn = blind.plans.draw(rng, machine, plan)
    scene = blind.scene.draw(rng, plan_drawn)
    case = SimpleNamespace(
        stage=SimpleNamespace(
            plan=plan_drawn,
            layout=scene.layout,
            climate=blind.thermal.climate(rng, plan_drawn),
        ),
        y=scene.y,
    )
    path = tmp_path / "x.readings.csv"
    blind.write.table(case).to_csv(path, index=False)
    measurement = measurement_of(plan_drawn.study)
    read = dataset.load(path, measurement)
    assert read.dropped == 0
    assert 250 <= len(read) <= 750
    assert np.abs(read.y - scene.y).max() < 1e-10  # as many digits as the file has
    theta = measurement.nominal.copy()
    theta[measurement.free] += (
        scene.theta
    )  # 0 nominal where the toolkit's nominal is added here
    assert np.abs(measurement.tolerance[measurement.free] - scene.prior).max() == 0.0
    assert np.abs(measurement.readings(read.series, theta) - scene.y).max() < 2e-11
    slopes = measurement.jacobian(read.series, theta)[:, measurement.free]
    assert np.abs(slopes - scene.J).max() < 1e-9 * np.abs(slopes).max()
    shown = {
        "time_s": "time",
        "direction": "direction",
        "feed_mm_min": "feed",
        "payload_N": "payload",
    }
    for column, stem in shown.items():
        assert (stem in read.covariates) == (column in plan_drawn.columns)


def test_joint_forces_follow_from_virtual_work(blind):
    plan = blind.plans.draw(np.random.default_rng(3), "hexapod", "full")
    scene = blind.scene.Scene(
        plan, np.zeros(42), np.zeros((2, 6))
    )  # the nominal machine, that forces are told for
    rise = []
    for leg in (0, 4):
        for sign in (1, -1):
            dq = np.zeros_like(scene.motion.q)
            dq[:, leg] = sign * 1e-5
            args = (scene.inverse, scene.motion.pose.R0, scene.motion.q + dq, scene.p)
            x = blind.scene.nearby(plan.machine, scene.x, *args)
            rise.append(
                blind.scene.tip(plan.machine, x, scene.motion.pose.R0, plan.tool)[:, 2]
            )
        lift = (rise[-2] - rise[-1]) / 2e-5
        assert np.abs(lift - scene.motion.lift[:, leg]).max() < 1e-6


def test_play_remembers_its_side_of_the_gap(blind):
    bench = stage_of(blind, "planar", "full")
    width = 4e-6
    q = bench.stage.motion.q
    error = blind.motion.play(
        bench.stage,
        blind.motion.passes(bench.stage),
        np.full((1, 2), width),
        np.ones(1),
    )
    assert np.abs(error).max() <= width / 2 + 1e-15
    for here in bench.plan.runs:
        for leg in range(2):
            travel = np.diff(q[here, leg])
            after = np.flatnonzero(np.abs(travel) > 2 * width) + 1
            turns = np.flatnonzero(travel[1:] * travel[:-1] < 0) + 1
            for k in after:
                if (
                    k not in turns + 1 and k not in turns
                ):  # the path turns in between there
                    assert error[here[k], leg] == pytest.approx(
                        -np.sign(travel[k - 1]) * width / 2, abs=1e-12
                    )


def test_every_form_does_something_and_departs_from_its_textbook(blind):
    departs: dict[str, list[float]] = {}
    for machine in ("a3", "planar", "delta", "hexaglide"):
        bench = stage_of(blind, machine, "full")
        for name in blind.effects.known_on(machine):
            effect = blind.effects.KNOWN[name](np.random.default_rng(11), bench.stage)
            change = bench.scene.response(effect.push(1e-6))
            assert bench.metric.size(change) > 0
            if name in (
                "backlash",
                "gravity",
                "frame_bending",
                "leg_thermal",
                "friction",
                "servo_lag",
            ):
                distances = blind.textbook.distances(
                    bench.scene, bench.stage, bench.metric, (name,), [change]
                )[0][name]
                departs.setdefault(name, []).append(
                    distances / bench.metric.size(change)
                )
    for name, shares in departs.items():
        assert 0.02 < max(shares) < 0.95, name
    assert set(blind.effects.UNKNOWN).isdisjoint(blind.effects.KNOWN)
    assert len(blind.effects.UNKNOWN) >= 8


def test_one_tool_cannot_tell_a_common_scale_from_the_bar_and_two_can(blind):
    distances = {}
    for plan in ("single", "full"):
        bench = stage_of(blind, "a3", plan)
        scale = blind.effects.EXACT["encoder_scale"](
            np.random.default_rng(0), bench.stage
        ).push(30e-6)
        bar = blind.effects.EXACT["bar_length"](
            np.random.default_rng(0), bench.stage
        ).push(10e-6)
        vectors = [
            bench.metric.embed(bench.scene.read(p) - bench.scene.y)
            for p in (scale, bar)
        ]
        distances[plan] = blind.severity.distance(
            vectors[0], vectors[1][:, None]
        ) / np.linalg.norm(vectors[0])
    assert distances["single"] < 0.01
    assert distances["full"] > 0.05


@pytest.mark.parametrize("part", ["dq", "dp", "dtip", "ds", "dy"])
def test_exact_readings_follow_first_order_for_small_additions(blind, part):
    bench = stage_of(blind, "planar", "poor")
    rows, rng = len(bench.plan.command), np.random.default_rng(4)
    width = {"dq": 2, "dp": 9, "dtip": 3, "ds": 6}
    shape = (bench.scene.layout.size,) if part == "dy" else (rows, width[part])
    push = blind.scene.Push(**{part: 1e-8 * rng.normal(size=shape)})
    change, first = bench.scene.read(push) - bench.scene.y, bench.scene.response(push)
    assert np.abs(change - first).max() < 1e-5 * np.abs(first).max()


def dense_lambda(truth, dy):
    """lambda as it is written down: (Sigma + J Lambda J^T) inverted whole."""
    J, prior = truth["J"].astype(float), truth["prior"]
    return float(dy @ np.linalg.solve(truth["sigma"] + (J * prior**2) @ J.T, dy))


@pytest.mark.parametrize(
    "kind", ["single", "pair", "unknown", "exact", "known_unknown"]
)
def test_sizes_are_as_labelled(blind, tmp_path, kind):
    blind.write.generate(tmp_path, name="blind", count=3, seed=5, kinds=[kind])
    labels = [
        json.loads(line)
        for line in (tmp_path / "labels.jsonl").read_text(encoding="utf-8").splitlines()
    ]
    assert len(labels) == 3
    for label in labels:
        truth = dict(np.load(tmp_path / "truth" / f"{label['id']}.npz"))
        truth["sigma"] = blind.write.covariance(truth)
        changes = [truth[f"dy_{i}"] for i in range(len(label["effects"]))]
        lambdas = [dense_lambda(truth, dy) for dy in changes]
        for effect, value in zip(label["effects"], lambdas, strict=True):
            assert np.sqrt(value) == pytest.approx(effect["sqrt_lambda"], rel=2e-3)
        if len(changes) == 1:
            assert label["effects"][0]["sqrt_lambda"] == pytest.approx(
                label["effects"][0]["target"], rel=1e-3
            )
        else:
            both = dense_lambda(truth, changes[0] + changes[1])
            cross = (both - sum(lambdas)) / 2
            for i, effect in enumerate(
                label["effects"]
            ):  # beyond the direction of the other
                alone = lambdas[i] - cross**2 / lambdas[1 - i]
                assert np.sqrt(alone) == pytest.approx(effect["target"], rel=0.02)
        apart = truth["clean"] - truth["y0"] - sum(changes)
        assert np.abs(apart).max() < 0.02 * np.abs(truth["clean"] - truth["y0"]).max()


@pytest.mark.parametrize("law", ["white", "correlated", "run", "heavy", "combined"])
def test_noise_has_the_covariance_it_tells(blind, law):
    group = blind.noise.Grouping(
        sigma=np.full(12, 2e-6),
        run=np.repeat([0, 1], 6),
        channel=np.zeros(12, dtype=int),
        phase=np.tile(np.linspace(0, 5, 6), 2),
        relative=np.ones(12, dtype=bool),
    )
    rng = np.random.default_rng(1)
    # the t has its variance where the covariance is told by information: leave its tail
    # off for this
    drawn = dataclasses.replace(blind.noise.draw(rng, law), dof=0.0, outliers=0.0)
    sample = np.array([blind.noise.sample(rng, drawn, group) for _ in range(6000)])
    covariance = blind.noise.covariance(drawn, group)
    assert np.abs(np.cov(sample.T) - covariance).max() < 0.09 * covariance.max()
    assert np.abs(covariance[:6, 6:]).max() == 0.0  # runs share nothing
    far = 4e-12 * np.array(
        [
            [
                drawn.level**2
                * (1 + (i == j))  # the shared reference, and the reading's own
                + drawn.offset**2
                + drawn.wave**2 * np.cos(group.phase[i] - group.phase[j])
                + drawn.along**2 * np.exp(-abs(i - j) / drawn.length)
                for j in range(6)
            ]
            for i in range(6)
        ]
    )
    assert np.abs(covariance[6:, 6:] - far).max() < 1e-12 * far.max()


def test_heavy_tails_are_heavy_and_told_by_their_information(blind):
    group = blind.noise.Grouping(
        sigma=np.ones(40000), run=np.arange(40000), channel=np.zeros(40000, dtype=int), phase=np.zeros(40000),
        relative=np.zeros(40000, dtype=bool),
    )  # fmt: skip
    law = blind.noise.Law(name="heavy", dof=3.0)
    x = blind.noise.sample(np.random.default_rng(2), law, group)
    # Fisher information about a shift, from the score of the t: E[psi^2], psi = (nu +
    # 1) x / (nu + x^2)
    information = np.mean((4.0 * x / (3.0 + x**2)) ** 2)
    small = dataclasses.replace(
        group, **{f.name: getattr(group, f.name)[:2] for f in dataclasses.fields(group)}
    )
    assert 1.0 / blind.noise.covariance(law, small)[0, 0] == pytest.approx(
        information, rel=0.02
    )
    assert np.mean(np.abs(x) > 5.0) > 0.005
