"""From residuals to a verdict: the noise, which effects, where, how far, and what to do
next.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Collection, Iterable, Sequence
from typing import Literal

import numpy as np
from scipy import linalg

from oed.arrays import Array, Index
from oed.effect import Effect
from oed.gap.cause import advice, answers, closure, gate, pursuit, which
from oed.gap.cause.which import Hypothesis, Search
from oed.gap.data import evidence, noise
from oed.gap.data.diagnosis import UNKNOWN, Block, Closure, Coefficient, Diagnosis, Size
from oed.gap.data.metric import Metric
from oed.gap.data.problem import GapProblem
from oed.gap.forms import library, marks, spots, waves
from oed.gap.forms.library import Library
from oed.gap.forms.processes.catalogue import BROAD, PROCESSES
from oed.gap.place import locate
from oed.noise import estimate, outliers
from oed.noise.law import NoiseLaw

#: root mean square, in units of the noise, that each effect and process has at least in
#: the wide model, beside which noise is told
WIDE = 0.7
#: log evidence of no gap, and of a gap, by which a law must be better to be taken
BETTER, CLEARLY = 0.1, 0.3
#: change of a reading, in units of the stated noise, from which on it is another one
#: without what is far off
OTHER = 1.0
#: forms that an unknown remainder is said to be like, at most, and the least
#: probability of each
LIKE, LEAST_LIKE = 3, 0.03


def diagnose(
    problem: GapProblem,
    effects: Sequence[Effect],
    rng: np.random.Generator,
    *,
    law: NoiseLaw | None = None,
) -> Diagnosis:
    """Diagnose residuals with a library of effects. `law`: of the noise, where it is
    known but for its level; told from the readings if not given.
    """
    made = searches(problem, effects) if law is None else _under(problem, effects, law)
    hypotheses = which.compare(made)
    # draws of its own: what comes after does not depend on whether the gate was asked
    shares = gate.weighed(
        made, hypotheses, which.probabilities(hypotheses), rng.spawn(1)[0]
    )
    found, best = conclude(problem, made, hypotheses, effects, shares=shares)
    seen = made[best.law].problem  # without what is far off, where anything is
    if (
        found.verdict == "none"
    ):  # what the likeliest effect would close is told all the same, nil or not
        best = next((h for h in hypotheses if h.effects and not h.unknown), best)
    located, shrunk = _placed(seen, made[best.law], best, found, rng)
    return dataclasses.replace(found, where=located, closure=shrunk)


def _placed(
    problem: GapProblem,
    search: Search,
    best: Hypothesis,
    found: Diagnosis,
    rng: np.random.Generator,
) -> tuple[tuple[Block, ...], tuple[Closure, ...]]:
    """Where the gap lies (nowhere if there is none), and how far it shrinks on held-out
    readings.
    """
    told: tuple[Block, ...] = ()
    if found.verdict != "none":
        columns, labels = _carrying(search, best, [s.effect for s in found.sizes])
        sure = UNKNOWN not in found.answers[0].effects
        told = locate.locate(
            problem, found.law, rng, columns=columns, labels=labels, known=sure
        )
    forms = _forms(search, best) or [
        np.zeros((len(problem), 1))
    ]  # nothing to add closes nothing, and is told so
    splits: tuple[Literal["within", "whole"], ...] = ("within", "whole")
    shrunk = tuple(
        closure.closure(problem, found.law, forms, rng, split=split) for split in splits
    )
    return told, shrunk


def _carrying(
    search: Search, best: Hypothesis, named: Collection[str]
) -> tuple[Array | None, list[str] | None]:
    """Columns (N, k) of the named effects and of the unknown process, in all limbs, and
    the blocks they belong to.
    """
    parts = [
        (search.library, k)
        for e, k in zip(best.effects, best.atoms, strict=True)
        if e in named
    ]
    if best.process is not None:
        parts.append((search.processes, best.process))
    if not parts:
        return None, None
    chosen = [(source, _widest(source, atom)) for source, atom in parts]
    columns = np.hstack([source.columns[:, rows] for source, rows in chosen])
    return columns, [source.labels[c] for source, rows in chosen for c in rows]


def _widest(source: Library, atom: int) -> Index:
    """Columns of the form of the same effect and constants that has as many as it can
    have, in blocks if it has any.
    """
    mine = source.atoms[atom]
    same = [
        a.columns
        for a in source.atoms
        if (a.effect, a.constants) == (mine.effect, mine.constants)
    ]
    return max(
        same, key=lambda columns: (all(source.labels[c] for c in columns), len(columns))
    )


def _forms(search: Search, best: Hypothesis) -> list[Array]:
    """Columns (N, k), at their sizes, of the forms of the selected effects between
    which training readings choose.
    """
    made: dict[tuple[tuple[int, float], ...], Array] = {}
    level = search.level(best)

    def add(atoms: Sequence[int], sizes: Sequence[float]) -> None:
        parts = [
            level * s * search.library.columns[:, search.columns_of(k)]
            for k, s in zip(atoms, sizes, strict=True)
        ]
        if best.process is not None:
            process = search.processes.columns[
                :, search.processes.atoms[best.process].columns
            ]
            parts.append(level * best.process_size * process)
        if parts:
            made[tuple(zip(atoms, sizes, strict=True))] = np.hstack(parts)

    for i in range(max(len(best.atoms), 1)):
        for factor in (1.0, 0.5, 2.0):
            add(
                best.atoms,
                [s * factor if j == i else s for j, s in enumerate(best.sizes)],
            )
        for atom, size in search.alternatives(best, i) if best.atoms else []:
            add(
                [*best.atoms[:i], atom, *best.atoms[i + 1 :]],
                [*best.sizes[:i], size, *best.sizes[i + 1 :]],
            )
    return list(made.values())


def conclude(
    problem: GapProblem,
    made: Sequence[Search],
    hypotheses: Sequence[Hypothesis],
    effects: Sequence[Effect],
    *,
    shares: Array | None = None,
) -> tuple[Diagnosis, Hypothesis]:
    """The diagnosis that searches under several noise laws come to, without where and
    how far; and the hypothesis that its first answer stands for. `shares`:
    probabilities of the hypotheses, by their evidence if not given.
    """
    shares = which.probabilities(hypotheses) if shares is None else shares
    groups = answers.gathered(made, hypotheses, shares)
    told, best = answers.told(groups)
    search = made[best.law]
    named = {name for c in told[0].classes for name in c}
    found = _explained(
        problem, search, best, named if named & set(best.effects) else set(best.effects)
    )
    law = search.law_at(found.level)
    diagnosis = Diagnosis(
        problem=problem,
        verdict=answers.verdict(told[0]),
        answers=told,
        set95=answers.held(groups),
        marginal=_marginal(search.library.effects, hypotheses, shares),
        law=law,
        noise_words=estimate.words(problem, law),
        constants={
            e: search.library.atoms[k].constants
            for e, k in zip(best.effects, best.atoms, strict=True)
            if e in [s.effect for s in found.sizes]
        },
        coefficients=found.coefficients,
        sizes=found.sizes,
        explained=found.explained * problem.sigma,
        unexplained=found.unexplained * problem.sigma,
        likeness=_likeness(search, best) if UNKNOWN in told[0].effects else {},
        before=found.before * problem.sigma,
        after=found.after * problem.sigma,
        where=(),
        closure=(),
        not_testable=search.library.not_testable,
        confusable=tuple(
            dict.fromkeys(c for a in told[:1] for c in a.classes if len(c) > 1)
        ),
        next=advice.advise(told, effects, search.library.not_testable),
    )
    return diagnosis, best


def _likeness(search: Search, best: Hypothesis) -> dict[str, float]:
    """What the unknown remainder is like: the likeliest few forms."""
    if best.process is None:
        return {}
    return {
        form: share
        for form, share in list(search.likeness(best).items())[:LIKE]
        if share > LEAST_LIKE
    }


def _marginal(
    names: Iterable[str], hypotheses: Sequence[Hypothesis], shares: Array
) -> dict[str, float]:
    told = {
        n: float(
            sum(p for h, p in zip(hypotheses, shares, strict=True) if n in h.effects)
        )
        for n in names
    }
    return told | {
        UNKNOWN: float(
            sum(p for h, p in zip(hypotheses, shares, strict=True) if h.unknown)
        )
    }


# -- what the best hypothesis explains -------------------------------------------------


@dataclasses.dataclass(frozen=True)
class _Explained:
    """In units of the noise: parts of the residual, what the fit leaves without and
    with the effects.
    """

    coefficients: tuple[Coefficient, ...]
    sizes: tuple[Size, ...]
    explained: Array
    unexplained: Array
    before: Array
    after: Array
    level: float


def _explained(
    problem: GapProblem, search: Search, h: Hypothesis, named: Collection[str]
) -> _Explained:
    """Of a hypothesis; effects that are not `named` count with what is unknown."""
    metric = Metric(problem, search.law)
    known = search.library
    chosen = [known.atoms[k].columns for k in h.atoms]
    parts = [s * known.columns[:, c] for c, s in zip(chosen, h.sizes, strict=True)]
    extra = np.zeros((len(problem), 0))
    if h.process is not None:
        extra = (
            h.process_size
            * search.processes.columns[:, search.processes.atoms[h.process].columns]
        )
    columns = np.hstack([np.zeros((len(problem), 0)), *parts, extra])
    inner = metric.gram(columns, columns) + np.eye(columns.shape[1])
    told = metric.gram(columns, search.problem.residual[:, None])[:, 0]
    beta, spread = np.linalg.solve(inner, told), linalg.inv(inner)
    noise = search.level(h)
    known_part, coefficients, sizes, start = np.zeros(len(problem)), [], [], 0
    for effect, rows, size, part in zip(h.effects, chosen, h.sizes, parts, strict=True):
        here = slice(start, start + len(rows))
        start += len(rows)
        if effect not in named:
            continue
        signal = part @ beta[here]
        known_part = known_part + signal
        unit = size * known.scales[rows]
        sd = noise * np.sqrt(np.diag(spread)[here]) * unit
        coefficients += [
            Coefficient(effect, known.names[c], known.labels[c], float(m), float(s))
            for c, m, s in zip(rows, beta[here] * unit, sd, strict=True)
        ]
        energy = float(metric.gram(signal[:, None], signal[:, None])[0, 0])
        sizes.append(
            Size(
                effect,
                _by_channel(problem, signal),
                float(np.sqrt(max(energy, 0.0))) / noise,
            )
        )
    far = problem.residual - search.problem.residual
    before = _left(problem, metric, search.problem.residual) + far
    after = _left(problem, metric, search.problem.residual - known_part) + far
    unknown_part = columns @ beta - known_part
    return _Explained(
        tuple(coefficients),
        tuple(sizes),
        known_part,
        unknown_part,
        before,
        after,
        noise,
    )


def _by_channel(problem: GapProblem, signal: Array) -> dict[str, float]:
    """Root mean square, SI, of a change of the readings in each channel."""
    values = signal * problem.sigma
    names = problem.rows["channel"].to_numpy()
    return {
        str(n): float(np.sqrt(np.mean(values[names == n] ** 2)))
        for n in dict.fromkeys(names)
    }


def _left(problem: GapProblem, metric: Metric, residual: Array) -> Array:
    """What the parameters leave of a residual (N,) where they are fitted to it."""
    return residual - problem.slopes @ metric.fit(residual)


# -- searches --------------------------------------------------------------------------


def searches(problem: GapProblem, effects: Sequence[Effect]) -> list[Search]:
    """The search under each of the noise laws that suit the readings."""
    nothing = np.zeros((len(problem), 0))
    calm = noise.fit_law(problem, nothing)
    known = library.build(problem, effects, Metric(problem, calm[0]))
    processes = library.build(problem, PROCESSES)
    columns = _wide(known, processes)
    wide = noise.fit_law(problem, columns, calm[0])
    found = noise.detect_outliers(problem, wide[0], columns)
    if found is None:
        return _searched(problem, known, processes, [calm, wide])
    wide = noise.fit_law(noise.without_outliers(problem, found), columns, wide[0])
    found = (
        noise.detect_outliers(problem, wide[0], columns) or found
    )  # once more: the law was told with them
    clean = noise.without_outliers(problem, found)
    laws = [
        noise.fit_law(clean, nothing, calm[0]),
        noise.fit_law(clean, columns, wide[0]),
    ]
    made = _searched(clean, known, processes, laws, found)
    # what looks far off may be a gap, within a run at that
    made.append(Search(problem, known, _looked_for(processes, problem, calm[0]), *calm))
    best, raw = _gap(which.compare(made)), made[-1]
    gaps = [(raw, _gap(raw.run()))] + (
        [(made[best.law], best)] if made[best.law] is not raw else []
    )
    for search, gap in gaps:
        made += _beside_gap(problem, search, gap, columns, found)
    return made


def _beside_gap(
    problem: GapProblem,
    search: Search,
    gap: Hypothesis,
    columns: Array,
    before: outliers.Outliers,
) -> list[Search]:
    """Searches without what is far off from a gap, where that is less than is far off
    from any: a step's edges, say, which no smooth model has.
    """
    forms = _columns(search.library, search.processes, gap)
    found = noise.detect_outliers(problem, search.law, np.hstack([columns, forms]))
    clean = noise.without_outliers(problem, found)
    if np.abs(clean.residual - before.residual).max() < OTHER:
        return []
    laws = [
        noise.fit_law(clean, beside, search.law)
        for beside in (np.zeros((len(problem), 0)), forms)
    ]
    return [
        Search(clean, search.library, search.processes, *pair, found) for pair in laws
    ]


def _searched(
    problem: GapProblem,
    known: Library,
    processes: Library,
    laws: list[tuple[NoiseLaw, float]],
    far: outliers.Outliers | None = None,
) -> list[Search]:
    """The search under the laws beside nothing and beside the wide model, with their
    log priors, and under all that these lead to.
    """
    plain = laws[0][0]
    laws = [*laws, estimate.quiet(plain)]
    processes = _looked_for(processes, problem, plain)
    processes, beside = pursuit.pursued(processes, problem, [plain, laws[2][0]])
    for pair in beside:
        if not any(_same(pair[0], law) for law, _ in laws):
            laws.append(pair)
    made = [Search(problem, known, processes, *pair, far) for pair in laws]
    # what each law would have act is given the law that suits it: a load's runs, say,
    # are not taken for poor repeats
    tried: set[tuple[tuple[int, ...], int | None]] = set()
    for start in list(made):
        _refitted(made, start, _gap(start.run()), tried)
    best = _gap(which.compare(made))
    _refitted(made, made[best.law], best, tried)
    _alone(made, made[_gap(which.compare(made)).law].law)
    return made


def _looked_for(processes: Library, problem: GapProblem, law: NoiseLaw) -> Library:
    """The processes with those beside them that could sit anywhere: steady waves, fine
    marks, spots.
    """
    for kind in (waves, marks, spots):
        processes = kind.add(processes, problem, law)
    return processes


def _under(
    problem: GapProblem, effects: Sequence[Effect], law: NoiseLaw
) -> list[Search]:
    """The search under a noise law that is known."""
    known, processes = (
        library.build(problem, effects, Metric(problem, law)),
        library.build(problem, PROCESSES),
    )
    found = noise.detect_outliers(problem, law, _wide(known, processes))
    made = []
    for far in (None, found) if found is not None else (None,):
        seen = noise.without_outliers(problem, far)
        more, _ = pursuit.pursued(
            _looked_for(processes, seen, law), seen, [law], known=True
        )
        made.append(Search(seen, known, more, law, 0.0, far))
    return made


def _gap(told: Sequence[Hypothesis]) -> Hypothesis:
    """The best hypothesis that says there is a gap."""
    return next(h for h in told if h.effects or h.unknown)


def _refitted(
    made: list[Search],
    start: Search,
    best: Hypothesis,
    tried: set[tuple[tuple[int, ...], int | None]],
) -> None:
    """Add the search under the law that suits a hypothesis, unless it was tried or
    another suits it as well.
    """
    forms = (tuple(sorted(best.atoms)), best.process)
    if forms in tried:
        return
    tried.add(forms)
    columns = _columns(start.library, start.processes, best)
    pair = noise.fit_law(start.problem, columns, start.law)
    worth = _worth(
        start.problem, columns, [pair, *((s.law, s.log_prior) for s in made)]
    )
    if worth[0] > max(worth[1:]) + CLEARLY:
        made.append(
            Search(start.problem, start.library, start.processes, *pair, start.strays)
        )


def _alone(made: list[Search], start: NoiseLaw) -> None:
    """Add the search under the law that suits no gap best, begun at the law that suits
    the best gap: what that gains by a law of its own, no gap should gain too.
    """
    first = made[0]
    nothing = np.zeros((len(first.problem), 0))
    found = noise.fit_law(first.problem, nothing, start)
    worth = _worth(first.problem, nothing, [found])[0]
    if worth > max(s.grams.base + s.log_prior for s in made) + BETTER:
        made.append(
            Search(first.problem, first.library, first.processes, *found, first.strays)
        )


def _worth(
    problem: GapProblem, columns: Array, pairs: Sequence[tuple[NoiseLaw, float]]
) -> list[float]:
    """Log evidence beside columns (N, k) under each law, with its log prior."""
    slopes = evidence.compress(problem, columns)
    return [evidence.log_evidence(problem, law, slopes) + prior for law, prior in pairs]


def _same(a: NoiseLaw, b: NoiseLaw) -> bool:
    sizes = np.array([[v.repeat, v.wander, v.sway, np.log(v.reach)] for v in (a, b)])
    return bool(
        np.abs(sizes[0, :3] - sizes[1, :3]).max() < 0.05
        and abs(sizes[0, 3] - sizes[1, 3]) < 0.2
    )


def _wide(known: Library, processes: Library) -> Array:
    """Columns (N, k) that hold any gap: the middle form of every effect, and the broad
    processes.
    """
    chosen = []
    for source, names in (
        (known, known.effects),
        (processes, [e for e in processes.effects if e in BROAD]),
    ):
        for effect in names:
            atoms = source.atoms_of(effect)
            widest = max(len(source.atoms[k].columns) for k in atoms)
            full = [k for k in atoms if len(source.atoms[k].columns) == widest]
            columns = source.columns[:, source.atoms[full[len(full) // 2]].columns]
            chosen.append(columns * (WIDE / np.sqrt((columns**2).sum() / len(columns))))
    return np.hstack(chosen)


def _columns(known: Library, processes: Library, h: Hypothesis) -> Array:
    """Columns (N, k) of a hypothesis, each times its size."""
    parts = [
        size * known.columns[:, known.atoms[atom].columns]
        for atom, size in zip(h.atoms, h.sizes, strict=True)
    ]
    if h.process is not None:
        parts.append(
            h.process_size * processes.columns[:, processes.atoms[h.process].columns]
        )
    return np.hstack([np.zeros((known.columns.shape[0], 0)), *parts])
