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

import numpy as np
from numpy.random import Generator

from benchmarks.blind.generator import effects, noise, plans, scene, severity, textbook
from benchmarks.blind.generator.effects import Effect, Stage
from benchmarks.blind.generator.effects.thermal import climate
from benchmarks.blind.generator.machine import Array
from benchmarks.blind.generator.machine_plans import PLANS
from benchmarks.blind.generator.scene import Scene

SETS = {"dev": 1, "blind": 2, "six": 3}
#: machines of each set: the hexapod is kept from whoever develops a diagnosis
ON = {
    "dev": ("a3", "planar", "delta"),
    "blind": ("a3", "planar", "delta", "hexapod"),
    "six": ("hexaglide",),
}
KINDS = ("null", "single", "pair", "exact", "unknown", "known_unknown")
#: (kind, number in a stretch of 200); null: that number for each noise law
SCHEDULE = (
    ("null", 15),
    ("single", 55),
    ("pair", 25),
    ("exact", 10),
    ("unknown", 20),
    ("known_unknown", 15),
)
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
SIZE = {"a3": 1.0, "hexapod": 1.0, "hexaglide": 2.0, "planar": 3.0, "delta": 8.0}
TRIES = 12


@dataclasses.dataclass(frozen=True)
class Sized:
    """An effect with its amplitude.

    effect       the effect
    known        whether the library may have it
    target       sqrt(lambda) that it was made for
    amplitude    of its largest addition, m
    change       (N,) exact difference of the noise-free readings by it alone
    """

    effect: Effect
    known: bool
    target: float
    amplitude: float
    change: Array


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
    return Case(
        identity(seed, name, k),
        k,
        part.kind,
        base,
        stage,
        law,
        group,
        metric,
        tuple(sized),
        clean,
        y,
        key,
    )


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
    target = float(
        rng.choice(PAIR_LEVELS, p=PAIR_SHARES)
        if kind == "unknown"
        else rng.choice(LEVELS)
    )
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
    forms = (
        effects.EXACT
        if kind == "exact"
        else effects.UNKNOWN
        if kind == "unknown"
        else effects.KNOWN
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
    a = severity.amplitude(
        lambda v: base.read(effect.push(v)) - base.y, size, target, start
    )
    if a > limit:
        raise ArithmeticError("too large to be believed")
    return Sized(effect, known, target, a, base.read(effect.push(a)) - base.y)


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


def label(case: Case) -> dict[str, object]:
    """What only the scorer may read."""
    plan = case.stage.plan
    names = effects.known_on(plan.machine.name)
    changes = [s.change for s in case.sized]
    distances = textbook.distances(case.scene, case.stage, case.metric, names, changes)
    pairs = list(zip(case.sized, distances, strict=True))
    exact = any(_is_exact(case, sized, by_form) for sized, by_form in pairs)
    return {
        "id": case.id,
        "number": case.number,
        "machine": plan.machine.name,
        "plan": plan.name,
        "kind": case.kind,
        "columns": list(plan.columns),
        "effects": [_effect_label(case, sized, by_form) for sized, by_form in pairs],
        "class": list(effects.EXACT) if exact else [],
        "sqrt_lambda": round(case.metric.size(case.clean - case.scene.y), 4),
        "noise": dataclasses.asdict(case.law),
        "readings": len(case.y),
        "seed": list(case.seed),
    }


def _is_exact(case: Case, sized: Sized, distances: dict[str, float]) -> bool:
    """Whether it is a member of the exact class here: the other one absorbs it whole."""
    if sized.effect.name not in effects.EXACT:
        return False
    whole = case.metric.size(sized.change)
    return all(distances.get(n, whole) < 0.02 * whole for n in effects.EXACT)


def _effect_label(
    case: Case,
    sized: Sized,
    distances: dict[str, float],
) -> dict[str, object]:
    """What the label states of an effect."""
    effect = sized.effect
    nearest = min(distances, key=lambda n: distances[n])
    total = case.metric.size(sized.change)
    beyond_textbook = distances.get(effect.name, total)
    sizes = {k: v * sized.amplitude for k, v in effect.unit.items()}
    return {
        "name": effect.name,
        "unknown": not sized.known,
        "target": sized.target,
        "sqrt_lambda": round(total, 4),
        "amplitude_um": round(1e6 * sized.amplitude, 5),
        "words": _words(sized),
        "blocks": list(effect.blocks),
        "about": effect.about | sizes,
        "legs": _leg_shares(case, sized),
        "beyond_textbook": round(beyond_textbook, 4),
        "nearest": nearest,
        "beyond_nearest": round(distances[nearest], 4),
        "beyond": {n: round(v, 3) for n, v in distances.items()},
    }


def _words(sized: Sized) -> str:
    """The size in words: `0.37 um at most, gap_um 0.74, leg 2`."""
    effect = sized.effect
    parts = [f"{1e6 * sized.amplitude:.3g} um at most"]
    parts += [f"{k} {v * sized.amplitude:.3g}" for k, v in effect.unit.items()]
    return ", ".join([*parts, *effect.blocks[:3]])


def _leg_shares(case: Case, sized: Sized) -> list[float]:
    """Share of each leg in the trace, for effects on joints; else empty."""
    push = sized.effect.push(sized.amplitude)
    if push.dq is None:
        return []
    eye = np.eye(push.dq.shape[1])
    parts = [
        case.metric.size(case.scene.response(scene.Push(dq=push.dq * eye[i]))) ** 2
        for i in range(len(eye))
    ]
    return [round(float(v), 4) for v in np.array(parts) / max(sum(parts), 1e-300)]
