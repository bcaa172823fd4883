"""Pool of candidate runs with the targets that they are to separate."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import linalg

from oed.base.arrays import Array, Index
from oed.gap.before.combinations import in_words
from oed.gap.before.forms import Form, effect_forms
from oed.gap.before.separation import Separation, Target
from oed.gap.data.problem import GapProblem
from oed.model.effect import Effect
from oed.noise.law import NoiseLaw

#: forms of an effect (values of its constants) that stand for its grid
FORMS = 6


def pool_runs(
    problem: GapProblem,
    law: NoiseLaw,
    rows: Sequence[Index],
    wanted: Sequence[Effect],
    rivals: Sequence[Effect] = (),
) -> Separation:
    """The separation of effects by candidate runs, as a function of their weights.

    problem    holds all candidates (`oed.gap.before.runs.prepare`)
    rows       (C,) readings of each run
    wanted     effects that are separated from each other and from the rivals
    rivals     further effects

    Of each wanted effect the coefficients of all legs alike, and each alone, are
    separated from each form of a rival. Its own constants are the middle ones of its
    grid. Raises ValueError for effects that no candidate can test.
    """
    effects = list({e.name: e for e in (*wanted, *rivals)}.values())
    forms = effect_forms(problem, effects, FORMS)
    for name, why in forms.reasons.items():
        raise ValueError(f"{name} cannot be tested by these candidates: {why}")
    targets: list[Target] = []
    for effect in wanted:
        for name, rival_forms in forms.by_effect.items():
            if name != effect.name:
                targets += _targets(forms.by_effect[effect.name], rival_forms)
    if not targets:
        raise ValueError("there is nothing to tell apart: give two effects at least")
    whiten = [law.factor(problem, at).whiten for at in rows]
    n, values = problem.slopes.shape[1], np.hstack([problem.slopes, forms.columns])
    prior = np.eye(n, values.shape[1])
    white = [whiten_run(values) for whiten_run in whiten]
    whole = np.vstack([*white, prior])
    change, log_scale = _convenient_coordinates(whole, n)
    changed = [x @ change for x in white]
    return Separation(
        grams=np.array([x.T @ x for x in changed]),
        base=(prior @ change).T @ (prior @ change),
        size=n,
        targets=tuple(targets),
        log_scale=log_scale,
    )


def _convenient_coordinates(whole: Array, n: int) -> tuple[Array, float]:
    """Change (m, m) to coordinates in which rounding does little harm.

    In these all rows (., m) together have unit information on the n parameters, and
    what the parameters can absorb of the effects is taken out. The second result is the
    log determinant that the parameters' information loses.
    """
    count = whole.shape[1] - n
    root = np.linalg.qr(whole[:, :n], mode="r")
    turned = linalg.solve_triangular(root, np.eye(n))
    absorbed = turned @ (turned.T @ (whole[:, :n].T @ whole[:, n:]))
    change = np.block([[turned, -absorbed], [np.zeros((count, n)), np.eye(count)]])
    return change, 2.0 * float(np.log(np.abs(np.diag(root))).sum())


def _targets(forms: Sequence[Form], rivals: Sequence[Form]) -> list[Target]:
    """Combinations of an effect's coefficients, each from each form of a rival."""
    middle = forms[len(forms) // 2]
    targets = []
    for members in _combinations(middle):
        shares = np.isin(middle.signature.names, members).astype(float)
        words = in_words(dict.fromkeys(members, 1.0))
        targets += [Target(middle, shares, words, rival) for rival in rivals]
    return targets


def _combinations(form: Form) -> list[list[str]]:
    """All legs alike, for each kind of textbook coefficient, and each one alone."""
    signature = form.signature
    kinds: dict[str, list[str]] = {}
    for k in np.flatnonzero(~signature.shape):
        name = signature.names[k]
        kind = name.removeprefix(signature.labels[k])
        kinds.setdefault(kind, []).append(name)
    alike = [kind for kind in kinds.values() if len(kind) > 1]
    return alike + [[name] for kind in kinds.values() for name in kind]
