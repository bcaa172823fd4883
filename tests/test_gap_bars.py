"""What a diagnosis must and must not claim: exact classes, missing covariates, unseen
runs, effects it does not know.

Readings come from the blind benchmark's generator, which shares no code with the
diagnosis, or from the exact closure.
"""

from __future__ import annotations

import dataclasses
import itertools
from collections.abc import Callable, Sequence
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
import pandas as pd
import pytest
from effects_sample import NAMES, effect_of
from scipy import linalg

from oed.effect import Effect
from oed.gap.data import state as states_of
from oed.gap.data.diagnosis import UNKNOWN, Answer, Diagnosis
from oed.gap.data.problem import GapProblem, assemble, prepare
from oed.gap.data.signature import exact_readings, signature
from oed.gap.diagnose import diagnose
from oed.gap.forms import library
from oed.instrument import mount
from oed.measurement import Measurement, Series
from pkm_models.instruments import relative
from pkm_models.machines import planar_2dof

MODULES = ("cases", "effects", "noise", "plans", "scene", "severity", "write")
COLUMNS = ("time_s", "direction", "feed_mm_min", "payload_N", "repeat")
TIMED = ("leg_thermal", "frame_thermal", "bar_thermal", "mount_drift", "step")
TURNING = ("backlash", "friction")
TWO = {"encoder_scale", "bar_length"}
#: another machine, or another noise law, of a bar that the default run has already
SLOW = pytest.mark.slow


@pytest.fixture(scope="module")
def blind(blind_modules: Callable[..., SimpleNamespace]) -> SimpleNamespace:
    """The benchmark's modules."""
    return blind_modules(
        "loading", *(f"generator.{n}" for n in MODULES), "generator.effects.thermal"
    )


@dataclasses.dataclass
class Virtual:
    """A case with one effect: as generated, its problem, and what the diagnosis may
    name.
    """

    case: Any
    problem: GapProblem
    effects: Sequence[Any]

    def diagnosed(self, without: str = "") -> Diagnosis:
        return diagnose(
            self.problem,
            [e for e in self.effects if e.name != without],
            np.random.default_rng(1),
        )


def virtual(
    blind: SimpleNamespace,
    folder: Path,
    seed: int,
    plan: tuple[str, str],
    form: Callable[..., Any],
    size: float,
    *,
    law: str = "white",
    second_form: Callable[..., Any] | None = None,
    columns: Sequence[str] = COLUMNS,
    rows: str = "",
) -> Virtual:
    """Readings with one effect of sqrt(lambda) = size, beyond what the form `beside`
    absorbs where that is given.

    plan: machine and plan;  columns: covariates in the file;  rows: a query on the
                             file's rows
    """
    rng = np.random.default_rng(seed)
    layout = dataclasses.replace(blind.plans.draw(rng, *plan), columns=tuple(columns))
    base = blind.scene.draw(rng, layout)
    stage = blind.effects.Stage(
        layout, base.motion, base.layout, blind.thermal.climate(rng, layout)
    )
    noise, group = blind.noise.draw(rng, law), blind.noise.grouping(layout, base.layout)
    metric = blind.severity.Metric(
        blind.noise.covariance(noise, group), base.J, base.prior
    )
    effect, wanted = form(rng, stage), metric.size
    if second_form is not None:
        wanted = metric.size_without(
            metric.embed(base.response(second_form(rng, stage).push(1e-6)))
        )
    start = size / wanted(base.response(effect.push(1e-7))) * 1e-7
    amplitude = blind.severity.amplitude(
        lambda a: base.read(effect.push(a)) - base.y, wanted, size, start
    )
    clean = base.read(effect.push(amplitude))
    sized = blind.cases.Sized(effect, True, size, amplitude, clean - base.y)
    y = clean + blind.noise.sample(rng, noise, group)
    case = blind.cases.Case(
        "one",
        0,
        "single",
        base,
        stage,
        noise,
        group,
        metric,
        (sized,),
        clean,
        y,
        (seed, 0, 0),
    )
    table = blind.write.table(case)
    (folder / "one.csv").write_text(
        (table.query(rows) if rows else table).to_csv(index=False), encoding="utf-8"
    )
    problem = blind.loading.prepared(
        folder, blind.loading.Case("one", layout.study, "one.csv")
    )
    return Virtual(case, problem, blind.loading.bench(layout.study).effects)


def together(answers: Sequence[Answer], names: set[str]) -> list[bool]:
    """For each class of the answers, down to 95 % of them, that has one of these names,
    whether it has them all.
    """
    before = np.cumsum([0.0, *(a.probability for a in answers)])
    likely = [a for a, p in zip(answers, before, strict=False) if p < 0.95]
    return [names <= set(c) for a in likely for c in a.classes if names & set(c)]


def held(diagnosis: Diagnosis, names: set[str]) -> list[bool]:
    """For each answer of the 95 % set that has one of these names, whether it has them
    all: beside the one a class of a second effect may leave it out.
    """
    every = [{name for c in a.classes for name in c} for a in diagnosis.set95]
    return [names <= each for each in every if names & each]


# -- a common encoder scale and the bar's length ---------------------------------------


@pytest.mark.parametrize(
    ("truth", "seed", "law"),
    [
        ("encoder_scale", 1, "white"),
        pytest.param("encoder_scale", 2, "run", marks=SLOW),
        ("bar_length", 3, "correlated"),
        pytest.param("bar_length", 4, "heavy", marks=SLOW),
    ],
)
def test_one_tool_never_tells_scale_from_bar(
    blind: SimpleNamespace, tmp_path: Path, truth: str, seed: int, law: str
) -> None:
    """The answer holds both, whichever acts, and names the reading that would tell."""
    form = blind.effects.EXACT[truth]
    diagnosis = virtual(
        blind, tmp_path, seed, ("a3", "single"), form, 14.0, law=law
    ).diagnosed()
    assert together(diagnosis.answers, TWO), diagnosis.answers[0]
    assert all(together(diagnosis.answers, TWO)), diagnosis.answers
    assert held(diagnosis, TWO), diagnosis.set95
    assert all(held(diagnosis, TWO)), diagnosis.set95
    assert diagnosis.verdict == "class"
    said = " ".join(diagnosis.next)
    assert "laser" in said
    assert "tool length" in said


@pytest.mark.parametrize("seed", [1, pytest.param(2, marks=SLOW)])
@pytest.mark.parametrize("truth", sorted(TWO))
def test_two_known_tools_tell_scale_from_bar(
    blind: SimpleNamespace, tmp_path: Path, truth: str, seed: int
) -> None:
    """At sqrt(lambda_k|j) = 8 the one that acts is named, and not the other."""
    forms = blind.effects.EXACT
    (rival,) = TWO - {truth}
    machine = virtual(
        blind,
        tmp_path,
        seed,
        ("a3", "full"),
        forms[truth],
        8.0,
        second_form=forms[rival],
    )
    diagnosis = machine.diagnosed()
    assert diagnosis.answers[0].effects == (truth,)
    assert diagnosis.marginal[rival] < 0.1
    assert rival not in diagnosis.answers[0].classes[0]


@pytest.mark.parametrize(
    ("truth", "seed"),
    [
        ("encoder_scale", 5),
        pytest.param("encoder_scale", 8, marks=SLOW),
        ("bar_length", 5),
    ],
)
def test_two_tools_do_not_misname_what_is_small(
    blind: SimpleNamespace, tmp_path: Path, truth: str, seed: int
) -> None:
    """At sqrt(lambda_k|j) = 2 either may be the likelier one; the one that acts is
    always in the answer.
    """
    forms = blind.effects.EXACT
    (rival,) = TWO - {truth}
    machine = virtual(
        blind,
        tmp_path,
        seed,
        ("a3", "full"),
        forms[truth],
        2.0,
        second_form=forms[rival],
    )
    diagnosis = machine.diagnosed()
    assert any(truth in c for c in diagnosis.answers[0].classes), diagnosis.answers[0]


# -- what the readings cannot test -----------------------------------------------------


def test_without_time_nothing_thermal_is_absent(
    blind: SimpleNamespace, tmp_path: Path
) -> None:
    """Legs grow; the file does not tell when. Thermal effects, drift and steps are not
    tested, and get no odds.
    """
    form, columns = (
        blind.effects.KNOWN["leg_thermal"],
        [c for c in COLUMNS if c != "time_s"],
    )
    diagnosis = virtual(
        blind, tmp_path, 3, ("planar", "full"), form, 10.0, columns=columns
    ).diagnosed()
    wanted = set(TIMED) - {"bar_thermal"}  # no bar here
    assert wanted <= set(diagnosis.not_testable)
    assert all("time" in diagnosis.not_testable[n] for n in wanted)
    assert not wanted & set(diagnosis.marginal)
    assert not wanted & {n for a in diagnosis.answers for c in a.classes for n in c}


@pytest.mark.parametrize(
    "rows", ["", "direction == '1'"], ids=["no direction", "one direction"]
)
def test_without_both_directions_backlash_is_not_absent(
    blind: SimpleNamespace, tmp_path: Path, rows: str
) -> None:
    form, columns = (
        blind.effects.KNOWN["backlash"],
        [c for c in COLUMNS if rows or c != "direction"],
    )
    machine = virtual(
        blind, tmp_path, 3, ("planar", "full"), form, 10.0, columns=columns, rows=rows
    )
    diagnosis = machine.diagnosed()
    assert set(TURNING) <= set(diagnosis.not_testable)
    assert all("direction" in diagnosis.not_testable[n] for n in TURNING)
    assert not set(TURNING) & set(diagnosis.marginal)
    assert not set(TURNING) & {
        n for a in diagnosis.answers for c in a.classes for n in c
    }
    assert not set(TIMED) & set(diagnosis.not_testable) - {"bar_thermal"}


def test_with_all_columns_all_is_tested(blind: SimpleNamespace, tmp_path: Path) -> None:
    machine = virtual(
        blind, tmp_path, 3, ("a3", "full"), blind.effects.KNOWN["backlash"], 10.0
    )
    assert not {*TIMED, *TURNING} & set(
        library.build(machine.problem, machine.effects).not_testable
    )


# -- an effect that the library does not have ------------------------------------------


@pytest.mark.parametrize(
    ("name", "seed"),
    [
        ("gravity", 3),
        ("servo_lag", 4),
        ("pitch_accumulation", 1),
        ("step", 1),
        pytest.param("step", 2, marks=SLOW),
    ],
    ids=lambda v: str(v),
)
def test_a_withheld_effect_is_unknown(
    blind: SimpleNamespace, tmp_path: Path, name: str, seed: int
) -> None:
    """Strong effects that no other can stand for; how often it goes so is a matter of
    the blind benchmark.

    Where one leg has four fifths of the trace, that leg is named, by itself or with one
    that the readings cannot tell from it.
    """
    machine = virtual(
        blind, tmp_path, seed, ("planar", "full"), blind.effects.KNOWN[name], 20.0
    )
    diagnosis = machine.diagnosed(without=name)
    assert UNKNOWN in diagnosis.answers[0].effects, diagnosis.answers[:3]
    assert diagnosis.marginal[UNKNOWN] > 0.8
    shares = np.array(blind.cases.label(machine.case)["effects"][0]["legs"])
    if shares.max() > 0.8:
        legs = [
            b for b in diagnosis.where if b.block.startswith("leg") and b.p_value < 0.05
        ]
        # a lost zero of either leg of this machine makes nearly the same readings: then
        # both are told, alike
        assert f"leg {shares.argmax() + 1}" in [
            b.block for b in legs if b.p_value <= 10.0 * legs[0].p_value
        ]


# -- a planar machine with gravity and over-constraint ---------------------------------

ACTING = (
    (
        "gravity",
        {"ratio": 0.47},
        {"drives": 2.0, "struts": 2.0},
    ),  # a weight beside the library's
    (
        "frame_bending",
        {"sag": 0.2},
        {"y by yz": -0.9, "y by zz": 1.5, "z by yy": -1.05, "z by yz": -1.2},
    ),
)
#: y (rm4) or z (rm5) of the lines, loads (N): those fitted, and others kept out
FITTED = {
    "rm4": ((-1.5, 0.0, 1.5), (0.0, 1500.0)),
    "rm5": ((0.0, 0.75, 1.5), (0.0, 1500.0)),
}
UNSEEN = {"rm4": ((-0.75, 0.75), (800.0,)), "rm5": ((0.375, 1.125), (800.0,))}
READS = {"rm4": 1, "rm5": 2}  # channels


def lines(
    m: Measurement, *parts: tuple[str, dict[str, Any]]
) -> tuple[list[Series], pd.DataFrame]:
    """Lines along z (rm4) and y (rm5) with their conditions; parts: (begin of the runs'
    names, places and loads).
    """
    series, rows = [], []
    for setup in READS:
        commands, runs = [], []
        for begin, where in parts:
            for load in where[setup][1]:
                for at in where[setup][0]:
                    s = (
                        np.linspace(0.0, 1.5, 11)
                        if setup == "rm4"
                        else np.linspace(-1.5, 1.5, 13)
                    )
                    commands.append(
                        np.column_stack(
                            [0 * s + at, s] if setup == "rm4" else [s, 0 * s + at]
                        )
                    )
                    run = {
                        "setup": setup,
                        "run": f"{begin} {at} m {load} N",
                        "payload": load,
                    }
                    runs += [
                        run | {"order": k + 1, "direction": 1.0, "feed": 1.0 / 60.0}
                        for k in range(len(s))
                    ]
        series.append(
            m.series(setup, np.vstack(commands), run=[r["run"] for r in runs])
        )
        rows += [
            r for r in runs if r["order"] > 1
        ]  # the first of a line is its reference
    return series, pd.DataFrame(rows).assign(
        time=lambda t: 1800.0 + 20.0 * np.arange(len(t))
    )


@dataclasses.dataclass
class Planar:
    """A virtual planar machine: the diagnosis of its lines, and all readings with those
    kept out.
    """

    diagnosis: Diagnosis
    whole: GapProblem
    held: np.ndarray


def planar(seed: int) -> Planar:
    m = Measurement(
        planar_2dof.machine, [mount(getattr(relative, n), n) for n in READS]
    )
    rng = np.random.default_rng(seed)
    theta = m.nominal + m.tolerance * rng.standard_normal(len(m.nominal))
    series, rows = lines(m, ("fitted", FITTED), ("unseen", UNSEEN))
    states = states_of.states(m, tuple(series), rows, theta)
    root = m.noise(series).root
    y = exact_readings(
        m, series, theta, states, [(effect_of(n), c, f) for n, c, f in ACTING]
    )
    y = y + root @ rng.standard_normal(root.shape[1])
    count = rows["setup"].map(READS).to_numpy()
    held = np.repeat(rows["run"].str.startswith("unseen").to_numpy(), count)
    fitted, known = lines(m, ("fitted", FITTED))
    problem = prepare(m, fitted, y[~held], known)
    diagnosis = diagnose(
        problem, [effect_of(n) for n in NAMES], np.random.default_rng(1)
    )
    return Planar(diagnosis, assemble(m, series, rows, problem.theta, y), held)


def predicted(case: Planar) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    """Errors (k,) of the unseen readings without and with the effects named,
    covariances (k, k) of both; um.

    Dense Gaussian conditioning on the fitted readings; constants (the platform's
    weight) are the library's likeliest.
    """
    whole, held = case.whole, case.held
    noise = np.zeros((len(whole), len(whole)))
    for members, base in zip(whole.members, whole.stated_correlation, strict=True):
        noise[np.ix_(members, members)] = np.eye(len(members)) if base is None else base
    plain = noise + whole.slopes @ whole.slopes.T
    named = [
        effect_of(n)
        for n in dict.fromkeys(c.effect for c in case.diagnosis.coefficients)
    ]
    choices = itertools.product(
        *([(e, point) for point in e.constant_grid()] for e in named)
    )
    best = max(
        (corrected(case, plain, forms) for forms in choices),
        key=lambda c: evidence(case, c),
    )
    um = 1e6 * whole.sigma[held]
    e0, p0 = conditioned(plain, whole.residual, held)
    e1, p1 = conditioned(best, whole.residual, held)
    return um * e0, um * e1, np.outer(um, um) * p0, np.outer(um, um) * p1


def corrected(
    case: Planar, plain: np.ndarray, forms: Sequence[tuple[Effect, dict[str, float]]]
) -> np.ndarray:
    """Covariance (N, N) with the coefficients that the diagnosis names, wide
    beforehand.
    """
    w, named = case.whole, {(c.effect, c.name) for c in case.diagnosis.coefficients}
    for effect, point in forms:
        effect_signature = signature(
            effect, point, w.states, w.responses, w.measurement, w.series, w.sigma
        )
        columns = (
            3.0
            * w.in_noise_units(effect_signature.columns)[
                :, [(effect.name, n) in named for n in effect_signature.names]
            ]
        )
        plain = plain + columns @ columns.T
    return plain


def evidence(case: Planar, covariance: np.ndarray) -> float:
    root = linalg.cholesky(covariance[np.ix_(~case.held, ~case.held)], lower=True)
    white = linalg.solve_triangular(root, case.whole.residual[~case.held], lower=True)
    return float(-0.5 * white @ white - np.log(np.diag(root)).sum())


def conditioned(
    covariance: np.ndarray, residual: np.ndarray, held: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    cross = covariance[np.ix_(held, ~held)]
    gain = np.linalg.solve(covariance[np.ix_(~held, ~held)], cross.T).T
    return (
        residual[held] - gain @ residual[~held],
        covariance[np.ix_(held, held)] - gain @ cross.T,
    )


def test_the_planar_gap_is_gravity_and_bending_and_shrinks_on_unseen_lines() -> None:
    """What geometry leaves, up to 0.06 mm, goes down to about 0.01 mm on lines and a
    load that were not fitted.

    The rms of what is left there lies in its 95 % interval, channel by channel, in at
    least 9 of 12 cases: 8 or fewer are a matter of 0.3 %. The shrink itself reaches the
    lower end of what the diagnosis said of unseen runs. In one machine of six an effect
    more may be named (the weight is between two of the library's).
    """
    inside, alone, draws = [], [], np.random.default_rng(7)
    for seed in range(6):
        case = planar(seed)
        assert min(case.diagnosis.marginal[n] for n, _, _ in ACTING) > 0.95
        alone.append(
            set(case.diagnosis.answers[0].effects) == {n for n, _, _ in ACTING}
        )
        assert case.diagnosis.where[0].block == "all legs"
        before, after, without, with_them = predicted(case)
        assert 40.0 < np.abs(before).max() < 90.0
        assert np.abs(after).max() < 20.0
        assert np.sqrt(np.mean(after**2)) < 6.0
        white0, white1 = (
            np.linalg.solve(np.linalg.cholesky(without), e) for e in (before, after)
        )
        s0, s1 = np.mean(white0**2), np.mean(white1**2)
        closure = next(c for c in case.diagnosis.closure if c.split == "whole")
        assert closure.low > 0.9
        assert (s0 - s1) / (s0 - 1.0) > closure.low - 3.0 * np.sqrt(
            2.0 / len(after)
        ) / (s0 - 1.0)
        root = np.linalg.cholesky(with_them)
        likely = root @ draws.standard_normal((len(root), 2000))
        channel = case.whole.rows["channel"].to_numpy()[case.held]
        for name in ("dy", "dz"):
            low, high = np.percentile(
                np.sqrt(np.mean(likely[channel == name] ** 2, axis=0)), [2.5, 97.5]
            )
            inside.append(low <= np.sqrt(np.mean(after[channel == name] ** 2)) <= high)
    assert sum(alone) >= 5
    assert sum(inside) >= 9
