"""The blind benchmark's generator: apart from the toolkit, yet of the same machines;
sizes and noise are as told.
"""

import dataclasses
import hashlib
from collections import Counter
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.blind import world
from benchmarks.blind.generator import (
    cases,
    effects,
    machines,
    noise,
    plans,
    scene,
    severity,
)
from benchmarks.harness.diagnosis import prepare
from oed import dataset
from pkm_studies import study
from pkm_studies.resolve import resolved as resolve

ROOT = Path(__file__).resolve().parents[2]
BLIND = ROOT / "benchmarks" / "blind"
STUDIES = [
    (m, p) for m in ("a3", "planar", "delta", "hexapod") for p in ("full", "poor")
]
STUDIES.append(("a3", "single"))


def stage_of(machine: str, plan: str, seed: int = 3) -> SimpleNamespace:
    """A scene with its stage, and metric under white noise."""
    rng = np.random.default_rng(seed)
    plan_drawn = plans.draw(rng, machine, plan)
    drawn = scene.draw(rng, plan_drawn)
    climate = effects.climate(rng, plan_drawn)
    stage = effects.Stage(plan_drawn, drawn.motion, drawn.layout, climate)
    group = noise.grouping(plan_drawn, drawn.layout)
    sigma = noise.covariance(noise.Law(name="white"), group)
    metric = severity.Metric(sigma, drawn.J, drawn.prior)
    return SimpleNamespace(
        plan=plan_drawn, scene=drawn, stage=stage, metric=metric, sigma=sigma
    )


def measurement_of(name: str):
    resolved = resolve.resolve(study.Study.load(BLIND / name), readings=[])
    return resolved.measurement_with(resolved.setups)


@pytest.mark.parametrize(("machine", "plan"), STUDIES)
def test_files_load_with_their_study_and_mean_the_same_machine(tmp_path, machine, plan):
    rng = np.random.default_rng(7)
    plan_drawn = plans.draw(rng, machine, plan)
    drawn = scene.draw(rng, plan_drawn)
    case = SimpleNamespace(
        stage=SimpleNamespace(
            plan=plan_drawn,
            layout=drawn.layout,
            climate=effects.climate(rng, plan_drawn),
        ),
        y=drawn.y,
    )
    path = tmp_path / "x.readings.csv"
    cases.table(case).to_csv(path, index=False)
    measurement = measurement_of(plan_drawn.study)
    read = dataset.load(path, measurement)
    assert read.dropped == 0
    assert 250 <= len(read) <= 750
    assert np.abs(read.y - drawn.y).max() < 1e-10  # as many digits as the file has
    theta = measurement.nominal.copy()
    # 0 nominal where the toolkit's nominal is added here
    theta[measurement.free] += drawn.theta
    assert np.abs(measurement.tolerance[measurement.free] - drawn.prior).max() == 0.0
    assert np.abs(measurement.readings(read.series, theta) - drawn.y).max() < 2e-11
    slopes = measurement.jacobian(read.series, theta)[:, measurement.free]
    assert np.abs(slopes - drawn.J).max() < 1e-9 * np.abs(slopes).max()
    shown = {
        "time_s": "time",
        "direction": "direction",
        "feed_mm_min": "feed",
        "payload_N": "payload",
    }
    for column, stem in shown.items():
        assert (stem in read.covariates) == (column in plan_drawn.columns)


def test_joint_forces_follow_from_virtual_work():
    plan = plans.draw(np.random.default_rng(3), "hexapod", "full")
    # the nominal machine, that forces are told for
    drawn = scene.Scene(plan, np.zeros(42), np.zeros((2, 6)))
    rise = []
    for leg in (0, 4):
        for sign in (1, -1):
            dq = np.zeros_like(drawn.motion.q)
            dq[:, leg] = sign * 1e-5
            args = (drawn.inverse, drawn.motion.pose.R0, drawn.motion.q + dq, drawn.p)
            x = machines.nearby(plan.machine, drawn.x, *args)
            rise.append(
                machines.tip(plan.machine, x, drawn.motion.pose.R0, plan.tool)[:, 2]
            )
        lift = (rise[-2] - rise[-1]) / 2e-5
        assert np.abs(lift - drawn.motion.lift[:, leg]).max() < 1e-6


def test_play_remembers_its_side_of_the_gap():
    bench = stage_of("planar", "full")
    width = 4e-6
    q = bench.stage.motion.q
    error = effects.play(
        bench.stage, effects.passes(bench.stage), np.full((1, 2), width), np.ones(1)
    )
    assert np.abs(error).max() <= width / 2 + 1e-15
    for here in bench.plan.runs:
        for leg in range(2):
            travel = np.diff(q[here, leg])
            after = np.flatnonzero(np.abs(travel) > 2 * width) + 1
            turns = np.flatnonzero(travel[1:] * travel[:-1] < 0) + 1
            for k in after:
                # the path turns in between there
                if k not in turns + 1 and k not in turns:
                    assert error[here[k], leg] == pytest.approx(
                        -np.sign(travel[k - 1]) * width / 2, abs=1e-12
                    )


def test_one_tool_cannot_tell_a_common_scale_from_the_bar_and_two_can():
    distances = {}
    for plan in ("single", "full"):
        bench = stage_of("a3", plan)
        scale = effects.EXACT["encoder_scale"](
            np.random.default_rng(0), bench.stage
        ).push(30e-6)
        bar = effects.EXACT["bar_length"](np.random.default_rng(0), bench.stage).push(
            10e-6
        )
        vectors = [
            bench.metric.embed(bench.scene.read(p) - bench.scene.y)
            for p in (scale, bar)
        ]
        distances[plan] = severity.distance(
            vectors[0], vectors[1][:, None]
        ) / np.linalg.norm(vectors[0])
    assert distances["single"] < 0.01
    assert distances["full"] > 0.05


@pytest.mark.parametrize("part", ["dq", "dp", "dtip", "ds", "dy"])
def test_exact_readings_follow_first_order_for_small_additions(part):
    bench = stage_of("planar", "poor")
    rows, rng = len(bench.plan.command), np.random.default_rng(4)
    width = {"dq": 2, "dp": 9, "dtip": 3, "ds": 6}
    shape = (bench.scene.layout.size,) if part == "dy" else (rows, width[part])
    push = scene.Push(**{part: 1e-8 * rng.normal(size=shape)})
    change, first = bench.scene.read(push) - bench.scene.y, bench.scene.response(push)
    assert np.abs(change - first).max() < 1e-5 * np.abs(first).max()


def dense_lambda(case, dy):
    """lambda as it is written down: (Sigma + J Lambda J^T) inverted whole."""
    J, prior = case.scene.J.astype(float), case.scene.prior
    sigma = noise.covariance(case.law, case.group)
    return float(dy @ np.linalg.solve(sigma + (J * prior**2) @ J.T, dy))


@pytest.mark.parametrize(
    "kind", ["single", "pair", "unknown", "exact", "known_unknown"]
)
def test_sizes_are_as_labelled(kind):
    number = next(k for k in range(400) if cases.role(5, "blind", k).kind == kind)
    case = cases.make(5, "blind", number)
    label = cases.label(case)
    changes = [sized.change for sized in case.sized]
    lambdas = [dense_lambda(case, dy) for dy in changes]
    for effect, value in zip(label["effects"], lambdas, strict=True):
        assert np.sqrt(value) == pytest.approx(effect["sqrt_lambda"], rel=2e-3)
    if len(changes) == 1:
        assert np.sqrt(lambdas[0]) == pytest.approx(case.sized[0].target, rel=1e-3)
    else:
        both = dense_lambda(case, changes[0] + changes[1])
        cross = (both - sum(lambdas)) / 2
        for i, effect in enumerate(label["effects"]):
            alone = np.sqrt(lambdas[i] - cross**2 / lambdas[1 - i])
            assert alone == pytest.approx(case.sized[i].target, rel=0.02)
            assert alone == pytest.approx(effect["given_other"], rel=1e-3)
    whole = case.clean - case.scene.y
    apart = whole - sum(changes)
    assert np.abs(apart).max() < 0.02 * np.abs(whole).max()


def test_labels_say_what_acts_and_where():
    """A common scale on one tool: nothing tells it from the bar; a step has its time."""
    where = cases._where(("time 7200-9000", "leg 2", "run R03", "direction +1"))
    assert where == {"time_s": [[7200.0, 9000.0]], "legs": [2], "runs": [3]}
    exact = [k for k in range(400) if cases.role(5, "blind", k).kind == "exact"]
    for number in exact:
        case = cases.make(5, "blind", number)
        if case.sized[0].target >= 6.0:
            break
    label = cases.label(case)
    assert label["kind"] == "class"
    assert set(label["effects"][0]["classes"]) >= {"bar_length", "encoder_scale"}


def test_expected_closure_is_that_of_a_fitted_size():
    """With independent readings of one size: half of them tell the size of the rest."""
    change, test = np.full(8, 2.0), np.arange(8) % 2 == 0
    expected = severity.expected_closure(np.eye(8), change, test)
    assert expected["C"] == pytest.approx(1.0 - 1.0 / 16.0)
    assert expected["gain"] == pytest.approx(16.0)
    shared = np.eye(8) + np.ones((8, 8))
    assert severity.expected_closure(shared, change, test)["gain"] < 16.0


@pytest.mark.parametrize("law", ["white", "correlated", "run", "heavy", "combined"])
def test_noise_has_the_covariance_it_tells(law):
    group = noise.Grouping(
        sigma=np.full(12, 2e-6),
        run=np.repeat([0, 1], 6),
        channel=np.zeros(12, dtype=int),
        phase=np.tile(np.linspace(0, 5, 6), 2),
        relative=np.ones(12, dtype=bool),
    )
    rng = np.random.default_rng(1)
    # the t has its variance where the covariance is told by information: leave its tail
    # off for this
    drawn = dataclasses.replace(noise.draw(rng, law), dof=0.0, outliers=0.0)
    sample = np.array([noise.sample(rng, drawn, group) for _ in range(6000)])
    covariance = noise.covariance(drawn, group)
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


def test_heavy_tails_are_heavy_and_told_by_their_information():
    group = noise.Grouping(
        sigma=np.ones(40000), run=np.arange(40000), channel=np.zeros(40000, dtype=int), phase=np.zeros(40000),
        relative=np.zeros(40000, dtype=bool),
    )  # fmt: skip
    law = noise.Law(name="heavy", dof=3.0)
    x = noise.sample(np.random.default_rng(2), law, group)
    # Fisher information about a shift, from the score of the t: E[psi^2], psi = (nu +
    # 1) x / (nu + x^2)
    information = np.mean((4.0 * x / (3.0 + x**2)) ** 2)
    small = dataclasses.replace(
        group, **{f.name: getattr(group, f.name)[:2] for f in dataclasses.fields(group)}
    )
    assert 1.0 / noise.covariance(law, small)[0, 0] == pytest.approx(
        information, rel=0.02
    )
    assert np.mean(np.abs(x) > 5.0) > 0.005


def test_a_thousand_cases_hold_what_the_judge_needs():
    roles = [cases.role(1, "blind", k) for k in range(1000)]
    laws = Counter(r.law for r in roles if r.kind == "null")
    assert set(laws) == set(noise.LAWS)
    assert min(laws.values()) >= 73
    assert set(Counter(r.kind for r in roles)) == set(cases.KINDS)
    machines = Counter(r.machine for r in roles if r.kind not in ("null", "exact"))
    assert min(machines.values()) > 100
    assert {r.machine for r in roles if r.kind == "exact"} == {"a3"}
    dev = [cases.role(1, "dev", k) for k in range(400)]
    assert {r.machine for r in dev} == {"a3", "planar", "delta"}


def test_roles_are_as_ever():
    for name, digest in (("dev", "444e20a361a0"), ("blind", "459754dcb789")):
        text = repr([dataclasses.astuple(cases.role(1, name, k)) for k in range(400)])
        assert hashlib.sha256(text.encode()).hexdigest().startswith(digest)


def test_a_case_depends_on_its_number_alone_and_its_file_gives_no_hint(tmp_path):
    setting = {"set": "dev", "set_seed": 2}
    number = next(k for k in range(99) if cases.role(2, "dev", k).machine == "planar")
    first, again = (world.draw(setting, number, tmp_path) for _ in range(2))
    assert first.label == again.label
    assert first.readings.name == f"{cases.identity(2, 'dev', number)}.readings.csv"
    columns = first.readings.read_text(encoding="utf-8").splitlines()[0].split(",")
    assert set(columns) <= {
        "setup", "run", "order", "y_mm", "z_mm", "time_s", "direction", "feed_mm_min", "payload_N",
        "temp_leg_C", "temp_frame_C", "repeat", "dy_mm", "dz_mm",
    }  # fmt: skip


def test_who_knows_the_noise_is_given_its_covariance(tmp_path):
    number = next(k for k in range(99) if cases.role(2, "dev", k).law == "run")
    case = world.draw({"set": "dev", "set_seed": 2}, number, tmp_path)
    problem, _ = prepare(case.study, case.readings)
    whitened = case.true_law(problem).factor(problem.structure)
    inverse = whitened.whiten(np.eye(len(problem)))
    whole = np.linalg.inv(inverse.T @ inverse)
    drawn = cases.make(2, "dev", number)
    sigma = noise.covariance(drawn.law, drawn.group)
    wanted = sigma / np.outer(problem.sigma, problem.sigma)
    np.testing.assert_allclose(whole, wanted, atol=1e-9 * wanted.max())
