"""Comparison of hypotheses: evidence over noise laws, probabilities, equivalent effects.

The noise law is a nuisance: the evidence of a set of effects is the sum over laws that
stand for all (`oed.gap.data.evidence`). Priors are fixed beforehand (`hypothesis.PRIOR`).

An equivalence class has the effects that are indistinguishable from a selected one. The
part of the readings that effect k explains, y_k = G_k beta_k, is fitted by a rival j:
what j cannot absorb of it, with the parameters and the other selected effects absorbing
too, is lambda_{k|j}. Where its root is below 5 the readings cannot distinguish the two,
and both belong to the answer. Effects of one family differ by their form alone: what a real
one's departure from its textbook form can make does not distinguish two of a family.

Where an effect is so large that its best form departs from the linear model by more than
the noise, the readings are linearised where it acts (`oed.gap.data.linearisation`) and
searched again. A hypothesis counts by the point that suits it best.
"""

import dataclasses
import functools
from collections.abc import Callable, Mapping, Sequence

import numpy as np
from scipy import special

from oed.base import Array, Index
from oed.effect_model import EFFECT_SIZES, Effect
from oed.gap.cause.search import Further, Hypothesis, Key, Search
from oed.gap.data.evidence import Grams
from oed.gap.data.linearisation import ActingEffectForm, settle
from oed.gap.data.problem import GapProblem, Metric

#: sqrt(lambda_{k|j}) below which a rival is indistinguishable from an effect
MIN_DISTINCT = 5.0
#: share of lambda_k that a rival leaves, below which no reading of this kind
#: distinguishes them
EXACT_SHARE = 0.002
#: log evidence by which a rival that leaves so little may be behind: as much as the
#: priors of sizes and forms can set two effects apart. One further behind leaves little
#: only because its form can be any
PRIOR_LOG_ODDS = 12.0
#: share of sqrt(lambda) that real effects keep outside their best textbook form: half, of
#: friction with presliding, play that is taken up, pitch errors of real screws
FORM_DEPARTURE = 0.5
#: largest size, against its expected one, that a rival may have where the effect is not
#: larger itself
MAX_RIVAL_SIZE = EFFECT_SIZES.usual[-1]
#: coefficient of a rival, in standard deviations of the largest usual size, that is usual
MAX_USUAL_COEFFICIENT = 3.0
#: departure from the linear model, in units of the noise over all readings, from which
#: it counts
MIN_DEPARTURE = 1.0
#: the searches of a problem, one a noise law
SearchOf = Callable[[GapProblem], list[Search]]


def compare(searches: Sequence[Search]) -> list[Hypothesis]:
    """Hypotheses with their evidence over all laws, best first, in their best forms;
    the effective number of laws is importance sampling's (Kong 1992).
    """
    by_key: dict[Key, list[Hypothesis]] = {}
    for number, search in enumerate(searches):
        for h in search.run():
            by_key.setdefault(h.key, []).append(dataclasses.replace(h, law=number))
    hypotheses = []
    for alike in by_key.values():
        values = np.array([h.log_evidence for h in alike])
        shares = special.softmax(values)
        over_laws = dataclasses.replace(
            max(alike, key=lambda h: h.log_evidence),
            log_evidence=float(special.logsumexp(values)),
            effective_laws=float(1.0 / np.sum(shares**2)),
        )
        hypotheses.append(over_laws)
    return sorted(hypotheses, key=lambda h: -h.score)


def probabilities(hypotheses: Sequence[Hypothesis]) -> Array:
    """Posterior probabilities of hypotheses."""
    return np.asarray(special.softmax([h.score for h in hypotheses]))


def equivalent_effects(
    search: Search, h: Hypothesis, scores: Mapping[Key, float], alive: float
) -> list[tuple[str, ...]]:
    """Names indistinguishable from each effect of a hypothesis, itself first."""
    return [_class_of(search, h, i, scores, alive) for i in range(len(h.effects))]


def _class_of(
    search: Search, h: Hypothesis, i: int, scores: Mapping[Key, float], alive: float
) -> tuple[str, ...]:
    """The names indistinguishable from the i-th effect of a hypothesis, itself first."""
    effect = h.effects[i]
    others, sizes = h.without(i)
    beside = [name for name in h.effects if name != effect]
    selected = [np.empty(0, dtype=np.intp), *map(search.columns_of, others)]
    grams = search.grams.project_out(np.concatenate(selected))

    @functools.cache
    def allowed_effects() -> dict[str, Further]:
        """Effects with all their forms and sizes, under the law of the search."""
        return search.screen(beside, others, sizes)

    def log_odds(rival: str) -> float:
        """Log evidence over the effect's; 0 beside an unknown remainder, which hides it."""
        if h.unknown:
            return 0.0
        rivals = allowed_effects()
        return rivals[rival].log_evidence - rivals[effect].log_evidence

    members = [effect]
    for rival in search.library.effects:
        if rival == effect:
            continue
        if rival in h.effects:  # it acts as well, and no reading may tell the two apart
            distinct, whole, _ = _distinct_energy(search, search.grams, h, i, rival)
            if distinct < EXACT_SHARE * whole:
                members.append(rival)
            continue
        distinct, whole, size = _distinct_energy(search, grams, h, i, rival)
        exact = distinct < EXACT_SHARE * whole and log_odds(rival) > -PRIOR_LOG_ODDS
        score = scores.get((frozenset({rival, *beside}), h.unknown), -np.inf)
        of_form = 0.0
        behind = alive
        is_usual = size < MAX_USUAL_COEFFICIENT * MAX_RIVAL_SIZE
        if is_usual and search.library.differ_by_form(effect, rival):
            # what a form can make that departs from its textbook, and its prior
            of_form = FORM_DEPARTURE**2 * whole
            behind = max(PRIOR_LOG_ODDS, 0.5 * of_form)
            if not h.unknown:
                score = max(score, h.score + log_odds(rival))
        near = score > h.score - behind
        if exact or (distinct < max(MIN_DISTINCT**2, of_form) and near):
            members.append(rival)
    return tuple(members)


def _distinct_energy(
    search: Search, grams: Grams, h: Hypothesis, i: int, rival: str
) -> tuple[float, float, float]:
    """lambda_{k|j} and lambda_k of the i-th effect of h, and the rival's largest coefficient.

    The rival has the form that absorbs most.
    """
    columns = search.columns_of(h.atoms[i])
    beta = posterior_mean(grams, columns, h.sizes[i])
    whole = float(beta @ grams.gram[np.ix_(columns, columns)] @ beta)
    least = whole
    size = 0.0
    for atom in search.library.atoms_of(rival):
        form = search.columns_of(atom)
        cross = grams.gram[np.ix_(form, columns)] @ beta
        precision = np.eye(len(form)) / max(MAX_RIVAL_SIZE, h.sizes[i]) ** 2
        inner = grams.gram[np.ix_(form, form)] + precision
        coefficients = np.linalg.solve(inner, cross)
        left = whole - float(cross @ coefficients)
        if left < least:
            least = left
            size = float(np.abs(coefficients).max())
    return max(least, 0.0), whole, size


def posterior_mean(grams: Grams, columns: Index, size: float) -> Array:
    """Posterior mean of the coefficients of `columns`, of prior N(0, size^2)."""
    precision = np.eye(len(columns)) / size**2
    inner = grams.gram[np.ix_(columns, columns)] + precision
    return np.asarray(np.linalg.solve(inner, grams.b[columns]))


#: probability from which a hypothesis is asked of withheld runs and of its sizes
MIN_ASKED = 0.002
#: probability from which the names of one whose sizes are not believed are left out
MIN_LEFT_OUT = 0.1


#: expected sizes beyond which a name is kept only where withheld runs prefer its form
MAX_UNCONFIRMED = 30.0


def without_implausible(
    searches: Sequence[Search], hypotheses: Sequence[Hypothesis]
) -> tuple[list[Hypothesis], tuple[str, ...]]:
    """Hypotheses, best first, and names left out: at sizes that are not to be believed.

    No machine has them, or they are beyond MAX_UNCONFIRMED and withheld runs are
    predicted better by an unknown. That one takes over the probability.
    """
    results = {h.key: h for h in hypotheses}
    left_out = []
    shares = probabilities(hypotheses)
    likely = [
        k for k, h in enumerate(hypotheses) if h.effects and shares[k] > MIN_ASKED
    ]
    # what takes over has fewer names, and may itself be left out then
    for k in sorted(likely, key=lambda k: -len(hypotheses[k].effects)):
        h = hypotheses[k]
        effects, sizes, limits = _sizes(searches[h.law], h)
        names = frozenset(effects[sizes > limits].tolist())
        is_impossible = bool(names)
        names = names or frozenset(effects[sizes > MAX_UNCONFIRMED].tolist())
        # an unknown in place of these names, or of all
        keys = dict.fromkeys([frozenset(h.effects) - names, frozenset()])
        carriers = [results[key, True] for key in keys if (key, True) in results]
        if not is_impossible:
            predicted = h.log_prediction
            carriers = [c for c in carriers if c.log_prediction > predicted]
        if not names or not carriers:
            continue
        _hand_over(results, h, carriers[0])
        left_out += sorted(names) if shares[k] > MIN_LEFT_OUT else []
    ranked = sorted(results.values(), key=lambda h: -h.score)
    return ranked, tuple(dict.fromkeys(left_out))


def without(hypotheses: Sequence[Hypothesis], key: Key) -> list[Hypothesis]:
    """Hypotheses, best first, without one: an unknown takes over its probability."""
    results = {h.key: h for h in hypotheses}
    carrier = results.get((frozenset(), True))
    if key in results and carrier is not None:
        _hand_over(results, results[key], carrier)
    return sorted(results.values(), key=lambda h: -h.score)


def _hand_over(
    results: dict[Key, Hypothesis], h: Hypothesis, carrier: Hypothesis
) -> None:
    """Add the probability of a hypothesis to a carrier's."""
    score = float(np.logaddexp(results[h.key].score, carrier.score))
    log_evidence = score - carrier.log_prior
    results[carrier.key] = dataclasses.replace(carrier, log_evidence=log_evidence)
    results[h.key] = dataclasses.replace(h, log_evidence=-np.inf)


def _sizes(search: Search, h: Hypothesis) -> tuple[Array, Array, Array]:
    """Of each coefficient (k,): its effect, its size in expected ones, and its limit."""
    forms = [search.columns_of(k) for k in h.atoms]
    counts = [len(form) for form in forms]
    columns = h.columns(search.library, search.processes)
    metric = Metric(search.problem, search.law)
    residual = search.problem.residual
    mean = metric.posterior(columns, residual)[0][: sum(counts)]
    sizes = np.abs(np.repeat(h.sizes, counts) * mean)
    limits = np.array(search.library.limits)[np.concatenate(forms)]
    return np.repeat(h.effects, counts), sizes, limits


@dataclasses.dataclass(frozen=True)
class Comparison:
    """Hypotheses by log posterior, best first, and the searches that they come from.

    The law of a hypothesis is the number of its search.
    """

    searches: tuple[Search, ...]
    hypotheses: tuple[Hypothesis, ...]


def compare_expanded(
    problem: GapProblem, effects: Sequence[Effect], search: SearchOf
) -> Comparison:
    """Hypotheses of a problem, about other points as well where effects are large."""
    first = search(problem)
    comparison = Comparison(tuple(first), tuple(compare(first)))
    tried: set[Key] = set()
    for _ in range(3):
        expanded = _next_point(comparison, effects, tried)
        if expanded is None:
            break
        acting, moved = expanded
        comparison = _joined(comparison, search(moved), acting)
    return comparison


def _next_point(
    comparison: Comparison, effects: Sequence[Effect], tried: set[Key]
) -> tuple[frozenset[str], GapProblem] | None:
    """The next hypothesis of large effects, the readings linearised about it."""
    named = [h for h in comparison.hypotheses if h.effects]
    single = [h for h in named if len(h.effects) == 1 and not h.unknown]
    for h in [*single[:1], *named[:1]]:
        if h.key in tried:
            continue
        tried.add(h.key)
        search = comparison.searches[h.law]
        outlying = search.problem.residual - search.given.residual
        forms = acting_forms(search, h, effects)
        settled = settle(search.given, forms, search.law, outlying)
        if MIN_DEPARTURE < settled.departure < np.inf:
            return frozenset(h.effects), settled.problem
    return None


def acting_forms(
    search: Search, h: Hypothesis, effects: Sequence[Effect]
) -> list[ActingEffectForm]:
    """The forms of a hypothesis' effects."""
    by_name = {effect.name: effect for effect in effects}
    library = search.library
    return [
        ActingEffectForm(
            by_name[name],
            library.atoms[atom].constants,
            library.coefficients_of(atom),
            size,
        )
        for name, atom, size in zip(h.effects, h.atoms, h.sizes, strict=True)
    ]


def _joined(
    comparison: Comparison, further: Sequence[Search], acting: frozenset[str]
) -> Comparison:
    """The hypotheses, those of some acting effects about a further point."""
    offset = len(comparison.searches)
    by_key = {
        h.key: h for h in comparison.hypotheses if not acting <= frozenset(h.effects)
    }
    for h in compare(further):
        there = dataclasses.replace(h, law=offset + h.law)
        by_key[h.key] = max(by_key.get(h.key, there), there, key=lambda h: h.score)
    hypotheses = sorted(by_key.values(), key=lambda h: -h.score)
    return Comparison((*comparison.searches, *further), tuple(hypotheses))
