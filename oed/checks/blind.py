"""Which mistakes readings cannot reveal: said before the measurement.

Each mistake is undone in noise-free readings of a machine that does not have it. Where
the result fits as well, readings with the mistake would as well.
"""

from __future__ import annotations

import numpy as np

from oed.checks.fit import fit, linear_model
from oed.checks.mistakes import Alternatives, variants
from oed.checks.session import SessionReadings
from oed.simulation import draw_parameters

#: penalised sum of squares that noise-free readings may gain without a trace
UNSEEN = 25.0
#: linear misfit, in the stated noise, beyond which a variant is not fitted
FAR = 100.0


def unseen_mistakes(
    session: SessionReadings, alternatives: Alternatives, rng: np.random.Generator
) -> list[str]:
    """Mistakes, as sentences without a full stop, that would pass unnoticed."""
    measurement = session.measurement
    truth = draw_parameters(measurement, rng)
    exact = session.with_y(measurement.readings(session.series, truth))
    plain = fit(exact)
    if plain is None:
        return []
    limit = plain.penalised + UNSEEN
    unseen = []
    model = linear_model(exact)
    for variant in variants(exact, alternatives):
        varied = variant.session
        same_poses = _same_poses(varied, exact)
        if same_poses and np.array_equal(varied.y, exact.y):
            continue
        of_poses = model if varied.series is exact.series else linear_model(varied)
        if of_poses is None or of_poses.penalised(varied.y) > FAR**2 * len(varied):
            continue
        solution = fit(varied)
        if solution is not None and solution.penalised <= limit:
            unseen.append(variant.what)
    return unseen


def _same_poses(one: SessionReadings, other: SessionReadings) -> bool:
    pairs = zip(one.series, other.series, strict=True)
    return all(a.setup == b.setup and np.array_equal(a.q, b.q) for a, b in pairs)
