"""Cases: which machine, plan, noise and effects case k of a set has, and how large its
effects are.

Case k depends on (seed, set, k) only. Kinds come from SCHEDULE, 200 cases in a drawn
order, so that every stretch of cases has every kind: with 1000 cases there are 75
without an effect for each noise law.

The size of an effect is given by sqrt(lambda) (`severity`): of one effect, its own; of
two, what each has left once the direction of the other is absorbed. Sizes that no such
machine would have (LIMITS) are drawn again, with another form, then another effect.
"""

from __future__ import annotations

import dataclasses
import hashlib
from typing import Any

import numpy as np
import pandas as pd
from numpy.random import Generator

from benchmarks.blind.generator import effects, noise, plans, scene, severity
from benchmarks.blind.generator.effects import Effect, Stage, climate
from benchmarks.blind.generator.machines import Array
from benchmarks.blind.generator.plans import PLANS, TEACH, Index
from benchmarks.blind.generator.scene import Scene

SETS = {"dev": 1, "blind": 2}
#: machines of each set: the hexapod is kept from whoever develops a diagnosis
ON = {"dev": ("a3", "planar", "delta"), "blind": ("a3", "planar", "delta", "hexapod")}
KINDS = ("null", "single", "pair", "exact", "unknown", "known_unknown")
#: (kind, number in a stretch of 200); null: that number for each noise law
SCHEDULE = tuple(zip(KINDS, (15, 55, 25, 10, 20, 15), strict=True))
LEVELS = (2.0, 4.0, 6.0, 10.0, 20.0)
#: of two effects, and of unknown ones, the lowest levels are rare
PAIR_LEVELS, PAIR_SHARES = (4.0, 6.0, 10.0, 20.0), (0.1, 0.3, 0.3, 0.3)
#: largest believable addition (m) at a joint, a place, a reading, by effect; times SIZE
#: of the machine
LIMITS = {
    "leg_thermal": 200e-6,
    "frame_thermal": 200e-6,
    "gravity": 150e-6,
    "frame_bending": 100e-6,
    "backlash": 30e-6,
    "friction": 40e-6,
    "servo_lag": 200e-6,
    "encoder_scale": 150e-6,
    "pitch_accumulation": 60e-6,
    "screw_cyclic": 20e-6,
    "encoder_subdivision": 3e-6,
    "guideway": 60e-6,
    "joint_runout": 30e-6,
    "joint_clearance": 30e-6,
    "bar_length": 60e-6,
    "bar_thermal": 30e-6,
    "mount_drift": 60e-6,
    "step": 200e-6,
}
UNKNOWN_LIMIT = 100e-6
SIZE = {"a3": 1.0, "hexapod": 1.0, "planar": 3.0, "delta": 8.0}
TRIES = 12
#: what the judge calls kinds
KIND_OF_LABEL = {"exact": "class", "known_unknown": "mixed"}
#: draws of a rival's form; a rival that leaves less of sqrt(lambda) explains an effect
FORMS, EXPLAINED = 16, 5.0


@dataclasses.dataclass(frozen=True)
class Sized:
    """An effect with its amplitude."""

    effect: Effect  #: the effect
    known: bool  #: whether the library may have it
    target: float  #: sqrt(lambda) that it was made for
    amplitude: float  #: of its largest addition, m
    change: Array  #: (N,) exact difference of the noise-free readings by it alone


@dataclasses.dataclass(frozen=True)
class Case:
    """A case as generated.

    id, number      its name and number in the set
    kind            null, single, pair, exact, unknown, known_unknown
    scene, stage    machine, plan and readings without effects
    law, group      noise law and which readings share errors
    metric          of the severity
    sized           effects that act
    clean           (N,) readings with the effects, without noise
    y               (N,) readings
    seed            key of its random stream
    """

    id: str
    number: int
    kind: str
    scene: Scene
    stage: Stage
    law: noise.Law
    group: noise.Grouping
    metric: severity.Metric
    sized: tuple[Sized, ...]
    clean: Array
    y: Array
    seed: tuple[int, int, int]


@dataclasses.dataclass(frozen=True)
class Role:
    """What the schedule gives case k."""

    kind: str
    law: str
    machine: str
    plan: str


def role(seed: int, name: str, k: int) -> Role:
    """Kind, noise law, machine and plan of case k of a set.

    Raises ValueError for an unknown set.
    """
    if name not in SETS:
        raise ValueError(f"there is no set {name!r}; there are {', '.join(SETS)}")
    slots = [
        (kind, law)
        for kind, n in SCHEDULE
        for law in (noise.LAWS if kind == "null" else ("",))
        for _ in range(n)
    ]
    block = k // len(slots)
    at = int(
        np.random.default_rng([seed, SETS[name], block, 99]).permutation(len(slots))[
            k % len(slots)
        ]
    )
    kind, law = slots[at]
    rng = np.random.default_rng([seed, SETS[name], k, 98])
    machine = ON[name][(at + block) % len(ON[name])]
    law = law or str(rng.choice(noise.LAWS))
    if kind == "exact" and "a3" not in ON[name]:
        kind = "single"  # only the A3 has a plan with one bar and one tool
    if kind == "exact":
        return Role(kind, law, "a3", str(rng.choice(["single", "poor"], p=[0.7, 0.3])))
    names = PLANS[machine]
    share = (0.55, 0.2, 0.25) if len(names) == 3 else (0.7, 0.3)
    return Role(kind, law, machine, str(rng.choice(names, p=share)))


def identity(seed: int, name: str, k: int) -> str:
    """A name that reveals nothing of the case."""
    return hashlib.sha256(f"{seed}/{name}/{k}".encode()).hexdigest()[:10]


def make(seed: int, name: str, k: int) -> Case:
    """Case k of a set."""
    part = role(seed, name, k)
    key = (seed, SETS[name], k)
    rng = np.random.default_rng(key)
    plan = plans.draw(rng, part.machine, part.plan)
    base = scene.draw(rng, plan)
    stage = Stage(plan, base.motion, base.layout, climate(rng, plan))
    law, group = noise.draw(rng, part.law), noise.grouping(plan, base.layout)
    metric = severity.Metric(noise.covariance(law, group), base.J, base.prior)
    sized = _effects(rng, part.kind, base, stage, metric)
    push = None
    for s in sized:
        added = s.effect.push(s.amplitude)
        push = added if push is None else push.plus(added)
    clean = base.read(push)
    y = clean + noise.sample(rng, law, group)
    about = identity(seed, name, k), k, part.kind
    return Case(*about, base, stage, law, group, metric, tuple(sized), clean, y, key)


def _effects(
    rng: Generator, kind: str, base: Scene, stage: Stage, metric: severity.Metric
) -> list[Sized]:
    if kind == "null":
        return []
    if kind in ("single", "exact", "unknown"):
        return [_single(rng, kind, base, stage, metric)]
    for _ in range(4 * TRIES):
        try:
            return _pair(rng, kind == "pair", base, stage, metric)
        except ArithmeticError:
            continue
    raise ArithmeticError("no pair of effects fits this plan")


def _single(
    rng: Generator, kind: str, base: Scene, stage: Stage, metric: severity.Metric
) -> Sized:
    rare = (PAIR_LEVELS, PAIR_SHARES)
    levels, shares = rare if kind == "unknown" else (LEVELS, None)
    target = float(rng.choice(levels, p=shares))
    for _ in range(4):
        name = _name(rng, kind, stage)
        for _ in range(TRIES):
            try:
                effect = _form(rng, kind, name, stage)
                return _scaled(base, metric.size, effect, kind != "unknown", target)
            except ArithmeticError:
                continue
        if kind == "exact":
            target = min(target, 6.0)
    raise ArithmeticError(f"no effect of kind {kind} fits this plan")


def _name(rng: Generator, kind: str, stage: Stage) -> str:
    machine = stage.machine.name
    choices = {"exact": tuple(effects.EXACT), "unknown": effects.unknown_on(machine)}
    return str(rng.choice(choices.get(kind, effects.known_on(machine))))


def _form(rng: Generator, kind: str, name: str, stage: Stage) -> Effect:
    forms = {"exact": effects.EXACT, "unknown": effects.UNKNOWN}.get(
        kind, effects.KNOWN
    )
    return forms[name](rng, stage)


def _limit(effect: Effect, known: bool, machine: str) -> float:
    return (LIMITS[effect.name] if known else UNKNOWN_LIMIT) * SIZE[machine]


def _scaled(
    base: Scene, size: severity.Size, effect: Effect, known: bool, target: float
) -> Sized:
    """The effect at the amplitude that gives the target.

    Raises ArithmeticError where no plausible one does.
    """
    small = 1e-7
    trace = size(base.response(effect.push(small)))
    if trace <= 0:
        raise ArithmeticError("no trace")
    start = target / trace * small
    limit = _limit(effect, known, base.plan.machine.name)
    if start > 1.3 * limit:
        raise ArithmeticError("too large to be believed")

    def change(amplitude: float) -> Array:
        return np.asarray(base.read(effect.push(amplitude)) - base.y)

    a = severity.amplitude(change, size, target, start)
    if a > limit:
        raise ArithmeticError("too large to be believed")
    return Sized(effect, known, target, a, change(a))


def _pair(
    rng: Generator, known: bool, base: Scene, stage: Stage, metric: severity.Metric
) -> list[Sized]:
    """Two effects, each of its size beyond the other's direction, and not nearly alike."""
    a, b = (float(v) for v in rng.choice(PAIR_LEVELS, 2, p=PAIR_SHARES))
    first_name = _name(rng, "single", stage)
    second = "single" if known else "unknown"
    second_name = _name(rng, second, stage)
    if first_name == second_name:
        raise ArithmeticError("twice the same")
    one = _form(rng, "single", first_name, stage)
    two = _form(rng, second, second_name, stage)
    directions = [metric.embed(base.response(e.push(1e-6))) for e in (one, two)]
    lengths = [np.linalg.norm(direction) for direction in directions]
    if min(lengths) <= 0:
        raise ArithmeticError("no trace")
    product = abs(float(directions[0] @ directions[1]))
    cosine = product / float(lengths[0] * lengths[1])
    if cosine > 0.9:
        raise ArithmeticError("nearly the same")
    return [
        _scaled(base, metric.size_without(directions[1]), one, True, a),
        _scaled(base, metric.size_without(directions[0]), two, known, b),
    ]


# -- files and truth -------------------------------------------------------------------
def table(case: Case) -> pd.DataFrame:
    """The readings as a file has them: text, empty where there is no reading."""
    plan = case.stage.plan
    rows = np.flatnonzero(plan.kind != TEACH)
    cells: dict[str, list[str]] = {
        "setup": [plan.setups[k].name for k in plan.setup[rows]],
        "run": [plan.run_name(int(k)) for k in plan.run[rows]],
        "order": [str(k) for k in plan.order[rows]],
    }
    for k, (stem, unit) in enumerate(plan.machine.command):
        factor = {"mm": 1e3, "deg": 180.0 / np.pi}[unit]
        cells[f"{stem}_{unit}"] = [f"{v:.9f}" for v in plan.command[rows, k] * factor]
    for column, values, form in _covariates(case):
        if column in plan.columns:
            cells[column] = [form.format(v) for v in values[rows]]
    return pd.DataFrame(cells | _readings(case, rows))


def _covariates(case: Case) -> list[tuple[str, Array, str]]:
    plan = case.stage.plan
    return [
        ("time_s", plan.time, "{:.2f}"),
        ("direction", plan.direction, "{:.0f}"),
        ("feed_mm_min", plan.feed * 6e4, "{:.3f}"),
        ("payload_N", plan.payload, "{:.1f}"),
        *((name, shown, "{:.1f}") for name, shown in case.stage.climate.shown.items()),
        ("repeat", plan.repeat.astype(float), "{:.0f}"),
    ]


def _readings(case: Case, rows: Index) -> dict[str, list[str]]:
    plan, layout = case.stage.plan, case.stage.layout
    cells: dict[str, list[str]] = {}
    at = 0
    for setup, here in zip(plan.setups, layout.rows, strict=True):
        channels = [f"{stem}_mm" for stem, _ in setup.instrument.channels]
        count = len(here) * len(channels)
        values = case.y[at : at + count].reshape(len(here), -1) * 1e3
        at += count
        for k, column in enumerate(channels):
            whole = cells.setdefault(column, [""] * len(plan.kind))
            for i, v in zip(here, values[:, k], strict=True):
                whole[i] = f"{v:.7f}"
    return {column: [whole[i] for i in rows] for column, whole in cells.items()}


def label(case: Case) -> dict[str, Any]:
    """The truth of a case, as the judge of all worlds reads it."""
    plan, metric = case.stage.plan, case.metric
    changes = [metric.embed(s.change) for s in case.sized]
    rivals = _rivals(case) if changes else {}
    acting = [
        _effect_label(sized, change, rivals)
        for sized, change in zip(case.sized, changes, strict=True)
    ]
    if len(acting) == 2:
        for k in (0, 1):
            rest = severity.distance(changes[k], changes[1 - k][:, None])
            acting[k]["given_other"] = rest
    return {
        "machine": plan.machine.name,
        "plan": plan.name,
        "kind": KIND_OF_LABEL.get(case.kind, case.kind),
        "law": {"law": case.law.name},
        "effects": acting,
        "sqrt_lambda_total": metric.size(case.clean - case.scene.y),
        "closure": _closures(case) if acting else {},
    }


def _rivals(case: Case) -> dict[str, Array]:
    """Changes of the readings (N, FORMS) by other draws of each known effect's form."""
    columns = {}
    for k, name in enumerate(effects.known_on(case.stage.machine.name)):
        responses = []
        for number in range(FORMS):
            rng = np.random.default_rng([*case.seed, k, number])
            try:
                effect = effects.KNOWN[name](rng, case.stage)
            except ArithmeticError:  # this form does nothing on this plan
                continue
            responses.append(case.scene.response(effect.push(1e-6)))
        if responses:
            columns[name] = case.metric.embed(np.stack(responses, -1))
    return columns


def _effect_label(
    sized: Sized, change: Array, rivals: dict[str, Array]
) -> dict[str, Any]:
    """Size and places of an effect, and which rivals explain it as well.

    Those whose drawn forms, of any size, leave less than EXPLAINED of its change (N,).
    """
    name, size = sized.effect.name, float(np.linalg.norm(change))
    rest = {
        rival: severity.distance(change, columns)
        for rival, columns in rivals.items()
        if rival != name
    }
    equal = {rival for rival, value in rest.items() if value < EXPLAINED}
    has_class = sized.known and size >= EXPLAINED
    return {
        "effect": name,
        "listed": sized.known,
        "sqrt_lambda": size,
        "classes": sorted({name} | equal) if has_class else None,
        "outside": min((v for n, v in rest.items() if n not in equal), default=0.0),
        "out_of_span": min(rest.values()),
        "where": _where(sized.effect.blocks),
    }


def _where(blocks: tuple[str, ...]) -> dict[str, Any]:
    """Legs, runs and spans of time of an effect's blocks, where it acts in part."""
    where: dict[str, Any] = {}
    for block in blocks:
        kind, _, place = block.partition(" ")
        if kind == "leg":
            where.setdefault("legs", []).append(int(place))
        if kind == "run":
            where.setdefault("runs", []).append(int(place.removeprefix("R")))
        if kind == "time":
            start, end = place.split("-")
            where.setdefault("time_s", []).append([float(start), float(end)])
    return where


def _closures(case: Case) -> dict[str, dict[str, float]]:
    """Closures expected of whoever knows the shape: parts of runs, two whole runs."""
    run = case.group.run
    number = np.unique(run, return_inverse=True)[1]
    held_out = {
        "within": np.arange(len(run)) % 5 == 2,
        "whole": np.isin(number, [number.max() // 3, 2 * number.max() // 3]),
    }
    prior = case.scene.J * case.scene.prior
    covariance = noise.covariance(case.law, case.group) + prior @ prior.T
    change = case.clean - case.scene.y
    return {
        split: severity.expected_closure(covariance, change, test)
        for split, test in held_out.items()
    }
